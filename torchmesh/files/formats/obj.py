"""Wavefront's files (.obj).

meshio loses materials, texture coordinates, normals and comments.  Here all lines of a file are kept; those of
vertices and faces are renewed where they change.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

import meshio
import numpy as np

from .format import LINEAR, Document, Format

_GROUPS = "obj:group_ids"

# What a line begins with, and what it says, that is lost in other formats.
_FOREIGN = {
    "vt": "texture coordinates", "vn": "normals", "mtllib": "materials", "o": "names of objects",
    "g": "names of groups", "usemtl": "names of materials", "s": "smoothing groups", "#": "comments", "p": "points",
    "vp": "parameters",
}  # fmt: skip


@dataclass(frozen=True)
class ObjFile:
    """The lines of a file.

    vertices  the numbers of the lines that are vertices
    blocks    for each cell block the numbers of the lines that are its cells
    """

    lines: list[str]
    vertices: list[int] = field(default_factory=list)
    blocks: list[list[int]] = field(default_factory=list)


@dataclass(frozen=True)
class ObjFormat(Format):
    """The `rest` of a document is an ObjFile."""

    def read(self, path: Path) -> Document:
        with open(path, encoding="utf-8", errors="surrogateescape") as stream:
            mesh, file = _parse(stream.read().splitlines())
        return Document(mesh, self.name, rest=file, node_numbers=1 + np.arange(len(mesh.points)))

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        lines = _renewed(like.rest, mesh) if like is not None and same_rows else _lines(mesh)
        with open(path, "w", encoding="utf-8", errors="surrogateescape") as stream:
            stream.write("\n".join(lines) + "\n")

    def left_behind(self, document: Document, target: Format, same_rows: bool) -> list[str]:
        if target is self and same_rows:
            return []
        begins = {words[0] for line in document.rest.lines if (words := line.replace("#", "# ", 1).split())}
        if all(re.fullmatch(r"g group_\d+", line) for line in document.rest.lines if line.startswith("g ")):
            begins.discard("g")  # these are the numbers of regions, as `_lines` writes them
        return [text for word, text in _FOREIGN.items() if word in begins]


OBJ = ObjFormat(
    "obj", (".obj",), (*LINEAR, "polygon"), point_data="none", cell_data="regions", region_name=_GROUPS, counts=False
)


def _parse(lines: list[str]) -> tuple[meshio.Mesh, ObjFile]:
    """The mesh, with its groups (lines `o`, `g`, `usemtl`) numbered in the cell data `obj:group_ids`."""
    file = ObjFile(lines)
    points: list[list[float]] = []
    blocks: list[tuple[str, int, list[list[int]]]] = []
    groups: dict[tuple[str, ...], int] = {}
    state = {"o": "", "g": "", "usemtl": ""}
    for number, line in enumerate(file.lines):
        key, *words = line.split("#", 1)[0].split() or [""]
        if key == "v":
            if len(words) < 3:
                raise ValueError(f"line {number + 1} needs three coordinates: {line.strip()!r}")
            points.append([float(word) for word in words[:3]])
            file.vertices.append(number)
        elif key in state:
            state[key] = " ".join(words)
        elif key in ("f", "l"):
            corners = [int(word.split("/")[0]) for word in words]
            corners = [c - 1 if c > 0 else len(points) + c for c in corners]
            fit = {2: "line"} if key == "l" else {3: "triangle", 4: "quad"}
            kind = fit.get(len(corners), "polygon" if key == "f" and len(corners) > 4 else "")
            if not kind:
                raise ValueError(f"line {number + 1} has {len(corners)} corners: {line.strip()!r}")
            group = groups.setdefault(tuple(state.values()), len(groups))
            if not blocks or blocks[-1][:2] != (kind, group) or len(blocks[-1][2][0]) != len(corners):
                blocks.append((kind, group, []))
                file.blocks.append([])
            blocks[-1][2].append(corners)
            file.blocks[-1].append(number)
    cells = [(kind, np.array(rows, np.int64)) for kind, _, rows in blocks]
    data = {_GROUPS: [np.full(len(rows), group) for _, group, rows in blocks]} if len(groups) > 1 else {}
    return meshio.Mesh(np.array(points).reshape(-1, 3), cells, cell_data=data), file


def _lines(mesh: meshio.Mesh) -> list[str]:
    """The lines of a new file."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.points.tolist()]
    groups = mesh.cell_data.get(_GROUPS)
    for i, block in enumerate(mesh.cells):
        last, letter = None, "l" if block.type == "line" else "f"
        for j, row in enumerate((block.data + 1).tolist()):
            if groups is not None and (last is None or groups[i][j] != last):
                last = groups[i][j]
                lines.append(f"g group_{last}")
            lines.append(f"{letter} {' '.join(map(str, row))}")
    return lines


def _renewed(file: ObjFile, mesh: meshio.Mesh) -> list[str]:
    """The lines of `file`, with the vertices and faces of `mesh` where they differ."""
    lines = list(file.lines)
    for number, point in zip(file.vertices, mesh.points.tolist(), strict=True):
        text, *remark = lines[number].split("#", 1)
        words = text.split()
        if [float(word) for word in words[1:4]] != point:
            lines[number] = " ".join(["v", *map(repr, point), *words[4:], *(f"#{more}" for more in remark)])
    _renew_faces(lines, mesh, file)
    return lines


def _renew_faces(lines: list[str], mesh: meshio.Mesh, file: ObjFile) -> None:
    """Faces with new corners keep texture and normal (`vertex/texture/normal`) if each corner has only one pair."""
    known: dict[int, set[str]] = {}
    stale: list[tuple[int, list[int]]] = []
    above = np.searchsorted(file.vertices, np.arange(len(lines))).tolist()  # the number of vertices before each line
    for numbers, block in zip(file.blocks, mesh.cells, strict=True):
        for number, row in zip(numbers, block.data.tolist(), strict=True):
            words = lines[number].split("#", 1)[0].split()[1:]
            corners = [int(word.split("/")[0]) for word in words]
            rows = [c - 1 if c > 0 else above[number] + c for c in corners]
            for corner, word in zip(rows, words, strict=True):
                known.setdefault(corner, set()).add("/".join([str(corner + 1), *word.split("/")[1:]]))
            if rows != row:
                stale.append((number, row))
    for number, row in stale:
        plain = any(len(known.get(c, ())) != 1 or "-" in next(iter(known[c])) for c in row)
        words = [str(corner + 1) if plain else next(iter(known[corner])) for corner in row]
        remark = lines[number].split("#", 1)[1:]
        lines[number] = " ".join(["f", *words, *(f"#{text}" for text in remark)])
