"""Is the frame of a mesh - boundary, constrained edges, holes, fixed vertices - what it was?"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from . import connectivity
from .batch import MeshBatch
from .connectivity import keys_of
from .kept_edges import constrained_half_edges
from .ragged import counts_from_offsets, owner_of, segment_count, true_rows

if TYPE_CHECKING:
    from .vertex_map import VertexMap


def same_frame(
    before: MeshBatch,
    after: MeshBatch,
    stays: Tensor,
    vertex_map: "VertexMap | None" = None,
) -> Tensor:
    """(B,) bool: the same boundary edges and Euler number, every constrained edge there, `stays` (V,) unmoved.

    vertex_map  how the vertices of `after` answer to those of `before`; None: row by row.  A boundary or
                constrained edge may then have been halved: the chain of its parts counts as the edge
    """
    same = torch.ones(len(before), dtype=torch.bool, device=before.points.device)
    if vertex_map is None:
        rows = torch.arange(len(before.points), device=same.device)
        new_row, old_row = rows, rows
    else:
        new_row, old_row = vertex_map.old_to_new, vertex_map.new_to_old

    def fail(vertices: Tensor) -> None:
        same[owner_of(vertices, before.point_offsets)] = False

    gone = stays & (new_row < 0)
    fail(true_rows(gone | (stays & (before.points != after.points[new_row]).any(1))))
    if before.triangles is after.triangles:
        return same
    if len(before.quads):
        # The halves of quads are where they were, row by row.
        halves = true_rows(before.of_quads)
        gone = (before.triangles[halves] != after.triangles[halves]).any(1)
        same[owner_of(halves[gone], before.triangle_offsets)] = False
    count = len(before.points)
    # The twins of the result are computed anew: a certificate must not lean on what the stages handed on.
    old_twin, twin = before.twin, connectivity.twins(after.triangles)
    old = connectivity.boundary_edges(before.triangles, old_twin)
    new = _whole(connectivity.boundary_edges(after.triangles, twin), old_row)
    keys = [edges[:, 0] * count + edges[:, 1] for edges in (old, new)]
    fail(old[~torch.isin(*keys), 0])
    fail(new[~torch.isin(*keys[::-1]), 0].clamp_min(0))
    same &= euler_numbers(before, old_twin) == euler_numbers(after, twin)
    wanted = before.constrained_edges
    if len(wanted):
        present, size = connectivity.edges(after.triangles, twin), len(after.points)
        if vertex_map is None:
            # Only edges between ends of constrained edges can be such edges.
            ends = torch.zeros(count, dtype=torch.bool, device=wanted.device)
            ends[wanted.reshape(-1)] = True
            present = present[ends[present[:, 0]] & ends[present[:, 1]]]
        # Of a remeshed batch, only its own constrained edges can be parts of the old ones.
        kept = present if vertex_map is None else after.constrained_edges
        kept = kept[torch.isin(keys_of(kept, size), keys_of(present, size))]
        chains = torch.cat([_whole(kept, old_row), _whole(kept.flip(1), old_row)])
        fail(wanted[~torch.isin(keys_of(wanted, count), keys_of(chains, count)), 0])
    return same


def _whole(edges: Tensor, old_row: Tensor) -> Tensor:
    """(N, 2) old rows: each of the `edges` (K, 2) from an old vertex, followed through new ones to the next old."""
    # An inserted vertex halves an edge, so it has two neighbours along it: their sum less the one is the other.
    around = torch.zeros_like(old_row).index_add_(0, edges[:, 0], edges[:, 1]).index_add_(0, edges[:, 1], edges[:, 0])
    before, here = edges[old_row[edges[:, 0]] >= 0].unbind(1)
    start = before
    for _ in range(len(edges)):
        inserted = old_row[here] < 0
        if not bool(inserted.any()):
            break
        onward = (around[here] - before).clamp(0, len(old_row) - 1)
        before, here = torch.where(inserted, here, before), torch.where(inserted, onward, here)
    return torch.stack([old_row[start], old_row[here]], 1)


def same_regions(before: MeshBatch, after: MeshBatch, new_row: Tensor) -> Tensor:
    """(B,) bool: the same edges bound the same regions, and fixed vertices inside lie in the same ones.

    A region is what boundary and constrained edges part from the rest; its sides are the half-edges that run along them
    in it.  Where holes, inclusions or fixed vertices have gone elsewhere, no mesh has all the old regions.

    new_row  (V,) int64 the rows of the vertices of `before` in `after`, -1 for those that are gone
    """
    old, new, size = _Regions.of(before), _Regions.of(after), len(after.points)
    same = torch.ones(len(before), dtype=torch.bool, device=new_row.device)
    # A side whose end is gone gets a key that no side has.
    ends = new_row[old.sides]
    keys = torch.where((ends >= 0).all(1), ends[:, 0] * size + ends[:, 1], -1)
    new_keys, order = (new.sides[:, 0] * size + new.sides[:, 1]).sort()
    there = torch.isin(keys, new_keys)
    same[owner_of(old.sides[~there, 0], before.point_offsets)] = False
    same[owner_of(new.sides[order[~torch.isin(new_keys, keys)], 0], after.point_offsets)] = False
    at = order[torch.searchsorted(new_keys, keys[there])]

    inside = true_rows(before.fixed & (old.of_vertex >= 0))
    to = new_row[inside]
    lost = (to < 0) | (new.of_vertex[to] < 0)
    same[owner_of(inside[lost], before.point_offsets)] = False
    inside, to = inside[~lost], to[~lost]

    first = torch.cat([old.of_side[there], old.of_vertex[inside]])
    second = torch.cat([new.of_side[at], new.of_vertex[to]])
    mixed = ~(_one_for_each(first, second) & _one_for_each(second, first))
    vertex = torch.cat([old.sides[there, 0], inside])
    same[owner_of(vertex[mixed], before.point_offsets)] = False
    return same


@dataclass(frozen=True, eq=False)
class _Regions:
    """The regions of a batch, which boundary and constrained edges part from each other.

    sides      (N, 2) int64 the ends of the half-edges along these edges
    of_side    (N,) int64 the region of each
    of_vertex  (V,) int64 the region of each vertex inside one, -1 for those on sides or in no triangle
    """

    sides: Tensor
    of_side: Tensor
    of_vertex: Tensor

    @classmethod
    def of(cls, batch: MeshBatch) -> "_Regions":
        blocked = (batch.twin < 0) | constrained_half_edges(batch)
        region = connectivity.triangle_components(batch.triangles, batch.twin, blocked)
        h, corners = true_rows(blocked), batch.triangles.reshape(-1)
        sides = torch.stack([connectivity.tails(batch.triangles)[h], connectivity.heads(batch.triangles)[h]], 1)
        of_vertex = torch.full((len(batch.points),), -1, device=corners.device)
        of_vertex[corners] = region.repeat_interleave(3)
        of_vertex[sides.reshape(-1)] = -1
        return cls(sides, region[h // 3], of_vertex)


def _one_for_each(first: Tensor, second: Tensor) -> Tensor:
    """(N,) bool: whatever number of `first` (N,) a row has, all rows with it have the same number of `second` (N,)."""
    if not len(first):
        return torch.zeros_like(first, dtype=torch.bool)
    least, most = (
        second.new_zeros(int(first.max()) + 1).scatter_reduce_(0, first, second, how, include_self=False)
        for how in ("amin", "amax")
    )
    return (least == most)[first]


def euler_numbers(batch: MeshBatch, twin: Tensor) -> Tensor:
    """(B,) V - E + F of each mesh, over the vertices that have a triangle: 2 E is 3 F and the boundary's edges."""
    used = connectivity.vertex_triangle_counts(batch.triangles, len(batch.points)) > 0
    boundary = segment_count(twin < 0, 3 * batch.triangle_offsets)
    return segment_count(used, batch.point_offsets) - (counts_from_offsets(batch.triangle_offsets) + boundary) // 2
