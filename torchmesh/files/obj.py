"""Wavefront OBJ files: vertices, faces and everything else of the file."""

from dataclasses import dataclass, field

import meshio
import numpy as np


@dataclass(frozen=True)
class ObjFile:
    """An .obj file's lines; which of them are vertices, and which the rows of each cell block."""

    lines: list[str]
    vertices: list[int] = field(default_factory=list)
    blocks: list[list[int]] = field(default_factory=list)


def read_obj(path: str) -> tuple[meshio.Mesh, ObjFile]:
    """The mesh, its groups (lines `o`, `g`, `usemtl`) numbered in the cell data `obj:group_ids`."""
    with open(path, encoding="utf-8", errors="surrogateescape") as stream:
        file = ObjFile(stream.read().splitlines())
    points: list[list[float]] = []
    blocks: list[tuple[str, int, list[list[int]]]] = []
    groups: dict[tuple[str, ...], int] = {}
    state = {"o": "", "g": "", "usemtl": ""}
    for number, line in enumerate(file.lines):
        key, *words = line.split() or [""]
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
    data = {"obj:group_ids": [np.full(len(rows), group) for _, group, rows in blocks]} if len(groups) > 1 else {}
    return meshio.Mesh(np.array(points).reshape(-1, 3), cells, cell_data=data), file


def write_obj(path: str, mesh: meshio.Mesh, file: ObjFile | None) -> None:
    """The lines of `file`, vertices and faces renewed where they changed; a new file without one."""
    if file is None:
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.points.tolist()]
        groups = mesh.cell_data.get("obj:group_ids")
        for i, block in enumerate(mesh.cells):
            last, letter = None, "l" if block.type == "line" else "f"
            for j, row in enumerate((block.data + 1).tolist()):
                if groups is not None and (last is None or groups[i][j] != last):
                    last = groups[i][j]
                    lines.append(f"g group_{last}")
                lines.append(f"{letter} {' '.join(map(str, row))}")
    else:
        lines = list(file.lines)
        for number, point in zip(file.vertices, mesh.points.tolist(), strict=True):
            words = lines[number].split()
            if [float(word) for word in words[1:4]] != point:
                lines[number] = " ".join(["v", *map(repr, point), *words[4:]])
        _renew_faces(lines, mesh, file)
    with open(path, "w", encoding="utf-8", errors="surrogateescape") as stream:
        stream.write("\n".join(lines) + "\n")


def _renew_faces(lines: list[str], mesh: meshio.Mesh, file: ObjFile) -> None:
    """New triangles keep texture and normal (`vertex/texture/normal`) where each corner has only one."""
    known: dict[int, set[str]] = {}
    stale: list[tuple[int, list[int]]] = []
    above = np.searchsorted(file.vertices, np.arange(len(lines))).tolist()  # vertices before each line
    for numbers, block in zip(file.blocks, mesh.cells, strict=True):
        for number, row in zip(numbers, block.data.tolist(), strict=True):
            words = lines[number].split()[1:]
            corners = [int(word.split("/")[0]) for word in words]
            rows = [c - 1 if c > 0 else above[number] + c for c in corners]
            for corner, word in zip(rows, words, strict=True):
                known.setdefault(corner, set()).add("/".join([str(corner + 1), *word.split("/")[1:]]))
            if rows != row:
                stale.append((number, row))
    for number, row in stale:
        plain = any(len(known.get(c, ())) != 1 or "-" in next(iter(known[c])) for c in row)
        words = [str(corner + 1) if plain else next(iter(known[corner])) for corner in row]
        lines[number] = " ".join(["f", *words])
