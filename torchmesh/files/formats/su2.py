"""SU2's planar mesh files (.su2).

meshio loses the names of markers and all lines that it does not know.  Here all lines of a file are kept; those of
points and elements are renewed where they change.  A mesh with other points or elements gets new sections, after which
the lines come that belong to none (boxes for free-form deformation, comments, ...).
"""

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np

from ..fields import region_tag
from .format import FLAT, LINEAR, Document, Format, counted_through
from .groups import names_of, one_word_each, said_of_words
from .su2_zones import Su2Lines, dimension, flat_points, numbers_in_zones, read_zones, section_rows, zones_of
from .text_numbers import number_lines, numbers_of

_TAG = "su2:tag"

# The name of all markers that say which points are periodic images of one another.
PERIODIC = "SEND_RECEIVE"

# SU2's number of each element type: meshio's name for it, its number of nodes.
_KINDS = {1: ("vertex", 1), 3: ("line", 2), 5: ("triangle", 3), 9: ("quad", 4)}

# VTK's numbers of planar elements of higher orders, as Gmsh writes them into SU2's files.
_HIGHER = (21, 22, 23, 28, 68, 69, 70)

_NUMBERS = {name: number for number, (name, _) in _KINDS.items()}


@dataclass(frozen=True)
class Su2Format(Format):
    """The `rest` of a document is a `Su2Lines`.  A file of several zones is only ever changed in place."""

    def read(self, path: Path) -> Document:
        """Markers become line cells with the integer cell data `su2:tag`, which is 0 on other cells.

        The names of markers stand in the field data as {name: [tag, 1]}, as Gmsh's groups do.
        """
        with open(path, encoding="utf-8", errors="surrogateescape", newline="") as stream:
            if zones_of(list(itertools.islice(stream, 200))) > 1:
                stream.seek(0)
                zones, file = read_zones(list(stream), _elements, _TAG)
                nodes, cells = numbers_in_zones(zones, file)
                return Document(zones, self.name, rest=file, node_numbers=nodes, cell_numbers=cells)
            stream.seek(0)
            mesh, file = _parse(list(stream))
        return Document(mesh, self.name, rest=file, cell_numbers=counted_through(mesh, 0, FLAT))

    def patches(self, document: Document) -> bool:
        return document.rest.several

    def patch(self, path: Path, mesh: meshio.Mesh, like: Document) -> None:
        with open(path, "w", encoding="utf-8", errors="surrogateescape", newline="") as stream:
            stream.writelines(like.rest.patched(mesh))

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        if like is not None and same_rows:
            self.patch(path, mesh, like)
            return
        with open(path, "w", encoding="utf-8", errors="surrogateescape") as stream:
            stream.writelines(_lines(mesh, like.rest.height if like is not None else None))
            stream.writelines(line + "\n" for line in (like.rest.rest if like is not None else []))

    def fit(self, mesh: meshio.Mesh) -> tuple[meshio.Mesh, set[str]]:
        """Beside what other formats do, vertices of a group are a marker of its name, and triangles have no groups."""
        fitted, lost = super().fit(mesh)
        tag = region_tag(mesh)
        if _TAG in fitted.cell_data:
            blocks = zip(fitted.cells, fitted.cell_data[_TAG], strict=True)
            if len({int(n) for block, values in blocks if block.dim == 2 for n in np.unique(values)}) > 1:
                lost.add(f"cell data {tag!r} of triangles and quads")
        for name in [name for name, value in fitted.field_data.items() if int(value[1]) == 2]:
            del fitted.field_data[name]
            lost.add(f"field data {name!r}")
        if tag != _TAG:
            _number_vertices(fitted)
        return fitted, lost

    def conversions(self, mesh: meshio.Mesh) -> list[str]:
        return said_of_words(names_of(mesh, (0, 1)))

    def left_behind(self, document: Document, target: Format, same_rows: bool) -> list[str]:
        file: Su2Lines = document.rest
        periodic = ["the pairs of periodic points (SEND_RECEIVE)"] if PERIODIC in document.mesh.field_data else []
        if target is self:
            comments = ["comments at the ends of lines"] if file.remarks else []
            return [] if same_rows else [*periodic, *comments]
        rest = file.rest
        comments = ["comments"] if file.remarks or any(line.lstrip().startswith("%") for line in rest) else []
        lines = [f"lines such as {line.strip()!r}" for line in rest if not line.lstrip().startswith("%")][:1]
        return [*periodic, *lines, *comments]


SU2 = Su2Format(
    "su2", (".su2",), ("vertex", *LINEAR), point_data="none", cell_data="regions", region_name=_TAG,
    field_data=True, names_only=True, planar=True,
)  # fmt: skip


