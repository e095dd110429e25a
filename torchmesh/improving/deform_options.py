"""How `deform` works: its options."""

import math
from dataclasses import dataclass, field, replace
from typing import Literal

from ..mesh.batch import MeshBatch
from ..mesh.typed import check_records
from ..optimising.targets import TargetFunction, Targets, check_topology
from ..smoothing.smoothing import SmoothOptions
from .checks import check_between_0_and_1, check_least, check_whole, is_number
from .options import ImproveOptions
from .step_options import Bound


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
        check_between_0_and_1(self, "shrink", "after_refusal")
        check_least(self, grow=1)
        if not (is_number(self.negligible) and 0 <= self.negligible < 1):
            raise ValueError(f"StepControl.negligible must be at least 0 and below 1, not {self.negligible!r}")


@dataclass(frozen=True)
class DeformOptions:
    """How `deform` works.

    topology       "flip": edges may flip between the steps and on arrival; "keep": the triangles stay.  "keep" in
                   `improve` says the same
    path           "auto": a boundary loop whose motion is rigid, or nearly so, turns steadily about its moving centre,
                   and everything else goes straight; "straight": every vertex goes straight
    stiffening     the interior follows the boundary with stiffnesses that are proportional to this power of one over a
                   triangle's area.  With 1 small triangles go along with the walls at which they lie, and steps are
                   longer; 0 is FEMWARP
    part           the part of the largest step without inversion that is taken, in (0, 1)
    smallest_step  a mesh is stuck when its next step would be a smaller part of the motion than this
    max_steps      the greatest number of steps
    when           only a mesh beyond this bound is flipped and smoothed after a step, and improved on arrival; one
                   within it has just followed its boundary.  None: as `improve.when` says, or every mesh is
    rounds         with such a bound, the greatest number of rounds of flips and smoothing on arrival: the mesh goes on
                   moving, and the fifth round and those after it gain a few thousandths of the inverse mean ratio
    smooth         the smoothing after each step.  Its targets govern the flips and the arrival, too, and those of
                   `improve.smooth` the steps
    improve        how the mesh is improved when it has arrived
    reference      the undeformed meshes, with as many vertices and triangles, and the same boundary and constrained
                   edges, if the caller has them.  On arrival a mesh that would be improved, or has other triangles,
                   becomes the reference, warped to the boundary, if that is good: within the bound, or, without one,
                   such that no triangle would be polished.  What a mesh is like then hangs less on how it came there
    finish         what happens to a mesh that is stuck: "stop" leaves it valid where it is; "improve" warps it the rest
                   of the way and untangles it, if a valid mesh exists there
    control        how the length of the steps changes
    """

    topology: Literal["keep", "flip"] = "flip"
    path: Literal["auto", "straight"] = "auto"
    stiffening: float = 1.0
    part: float = 0.7
    smallest_step: float = 1e-4
    max_steps: int = 1000
    when: Bound | None = None
    rounds: int = 4
    smooth: SmoothOptions = field(
        default_factory=lambda: SmoothOptions(power=1, max_iterations=10, energy_tolerance=1e-3)
    )
    improve: ImproveOptions = field(default_factory=ImproveOptions)
    reference: MeshBatch | None = None
    finish: Literal["stop", "improve"] = "stop"
    control: StepControl = field(default_factory=StepControl)

    def __post_init__(self) -> None:
        check_records(self)
        for name, known in (
            ("topology", ("keep", "flip")),
            ("path", ("auto", "straight")),
            ("finish", ("stop", "improve")),
        ):
            if getattr(self, name) not in known:
                raise ValueError(f"DeformOptions.{name} must be one of {known}, not {getattr(self, name)!r}")
        check_between_0_and_1(self, "part", "smallest_step")
        if not (is_number(self.stiffening) and 0 <= self.stiffening <= 4):
            raise ValueError(f"DeformOptions.stiffening must be between 0 and 4, not {self.stiffening!r}")
        check_whole(self, max_steps=1, rounds=1)
        if self.topology == "keep" and self.improve.topology == "full":
            raise ValueError("DeformOptions.topology='keep' and improve.topology='full' exclude each other")
        check_topology(self.targets, "flip" if self.may_flip else "keep")

    @property
    def may_flip(self) -> bool:
        """Whether edges may flip, on the way and on arrival."""
        return self.topology != "keep" and self.improve.topology != "keep"

    @property
    def targets(self) -> Targets | TargetFunction | None:
        """The shapes that are the aim, on the way and on arrival; None: equilateral triangles."""
        return self.smooth.targets if self.smooth.targets is not None else self.improve.smooth.targets

    @property
    def bound(self) -> Bound | None:
        """The bound beyond which a mesh is worked on, on the way and on arrival."""
        return self.when or self.improve.when

    @property
    def arrival(self) -> ImproveOptions:
        """How the mesh is improved on arrival: `improve`, with what else is asked here.

        All vertices move in a deformation: they are not held near where it has left them, but do not travel, either.
        """
        tether = self.improve.max_motion
        if tether is None and self.improve.relocate == "auto" and self.improve.stays_near:
            tether = math.inf
        rounds = self.improve.smooth_rounds
        return replace(
            self.improve,
            max_motion=tether,
            topology=self.improve.topology if self.may_flip else "keep",
            when=self.bound,
            smooth_rounds=rounds if self.bound is None else min(rounds, self.rounds),
            smooth=replace(self.improve.smooth, targets=self.targets),
        )
