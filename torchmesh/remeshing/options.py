"""What is asked of remeshing."""

from dataclasses import dataclass, field

from torch import Tensor

from ..mesh.interfaces import Interfaces, check_interfaces
from ..smoothing.smoothing import SmoothOptions
from .sizing import Sizes, check_sizes


@dataclass(frozen=True)
class RemeshOptions:
    """How `remesh` works.

    sizes           the edge lengths wanted, as in `size_field`; a tensor is over the vertices of the batch
    collapse_below  edges shorter than this part of the size wanted are collapsed
    split_above     edges longer than this many times it are split
    worst           no split or collapse makes a triangle of higher inverse mean ratio, unless one as bad was there
    split_boundary  may boundary and constrained edges be halved?  Their course stays as it is
    max_rounds      rounds of splitting, collapsing, flipping and smoothing at most
    interfaces      "free": the smoothing moves the ends of constrained edges as it moves any vertex; otherwise they
                    stay.  None of them is taken out in either case, and none of these edges is flipped
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
    interfaces: Interfaces | None = None
    smooth: SmoothOptions = field(default_factory=lambda: SmoothOptions(ceiling=1.5, energy_tolerance=1e-4))

    @property
    def sizes_asked(self) -> bool:
        """Are there other sizes than the boundary's?"""
        return not (isinstance(self.sizes, str) and self.sizes == "boundary")

    def __post_init__(self) -> None:
        check_sizes(self.sizes)
        check_interfaces(self.interfaces, "RemeshOptions.interfaces")
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
