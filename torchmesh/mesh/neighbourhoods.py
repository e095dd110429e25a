"""Who lies round whom in a batch: rings of triangles, means at vertices, ragged rows of neighbours."""

from dataclasses import replace

import torch
from torch import Tensor

from . import connectivity
from .batch import MeshBatch
from .ragged import counts_from_offsets, offsets_from_counts, spread
from .triangle import corners, squared_edge_lengths


def constrained_half_edges(batch: MeshBatch, twin: Tensor) -> Tensor:
    """(3T,) bool: the half-edges, both of an edge, that lie on constrained edges."""
    locked = torch.zeros(len(twin), dtype=torch.bool, device=twin.device)
    if not len(batch.constrained_edges):
        return locked
    ends = torch.zeros(len(batch.points), dtype=torch.bool, device=twin.device)
    ends[batch.constrained_edges.reshape(-1)] = True
    tail, head = connectivity.tails(batch.triangles), connectivity.heads(batch.triangles)
    near = (ends[tail] & ends[head]).nonzero().squeeze(1)
    count = len(batch.points)
    keys = connectivity.edge_keys(tail[near], head[near], count)
    locked[near] = torch.isin(
        keys, connectivity.edge_keys(batch.constrained_edges[:, 0], batch.constrained_edges[:, 1], count)
    )
    return locked


def touching(batch: MeshBatch, vertices: Tensor) -> Tensor:
    """(T,) bool: the triangles with a corner among `vertices` (V,) bool."""
    a, b, c = (vertices.index_select(0, v.contiguous()) for v in batch.triangles.unbind(1))
    return a | b | c


def corners_of(batch: MeshBatch, triangles: Tensor) -> Tensor:
    """(V,) bool: the corners of the `triangles` (T,) bool."""
    mask = torch.zeros(len(batch.points), dtype=torch.bool, device=triangles.device)
    return mask.index_fill_(0, batch.triangles.index_select(0, triangles.nonzero().squeeze(1)).reshape(-1), True)


def rewired(before: MeshBatch, after: MeshBatch) -> Tensor:
    """(V,) bool: the corners of the triangles that are not what they were."""
    changed = torch.zeros(len(after.triangles), dtype=torch.bool, device=after.triangles.device)
    return corners_of(after, changed.index_fill_(0, (before.triangles != after.triangles).nonzero()[:, 0], True))


def surroundings(batch: MeshBatch, triangles: Tensor, rings: int) -> Tensor:
    """(V,) bool: the corners of the `triangles` (T,) bool and the `rings` - 1 rings of vertices round them."""
    near = corners_of(batch, triangles)
    for _ in range(rings - 1):
        near = corners_of(batch, touching(batch, near))
    return near


class Means:
    """Means from vertices to triangles and back, many times over the same triangles."""

    def __init__(self, batch: MeshBatch) -> None:
        self.corners = [v.contiguous() for v in batch.triangles.unbind(1)]
        self.count = torch.bincount(batch.triangles.reshape(-1), minlength=len(batch.points)).clamp_min(1)

    def of_corners(self, values: Tensor) -> Tensor:
        """(T,) the mean of `values` (V,) over each triangle's corners."""
        a, b, c = (values.index_select(0, v) for v in self.corners)
        return a.add_(b).add_(c).div_(3)

    def round_vertices(self, values: Tensor) -> Tensor:
        """(V,) the mean of `values` (T,) over the triangles round each vertex; 0 for unused ones."""
        total = values.new_zeros(len(self.count))
        for v in self.corners:
            total.index_add_(0, v, values)
        return total.div_(self.count)


def repeated(batch: MeshBatch, owner: Tensor) -> MeshBatch:
    """The meshes `owner` (M,) of the batch, each as often as it is named."""
    vertices, faces = ragged_rows(batch.point_offsets, owner), ragged_rows(batch.triangle_offsets, owner)
    point_offsets = offsets_from_counts(counts_from_offsets(batch.point_offsets)[owner])
    triangle_offsets = offsets_from_counts(counts_from_offsets(batch.triangle_offsets)[owner])
    shift = point_offsets[:-1] - batch.point_offsets[:-1][owner]
    of_edge = torch.searchsorted(batch.point_offsets, batch.constrained_edges[:, 0].contiguous(), right=True) - 1
    order = of_edge.argsort(stable=True)
    edge_offsets = offsets_from_counts(torch.bincount(of_edge, minlength=len(batch)))
    edges = ragged_rows(edge_offsets, owner)
    edge_shift = shift.repeat_interleave(counts_from_offsets(edge_offsets)[owner])
    return MeshBatch(
        batch.points[vertices],
        batch.triangles[faces] + spread(shift, triangle_offsets)[:, None],
        batch.fixed[vertices],
        batch.constrained_edges[order][edges] + edge_shift[:, None],
        point_offsets,
        triangle_offsets,
        batch.frames[owner],
    )


def picked(batch: MeshBatch, order: Tensor, like: MeshBatch) -> MeshBatch:
    """The meshes `order` (P,) of `batch`, which have the rows of `like`."""
    points = batch.points[ragged_rows(batch.point_offsets, order)]
    faces = ragged_rows(batch.triangle_offsets, order)
    shift = like.point_offsets[:-1] - batch.point_offsets[:-1][order]
    triangles = batch.triangles[faces] + spread(shift, like.triangle_offsets)[:, None]
    return replace(like, points=points, triangles=triangles)


def ragged_rows(offsets: Tensor, owner: Tensor) -> Tensor:
    """The rows of the meshes `owner` (M,), one after the other."""
    counts = counts_from_offsets(offsets)[owner]
    ends = offsets_from_counts(counts)
    shift = offsets[:-1][owner] - ends[:-1]
    return torch.arange(int(ends[-1]), device=owner.device) + shift.repeat_interleave(counts)


def vertex_size(batch: MeshBatch) -> Tensor:
    """(V,) root mean square edge length round each vertex, in the batch's unit; 0 for unused ones."""
    ab, bc, ca = squared_edge_lengths(corners(batch.points.to(torch.float64), batch.triangles))
    a, b, c = (v.contiguous() for v in batch.triangles.unbind(1))
    total = ab.new_zeros(len(batch.points))
    total.index_add_(0, a, ab + ca).index_add_(0, b, ab + bc).index_add_(0, c, bc + ca)
    count = torch.bincount(batch.triangles.reshape(-1), minlength=len(batch.points)).clamp_min(1)
    return (total / (2 * count)).sqrt()
