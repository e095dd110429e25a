"""How `untangle` works: its options."""

from dataclasses import dataclass, field, replace
from typing import Literal

from ..mesh.interfaces import Interfaces, check_interfaces
from ..optimising.lbfgs_options import LbfgsOptions


@dataclass(frozen=True)
class NewtonWays:
    """The second-order ways of `untangle`, for the meshes that are tangled still.

    size_sweeps        the size fields of the targets, which are tried in turn (see `UntangleOptions`); det is in units
                       of the target's area
    betas              bounds above which areas are pushed, one after the other
    pushes             linear systems at most for one of them
    alphas             of the total lifted content, one after the other
    steps_per_alpha    Newton steps at most for one of them
    least_alphas       after so many of them, one that leaves more than `stall_ratio` of the fewest inverted triangles
                       so far is the last
    steps_per_epsilon  Newton steps at most for one epsilon of the regularised functional
    max_continuations  values of epsilon at most
    stall_patience, stall_ratio, stall_depth  the regularised functional ends where nothing is gained, by the rule of
                       `UntangleOptions`.  Of some 20 hard meshes (turned rings, letters, spirals) those that it solved
                       took 6 to 24 epsilons and never met the rule; the others met it after 11 to 40, or had the 60
    first_push         after so many of them, and then twice as many each time, areas are pushed from where the mesh is
    weightings         tries to push areas in rounds, with more and more weight on the triangles that stay inverted:
                       sweeps of the size field, the bound, and the factor of their weights from round to round
    weight_rounds      rounds at most of one try
    weight_pushes      linear systems at most for a round
    weight_decay       power to which weights are raised before that, so that what is no longer inverted counts less and
                       less again
    """

    size_sweeps: tuple[int, ...] = (100, 1000, 20)
    betas: tuple[float, ...] = (0.3, 0.1, 0.03)
    pushes: int = 150
    alphas: tuple[float, ...] = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
    steps_per_alpha: int = 60
    least_alphas: int = 1
    steps_per_epsilon: int = 10
    max_continuations: int = 60
    stall_patience: int = 10
    stall_ratio: float = 0.9
    stall_depth: float = 8.0
    first_push: int = 6
    weightings: tuple[tuple[int, float, float], ...] = (
        (1000, 0.3, 5.0),
        (100, 0.1, 5.0),
        (100, 0.3, 3.0),
        (1000, 0.03, 3.0),
        (20, 0.3, 3.0),
        (1000, 0.1, 3.0),
        (100, 0.3, 2.0),
        (20, 0.1, 3.0),
        (1000, 0.3, 2.0),
        (100, 0.03, 3.0),
        (20, 0.3, 2.0),
        (1000, 0.1, 5.0),
    )
    weight_rounds: int = 60
    weight_pushes: int = 60
    weight_decay: float = 0.9

    def __post_init__(self) -> None:
        counts = ["pushes", "steps_per_alpha", "steps_per_epsilon", "max_continuations", "stall_patience", "first_push"]
        for name in [*counts, "weight_rounds", "weight_pushes"]:
            if getattr(self, name) < 1:
                raise ValueError(f"NewtonWays.{name} must be at least 1, not {getattr(self, name)}")
        if not 0 < self.stall_ratio <= 1 or not self.stall_depth >= 0:
            raise ValueError(
                "NewtonWays.stall_ratio must be above 0 and at most 1, and stall_depth not negative, not "
                f"{self.stall_ratio} and {self.stall_depth}"
            )
        if not 0 <= self.weight_decay <= 1:
            raise ValueError(f"NewtonWays.weight_decay must be from 0 to 1, not {self.weight_decay}")
        if not all(len(w) == 3 and w[0] >= 0 and w[1] > 0 and w[2] > 1 for w in self.weightings):
            raise ValueError(
                "NewtonWays.weightings must be triples of sweeps, a positive bound and a factor above 1, not "
                f"{self.weightings!r}"
            )
        for name in ("alphas", "betas"):
            if not all(v > 0 for v in getattr(self, name)):
                raise ValueError(f"NewtonWays.{name} must all be positive, not {getattr(self, name)!r}")
        if not self.size_sweeps or min(self.size_sweeps) < 0:
            raise ValueError(f"NewtonWays.size_sweeps must be numbers, none negative, not {self.size_sweeps!r}")


