"""Targets of a tangled mesh: the size of the triangles around a vertex, smoothed; or the shapes of a reference."""

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.means import Means, vertex_size
from ..mesh.ragged import counts_from_offsets, segment_sum, spread
from ..mesh.triangle import SQRT3, Corners, corners, signed_area
from ..optimising.jacobian import Target, target_of
from ..optimising.targets import checked_matrices


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


def own_target(batch: MeshBatch, reference: MeshBatch) -> tuple[Target, Tensor]:
    """The reference's triangles as targets (T,), and their sizes (V,), scaled per mesh to the area enclosed now."""
    before = corners(reference.points.to(torch.float64), reference.triangles)
    target, factor = _scaled_to(batch, before)
    return target, vertex_size(reference) * spread(factor, batch.point_offsets)


def rest_target(batch: MeshBatch, matrices: Tensor) -> tuple[Target, Tensor]:
    """The target matrices (T, 2, 2) with their sizes as targets, and sizes (V,); scaled as in `own_target`.

    Raises InvalidMeshError for another shape, and for a matrix whose determinant is not positive.
    """
    checked_matrices(batch, matrices, len(batch.triangles))
    w = matrices.to(batch.points.device, torch.float64)
    zero = torch.zeros_like(w[:, 0, 0])
    before = Corners(zero, zero, w[:, 0, 0], w[:, 1, 0], w[:, 0, 1], w[:, 1, 1])
    target, factor = _scaled_to(batch, before)
    size = Means(batch).round_vertices(4 / SQRT3 * signed_area(before)).sqrt()
    return target, size * spread(factor, batch.point_offsets)


def _scaled_to(batch: MeshBatch, before: Corners) -> tuple[Target, Tensor]:
    """The triangles `before` as targets (T,), and the factor (B,) that scales them to the area that is enclosed now."""
    now = corners(batch.points.to(torch.float64), batch.triangles)
    areas = [segment_sum(signed_area(t), batch.triangle_offsets) for t in (now, before)]
    factor = (areas[0].abs() / areas[1]).sqrt()
    return target_of(Corners(*(v * spread(factor, batch.triangle_offsets) for v in before))), factor
