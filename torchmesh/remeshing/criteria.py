"""Which valid meshes have shapes so poor that vertices should travel."""

from dataclasses import dataclass

import torch
from torch import Tensor

from ..mesh.measure import Quality
from ..mesh.ragged import counts_from_offsets, segment_count
from ..smoothing.polishing import PolishOptions
from .options import RemeshOptions

# The mean inverse mean ratio that flips and smoothing should reach: above it, relocation is tried, and shaken.
GOOD_MEAN = 1.06


@dataclass(frozen=True)
class CrowdedOptions:
    """What `crowded` finds poor, in inverse mean ratios and numbers of triangles.

    mean          flips and smoothing should come below this mean
    max           no triangle should be above this maximum, at which polishing starts, too
    huge          in a mesh of more triangles relocation takes three times as long as all else
    mean_of_huge  the mean above which it is worth that there
    few           a part of the triangles of a mesh: if no more than these are above `max`, work on all of a large
                  mesh is not worth it
    """

    mean: float = GOOD_MEAN
    max: float = PolishOptions.ratio
    huge: int = 200_000
    mean_of_huge: float = 1.08
    few: float = 1e-4


def crowded(
    q: Quality,
    options: RemeshOptions,
    triangle_offsets: Tensor | None = None,
    limits: CrowdedOptions | None = None,
) -> Tensor:
    """(B,) bool: valid meshes that relocation may better, or for which sizes were asked.

    triangle_offsets  (B+1,) with these, a few poor triangles of a large mesh do not count, and of a huge mesh only
                      its mean does beyond that
    """
    limits = limits or CrowdedOptions()
    poor, mean = q.max > limits.max, q.mean > limits.mean
    if triangle_offsets is not None:
        counts = counts_from_offsets(triangle_offsets)
        poor = segment_count(q.inverse_mean_ratio > limits.max, triangle_offsets) > limits.few * counts
        mean = q.mean > torch.where(counts > limits.huge, limits.mean_of_huge, limits.mean)
    return (q.inverted == 0) & (mean | poor | options.sizes_asked)
