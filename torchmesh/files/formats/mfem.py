"""MFEM's meshes of version 1 (.mesh), which share their extension with Medit's.

    MFEM mesh v1.0
    dimension 2
    elements  n, then rows of: attribute, geometry, vertices counted from 0
    boundary  the same for the elements of the boundary
    vertices  n, then the number of coordinates, then rows of coordinates
    nodes     instead of these: positions that curve the elements (mfem_nodes.py)

https://mfem.org/mesh-formats/
"""

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import meshio
import numpy as np

from .format import FLAT, LINEAR, Document, counted_through
from .mfem_nodes import CURVED, CurvedTables, NodeValues, curved_cells, node_lines, read_nodes, without_middles
from .text_numbers import number_lines
from .text_tables import Reader, Rows, TextFormat, TextTables, groups_by_tag, tagged, whole

ATTRIBUTE = "mfem:attribute"

# MFEM's number of each geometry: meshio's name for it, its number of vertices.
_KINDS = {0: ("vertex", 1), 1: ("line", 2), 2: ("triangle", 3), 3: ("quad", 4)}
_NUMBERS = {name: number for number, (name, _) in _KINDS.items()}
_SECOND = {"line": "line3", "triangle": "triangle6", "quad": "quad9"}

_SETS = ("attribute_sets", "bdr_attribute_sets")


@dataclass
class _Parts:
    """What is read of a file: blocks as (type, is it on the boundary, nodes, attributes), and where their rows are."""

    blocks: list[tuple[str, bool, np.ndarray, np.ndarray]] = field(default_factory=list)
    rows: list[Rows] = field(default_factory=list)
    points: np.ndarray | None = None
    points_at: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    vertices: int = 0
    nodes: NodeValues | None = None
    sets: dict[str, list[int]] = field(default_factory=dict)
    skipped: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class MfemFormat(TextFormat):
    """Attributes are the cell data `mfem:attribute`; the boundary with attribute 3 is called attribute-3.

    Version 1.3 has names for sets of attributes, which then are the names of these parts of the boundary.
    """

    def recognises(self, head: bytes) -> bool:
        return head.lstrip().startswith(b"MFEM")

    def parse(self, lines: list[str], path: Path) -> Document:
        reader = Reader(lines, "#")
        head = reader.text("its first line")
        if not re.fullmatch(r"MFEM mesh v1\.[0-3]", head):
            raise ValueError(
                f"{head[:40]!r} is not of the versions 1.0 to 1.3 of MFEM's format, as mesh.Save writes them"
            )
        parts = _Parts()
        while reader.left:
            self._read_section(reader.text("a section"), reader, parts)
        if parts.nodes is not None:
            parts.points = parts.nodes.values
        if parts.points is None or not parts.blocks:
            raise ValueError("it has no elements or no vertices")
        cells = [(kind, nodes) for kind, _, nodes, _ in parts.blocks]
        edges = [(nodes, tags) for kind, border, nodes, tags in parts.blocks if border and kind == "line"]
        if parts.nodes is not None:
            made = curved_cells(parts.blocks, parts.vertices, parts.nodes)
            second = _SECOND if parts.nodes.order == 2 else {}
            cells = [(second.get(kind, kind), nodes) for (kind, _), nodes in zip(cells, made, strict=True)]
        mesh = meshio.Mesh(parts.points, cells, cell_data={ATTRIBUTE: [tags for *_, tags in parts.blocks]})
        sides = groups_by_tag([nodes for nodes, _ in edges], [tags for _, tags in edges], "attribute")
        for name, members in parts.sets.items():
            sides[name] = np.concatenate([np.zeros((0, 2), np.int64), *(n[np.isin(t, members)] for n, t in edges)])
        labels = np.arange(len(parts.points))
        tables = TextTables(lines, Rows(parts.points_at, 0), parts.rows, labels)
        if parts.nodes is not None:
            borders = [border for _, border, _, _ in parts.blocks]
            nowhere = Rows(np.zeros(0, np.int64), 0)
            tables = CurvedTables(lines, nowhere, parts.rows, labels, parts.nodes, parts.vertices, borders)
        comments = ["comments"] if any(line.split("#")[1:] for line in lines[1:]) else []
        return Document(
            mesh, self.name, rest=tables, sides=sides, skipped=(*parts.skipped, *comments),
            cell_numbers=counted_through(mesh, 0, (*FLAT, "triangle6", "quad9")),
        )  # fmt: skip

    def _read_section(self, key: str, reader: Reader, parts: _Parts) -> None:
        if key == "dimension":
            if reader.whole("the dimension") != [2]:
                raise ValueError("its dimension is not 2: only planar meshes can be improved")
        elif key in ("elements", "boundary"):
            (count,) = reader.whole(f"the number of {key}")
            at, numbers, starts, widths = reader.table(count, 3, key)
            _read_elements(key, at, numbers, starts, widths, parts)
        elif key == "vertices":
            (count,) = reader.whole("the number of vertices")
            parts.vertices = count
            if reader.left and not re.fullmatch(r"\d+", reader.texts[reader.at]):
                return  # nodes follow, which have the positions
            (width,) = reader.whole("the number of coordinates")
            if not 2 <= width <= 3:
                raise ValueError(f"its vertices have {width} coordinates instead of 2 or 3")
            parts.points_at, parts.points = reader.columns(count, width, "vertices")
        elif key == "nodes":
            parts.nodes = read_nodes(reader)
        elif key in _SETS:
            parts.skipped.append(f"the {key}")
            (count,) = reader.whole(f"the number of {key}")
            for _ in range(count):
                name, members = _read_set(reader, key)
                if key == "bdr_attribute_sets":
                    parts.sets[name] = members
        elif key != "mfem_mesh_end":
            raise ValueError(f"its section {key[:40]!r} is not known")

    def new_lines(self, mesh: meshio.Mesh, like: Document | None) -> Iterator[str]:
        groups: dict[bool, list[np.ndarray]] = {False: [], True: []}
        points = np.asarray(mesh.points)
        if points.shape[1] == 3 and not points[:, 2].any():
            points = points[:, :2]
        cells, layout = [(block.type, block.data) for block in mesh.cells], None
        second = any(block.type in CURVED for block in mesh.cells)
        if second or (like is not None and isinstance(like.rest, CurvedTables)):
            cells, layout = without_middles(mesh)
        for i, (kind, data) in enumerate(cells):
            border = kind in ("line", "vertex")
            head = np.column_stack([tagged(mesh, ATTRIBUTE, i, 1), np.full(len(data), _NUMBERS[kind])])
            head[:, 0] = np.maximum(head[:, 0], 1)  # attributes are positive
            groups[border].append(np.column_stack([head, data]))
        yield "MFEM mesh v1.0\n\ndimension\n2\n"
        for border, name in ((False, "elements"), (True, "boundary")):
            yield f"\n{name}\n{sum(map(len, groups[border]))}\n"
            for table in groups[border]:
                yield from number_lines(table)
        if layout is not None:
            yield f"\nvertices\n{len(layout.vertices)}\n"
            yield from node_lines(layout.values(points, 1 + second), 1 + second)
            return
        yield f"\nvertices\n{len(points)}\n{points.shape[1]}\n"
        yield from number_lines(points)


