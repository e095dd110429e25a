"""The numbers that steer the steps of `improve`: when they begin, how they go on, and when they end."""

import math
from dataclasses import dataclass, field

from ..untangling.options import NewtonWays, UntangleOptions
from .checks import check_least


@dataclass(frozen=True)
class StartAnew:
    """Which tangled meshes get new positions for all free vertices (`remeshing.anew_in_rows`).

    large   meshes of fewer triangles are untangled from where they are
    share   so are meshes, and regions of them, in which fewer of the triangles are inverted than this part: there most
            triangles can stay as they are
    """

    large: int = 5_000
    share: float = 0.02

    def __post_init__(self) -> None:
        check_least(self, large=0, share=0)


@dataclass(frozen=True)
class Rounds:
    """How steps 1 and 2 of Kim 2017 alternate, and when they are stalled.

    anew                 which large meshes that averaging leaves tangled get new positions for all free vertices,
                         where these may travel, edges may flip, and nothing else was asked for; None: none do
    flip_rounds          the rounds of flips before each untangling: the first flips do most, and later ones are guided
                         by tangled triangles only
    progress, patience   a mesh leaves the loop after so many rounds in a row in which the number of its inverted
                         triangles did not fall to this part of the fewest so far
    paper_patience       a mesh leaves the loop of the paper after so many rounds in a row in which that number did not
                         fall at all
    paper_quiet          or after so many rounds in a row without a flip in which L-BFGS took its least number of steps
    last_untangling      the regularised functional as the last resort where edges may flip, and beside a fault: its
                         work is bounded, since hardly a mesh gets so far that can be untangled
    newton               the second-order ways where triangles stay, for the meshes that are tangled still
    newton_beside_faults  the same for meshes with a fault that does not prove them impossible.  None: these ways are
                         not tried, since a valid mesh seldom exists there and they take seconds
    newton_of_quads      few steps of the same for meshes with quads where edges may flip: two zones of quads round a
                         cylinder (SU2's MeshCHT, 4,524 quads, 117 folded) take a quarter of a second, and a hopeless
                         ring of 1,400 quads that turned by 200 degrees 0.8 seconds
    rings_round_faults   where a fault leaves triangles inverted, so many rings of vertices round them stay as they are
    tells_flips          whether it is told of a mesh that stays tangled with its triangles kept how few flips would do
    """

    anew: StartAnew | None = field(default_factory=StartAnew)
    flip_rounds: int = 2
    progress: float = 0.75
    patience: int = 2
    paper_patience: int = 10
    paper_quiet: int = 4
    last_untangling: UntangleOptions = field(
        default_factory=lambda: UntangleOptions(size_sweeps=(100,), max_iterations=60, work=400_000, newton=None)
    )
    newton: NewtonWays = field(default_factory=NewtonWays)
    newton_of_quads: NewtonWays = field(
        default_factory=lambda: NewtonWays(
            (100,), pushes=40, alphas=(0.1,), steps_per_alpha=10, max_continuations=1, weightings=()
        )
    )
    newton_beside_faults: NewtonWays | None = None
    rings_round_faults: int = 2
    tells_flips: bool = True

    def __post_init__(self) -> None:
        check_least(self, flip_rounds=0, progress=0, patience=1, paper_patience=1, paper_quiet=1, rings_round_faults=0)
        if self.progress > 1:
            raise ValueError(f"Rounds.progress must be at most 1, not {self.progress}")


@dataclass(frozen=True)
class Refining:
    """How flips and smoothing alternate on a valid mesh; ratios are inverse mean ratios.

    first_flip_rounds      rounds of flips before the first smoothing
    rest                   a vertex that moves less than this part of its mean edge length in a round does not move in
                           the next one
    little_gain            a round that lowers the mean by less than this is the last of a mesh without poor triangles
    least_gain             a round that lowers the mean by less than this, and the maximum by less than
                           `least_gain_of_maximum` times itself, is the last one of any mesh
    sliver                 a triangle with a higher ratio is so flat that it alone would decide flips and smoothing
    last_steps             iterations of the last smoothing at most, where edges may flip: usual meshes take up to 40;
                           what is still poor after 150 is better mended by the travel of vertices
    coarse                 meshes with a higher maximum are smoothed in double precision, whatever was asked for
    kept_again             where triangles stay, the last smoothing of poor meshes is repeated so often at most, while
                           they gain by it: it may end early where few triangles outweigh all others
    """

    first_flip_rounds: int = 4
    rest: float = 0.02
    little_gain: float = 3e-3
    least_gain: float = 1e-4
    least_gain_of_maximum: float = 1e-3
    sliver: float = 1e4
    last_steps: int = 150
    coarse: float = 100.0
    kept_again: int = 10

    def __post_init__(self) -> None:
        check_least(
            self, first_flip_rounds=0, rest=0, little_gain=0, least_gain=0, least_gain_of_maximum=0, sliver=1,
            last_steps=0, coarse=1, kept_again=0,
        )  # fmt: skip