@dataclass(frozen=True)
class UntangleOptions:
    """How `untangle` works.

    method             "regularised": the foldover-free functional with a local size for each triangle's
                       target (Garanzha et al. 2021), then as "newton"; "newton": the second-order ways alone, which
                       solve harder meshes; "beta": Knupp's untangle-beta (Kim 2017, equation 2)
    newton             the second-order ways, for meshes that are tangled still; None: "regularised" leaves them so
    beta               beta of "beta": the area below which a triangle is pushed, as a part of the
                       mesh's mean absolute area
    local              beta is a part of at most twice the usual area nearby; meant for graded meshes
    absolute_beta      beta in the mesh's own unit of area instead, as printed in Kim 2017 (0.01 there)
    single             compute displacements of "beta" in single precision, which is faster
    reach              rings of vertices around the triangles that "beta" pushes which move; None: all move
    size_sweeps        how often the target sizes of "regularised" are averaged over neighbours.  Each number is
                       tried in turn, from the given positions, until the mesh is valid
    max_iterations     number of L-BFGS steps after which the method stops; for "regularised" per value of epsilon
    gradient_tolerance  stop when the root mean square of the scaled gradient is below this; None: 1e-6 for
                       "regularised", 1e-12 for "beta", whose gradient is nought once every area is beta
    energy_tolerance   stop when five steps together lower the energy by less than this part; None: 1e-3 for
                       "regularised", whose epsilon then changes the energy, 1e-6 for "beta"
    settled_tolerance  the same for the last minimisation of "regularised", at the least epsilon, of valid meshes
    first_step         root mean square length of the first step, in local sizes
    max_continuations  number of values of epsilon after which "regularised" stops
    work               bound of the work of "regularised" from one start: steps of L-BFGS times the sum of the triangles
                       and 1,750, which a step's time on a small mesh comes to; None: no bound
    least_steps        so many steps it may take whatever the size of the mesh
    stall_patience     values of epsilon over which "regularised" judges whether a mesh still gains.  A mesh stalls when
                       all three hold: its lowest determinant is not up and its inverted triangles are not down to
                       `stall_ratio` of what they were, and the determinant is below -`stall_depth` times epsilon.
                       Of 129 tries on random domains (holes, onto, letter, airfoil, jitter, spiral; up to 400 values
                       of epsilon) none that ended valid ever met these conditions, though some needed 120 values; of
                       the others nine in ten did, after 50 values on average
    stall_ratio        see there; the remaining part of what a mesh had, 1: any gain counts
    stall_depth        see there, in epsilons
    interfaces         "free": the ends of constrained edges move like any vertex; otherwise they stay
    """

    method: Literal["regularised", "newton", "beta"] = "regularised"
    newton: NewtonWays | None = field(default_factory=NewtonWays)
    beta: float = 0.01
    local: bool = False
    absolute_beta: float | None = None
    reach: int | None = None
    single: bool = False
    size_sweeps: tuple[int, ...] = (100, 20, 1000)
    max_iterations: int = 500
    gradient_tolerance: float | None = None
    energy_tolerance: float | None = None
    settled_tolerance: float = 1e-5
    first_step: float = 0.1
    max_continuations: int = 200
    work: int | None = None
    least_steps: int = 150
    stall_patience: int = 10
    stall_ratio: float = 0.9
    stall_depth: float = 8.0
    interfaces: Interfaces | None = None

    def __post_init__(self) -> None:
        if self.method not in ("regularised", "newton", "beta"):
            raise ValueError(f"UntangleOptions.method must be 'regularised', 'newton' or 'beta', not {self.method!r}")
        if self.method == "newton" and self.newton is None:
            raise ValueError("UntangleOptions.method 'newton' needs its ways: UntangleOptions.newton must not be None")
        for name in ("max_iterations", "max_continuations", "stall_patience"):
            if getattr(self, name) < 1:
                raise ValueError(f"UntangleOptions.{name} must be at least 1, not {getattr(self, name)}")
        if not self.size_sweeps or min(self.size_sweeps) < 0:
            raise ValueError(f"UntangleOptions.size_sweeps must be numbers, none negative, not {self.size_sweeps!r}")
        check_interfaces(self.interfaces, "UntangleOptions.interfaces")
        if self.reach is not None and self.reach < 1:
            raise ValueError(f"UntangleOptions.reach must be at least 1, not {self.reach}")
        if self.local and self.absolute_beta is not None:
            raise ValueError("UntangleOptions.local and absolute_beta exclude each other")
        if not 0 < self.stall_ratio <= 1:
            raise ValueError(f"UntangleOptions.stall_ratio must be above 0 and at most 1, not {self.stall_ratio}")
        if not self.first_step > 0:
            raise ValueError(f"UntangleOptions.first_step must be positive, not {self.first_step}")
        for name in (
            "beta",
            "absolute_beta",
            "stall_depth",
            "gradient_tolerance",
            "energy_tolerance",
            "settled_tolerance",
        ):
            value = getattr(self, name)
            if value is not None and not value >= 0:
                raise ValueError(f"UntangleOptions.{name} must not be negative, but is {value}")

    def minimiser(self) -> LbfgsOptions:
        """How L-BFGS minimises one energy of the method."""
        gradient, energy = (1e-6, 1e-3) if self.method == "regularised" else (1e-12, 1e-6)
        return LbfgsOptions(
            max_iterations=self.max_iterations,
            gradient_tolerance=gradient if self.gradient_tolerance is None else self.gradient_tolerance,
            energy_tolerance=energy if self.energy_tolerance is None else self.energy_tolerance,
            first_step=self.first_step,
        )

    def up_to(self, iterations: int) -> "UntangleOptions":
        """These options with at most so many iterations."""
        return replace(self, max_iterations=min(self.max_iterations, iterations))
