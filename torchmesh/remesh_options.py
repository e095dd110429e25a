"""What is asked of remeshing, and which meshes need vertices moved about: light, for those that do not."""

from dataclasses import dataclass, field

import torch
from torch import Tensor

from .quality import Quality
from .segments import counts_from_offsets, segment_count
from .sizing import Sizes, check_sizes
from .smoothing import SmoothOptions

# Above this mean or maximum of the inverse mean ratio, flips and smoothing have not come far enough.
_MEAN, _MAX = 1.06, 1.9
# The mean above which it is worth what it costs where there are more triangles than so many.
_MEAN_OF_HUGE, _HUGE = 1.08, 200_000
# So small a part of the triangles above that maximum is not worth work on a whole large mesh.
_FEW = 1e-4


@dataclass(frozen=True)
class RemeshOptions:
    """How `remesh` works.

    sizes           the edge lengths wanted, as in `size_field`; a tensor is over the vertices of the batch
    collapse_below  edges shorter than this part of the size wanted are collapsed
    split_above     edges longer than this many times it are split
    worst           no split or collapse makes a triangle of higher inverse mean ratio, unless one as bad was there
    split_boundary  may boundary and constrained edges be halved?  Their course stays as it is
    max_rounds      rounds of splitting, collapsing, flipping and smoothing at most
    smooth          the last smoothing, where all rows stay at five times its tolerance.  A metric field as its
                    `targets` holds for all of the remeshing: lengths and shapes are then those that it measures, so
                    that it stretches edges and leaves areas alone
    """

    sizes: Sizes = "boundary"
    collapse_below: float = 0.7
    split_above: float = 1.4
    worst: float = 3.0
    split_boundary: bool = False
    max_rounds: int = 8
    smooth: SmoothOptions = field(default_factory=lambda: SmoothOptions(ceiling=1.5, energy_tolerance=1e-4))

    @property
    def sizes_asked(self) -> bool:
        """Are there other sizes than the boundary's?"""
        return not (isinstance(self.sizes, str) and self.sizes == "boundary")

    def __post_init__(self) -> None:
        check_sizes(self.sizes)
        # An edge that was just halved must not be short, nor one that comes of a collapse long.
        if not 0 < self.collapse_below <= self.split_above / 2:
            raise ValueError(
                "RemeshOptions.collapse_below must be positive and at most half of split_above "
                f"({self.split_above}), or edges are halved and collapsed in turn for ever; not {self.collapse_below}"
            )
        if not self.worst > 1:
            raise ValueError(f"RemeshOptions.worst must be above 1, the ideal, not {self.worst}")
        if isinstance(self.smooth.targets, Tensor):
            raise ValueError(
                "RemeshOptions.smooth.targets are matrices of triangles, which come and go here: give a MetricField "
                "(metric_from, MetricField.from_targets)"
            )
        if self.max_rounds < 0:
            raise ValueError(f"RemeshOptions.max_rounds must not be negative, but is {self.max_rounds}")


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