def _parse(lines: list[str]) -> tuple[meshio.Mesh, Su2Lines]:
    """The mesh and where in the lines it stands.

    Raises ValueError for anything but a complete planar mesh of one zone.
    """
    points: np.ndarray | None = None
    file = Su2Lines(lines)
    cells: list[tuple[str, int, np.ndarray]] = []
    names: dict[str, int] = {}
    tag = markers = found = 0
    width = 2
    numbered = iter(enumerate(lines))
    for _, line in numbered:
        match = re.match(r"\s*(\w+)\s*=\s*([^%]*)", line)
        key, value = (match[1].upper(), match[2].strip()) if match else ("", "")
        if key == "NDIME":
            width = dimension(value)
        elif key == "NZONE":
            pass
        elif key == "NPOIN":
            at, rows = section_rows(numbered, int(value.split()[0]), "NPOIN")
            file.points += at
            numbers, starts, widths = numbers_of(rows, "NPOIN")
            points, height = flat_points(rows, numbers, starts, widths, width)
            file.height = height if width == 3 else None
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
            at, rows = section_rows(numbered, int(value), key)
            for kind, nodes in _elements(rows, key):
                here, at = at[: len(nodes)], at[len(nodes) :]
                if cells and cells[-1][:2] == (kind, own):
                    nodes, here = np.concatenate([cells.pop()[2], nodes]), [*file.cells.pop(), *here]
                cells.append((kind, own, nodes))
                file.cells.append(here)
        elif line.strip():
            file.rest.append(line.rstrip("\r\n"))
            continue
        file.remarks |= "%" in line
    if points is None or not cells:
        raise ValueError("it has no NPOIN or no NELEM section")
    if found != markers:
        raise ValueError(f"NMARK says {markers} markers, the file has {found}")
    data = {_TAG: [np.full(len(nodes), own) for _, own, nodes in cells]}
    of_lines = {own for kind, own, _ in cells if kind != "vertex"}
    of_points = {own for kind, own, _ in cells if kind == "vertex"} - of_lines
    groups = {name: np.array([number, int(number not in of_points)]) for name, number in names.items()}
    file.starts = [0] * len(cells)
    file.remarks |= any("%" in lines[number] for numbers in [file.points, *file.cells] for number in numbers)
    return meshio.Mesh(points, [(k, nodes) for k, _, nodes in cells], cell_data=data, field_data=groups), file


def _number_vertices(mesh: meshio.Mesh) -> None:
    """Gives groups of vertices numbers that no groups of lines have: a marker is known by its number alone."""
    if _TAG not in mesh.cell_data:
        return
    tags = mesh.cell_data[_TAG]
    lines = {
        int(n) for block, values in zip(mesh.cells, tags, strict=True) if block.dim == 1 for n in np.unique(values)
    }
    lines |= {int(value[0]) for value in mesh.field_data.values() if int(value[1]) == 1}
    names = {int(value[0]): name for name, value in mesh.field_data.items() if int(value[1]) == 0}
    new: dict[int, int] = {}
    points = [i for i, block in enumerate(mesh.cells) if block.dim == 0]
    for number in {int(n) for i in points for n in np.unique(tags[i])}:
        new[number] = number if number not in lines else 1 + max(*lines, *new.values(), *names)
        if number in names:
            mesh.field_data[names[number]] = np.array([new[number], 0])
    for i in points:
        tags[i] = np.array([new[number] for number in tags[i].tolist()], np.int64)


def _elements(rows: list[str], section: str) -> Iterator[tuple[str, np.ndarray]]:
    """Runs of elements of one type: its name and the nodes (n, width)."""
    numbers, starts, widths = numbers_of(rows, section)
    kinds = numbers[starts]
    ends = [0, *(1 + np.flatnonzero(np.diff(kinds))).tolist(), len(rows)]
    for begin, end in itertools.pairwise(ends):
        if begin == end:
            continue
        kind = int(kinds[begin])
        if kind not in _KINDS:
            what = "of higher order, which SU2 does not have" if kind in _HIGHER else "not planar or not known"
            raise ValueError(f"element type {kind} is {what}")
        name, width = _KINDS[kind]
        short = widths[begin:end] < 1 + width
        if short.any():
            row = rows[begin + int(short.argmax())].strip()
            raise ValueError(f"an element of type {kind} needs {width} points: {row!r}")
        nodes = numbers[starts[begin:end, None] + 1 + np.arange(width)]
        if (nodes != np.floor(nodes)).any():
            row = rows[begin + int((nodes != np.floor(nodes)).any(1).argmax())].strip()
            raise ValueError(f"the points of an element are whole numbers: {row!r}")
        yield name, nodes.astype(np.int64)


def _lines(mesh: meshio.Mesh, height: float | None = None) -> Iterator[str]:
    """The file of a mesh with points (V, 2), in runs of whole lines.

    Triangles and quads are its elements; lines and vertices are markers by their `su2:tag`.

    height  the third coordinate of all points; None for a file of two dimensions
    """
    names = {int(v[0]): name for name, v in mesh.field_data.items() if np.shape(v) == (2,) and int(v[1]) < 2}
    paired = {tag for tag, name in names.items() if name == PERIODIC}  # they hold for the points that were
    names = {tag: name for tag, name in names.items() if tag not in paired}
    words = one_word_each(names.values())
    inner = [block for block in mesh.cells if block.type in ("triangle", "quad")]
    members: dict[int, list[str]] = {tag: [] for tag in names}
    counts = dict.fromkeys(names, 0)
    for i, block in enumerate(mesh.cells):
        if block.type in ("triangle", "quad"):
            continue
        tags = mesh.cell_data[_TAG][i] if _TAG in mesh.cell_data else np.ones(len(block.data), np.int64)
        for tag in dict.fromkeys(tag for tag in tags.tolist() if tag not in paired):
            rows = block.data[tags == tag]
            members.setdefault(tag, []).extend(number_lines(rows, f"{_NUMBERS[block.type]} "))
            counts[tag] = counts.get(tag, 0) + len(rows)
    yield f"NDIME= {2 if height is None else 3}\nNELEM= {sum(len(block.data) for block in inner)}\n"
    for block in inner:
        yield from number_lines(block.data, f"{_NUMBERS[block.type]} ")
    yield f"NPOIN= {len(mesh.points)}\n"
    third = np.full((len(mesh.points), int(height is not None)), height, float)
    yield from number_lines(np.column_stack([mesh.points, third]))
    yield f"NMARK= {len(members)}\n"
    for tag, lines in members.items():
        name = words[names[tag]] if tag in names else str(tag)
        yield f"MARKER_TAG= {name}\nMARKER_ELEMS= {counts[tag]}\n"
        yield from lines
