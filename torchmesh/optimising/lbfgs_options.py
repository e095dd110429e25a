"""How `minimise` of lbfgs.py runs, and what it comes to."""

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class LbfgsOptions:
    """How `minimise` runs.

    max_iterations       steps tried at most
    gradient_tolerance   stop when the root mean square of the scaled gradient is below it
    energy_tolerance     stop when `patience` steps together lower the energy by less than this part
    patience             see above
    history              pairs kept (m of Byrd et al. 1994)
    first_step           root mean square length of the first step, in units of `scale`
    largest_step         largest move of one unknown in a step, in units of `scale`
    sufficient_decrease  a step is accepted when the energy falls by this part of what the slope promises
                         (c1 of Nocedal & Wright 2006, equation 3.4, and their value)
    least_curvature      a step and its change of the gradient enter the history when the slope along the step rises
                         by this part; below, the change may be rounding
    shortening           a refused step is shortened to the minimum of the parabola through it, but to no less and no
                         more than these parts of it (Nocedal & Wright 2006, section 3.5)
    blind_shortening     a refused step whose energy is not finite is shortened to this part
    shortest_step        stop when a step is refused at less than this part of its length
    """

    max_iterations: int = 300
    gradient_tolerance: float = 1e-6
    energy_tolerance: float = 1e-5
    patience: int = 5
    history: int = 4
    first_step: float = 0.1
    largest_step: float = 2.0
    sufficient_decrease: float = 1e-4
    least_curvature: float = 1e-6
    shortening: tuple[float, float] = (0.1, 0.5)
    blind_shortening: float = 0.3
    shortest_step: float = 1e-12

    def __post_init__(self) -> None:
        for name in ("patience", "history"):
            if getattr(self, name) < 1:
                raise ValueError(f"LbfgsOptions.{name} must be at least 1, not {getattr(self, name)}")
        for name in ("first_step", "largest_step"):
            if not getattr(self, name) > 0:
                raise ValueError(f"LbfgsOptions.{name} must be positive, not {getattr(self, name)}")
        for name in ("sufficient_decrease", "blind_shortening"):
            if not 0 < getattr(self, name) < 1:
                raise ValueError(f"LbfgsOptions.{name} must lie between 0 and 1, not {getattr(self, name)}")
        if not 0 < self.shortening[0] <= self.shortening[1] < 1:
            raise ValueError(f"LbfgsOptions.shortening must be two rising parts below 1, not {self.shortening}")


@dataclass(frozen=True, eq=False)
class LbfgsResult:
    """Where `minimise` ended: unknowns (N,), and per problem (B,) energy, root mean square
    scaled gradient, steps accepted, energies evaluated and the `Status` as int64."""

    unknowns: Tensor
    energy: Tensor
    gradient: Tensor
    iterations: Tensor
    evaluations: Tensor
    status: Tensor
