r"""Meshes as the optimiser sees them: one vector of the free coordinates, in blocks, and an energy on it.

    coordinates  [ mesh 0: x blocks | y blocks ][ mesh 1: x blocks | y blocks ] ... [ x | y of the vertices that stay ]
                 \___________________________ unknowns _______________________/     \__________ anchored __________/

Only triangles with a free vertex take part.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from ..kernels.continuation import LARGEST as LARGEST_TURN
from ..kernels.continuation import CompiledTurns
from ..kernels.energies import PackedTriangles, energies
from ..kernels.library import library_for
from ..kernels.minimiser import minimise_meshes
from ..kernels.packing import packed, scattered, unpacked
from ..mesh.detached import loops_may_read
from ..mesh.ragged import (
    counts_from_offsets,
    offsets_from_counts,
    segment_count,
    segment_ids,
    segment_min,
    segment_sum,
    spread,
    take,
    true_rows,
)
from ..mesh.units import centre_and_unit_of_triangles
from .assembly import Chunk, chunk_offsets, chunks_of, energy_and_forces
from .blocks import BLOCK, block_width
from .energies import Energy, formula_of
from .jacobian import EdgeMap, Target, select_rows
from .lbfgs_options import LbfgsOptions


@dataclass(frozen=True, eq=False)
class Packing:
    """The free part of a batch as one vector.

    Coordinates are measured from each mesh's centre, in a power of two near the mesh's extent.  So no constant
    anywhere depends on the user's unit or origin.  Alternatively, they are displacements in that unit, in single
    precision, and `edges` holds the edges before any displacement.  Displacements take half the memory, and an edge
    keeps its digits however far from the centre it lies.

    unknowns          (N,) free coordinates, padded to whole blocks with zeros
    anchored          (F,) coordinates of the vertices that stay
    rows              (6, T) int32, the rows of ax, ay, bx, by, cx, cy in `unknowns` followed by `anchored`
    x_rows, y_rows    (M,) int64, the rows of the free vertices' coordinates in `unknowns`
    vertices          (M,) int64, the free vertices
    triangles         (T,) int64, the triangles with a free corner
    block_offsets     (B+1,) int64
    triangle_offsets  (B+1,) int64 over `triangles`
    centre, unit      (B, 2) and (B,) float64, origin and length unit of each mesh's coordinates
    point_mesh        (M,) int64, the mesh of each free vertex
    edges             (4, T) float32, x and y of b - a and of c - a before any displacement; None if the coordinates
                      are positions
    """

    unknowns: Tensor
    anchored: Tensor
    rows: Tensor
    x_rows: Tensor
    y_rows: Tensor
    vertices: Tensor
    triangles: Tensor
    block_offsets: Tensor
    triangle_offsets: Tensor
    centre: Tensor
    unit: Tensor
    point_mesh: Tensor
    edges: Tensor | None = None

    def spread_vertices(self, values: Tensor) -> Tensor:
        """Values per vertex (V,) as values per unknown (N,), which are zero in the padding."""
        if loops_may_read(values) and values.dtype == torch.float64:
            return scattered(values, self.vertices, self.x_rows, self.y_rows, self.unknowns)
        out = torch.zeros_like(self.unknowns)
        out[self.x_rows] = out[self.y_rows] = values[self.vertices].to(out)
        return out

    def unpack(self, unknowns: Tensor, points: Tensor) -> Tensor:
        """(V, 2) a copy of `points` with the free vertices at the positions that `unknowns` (N,) gives them."""
        if loops_may_read(points) and points.dtype == torch.float64:
            return unpacked(self, unknowns, points)
        moved = points.clone()
        unit, centre = self.unit[self.point_mesh], self.centre[self.point_mesh]
        for axis, rows in enumerate((self.x_rows, self.y_rows)):
            now, before = take(unknowns, rows), points[self.vertices, axis]
            origin = centre[:, axis] if self.edges is None else before.to(unit)
            there = torch.addcmul(origin, now.to(unit), unit).to(points)
            # Centring and undoing it may change the last bits, so vertices that did not move keep theirs.
            still = now == take(self.unknowns, rows)
            moved[self.vertices, axis] = torch.where(still, before, there)
        return moved


def pack(
    points: Tensor,
    triangles: Tensor,
    free: Tensor,
    point_offsets: Tensor,
    triangle_offsets: Tensor,
    displacements: bool = False,
    block: int = BLOCK,
) -> Packing:
    """Pack the free vertices and the triangles with a free corner.

    points         (V, 2)
    triangles      (T, 3) int64
    free           (V,) bool
    displacements  whether the unknowns are displacements in float32, or positions in float64
    block          numbers in a block
    """
    centre, unit = centre_and_unit_of_triangles(points, triangles, point_offsets)
    if library_for(points) is not None:
        offsets = point_offsets, triangle_offsets
        made = packed(points.to(torch.float64), triangles, free, *offsets, (centre, unit), displacements, block)
        return Packing(**made, centre=centre, unit=unit)
    points = (points.to(torch.float64) - spread(centre, point_offsets)) / spread(unit, point_offsets)[:, None]
    x, y = points[:, 0].contiguous(), points[:, 1].contiguous()
    touched, kept, corner = _touched(triangles, free)
    vertices = true_rows(free)
    layout = _Layout.of(segment_count(free, point_offsets), len(vertices), block)
    anchors = _anchors(free, corner)
    unknowns = points.new_zeros(layout.size)
    unknowns[layout.x_rows] = torch.index_select(x, 0, vertices)
    unknowns[layout.y_rows] = torch.index_select(y, 0, vertices)
    anchored = torch.cat([torch.index_select(x, 0, anchors), torch.index_select(y, 0, anchors)])
    edges = None
    if displacements:
        edges = _single_edges(x, y, corner)
        unknowns, anchored = (torch.zeros_like(v, dtype=torch.float32) for v in (unknowns, anchored))
    return Packing(
        unknowns, anchored, layout.coordinate_rows(corner, vertices, anchors, len(points)), layout.x_rows,
        layout.y_rows, vertices, kept, layout.block_offsets,
        offsets_from_counts(segment_count(touched, triangle_offsets)), centre, unit,
        segment_ids(layout.vertex_offsets), edges,
    )  # fmt: skip


def _touched(triangles: Tensor, free: Tensor) -> tuple[Tensor, Tensor, list[Tensor]]:
    """The triangles with a free corner, as a mask (T,) and as rows (K,), and their corners, three (K,)."""
    corner = [v.contiguous() for v in triangles.unbind(1)]
    a, b, c = (torch.index_select(free, 0, v) for v in corner)
    touched = a | b | c
    kept = true_rows(touched)
    if len(kept) < len(triangles):
        corner = [torch.index_select(v, 0, kept) for v in corner]
    return touched, kept, corner


def _anchors(free: Tensor, corner: list[Tensor]) -> Tensor:
    """(A,) int64 the vertices among the corners that are not free."""
    needed = torch.zeros_like(free)
    for v in corner:
        needed.index_fill_(0, v, True)
    needed &= ~free
    return true_rows(needed)


def _single_edges(x: Tensor, y: Tensor, corner: list[Tensor]) -> Tensor:
    """(4, T) float32 x and y of the edges b - a and c - a, whose differences are taken in double precision."""
    (ax, ay), *ends = ((torch.index_select(x, 0, v), torch.index_select(y, 0, v)) for v in corner)
    return torch.stack([e.to(torch.float32) for bx, by in ends for e in (bx - ax, by - ay)])


class _Layout(NamedTuple):
    """The rows of the free vertices' coordinates in the vector of unknowns.

    size            the length of that vector
    x_rows, y_rows  (M,) int64
    block_offsets   (B+1,) int64
    vertex_offsets  (B+1,) int64 over the free vertices
    """

    size: int
    x_rows: Tensor
    y_rows: Tensor
    block_offsets: Tensor
    vertex_offsets: Tensor

    @classmethod
    def of(cls, counts: Tensor, total: int, block: int) -> "_Layout":
        """The layout of meshes with `counts` (B,) free vertices each, `total` together."""
        blocks = (counts + block - 1) // block
        block_offsets, vertex_offsets = offsets_from_counts(2 * blocks), offsets_from_counts(counts)
        shift = spread(block_offsets[:-1] * block - vertex_offsets[:-1], vertex_offsets)
        x_rows = shift + torch.arange(total, device=counts.device)
        y_rows = x_rows + spread(blocks * block, vertex_offsets)
        return cls(int(block_offsets[-1]) * block, x_rows, y_rows, block_offsets, vertex_offsets)

    def coordinate_rows(self, corner: list[Tensor], vertices: Tensor, anchors: Tensor, count: int) -> Tensor:
        """(6, T) int32 the rows of the corners' coordinates: `vertices` are free, `anchors` follow the unknowns."""
        row_x = torch.zeros(count, dtype=torch.int32, device=anchors.device)
        row_y = torch.zeros_like(row_x)
        row_x[vertices], row_y[vertices] = self.x_rows.to(torch.int32), self.y_rows.to(torch.int32)
        ordinal = torch.arange(len(anchors), dtype=torch.int32, device=anchors.device)
        row_x[anchors], row_y[anchors] = self.size + ordinal, self.size + len(anchors) + ordinal
        return torch.stack([torch.index_select(row, 0, v) for v in corner for row in (row_x, row_y)])


