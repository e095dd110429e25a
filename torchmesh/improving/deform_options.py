"""How `deform` works: its options."""

from dataclasses import dataclass, field
from typing import Literal

from ..smoothing.smoothing import SmoothOptions
from .options import ImproveOptions


@dataclass(frozen=True)
class StepControl:
    """How long the next step of a mesh is, from the largest step that inverts no triangle.

    shrink         the next step is at least this part of the last one that was tried
    grow           and at most so many times as long
    after_refusal  after a step that was refused it is at most this part
    negligible     when less than this part of the motion would be left, a step goes all the way: so short a step is not
                   worth its factorisation
    """

    shrink: float = 0.1
    grow: float = 2.0
    after_refusal: float = 0.7
    negligible: float = 1e-9

    def __post_init__(self) -> None:
        for name in ("shrink", "after_refusal"):
            if not 0 < getattr(self, name) < 1:
                raise ValueError(f"StepControl.{name} must be between 0 and 1, not {getattr(self, name)}")
        if not self.grow >= 1:
            raise ValueError(f"StepControl.grow must be at least 1, not {self.grow}")
        if not 0 <= self.negligible < 1:
            raise ValueError(f"StepControl.negligible must be at least 0 and below 1, not {self.negligible}")


@dataclass(frozen=True)
class DeformOptions:
    """How `deform` works.

    topology       "flip": edges may flip between the steps; "keep": the triangles stay
    path           "auto": a boundary loop whose motion is rigid, or nearly so, turns steadily about its moving centre,
                   and everything else goes straight; "straight": every vertex goes straight
    part           the part of the largest step without inversion that is taken, in (0, 1)
    smallest_step  a mesh is stuck when its next step would be a smaller part of the motion than this
    max_steps      the greatest number of steps
    smooth         the smoothing after each step
    improve        how the mesh is improved when it has arrived
    finish         what happens to a mesh that is stuck: "stop" leaves it valid where it is; "improve" warps it the rest
                   of the way and untangles it, if a valid mesh exists there
    control        how the length of the steps changes
    """

    topology: Literal["keep", "flip"] = "flip"
    path: Literal["auto", "straight"] = "auto"
    part: float = 0.7
    smallest_step: float = 1e-4
    max_steps: int = 1000
    smooth: SmoothOptions = field(
        default_factory=lambda: SmoothOptions(power=1, max_iterations=10, energy_tolerance=1e-3)
    )
    improve: ImproveOptions = field(default_factory=ImproveOptions)
    finish: Literal["stop", "improve"] = "stop"
    control: StepControl = field(default_factory=StepControl)

    def __post_init__(self) -> None:
        for name, known in (
            ("topology", ("keep", "flip")),
            ("path", ("auto", "straight")),
            ("finish", ("stop", "improve")),
        ):
            if getattr(self, name) not in known:
                raise ValueError(f"DeformOptions.{name} must be one of {known}, not {getattr(self, name)!r}")
        for name in ("part", "smallest_step"):
            if not 0 < getattr(self, name) < 1:
                raise ValueError(f"DeformOptions.{name} must be between 0 and 1, not {getattr(self, name)}")
        if self.max_steps < 1:
            raise ValueError(f"DeformOptions.max_steps must be at least 1, not {self.max_steps}")
