r"""What can be moved by name: the parts of a mesh that a file or its shape gives a name to.

+------outlet------+     outer:1, hole:1     the loops of the boundary, round triangles and quads
|    /--\          |     outlet, cylinder    named lines and sides: physical groups, markers, side sets
|    \--/ cylinder |     solid, material:2   cells with a name or number: physical surfaces, blocks
+------------------+     probes              named points: node sets

Where quads stand on a part, layer upon layer, they are to go along with it: `Part.layer`.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from ..mesh.boundary_parts import boundary_parts
from ..mesh.connectivity import edge_components, keys_of
from .content import Content
from .source import Source
from .walls import groups, lines_of

# Parts of these kinds are bodies or points, and have no edges of their own.
LOOP, LINES, CELLS, POINTS = "loop", "lines", "cells", "points"

# A layer of quads has so many columns side by side.
_SIDE_BY_SIDE = 3


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a mesh that has a name.

    name       how it is called
    kind       "loop", "lines", "cells" or "points"
    vertices   (N,) int64, ascending
    edges      (K, 2) int64; of cells those on their outline
    layer      (L,) int64, the further vertices of the layers of quads that stand on it
    base       (L,) int64, for each of these the vertex of the part that it stands on
    triangles  how many triangles have an edge on it; of cells how many they are
    quads      likewise
    """

    name: str
    kind: str
    vertices: Tensor
    edges: Tensor
    layer: Tensor
    base: Tensor
    triangles: int
    quads: int

    def length(self, points: Tensor) -> float:
        """The length of its edges, in the unit of the mesh."""
        return float((points[self.edges[:, 1]] - points[self.edges[:, 0]]).norm(dim=1).sum())


def parts_of(source: Source) -> dict[str, Part]:
    """The parts of a file's mesh by name: loops, named lines and sides, named cells, named points."""
    content, count = source.content, len(source.mesh.points)
    cells = _Cells.of(source)
    found: dict[str, Part] = {}
    halves = torch.cat([cells.triangles, cells.quads[:, :3], cells.quads[:, [0, 2, 3]]])
    for name, loop in boundary_parts(source.mesh, halves).items():
        found[name] = cells.part(name, LOOP, loop.unique(), torch.stack([loop, loop.roll(-1)], 1))
    lines: dict[str, list[Tensor]] = {}
    for name, edges in lines_of(content):
        lines.setdefault(name, []).append(edges)
    for name, several in lines.items():
        edges = torch.cat(several)
        if len(edges):
            found.setdefault(name, cells.part(name, LINES, edges.unique(), edges))
    known = {part.vertices.numpy().tobytes() for part in found.values()}
    for name, edges in _numbered(content, "line"):
        if edges.unique().numpy().tobytes() not in known:
            found.setdefault(name, cells.part(name, LINES, edges.unique(), edges))
    faces: dict[str, list[np.ndarray]] = {}
    for name, rows in (*groups(content.mesh, 2), *_numbered_cells(content)):
        for block, members in zip(content.mesh.cells, rows, strict=True):
            if block.type in ("triangle", "quad") and len(members):
                faces.setdefault(name, []).append(block.data[members])
    known = set()
    for name, corners in faces.items():
        key = np.unique(np.concatenate([c.reshape(-1) for c in corners])).tobytes()
        if key not in known or name in content.mesh.cell_sets:
            found.setdefault(name, cells.body(name, corners))
        known.add(key)
    for name, rows in content.mesh.point_sets.items():
        vertices = torch.from_numpy(np.unique(np.asarray(rows, np.int64)))
        if len(vertices) and int(vertices.max()) < count:
            found.setdefault(name, cells.part(name, POINTS, vertices, torch.zeros((0, 2), dtype=torch.int64)))
    return found


def _numbered(content: Content, kind: str) -> Iterator[tuple[str, Tensor]]:
    """The lines by the numbers that the data which tells regions gives them, as "line:3"; 0 is no number."""
    for name in content.told_by.data[:1]:
        blocks = zip(content.mesh.cells, content.mesh.cell_data[name], strict=True)
        own = [(block.data, values) for block, values in blocks if block.type == kind and len(block.data)]
        for number in sorted({int(n) for _, values in own for n in np.unique(values)} - {0}):
            edges = np.concatenate([data[values == number] for data, values in own]).astype(np.int64)
            yield f"{kind}:{number}", torch.from_numpy(edges)


def _numbered_cells(content: Content) -> Iterator[tuple[str, list[np.ndarray]]]:
    """The cells by their numbers in the data that tells regions, as "material:2": for each block their rows."""
    for name in content.told_by.data:
        values = content.mesh.cell_data[name]
        flat = [v for b, v in zip(content.mesh.cells, values, strict=True) if b.type in ("triangle", "quad")]
        for number in np.unique(np.concatenate(flat)).tolist():
            yield f"{name.split(':')[-1]}:{number:g}", [np.flatnonzero(v == number) for v in values]


