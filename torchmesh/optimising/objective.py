"""Meshes as the optimiser sees them: the free coordinates in blocks, the rest at the end.

unknowns [ mesh 0: x blocks | y blocks ][ mesh 1: x blocks | y blocks ] ...   then the coordinates
of the vertices that stay.  Only triangles with a free vertex are in it.
"""

import functools
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..mesh.ragged import (
    counts_from_offsets,
    offsets_from_counts,
    segment_count,
    segment_ids,
    segment_min,
    segment_sum,
    spread,
)
from ..mesh.units import centre_and_unit
from .assembly import Chunk, chunk_offsets, chunks_of, energy_and_forces
from .blocks import BLOCK, block_width
from .energies import Energy
from .jacobian import EdgeMap, Target, select_rows


@dataclass(frozen=True, eq=False)
class Packing:
    """The free part of a batch as one vector.

    Coordinates are counted from each mesh's centre in a power of two near its extent, so that no
    constant anywhere depends on the user's unit or origin.  Or they are displacements in that unit, in
    single precision: then `edges` says from where, and an edge keeps its digits however far from the
    centre, though it takes half the memory.

    unknowns          (N,) free coordinates, padded to whole blocks with zeros
    anchored          (F,) coordinates of the vertices that stay
    rows              (6, T) int32, where ax ay bx by cx cy stand in unknowns followed by anchored
    x_rows, y_rows    (M,) int64, where the free vertices' coordinates stand
    vertices          (M,) int64, the free vertices
    triangles         (T,) int64, the triangles that a free vertex touches
    block_offsets     (B+1,) int64
    triangle_offsets  (B+1,) int64 over `triangles`
    centre, unit      (B, 2) and (B,) float64, origin and length unit of each mesh's coordinates
    point_mesh        (M,) int64, the mesh of each free vertex
    edges             (4, T) float32, x and y of b - a and of c - a undisplaced; None: coordinates are no displacements
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
        """(V,) one value a vertex to (N,) one an unknown, zero in the padding."""
        out = torch.zeros_like(self.unknowns)
        out[self.x_rows] = out[self.y_rows] = values[self.vertices].to(out)
        return out

    def unpack(self, unknowns: Tensor, points: Tensor) -> Tensor:
        """(V, 2) a copy of `points` with the free vertices where `unknowns` has them."""
        moved = points.clone()
        unit, centre = self.unit[self.point_mesh], self.centre[self.point_mesh]
        for axis, rows in enumerate((self.x_rows, self.y_rows)):
            now, before = unknowns.index_select(0, rows), points[self.vertices, axis]
            origin = centre[:, axis] if self.edges is None else before.to(unit)
            there = torch.addcmul(origin, now.to(unit), unit).to(points)
            # What did not move keeps its bits, which centring and back may not.
            still = now == self.unknowns.index_select(0, rows)
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
    """Pack the `free` (V,) bool vertices and the triangles that touch them; coordinates in float64, or displacements
    in float32; in blocks of so many."""
    device = points.device
    centre, unit = centre_and_unit(points, point_offsets)
    points = (points.to(torch.float64) - spread(centre, point_offsets)) / spread(unit, point_offsets)[:, None]
    gather = torch.index_select
    corner = [v.contiguous() for v in triangles.unbind(1)]
    touched = gather(free, 0, corner[0]) | gather(free, 0, corner[1]) | gather(free, 0, corner[2])
    kept = touched.nonzero().squeeze(1)
    if len(kept) < len(triangles):
        corner = [gather(v, 0, kept) for v in corner]
    vertices = free.nonzero().squeeze(1)
    counts = segment_count(free, point_offsets)
    blocks = (counts + block - 1) // block
    block_offsets = offsets_from_counts(2 * blocks)
    row_offsets = offsets_from_counts(counts)
    x_rows = spread(block_offsets[:-1] * block - row_offsets[:-1], row_offsets) + torch.arange(
        len(vertices), device=device
    )
    y_rows = x_rows + spread(blocks * block, row_offsets)
    size = int(block_offsets[-1]) * block
    x, y = points[:, 0].contiguous(), points[:, 1].contiguous()
    unknowns = points.new_zeros(size)
    unknowns[x_rows] = gather(x, 0, vertices)
    unknowns[y_rows] = gather(y, 0, vertices)
    needed = torch.zeros_like(free)
    for v in corner:
        needed.index_fill_(0, v, True)
    needed &= ~free
    anchors = needed.nonzero().squeeze(1)
    anchored = torch.cat([gather(x, 0, anchors), gather(y, 0, anchors)])
    place_x = torch.zeros(len(points), dtype=torch.int32, device=device)
    place_y = torch.zeros_like(place_x)
    place_x[vertices], place_y[vertices] = x_rows.to(torch.int32), y_rows.to(torch.int32)
    ordinal = torch.arange(len(anchors), dtype=torch.int32, device=device)
    place_x[anchors], place_y[anchors] = size + ordinal, size + len(anchors) + ordinal
    rows = torch.stack([gather(place, 0, v) for v in corner for place in (place_x, place_y)])
    edges = None
    if displacements:
        (ax, ay), *ends = ((gather(x, 0, v), gather(y, 0, v)) for v in corner)
        edges = torch.stack([e.to(torch.float32) for bx, by in ends for e in (bx - ax, by - ay)])
        unknowns, anchored = (torch.zeros_like(v, dtype=torch.float32) for v in (unknowns, anchored))
    return Packing(
        unknowns, anchored, rows, x_rows, y_rows, vertices, kept, block_offsets,
        offsets_from_counts(segment_count(touched, triangle_offsets)), centre, unit,
        segment_ids(row_offsets), edges,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class MeshObjective:
    """The sum of an energy over each mesh's packed triangles, as an `lbfgs.Objective`.

    enough    a mesh is done as soon as each of its packed triangles has det > this; None: never
    edges     of the packing
    edge_map  through which the triangles are seen, of a metric field; None: as they are
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
        coordinates = torch.cat([unknowns, self.anchored])
        phi, gradient, det = energy_and_forces(coordinates, self.chunks)
        energy = segment_sum(phi.to(torch.float64), self.triangle_offsets)
        done = None if self.enough is None else segment_min(det, self.triangle_offsets) > self.enough
        return energy, gradient[: len(unknowns)], done

    @functools.cached_property
    def chunks(self) -> list[Chunk]:
        """The triangles as the kernel takes them."""
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

    def select(self, keep: Tensor) -> "MeshObjective":
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