@dataclass(frozen=True, eq=False)
class MeshObjective:
    """The sum of an energy over the packed triangles of each mesh; it is an `lbfgs.Objective`.

    enough    a mesh is done as soon as the determinants of all its packed triangles exceed this; None means never
    edges     the edges of the packing, if its unknowns are displacements
    edge_map  the map of a metric field through which the triangles are measured; None means the identity
    """

    energy: Energy
    target: Target
    rows: Tensor
    anchored: Tensor
    block_offsets: Tensor
    triangle_offsets: Tensor
    scale: Tensor
    enough: float | None = None
    edges: Tensor | None = None
    edge_map: EdgeMap | None = None

    def __call__(self, unknowns: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
        """The energy of each mesh (B,), its gradient (N,), and which meshes are done (B,) bool or None."""
        coordinates = torch.cat([unknowns, self.anchored])
        packed = self.compiled
        if packed is not None:
            energy, gradient, least = energies(packed, coordinates, self.triangle_offsets)
            return energy, gradient[: len(unknowns)], None if self.enough is None else least > self.enough
        phi, gradient, det = energy_and_forces(coordinates, self.chunks)
        energy = segment_sum(phi.to(torch.float64), self.triangle_offsets)
        done = None if self.enough is None else segment_min(det, self.triangle_offsets) > self.enough
        return energy, gradient[: len(unknowns)], done

    @property
    def compiled(self) -> PackedTriangles | None:
        """The triangles as the compiled loops take them; None where torch is to do their work."""
        if library_for(self.rows) is None:
            return None
        formula = formula_of(self.energy)
        return formula and PackedTriangles(formula, self.target, self.rows, self.edges, self.edge_map)

    @functools.cached_property
    def chunks(self) -> list[Chunk]:
        """The triangles in the portions that the energy kernel works on."""
        offsets = chunk_offsets(self.triangle_offsets.tolist())
        return chunks_of(self.rows, self.energy, self.target, offsets, self.edges, self.edge_map)

    def det(self, unknowns: Tensor) -> Tensor:
        """(T,) det J of the packed triangles."""
        coordinates = torch.cat([unknowns, self.anchored])
        parts = []
        for chunk in self.chunks:
            e1, e2 = chunk.edges_at(coordinates).unbind(0)
            parts.append(chunk.target.m * (e1[0] * e2[1] - e1[1] * e2[0]))
        return torch.cat([coordinates[:0], *parts])

    def minimised(
        self, start: Tensor, options: LbfgsOptions, monitor: Callable[[int, Tensor], None] | None
    ) -> tuple[Tensor, ...] | None:
        """What the compiled minimiser comes to from `start` (N,); None where torch is to do its work."""
        packed = self.compiled
        if packed is None:
            return None
        width = block_width(len(start), self.block_offsets)
        anchored, scale = self.anchored.to(start.dtype), self.scale.to(start.dtype)
        offsets = self.block_offsets.contiguous(), self.triangle_offsets.contiguous()
        return minimise_meshes(
            packed, anchored, scale, *offsets, width, start.contiguous(), vars(options), self.enough, monitor
        )

    def turns(self, x: Tensor, options: LbfgsOptions) -> CompiledTurns | None:
        """The compiled minimiser of some of the meshes, again and again, with an epsilon of each; x (N,) changes.

        None where torch is to do its work.
        """
        packed = self.compiled
        if packed is None or packed.edges is not None or packed.map is not None or x.dtype != torch.float64:
            return None
        counts = counts_from_offsets(self.triangle_offsets)
        if bool((counts > LARGEST_TURN).any()):
            return None
        given = self.anchored.contiguous(), self.scale.contiguous(), self.block_offsets.contiguous()
        offsets, width = self.triangle_offsets.contiguous(), block_width(len(x), self.block_offsets)
        return CompiledTurns(packed, *given, offsets, width, x, vars(options))

    def select(self, keep: Tensor) -> "MeshObjective":
        """The objective of the meshes `keep` (B,) bool, over their unknowns alone."""
        blocks = counts_from_offsets(self.block_offsets)
        size = len(self.scale)
        faces = spread(keep, self.triangle_offsets)
        kept = keep.repeat_interleave(blocks).repeat_interleave(block_width(size, self.block_offsets))
        shift = torch.cat([kept.to(torch.int64).cumsum(0) - 1, torch.arange(len(self.anchored), device=kept.device)])
        shift[size:] += int(kept.sum())
        rows = shift[self.rows[:, faces].long()].to(torch.int32)
        return replace(
            self,
            energy=select_rows(self.energy, faces),
            target=select_rows(self.target, faces),
            rows=rows,
            block_offsets=offsets_from_counts(blocks[keep]),
            triangle_offsets=offsets_from_counts(counts_from_offsets(self.triangle_offsets)[keep]),
            scale=self.scale[kept],
            edges=None if self.edges is None else self.edges[:, faces],
            edge_map=None if self.edge_map is None else select_rows(self.edge_map, faces),
        )
