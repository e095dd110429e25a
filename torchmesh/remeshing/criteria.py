"""Which valid meshes are so poor that vertices should travel."""

import torch
from torch import Tensor

from ..mesh.measure import Quality
from ..mesh.ragged import counts_from_offsets, segment_count
from .options import RemeshOptions

# Above this mean or maximum of the inverse mean ratio, flips and smoothing have not come far enough.
_MEAN, _MAX = 1.06, 1.9


# The mean above which it is worth what it costs where there are more triangles than so many.
_MEAN_OF_HUGE, _HUGE = 1.08, 200_000


# So small a part of the triangles above that maximum is not worth work on a whole large mesh.
_FEW = 1e-4


def crowded(q: Quality, options: RemeshOptions, triangle_offsets: Tensor | None = None) -> Tensor:
    """(B,) bool: valid meshes that relocation may better, or for which sizes were asked.

    With `triangle_offsets` (B+1,) a few poor triangles of a large mesh do not count, and of a huge one, where
    relocation would take three times as long as all else, only a poorer whole.
    """
    poor, mean = q.max > _MAX, q.mean > _MEAN
    if triangle_offsets is not None:
        counts = counts_from_offsets(triangle_offsets)
        poor = segment_count(q.inverse_mean_ratio > _MAX, triangle_offsets) > _FEW * counts
        mean = q.mean > torch.where(counts > _HUGE, _MEAN_OF_HUGE, _MEAN)
    return (q.inverted == 0) & (mean | poor | options.sizes_asked)