@dataclass(frozen=True, eq=False)
class _Cells:
    """The triangles (T, 3) and quads (Q, 4) of a mesh of `count` vertices, wound alike.

    on      the key of each edge of the triangles, then of the quads
    across  (4Q,) for each side of the quads the row of the quad on its other side; -1: a triangle, -2: nothing
    """

    triangles: Tensor
    quads: Tensor
    count: int
    on: tuple[Tensor, Tensor]
    across: Tensor

    @classmethod
    def of(cls, source: Source) -> "_Cells":
        count = len(source.mesh.points)
        triangles, quads = source.mesh.triangles, source.mesh.quads
        on = tuple(keys_of(torch.stack([c, c.roll(-1, 1)], 2).reshape(-1, 2), count) for c in (triangles, quads))
        across = torch.full((len(on[1]),), -2)
        across[torch.isin(on[1], on[0])] = -1
        order = on[1].argsort(stable=True)
        twice = (on[1][order][1:] == on[1][order][:-1]).nonzero().squeeze(1)
        one, other = order[twice], order[twice + 1]
        across[one], across[other] = other // 4, one // 4
        return cls(triangles, quads, count, (on[0], on[1]), across)

    def part(self, name: str, kind: str, vertices: Tensor, edges: Tensor) -> Part:
        keys = keys_of(edges, self.count)
        triangles, quads = (int(torch.isin(on, keys).sum()) for on in self.on)
        layer, base = self._layer(keys, vertices)
        return Part(name, kind, vertices, edges, layer, base, triangles, quads)

    def body(self, name: str, corners: list[np.ndarray]) -> Part:
        """Cells, tables of triangles and of quads, with all that is in them; their outline has edges of one of them."""
        ends = [np.stack([c, np.roll(c, -1, 1)], 2).reshape(-1, 2) for c in corners]
        edges = torch.from_numpy(np.concatenate(ends).astype(np.int64))
        keys = keys_of(edges, self.count)
        _, back, copies = keys.unique(return_inverse=True, return_counts=True)
        outline = edges[copies[back] == 1]
        part = self.part(name, CELLS, edges.unique(), outline)
        within = torch.isin(part.layer, part.vertices)
        return replace(
            part,
            layer=part.layer[~within],
            base=part.base[~within],
            triangles=sum(len(c) for c in corners if c.shape[1] == 3),
            quads=sum(len(c) for c in corners if c.shape[1] == 4),
        )

    def _layer(self, keys: Tensor, vertices: Tensor) -> tuple[Tensor, Tensor]:
        """The vertices of the quads that stand on edges, column by column, and what each stands on.

        A column goes on from side to opposite side while there are quads.  It belongs to a layer where it ends at a
        triangle, as its neighbours do; quads that go through to another boundary are no layer of this one, and neither
        are those of a region without rows.
        """
        none = torch.zeros(0, dtype=torch.int64)
        side = torch.isin(self.on[1], keys).nonzero().squeeze(1)
        if not len(side):
            return none, none
        foot = self.quads.reshape(-1)[side], self.quads.reshape(-1)[side - side % 4 + (side + 1) % 4]
        column = torch.arange(len(side))
        stood: list[Tensor] = []
        bases: list[Tensor] = []
        of: list[Tensor] = []
        ended = torch.zeros(len(side), dtype=torch.bool)
        for _ in range(len(self.quads)):
            start, opposite = side - side % 4, (side + 2) % 4
            far = self.quads.reshape(-1)[start + (opposite + 1) % 4], self.quads.reshape(-1)[start + opposite]
            stood += far
            bases += [foot[0][column], foot[1][column]]
            of += [column, column]
            top = start + opposite
            beyond = self.across[top]
            ended[column[beyond == -1]] = True
            goes_on = beyond >= 0
            if not bool(goes_on.any()):
                break
            # The side of the next quad that lies on this one's far side.
            next_quad, key = beyond[goes_on], self.on[1][top[goes_on]]
            sides = self.on[1].reshape(-1, 4)[next_quad]
            side = 4 * next_quad + (sides == key[:, None]).int().argmax(1)
            column = column[goes_on]
        stood_on, base, of_column = torch.cat(stood), torch.cat(bases), torch.cat(of)
        even = _even(foot, ended, of_column.bincount(minlength=len(ended)) // 2)
        kept = even[of_column] & ~torch.isin(stood_on, vertices)
        layer, first = np.unique(stood_on[kept].numpy(), return_index=True)
        return torch.from_numpy(layer), base[kept][torch.from_numpy(first)]


def _even(foot: tuple[Tensor, Tensor], ended: Tensor, rows: Tensor) -> Tensor:
    """(N,) bool: the columns of a layer, of those that `ended` (N,) bool at triangles after so many `rows` (N,).

    A layer has three columns or more side by side, whose numbers of rows differ by one at most from one to the next.
    Of unstructured quads a few columns may look like that: where most on the part are none, there is no layer.

    foot  (N,) each, the vertices on the left and the right below each column
    """
    count = len(ended)
    order = foot[0].argsort(stable=True)
    first = foot[0][order]
    begin, end = torch.searchsorted(first, foot[1]), torch.searchsorted(first, foot[1], right=True)
    pairs = [torch.zeros((0, 2), dtype=torch.int64)]
    for k in range(int((end - begin).max())):
        one = (begin + k < end).nonzero().squeeze(1)
        other = order[begin[one] + k]
        alike = ended[one] & ended[other] & ((rows[one] - rows[other]).abs() <= 1) & (foot[0][one] != foot[1][other])
        pairs.append(torch.stack([one, other], 1)[alike])
    label = edge_components(torch.cat(pairs), count)
    even = ended & (label.bincount(minlength=count)[label] >= _SIDE_BY_SIDE)
    return even if 2 * int(even.sum()) >= count else torch.zeros_like(even)
