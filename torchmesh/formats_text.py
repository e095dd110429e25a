"""SU2 (.su2) and Wavefront (.obj) files, of which meshio loses names and foreign lines.

A mesh read here remembers the file's lines, so that what torchmesh has no use for (FFD boxes,
materials, texture coordinates, normals, comments) is written back as it was.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import meshio
import numpy as np

_SU2_KINDS = {1: ("vertex", 1), 3: ("line", 2), 5: ("triangle", 3), 9: ("quad", 4)}
_SU2_NUMBERS = {name: number for number, (name, _) in _SU2_KINDS.items()}


def read_su2(path: str) -> tuple[meshio.Mesh, list[str]]:
    """The mesh, and the lines that are none of its points, elements and markers.

    Markers become line cells with the integer cell data `su2:tag` (0 on other cells); their names
    stand in the field data as {name: [tag, 1]}, as Gmsh's groups do.  Raises ValueError for what is
    not a complete planar SU2 mesh.
    """
    with open(path, encoding="utf-8", errors="surrogateescape") as stream:
        lines = iter(stream.read().splitlines())
    points: np.ndarray | None = None
    rest: list[str] = []
    cells: list[tuple[str, list[list[int]]]] = []
    tags: list[int] = []
    names: dict[str, int] = {}
    tag = markers = found = 0
    for line in lines:
        match = re.match(r"\s*(\w+)\s*=\s*([^%]*)", line)
        key, value = (match[1].upper(), match[2].strip()) if match else ("", "")
        if key == "NDIME":
            if int(value) != 2:
                raise ValueError("NDIME is not 2: only planar meshes can be improved")
        elif key == "NZONE":
            if int(value) != 1:
                raise ValueError("it has several zones; give each zone its own file")
        elif key == "NPOIN":
            table = [row.split()[:2] for row in _rows(lines, int(value.split()[0]), "NPOIN")]
            points = np.array(table, float).reshape(len(table), 2)
        elif key == "NMARK":
            markers = int(value)
        elif key == "MARKER_TAG":
            name, found = value.split()[0], found + 1
            if name not in names:
                number = int(name) if re.fullmatch(r"\d+", name) and int(name) > 0 else 1
                while number in names.values():
                    number += 1
                names[name] = number
            tag = names[name]
        elif key in ("NELEM", "MARKER_ELEMS"):
            for row in _rows(lines, int(value), key):
                kind, *nodes = [int(word) for word in row.split()]
                if kind not in _SU2_KINDS:
                    raise ValueError(f"element type {kind} is not planar or not known")
                name, width = _SU2_KINDS[kind]
                if len(nodes) < width:
                    raise ValueError(f"an element of type {kind} needs {width} points: {row.strip()!r}")
                own = tag if key == "MARKER_ELEMS" else 0
                if not cells or (cells[-1][0], tags[-1]) != (name, own):
                    cells.append((name, []))
                    tags.append(own)
                cells[-1][1].append(nodes[:width])
        elif line.strip():
            rest.append(line)
    if points is None or not cells:
        raise ValueError("it has no NPOIN or no NELEM section")
    if found != markers:
        raise ValueError(f"NMARK says {markers} markers, the file has {found}")
    blocks = [(name, np.array(rows, np.int64)) for name, rows in cells]
    data = {"su2:tag": [np.full(len(rows), t) for (_, rows), t in zip(blocks, tags, strict=True)]}
    return meshio.Mesh(points, blocks, cell_data=data, field_data={n: np.array([t, 1]) for n, t in names.items()}), rest


def _rows(lines: Iterator[str], count: int, section: str) -> list[str]:
    """The next `count` lines that hold something."""
    rows: list[str] = []
    while len(rows) < count:
        line = next(lines, None)
        if line is None:
            raise ValueError(f"{section} says {count}, the file ends after {len(rows)}")
        if line.strip() and not line.lstrip().startswith("%"):
            rows.append(line)
    return rows


def write_su2(path: str, mesh: meshio.Mesh, rest: list[str]) -> None:
    """Points (V, 2), triangles and quads; line cells as markers by their `su2:tag` or physical group."""
    key = next((k for k in ("su2:tag", "gmsh:physical") if k in mesh.cell_data), None)
    key = key or next((k for k, v in mesh.cell_data.items() if all(np.asarray(b).dtype.kind in "iu" for b in v)), None)
    names = {int(v[0]): name for name, v in mesh.field_data.items() if np.shape(v) == (2,) and int(v[1]) == 1}
    body: list[str] = []
    members: dict[int, list[str]] = {tag: [] for tag in names}
    for i, block in enumerate(mesh.cells):
        rows = [f"{_SU2_NUMBERS[block.type]} {' '.join(map(str, row))}" for row in block.data.tolist()]
        if block.type in ("triangle", "quad"):
            body += rows
            continue
        tags = mesh.cell_data[key][i].tolist() if key else [1] * len(rows)
        for tag, row in zip(tags, rows, strict=True):
            members.setdefault(tag, []).append(row)
    lines = ["NDIME= 2", f"NELEM= {len(body)}", *body, f"NPOIN= {len(mesh.points)}"]
    lines += [f"{x!r} {y!r}" for x, y in mesh.points.tolist()]
    lines.append(f"NMARK= {len(members)}")
    for tag, rows in members.items():
        lines += [f"MARKER_TAG= {'_'.join(names.get(tag, str(tag)).split())}", f"MARKER_ELEMS= {len(rows)}", *rows]
    with open(path, "w", encoding="utf-8", errors="surrogateescape") as stream:
        stream.write("\n".join(lines + rest) + "\n")


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