def _read_elements(
    key: str, at: np.ndarray, numbers: np.ndarray, starts: np.ndarray, widths: np.ndarray, parts: _Parts
) -> None:
    """Adds the runs of elements of one geometry."""
    kinds = whole(numbers[starts + 1], f"the geometries of {key}")
    ends = [0, *(1 + np.flatnonzero(np.diff(kinds))).tolist(), len(kinds)]
    for begin, end in itertools.pairwise(ends):
        if begin == end:
            continue
        if int(kinds[begin]) not in _KINDS:
            raise ValueError(f"geometry {kinds[begin]} is not planar or not known")
        name, width = _KINDS[int(kinds[begin])]
        if (widths[begin:end] < 2 + width).any():
            raise ValueError(f"one of its {key} of geometry {kinds[begin]} needs {width} vertices")
        table = whole(numbers[starts[begin:end, None] + np.arange(2 + width)], key)
        parts.blocks.append((name, key == "boundary", table[:, 2:], table[:, 0]))
        parts.rows.append(Rows(at[begin:end], 2))


# The extension .mfem is ours: it says that a new file is not to be one of Medit's.
MFEM = MfemFormat("mfem", (".mfem", ".mesh"), ("vertex", *LINEAR, *CURVED), point_data="none", cell_data="regions",
                  region_name=ATTRIBUTE)  # fmt: skip


def _read_set(reader: Reader, key: str) -> tuple[str, list[int]]:
    """The name of a set of attributes, in quotes or a word, and its members, which may stand on further lines."""
    row = reader.text(f"one of the {key}")
    if (begun := re.fullmatch(r'(?:"([^"]*)"|([^\s"]+))((?:\s+\d+)*)', row)) is None:
        raise ValueError(f"a row of {key} is not a name and numbers: {row[:60]!r}")
    name = begun[1] if begun[2] is None else begun[2]
    words = begun[3].split()
    while not words or len(words) <= int(words[0]):
        more = reader.text(f"the numbers of {name!r}").split()
        if not more or not all(re.fullmatch(r"\d{1,9}", word) for word in more):
            raise ValueError(f"a number of {name!r} among the {key} is none: {' '.join(more)[:60]!r}")
        words += more
    return name, [int(word) for word in words[1 : 1 + int(words[0])]]
