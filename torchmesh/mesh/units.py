"""Powers of two as units of length, so that scaling a mesh rounds nothing."""

import torch
from torch import Tensor

from ..kernels import packing
from ..kernels.library import library_for
from .ragged import segment_max, segment_min


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
