"""SU2 (.su2) and Wavefront (.obj) files, of which meshio loses names and foreign lines.

A mesh read here remembers the file's lines, so that what torchmesh has no use for (FFD boxes,
materials, texture coordinates, normals, comments) is written back as it was.
"""

import itertools
import re
import warnings
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
        return _su2_of(stream)


def _su2_of(lines: Iterator[str]) -> tuple[meshio.Mesh, list[str]]:
    """From the file's lines, of which no more are held at a time than a section has."""
    points: np.ndarray | None = None
    rest: list[str] = []
    cells: list[tuple[str, int, np.ndarray]] = []
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
            rows = _rows(lines, int(value.split()[0]), "NPOIN")
            numbers, starts, widths = _numbers(rows, "NPOIN")
            if len(rows) and widths.min() < 2:
                raise ValueError(f"a point needs two coordinates: {rows[int(widths.argmin())].strip()!r}")
            points = numbers[starts[:, None] + np.arange(2)]
        elif key == "NMARK":
            markers = int(value)
        elif key == "MARKER_TAG":
            name, found = value, found + 1
            if not name:
                raise ValueError("a MARKER_TAG has no name")
            if name not in names:
                number = int(name) if re.fullmatch(r"\d+", name) and int(name) > 0 else 1
                while number in names.values():
                    number += 1
                names[name] = number
            tag = names[name]
        elif key in ("NELEM", "MARKER_ELEMS"):
            own = tag if key == "MARKER_ELEMS" else 0
            for kind, nodes in _su2_elements(_rows(lines, int(value), key), key):
                if cells and cells[-1][:2] == (kind, own):
                    nodes = np.concatenate([cells.pop()[2], nodes])
                cells.append((kind, own, nodes))
        elif line.strip():
            rest.append(line.rstrip("\n"))
    if points is None or not cells:
        raise ValueError("it has no NPOIN or no NELEM section")
    if found != markers:
        raise ValueError(f"NMARK says {markers} markers, the file has {found}")
    data = {"su2:tag": [np.full(len(nodes), own) for _, own, nodes in cells]}
    groups = {name: np.array([number, 1]) for name, number in names.items()}
    return meshio.Mesh(points, [(k, nodes) for k, _, nodes in cells], cell_data=data, field_data=groups), rest


def _su2_elements(rows: list[str], section: str) -> Iterator[tuple[str, np.ndarray]]:
    """Runs of elements of one kind: its name and (n, width) nodes."""
    numbers, starts, widths = _numbers(rows, section)
    kinds = numbers[starts]
    ends = [0, *(1 + np.flatnonzero(np.diff(kinds))).tolist(), len(rows)]
    for begin, end in itertools.pairwise(ends):
        if begin == end:
            continue
        kind = int(kinds[begin])
        if kind not in _SU2_KINDS:
            raise ValueError(f"element type {kind} is not planar or not known")
        name, width = _SU2_KINDS[kind]
        short = widths[begin:end] < 1 + width
        if short.any():
            row = rows[begin + int(short.argmax())].strip()
            raise ValueError(f"an element of type {kind} needs {width} points: {row!r}")
        nodes = numbers[starts[begin:end, None] + 1 + np.arange(width)]
        if (nodes != np.floor(nodes)).any():
            row = rows[begin + int((nodes != np.floor(nodes)).any(1).argmax())].strip()
            raise ValueError(f"the points of an element are whole numbers: {row!r}")
        yield name, nodes.astype(np.int64)


def _numbers(rows: list[str], section: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All numbers of the rows, where each row begins among them, and how many it has."""
    widths = np.fromiter((len(row.split()) for row in rows), np.int64, len(rows))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            numbers = np.fromstring(" ".join(rows), sep=" ") if rows else np.zeros(0)
            complete = len(numbers) == widths.sum()
        except (DeprecationWarning, ValueError):
            complete = False
    if not complete:
        raise ValueError(f"{section} has a row that is not numbers: {_not_numbers(rows)!r}")
    return numbers, np.cumsum(widths) - widths, widths


def _not_numbers(rows: list[str]) -> str:
    """The first row that is not numbers only."""
    for row in rows:
        try:
            [float(word) for word in row.split()]
        except ValueError:
            return row.strip()
    return ""


def _rows(lines: Iterator[str], count: int, section: str) -> list[str]:
    """The next `count` lines that hold something, without the remarks at their ends."""
    rows: list[str] = []
    while len(rows) < count:
        more = list(itertools.islice(lines, count - len(rows)))
        if not more:
            raise ValueError(f"{section} says {count}, the file ends after {len(rows)}")
        more = [line.split("%", 1)[0] if "%" in line else line for line in more]
        rows += [line for line in more if not line.isspace() and line]
    return rows


def number_lines(table: np.ndarray, before: str = "") -> Iterator[str]:
    """The rows (n, m) as lines of text, `before` in front of each, some thousands at a time.

    Each number is as short as gives it back to the bit.
    """
    line = before + " ".join(["%r"] * table.shape[1]) + "\n"
    for start in range(0, len(table), 1 << 14):
        part = table[start : start + (1 << 14)]
        yield line * len(part) % tuple(part.reshape(-1).tolist())


def write_su2(path: str, mesh: meshio.Mesh, rest: list[str]) -> None:
    """Points (V, 2), triangles and quads; line cells as markers by their `su2:tag` or physical group."""
    key = next((k for k in ("su2:tag", "gmsh:physical") if k in mesh.cell_data), None)
    key = key or next((k for k, v in mesh.cell_data.items() if all(np.asarray(b).dtype.kind in "iu" for b in v)), None)
    names = {int(v[0]): name for name, v in mesh.field_data.items() if np.shape(v) == (2,) and int(v[1]) == 1}
    inner = [block for block in mesh.cells if block.type in ("triangle", "quad")]
    members: dict[int, list[str]] = {tag: [] for tag in names}
    counts = dict.fromkeys(names, 0)
    for i, block in enumerate(mesh.cells):
        if block.type in ("triangle", "quad"):
            continue
        tags = np.asarray(mesh.cell_data[key][i]) if key else np.ones(len(block.data), np.int64)
        for tag in dict.fromkeys(tags.tolist()):
            rows = block.data[tags == tag]
            members.setdefault(tag, []).extend(number_lines(rows, f"{_SU2_NUMBERS[block.type]} "))
            counts[tag] = counts.get(tag, 0) + len(rows)
    with open(path, "w", encoding="utf-8", errors="surrogateescape") as stream:
        stream.write(f"NDIME= 2\nNELEM= {sum(len(block.data) for block in inner)}\n")
        for block in inner:
            stream.writelines(number_lines(block.data, f"{_SU2_NUMBERS[block.type]} "))
        stream.write(f"NPOIN= {len(mesh.points)}\n")
        stream.writelines(number_lines(np.asarray(mesh.points)))
        stream.write(f"NMARK= {len(members)}\n")
        for tag, lines in members.items():
            name = "_".join(names.get(tag, str(tag)).split())
            stream.write(f"MARKER_TAG= {name}\nMARKER_ELEMS= {counts[tag]}\n")
            stream.writelines(lines)
        stream.writelines(line + "\n" for line in rest)


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
