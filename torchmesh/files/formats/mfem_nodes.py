"""Curved elements of MFEM: a section of nodes in place of coordinates of vertices, as functions of order 1 or 2.

    nodes
    FiniteElementSpace
    FiniteElementCollection: H1_2D_P2
    VDim: 2
    Ordering: 1            x and y of a node side by side; 0: first all x, then all y

Nodes are those of the vertices, then those of the edges, then those of the quads.  MFEM numbers edges in the order in
which they first come up in the elements, so that flips change their order: `Layout` finds it.

    rows of the mesh    vertices | middles of edges | middles of quads     as the file has them when it is read
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import meshio
import numpy as np

from .text_numbers import number_lines, with_words
from .text_tables import Reader, TextTables

_SECTION = ("FiniteElementSpace", r"FiniteElementCollection:\s*(\S+)", r"VDim:\s*(\d+)", r"Ordering:\s*([01])")

# The names of continuous functions of an order whose values at nodes are positions.
_ORDERS = {"Linear": 1, "Quadratic": 2}
_NAME = re.compile(r"H1(?:@[GU])?_2D_P(\d+)")

# Cells with nodes at their sides: the number of their corners.
CURVED = {"triangle6": 3, "quad8": 4, "quad9": 4, "line3": 2}
_CORNERS = {"triangle": 3, "quad": 4, **{kind: n for kind, n in CURVED.items() if n > 2}}


@dataclass(frozen=True)
class NodeValues:
    """The section of nodes in the text.

    order     1 or 2
    by_axis   do all values of one axis stand together
    lines, words  (n,) where each value stands
    values    (N, 2) or (N, 3) the positions in MFEM's order
    """

    order: int
    by_axis: bool
    lines: np.ndarray
    words: np.ndarray
    values: np.ndarray


def read_nodes(reader: Reader) -> NodeValues:
    """The section of nodes, whose head has been read.  Raises ValueError for functions of other kinds."""
    found = []
    for pattern in _SECTION:
        row = reader.text("the nodes")
        match = re.fullmatch(pattern, row)
        if match is None:
            raise ValueError(f"its nodes should have a row {pattern.split(':')[0]}: {row[:60]!r}")
        found.append(match)
    name, width, by_axis = found[1][1], int(found[2][1]), found[3][1] == "0"
    match = _NAME.fullmatch(name)
    order = int(match[1]) if match else _ORDERS.get(name, 0)
    if order not in (1, 2):
        discontinuous = "; they are periodic or torn at edges" if name.startswith("L2") else ""
        raise ValueError(
            f"its elements are curved by {name}{discontinuous}; continuous ones of order 1 and 2 can be improved: "
            "save it after SetCurvature(2, false) in MFEM"
        )
    if not 2 <= width <= 3:
        raise ValueError(f"its nodes have {width} coordinates instead of 2 or 3")
    lines: list[int] = []
    words: list[int] = []
    values: list[float] = []
    while reader.left and not reader.texts[reader.at][0].isalpha():
        number, texts = reader.numbers[reader.at], reader.text("the nodes").split()
        try:
            values += [float(word) for word in texts]
        except ValueError:
            raise ValueError(f"its nodes have a row that is not numbers: {' '.join(texts)[:60]!r}") from None
        lines += [number] * len(texts)
        words += range(len(texts))
    if len(values) % width:
        raise ValueError(f"its nodes have {len(values)} numbers, which are no rows of {width}")
    table = np.array(values).reshape((width, -1) if by_axis else (-1, width))
    return NodeValues(order, by_axis, np.array(lines), np.array(words), table.T if by_axis else table)


@dataclass(frozen=True)
class Layout:
    """Which rows of a mesh are MFEM's nodes.

    vertices  rows of vertices, in their order
    edges     (E, 2) the ends of edges in MFEM's order, as rows
    at_edges  (E,) rows of the nodes of edges; -1 where there is none
    quads     rows of quads in file order, by their corners (Q, 4), and of their middles (Q,), -1 where there is none
    """

    vertices: np.ndarray
    edges: np.ndarray
    at_edges: np.ndarray
    quads: np.ndarray
    at_quads: np.ndarray

    @classmethod
    def of(cls, cells: Sequence[tuple[str, np.ndarray]], vertices: np.ndarray) -> "Layout":
        """The layout for cells in file order."""
        count = int(vertices.max(initial=-1)) + 1
        edges, middles = [np.zeros((0, 2), np.int64)], [np.zeros(0, np.int64)]
        quads, centres = [np.zeros((0, 4), np.int64)], [np.zeros(0, np.int64)]
        for kind, nodes in cells:
            if kind not in _CORNERS:
                continue
            n = _CORNERS[kind]
            corners, rest = nodes[:, :n], nodes[:, n:]
            edges.append(np.stack([corners, np.roll(corners, -1, 1)], 2).reshape(-1, 2))
            middles.append(rest[:, :n].reshape(-1) if rest.shape[1] else np.full(corners.size, -1))
            if n == 4:
                quads.append(corners)
                centres.append(rest[:, 4] if rest.shape[1] == 5 else np.full(len(corners), -1))
        every, at = np.concatenate(edges), np.concatenate(middles)
        keys = every.min(1) * count + every.max(1)
        known, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
        # An edge between a straight and a curved element has the node of the curved one.
        node = np.full(len(known), -1)
        np.maximum.at(node, inverse.reshape(-1), at)
        order = np.argsort(first)
        return cls(vertices, every[first[order]], node[order], np.concatenate(quads), np.concatenate(centres))

    def nodes_of(self, edges: np.ndarray) -> np.ndarray:
        """(K,) the numbers of edges (K, 2) among MFEM's; -1 for none."""
        count = int(self.vertices.max(initial=-1)) + 1
        keys, wanted = (e.min(1) * count + e.max(1) for e in (self.edges, edges))
        order = np.argsort(keys)
        if not len(order):
            return np.full(len(edges), -1)
        at = np.minimum(np.searchsorted(keys[order], wanted), len(order) - 1)
        return np.where(keys[order][at] == wanted, order[at], -1)

    def values(self, points: np.ndarray, order: int) -> np.ndarray:
        """(N, k) the positions of MFEM's nodes; edges and quads without nodes of their own have their middles."""
        parts = [points[self.vertices]]
        if order == 2:
            ends = points[self.edges].mean(1)
            sides = np.where(self.at_edges[:, None] >= 0, points[self.at_edges], ends)
            parts.append(sides)
            around = np.stack(
                [self.nodes_of(np.stack([self.quads[:, k], self.quads[:, k - 3]], 1)) for k in range(4)], 1
            )
            corners = points[self.quads].sum(1)
            inside = sides[around].sum(1) / 2 - corners / 4  # as eight-node quads have it
            parts.append(np.where(self.at_quads[:, None] >= 0, points[self.at_quads], inside))
        return np.concatenate(parts)


