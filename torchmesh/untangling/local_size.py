"""The size of the triangles around a vertex, smoothed over the mesh."""

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.means import Means
from ..mesh.ragged import counts_from_offsets, segment_sum, spread
from ..mesh.triangle import SQRT3, corners, signed_area


def local_size(batch: MeshBatch, sweeps: int = 100) -> Tensor:
    """(V,) side of the equilateral triangle that the triangles at a vertex should have, in the batch's unit.

    It starts from the root of the mean |area| around each vertex, which is averaged over neighbours `sweeps` times.
    It is then scaled per mesh so that the triangles' target areas sum to the enclosed area.
    """
    t = corners(batch.points.to(torch.float64), batch.triangles)
    area = signed_area(t)
    offsets = batch.triangle_offsets
    enclosed = segment_sum(area, offsets)
    mean = spread(segment_sum(area.abs(), offsets) / counts_from_offsets(offsets), offsets)
    share = area.abs() / torch.where(mean > 0, mean, 1.0)
    means = Means(batch)
    # Not below a thousandth of the mean size, so that no target has the size zero.
    size = means.round_vertices(share).sqrt().clamp_min(1e-3)
    for _ in range(sweeps):
        size = means.round_vertices(means.of_corners(size))
    target = means.of_corners(size).square() * (SQRT3 / 4)
    factor = (enclosed.abs() / segment_sum(target, offsets)).sqrt()
    return size * spread(factor, batch.point_offsets)
