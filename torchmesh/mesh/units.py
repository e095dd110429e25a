"""Powers of two as units of length, so that scaling a mesh rounds nothing."""

import torch
from torch import Tensor

from ..kernels import packing
from ..kernels.library import library_for
from .connectivity import corners_of
from .ragged import offsets_from_counts, segment_count, segment_max, segment_min, true_rows


def centre_and_unit(points: Tensor, point_offsets: Tensor) -> tuple[Tensor, Tensor]:
    """(B, 2) middle of each mesh's bounding box, and (B,) the power of two at or below its half extent."""
    wide = points.to(torch.float64)
    if library_for(wide) is not None:
        return packing.centre_and_unit(wide, point_offsets)
    low = torch.stack([segment_min(wide[:, i].contiguous(), point_offsets) for i in (0, 1)], 1)
    high = torch.stack([segment_max(wide[:, i].contiguous(), point_offsets) for i in (0, 1)], 1)
    half = 0.5 * high - 0.5 * low
    extent = half.amax(1)
    unit = torch.ldexp(torch.ones_like(extent), torch.frexp(extent).exponent - 1)
    return low + half, torch.where(extent > 0, unit, 1.0)


def centre_and_unit_of_triangles(points: Tensor, triangles: Tensor, point_offsets: Tensor) -> tuple[Tensor, Tensor]:
    """As `centre_and_unit`, of the vertices of `triangles` (T, 3) alone: others may be anywhere.

    The centre of a mesh without triangles is 0, and its unit 1.
    """
    every = torch.ones(len(triangles), dtype=torch.bool, device=triangles.device)
    used = corners_of(triangles, every, len(points))
    if bool(used.all()):
        return centre_and_unit(points, point_offsets)
    count = segment_count(used, point_offsets)
    centre, unit = centre_and_unit(points[true_rows(used)], offsets_from_counts(count))
    return torch.where(count[:, None] > 0, centre, 0.0), unit