def curved_cells(
    blocks: list[tuple[str, bool, np.ndarray, np.ndarray]], vertices: int, nodes: NodeValues
) -> list[np.ndarray]:
    """The cells of each block with their nodes of order 2, in meshio's order.  Raises ValueError for missing nodes."""
    flat = [(kind, cells) for kind, border, cells, _ in blocks if not border]
    layout = Layout.of(flat, np.arange(vertices))
    quads = len(layout.quads)
    wanted = vertices + len(layout.edges) * (nodes.order == 2) + quads * (nodes.order == 2)
    if len(nodes.values) != wanted:
        raise ValueError(f"its nodes have {len(nodes.values)} positions instead of {wanted}")
    if nodes.order == 1:
        return [cells for _, _, cells, _ in blocks]
    made, quad = [], 0
    for kind, border, cells, _ in blocks:
        sides = cells.shape[1] if kind != "line" else 1
        if kind == "vertex":
            made.append(cells)
            continue
        ends = np.stack([cells[:, :sides], np.roll(cells, -1, 1)[:, :sides]], 2)
        at = layout.nodes_of(ends.reshape(-1, 2)).reshape(len(cells), sides)
        if (at < 0).any():
            raise ValueError("a part of its boundary is no edge of an element")
        columns = [cells, vertices + at]
        if kind == "quad" and not border:
            columns.append((vertices + len(layout.edges) + quad + np.arange(len(cells)))[:, None])
            quad += len(cells)
        made.append(np.concatenate(columns, 1))
    return made


@dataclass
class CurvedTables(TextTables):
    """The text of a mesh with a section of nodes.

    nodes     that section
    vertices  the number of vertices, which are the first rows
    borders   for each block whether it is of the boundary
    """

    nodes: NodeValues
    vertices: int = 0
    borders: list[bool] = field(default_factory=list)

    def patched(self, before: meshio.Mesh, after: meshio.Mesh) -> list[str]:
        flat = np.zeros((0, before.points.shape[1]))
        straight = [meshio.Mesh(flat, [(b.type, _corners(b)) for b in mesh.cells]) for mesh in (before, after)]
        lines = super().patched(*(_renamed(mesh) for mesh in straight))
        old, new = (self._values(mesh) for mesh in (before, after))
        old, new = (table.T.reshape(-1) if self.nodes.by_axis else table.reshape(-1) for table in (old, new))
        for k in np.flatnonzero((old != new) & ~((old != old) & (new != new))).tolist():
            number = int(self.nodes.lines[k])
            lines[number] = with_words(lines[number], int(self.nodes.words[k]), [repr(float(new[k]))])
        return lines

    def _values(self, mesh: meshio.Mesh) -> np.ndarray:
        cells = [(b.type, b.data) for b, border in zip(mesh.cells, self.borders, strict=True) if not border]
        width = self.nodes.values.shape[1]
        return Layout.of(cells, np.arange(self.vertices)).values(mesh.points[:, :width], self.nodes.order)


def _corners(block: meshio.CellBlock) -> np.ndarray:
    return block.data[:, : CURVED.get(block.type, block.data.shape[1])]


def _renamed(mesh: meshio.Mesh) -> meshio.Mesh:
    """The mesh of corners, with the types of straight cells."""
    names = {2: "line", 3: "triangle", 4: "quad"}
    cells = [(b.type if b.type not in CURVED else names[b.data.shape[1]], b.data) for b in mesh.cells]
    return meshio.Mesh(mesh.points, cells)


def without_middles(mesh: meshio.Mesh) -> tuple[list[tuple[str, np.ndarray]], Layout]:
    """The cells by their corners, which are numbered anew, and where the nodes are in the old rows."""
    middle = np.zeros(len(mesh.points), bool)
    for block in mesh.cells:
        if block.type in CURVED:
            middle[block.data[:, CURVED[block.type] :]] = True
    vertices = np.flatnonzero(~middle)
    row = np.cumsum(~middle) - 1
    names = {2: "line", 3: "triangle", 4: "quad"}
    cells = [(names.get(_corners(b).shape[1], b.type), row[_corners(b)]) for b in mesh.cells]
    faces = [(b.type, b.data) for b in mesh.cells if b.type in _CORNERS]
    return cells, Layout.of(faces, vertices)


def node_lines(values: np.ndarray, order: int) -> Iterator[str]:
    """The section of nodes of a new file."""
    yield f"\nnodes\nFiniteElementSpace\nFiniteElementCollection: H1_2D_P{order}\n"
    yield f"VDim: {values.shape[1]}\nOrdering: 1\n\n"
    yield from number_lines(values)
