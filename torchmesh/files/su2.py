"""SU2 (.su2) and Wavefront (.obj) files, of which meshio loses names and foreign lines.

A mesh read here remembers the file's lines, so that what torchmesh has no use for (FFD boxes,
materials, texture coordinates, normals, comments) is written back as it was.
"""

import itertools
import re
from collections.abc import Iterator

import meshio
import numpy as np

from .text_numbers import _numbers, _rows, number_lines

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