@dataclass(frozen=True)
class LocalRepair:
    """Which meshes are worked on only round their damage; ratios are inverse mean ratios.

    large           meshes with at most so many triangles are worked on as a whole, since a submesh would not save much
    poor            triangles with a higher ratio are damaged, and so are inverted ones
    excellent       the mean ratio outside the submesh is at most this, since a worse one could be improved by flips and
                    smoothing of the whole mesh
    share           the submesh is at most this part of the mesh
    rings           the submesh includes so many rings of vertices round the damage
    rings_by_width  and further rings, so many times the square root of the number of damaged triangles: a tangle of n
                    triangles is about 0.7 sqrt(n) edges wide, and needs as much room round it to get good shapes
    """

    large: int = 20_000
    poor: float = 1.5
    excellent: float = 1.03
    share: float = 0.1
    rings: int = 8
    rings_by_width: float = 0.7

    def __post_init__(self) -> None:
        check_least(self, large=0, poor=1, excellent=1, share=0, rings=1, rings_by_width=0)
        if self.share > 1:
            raise ValueError(f"LocalRepair.share must be at most 1, the whole mesh, not {self.share}")


@dataclass(frozen=True)
class Bound:
    """What is good enough: a mesh, or under scope "damage" a place, that is within the bound comes back to the bit.

    Triangles that nothing can change do not count: those of layers that are held, those between vertices that stay and
    edges that stay, and those at a boundary corner that allows no better (`limit_share`).

    angle        degrees; no triangle has a smaller angle.  0 asks for nothing
    ratio        no triangle has a higher inverse mean ratio.  Infinity asks for nothing but that it is not inverted
    limit_share  where the boundary allows less, this part of what it allows suffices
    """

    angle: float = 0.0
    ratio: float = math.inf
    limit_share: float = 0.95

    def __post_init__(self) -> None:
        if not 0 <= self.angle < 60:
            raise ValueError(f"Bound.angle must be in degrees from 0 to below 60, not {self.angle}")
        if not self.ratio > 1:
            raise ValueError(f"Bound.ratio must be above 1, the ideal, not {self.ratio}")
        if not 0 < self.limit_share <= 1:
            raise ValueError(f"Bound.limit_share must be above 0 and at most 1, not {self.limit_share}")


@dataclass(frozen=True)
class LeastGain:
    """What a mesh that came valid must gain; if it gains less than all of this, it comes back as it was given.

    On its own result `improve` gains less, so that it changes nothing there: on the meshes of the experiments the mean
    came nearer to 1 by up to 3 percent of its distance.  One triangle fewer that polishing would work on is enough.

    mean   the mean inverse mean ratio comes nearer to 1 by this part of its distance
    max    so does the maximum, if that is above the ratio from which triangles are polished
    angle  degrees that the smallest angle gains, if that is below the angle from which triangles are polished
    """

    mean: float = 0.1
    max: float = 0.1
    angle: float = 1.0

    def __post_init__(self) -> None:
        for name in ("mean", "max"):
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(f"LeastGain.{name} must be at least 0 and below 1, not {getattr(self, name)}")
        if not self.angle >= 0:
            raise ValueError(f"LeastGain.angle must not be negative, but is {self.angle}")


@dataclass(frozen=True)
class Damage:
    """What scope "damage" takes for damage, and how far it reaches round it; ratios are inverse mean ratios.

    worse       a triangle with a higher ratio, as the shape that is meant at its place sees it, is damage, as inverted
                ones are.  Where the shape meant is the median of those around, the ratio is over the mean of theirs.
                In remeshing, too, no triangle may come out worse than 3
    stretched   where the shape meant has a higher ratio for most of a part, it is the aim: 1.25 is two to one
    rings       rings of vertices round the damage that may move at first, the corners of damaged triangles among them
    growth      how many times as many may move after a part could not be mended, up to the whole mesh
    passes      the greatest number of passes: another one looks for the damage that the last one left
    growths_for_shapes  a part that is valid grows so often, and then only while fewer of its triangles are bad each
                time, so that triangles which the boundary forces to be bad do not set much of the mesh in motion
    """

    worse: float = 3.0
    stretched: float = 1.25
    rings: int = 2
    growth: float = 2.0
    growths_for_shapes: int = 1
    passes: int = 5

    def __post_init__(self) -> None:
        for name in ("worse", "stretched", "growth"):
            if not getattr(self, name) > 1:
                raise ValueError(f"Damage.{name} must be above 1, not {getattr(self, name)}")
        for name in ("rings", "passes"):
            if getattr(self, name) < 1:
                raise ValueError(f"Damage.{name} must be at least 1, not {getattr(self, name)}")
        if self.growths_for_shapes < 0:
            raise ValueError(f"Damage.growths_for_shapes must not be negative, but is {self.growths_for_shapes}")

    def rings_at(self, tries: int) -> int:
        """The rings after so many tries in vain.

        The second try is smaller, since a place that nothing can mend may lie in the part beside one that can be.
        From then on parts grow, by one ring at least.
        """
        if tries == 1:
            return max(1, round(self.rings / self.growth))
        growths = max(tries - 1, 0)
        return max(self.rings + growths, round(self.rings * self.growth**growths))
