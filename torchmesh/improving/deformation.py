"""Deform a mesh with its boundary so that nothing tangles on the way.

    +-> boundary a step further, interior by FEMWARP --- would a triangle invert? -- yes --> shorten the step --+
    |                                                       | no                                                |
    |   smooth <- flip <- take it  <------------------------+                                                   |
    +------------------------------------------------------------------------------------------------------------

Every mesh of a batch has its own steps; meshes that have arrived leave.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import torch
from torch import Tensor

from ..diagnosing.diagnosis import diagnose
from ..errors import ConvergenceError
from ..flipping.delaunay import FlipOptions, flip_to_delaunay
from ..mesh.batch import MeshBatch, put
from ..mesh.measure import upright
from ..mesh.ragged import segment_any, segment_min, spread
from ..smoothing.smoothing import SmoothOptions, smooth
from ..status import Status
from ..warping.boundary_path import BoundaryPath, first_flat
from ..warping.femwarp import boundary_goal, femwarp
from .options import ImproveOptions
from .pipeline import improve
from .report import Progress, Report


@dataclass(frozen=True)
class DeformOptions:
    """How `deform` works.

    topology       "flip": edges may flip between the steps; "keep": the triangles stay
    path           "auto": a boundary loop that goes as a rigid body, or nearly, turns steadily about its
                   moving centre, all else goes straight; "straight": every vertex goes straight
    part           the part of the largest step without inversion that is taken, in (0, 1)
    smallest_step  a mesh whose next step would be a smaller part of the motion is stuck
    max_steps      steps at most
    smooth         the smoothing after each step
    improve        how the mesh is improved on arrival
    finish         what happens to a mesh that is stuck: "stop" leaves it valid, where it got to;
                   "improve" warps it the rest of the way, if a valid mesh exists there, and untangles it
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


@dataclass(frozen=True, eq=False)
class DeformReport:
    """What `deform` did, per mesh (B,).

    status    int64 `Status`: VALID where the whole motion was done
    reached   float64 the part of the motion done without a tangle, 1 for all of it
    steps     int64 steps taken
    refused   int64 steps tried that would have inverted a triangle, and were shortened
    flips     int64 edges flipped on the way
    path      for every mesh, the parts of the motion at which its steps ended
    messages  for every mesh, why it ended
    report    `Report` of the improvement on arrival
    """

    status: Tensor
    reached: Tensor
    steps: Tensor
    refused: Tensor
    flips: Tensor
    path: list[list[float]]
    messages: list[str]
    report: Report

    @property
    def valid(self) -> Tensor:
        """(B,) bool: every triangle is upright, wherever the boundary is."""
        return self.report.valid

    def check(self) -> "DeformReport":
        """Raise ConvergenceError, naming the meshes, unless every mesh did the whole motion and is valid."""
        failed = (self.status != Status.VALID).nonzero().squeeze(1).tolist()
        if failed:
            shown = "; ".join(f"mesh {b}: {self.messages[b]}" for b in failed[:10])
            more = f"; and {len(failed) - 10} more" if len(failed) > 10 else ""
            raise ConvergenceError(f"{len(failed)} of {len(self.status)} meshes did not arrive: {shown}{more}")
        return self

    def to_dict(self) -> list[dict[str, Any]]:
        """One plain record a mesh, for JSON: no infinities."""
        records = self.report.to_dict()
        columns = ("reached", "steps", "refused", "flips")
        return [
            {
                "mesh": b,
                "status": Status(int(self.status[b])).name.lower(),
                "message": self.messages[b],
                **{name: getattr(self, name)[b].item() for name in columns},
                "path": self.path[b],
                "improve": {key: value for key, value in records[b].items() if key != "mesh"},
            }
            for b in range(len(self.status))
        ]


def deform(
    batch: MeshBatch,
    new_points: Tensor,
    steps: Literal["auto"] | int = "auto",
    options: DeformOptions | None = None,
    *,
    progress: Callable[[Progress], None] | None = None,
) -> tuple[MeshBatch, DeformReport]:
    """Move the boundary of a valid batch to `new_points` in steps so small that no triangle ever inverts.

    The interior follows by FEMWARP (Shontz & Vavasis, BIT 50, 2010) from where it is; along the
    straight way of one step every triangle's area is a quadratic in the step length, whose least
    positive root bounds the step.  After each step edges flip and vertices smooth, so that the next
    one can be long; at the end `improve` makes the shapes good.  Vertices keep number and order.

    new_points  (V, 2) in the batch's unit; the rows of fixed vertices count
    steps       "auto": as few as can be; a number: at least so many, of equal length where possible
    progress    called now and then with a `Progress`

    A mesh whose boundary runs into itself on the way, or whose triangles (topology "keep") admit no
    further step, ends valid where it got to, with `Status.STALLED`, or `Status.INFEASIBLE` when no
    valid mesh exists at the goal; the report says where.  Raises InvalidMeshError when a triangle
    of `batch` is inverted, or new positions are not finite or of another shape.
    """
    options = options or DeformOptions()
    if steps != "auto" and (not isinstance(steps, int) or isinstance(steps, bool) or steps < 1):
        raise ValueError(f"steps must be 'auto' or a number of steps, at least 1, not {steps!r}")
    target = boundary_goal(batch, new_points, "deform")
    way = _Way(batch, target, 1.0 if steps == "auto" else 1.0 / steps, options, progress)
    while way.step():
        pass
    return way.arrive()


class _Way:
    """A batch on its way along its boundary's path."""

    def __init__(
        self,
        batch: MeshBatch,
        target: Tensor,
        longest: float,
        options: DeformOptions,
        progress: Callable[[Progress], None] | None,
    ) -> None:
        self.given = self.batch = batch
        self.target, self.longest, self.options, self.progress = target, longest, options, progress
        self.path = BoundaryPath.of(batch, target, straight=options.path == "straight")
        device = batch.points.device
        self.status = torch.full((len(batch),), Status.RUNNING, device=device)
        self.reached = torch.zeros(len(batch), dtype=torch.float64, device=device)
        # The last motion bounds the next try: a mesh in a narrow place stays in it for a while.
        self.length = torch.full_like(self.reached, longest)
        self.steps, self.refused, self.flips = (torch.zeros_like(self.status) for _ in range(3))
        self.trail: list[list[float]] = [[] for _ in range(len(batch))]
        self.places: dict[int, tuple[float, float]] = {}

    def step(self) -> bool:
        """Try a step of every mesh that is under way; whether any is left."""
        going = self.status == Status.RUNNING
        if not bool(going.any()):
            return False
        goal = (self.reached + self.length).clamp_max(1.0)
        # A last step that is all but nothing is not worth its factorisation.
        goal = torch.where(1.0 - goal < 1e-9, 1.0, goal)
        part = self.batch.select(going)
        points = self.path.at(torch.where(going, goal, self.reached)).to(part.points)
        moved = femwarp(part, points[spread(going, self.given.point_offsets)])
        flat = first_flat(part, moved.points)
        limit = segment_min(flat, part.triangle_offsets)
        # Rounding may invert a triangle where the quadratic does not.
        sound = ~segment_any(~upright(moved), part.triangle_offsets)
        taken = torch.zeros_like(going)
        taken[going] = (self.options.part * limit >= 1) & sound
        self._remember(part, flat, going, taken)
        ratio = torch.ones_like(self.length)
        ratio[going] = (self.options.part * limit).clamp(0.1, 2.0)
        ratio[going & ~taken] = ratio[going & ~taken].clamp_max(0.7)
        self.length = torch.where(going, ratio * (goal - self.reached), self.length).clamp_max(self.longest)
        if bool(taken.any()):
            self._take(taken, moved.select(taken[going]), goal)
        self.refused += going & ~taken
        self.status[going & taken & (self.reached >= 1)] = Status.VALID
        going = self.status == Status.RUNNING
        self.status[going & (self.length < self.options.smallest_step)] = Status.STALLED
        self.status[going & (self.steps >= self.options.max_steps)] = Status.ITERATION_LIMIT
        return bool((self.status == Status.RUNNING).any())

    def arrive(self) -> tuple[MeshBatch, DeformReport]:
        """Say what stopped the meshes that are stuck, and improve all."""
        messages = [""] * len(self.status)
        stuck = self.status != Status.VALID
        if bool(stuck.any()):
            self._explain(stuck, messages)
        warped = stuck & (self.status != Status.INFEASIBLE) & (self.options.finish == "improve")
        if bool(warped.any()):
            rows = spread(warped, self.given.point_offsets)
            self.batch = put(self.batch, warped, femwarp(self.batch.select(warped), self.target[rows]))
        after, report = improve(self.batch, self.options.improve, progress=self.progress)
        self.status[warped & report.valid] = Status.VALID
        for b in warped.nonzero().squeeze(1).tolist():
            end = "untangled at the goal" if bool(report.valid[b]) else f"not untangled there: {report.messages[b]}"
            messages[b] = f"{messages[b]}; {end}"
        for b in (~stuck).nonzero().squeeze(1).tolist():
            messages[b] = f"arrived in {int(self.steps[b])} steps"
        return after, DeformReport(
            self.status, self.reached, self.steps, self.refused, self.flips, self.trail, messages, report
        )

    def _take(self, taken: Tensor, part: MeshBatch, goal: Tensor) -> None:
        self.reached = torch.where(taken, goal, self.reached)
        self.steps += taken
        for b in taken.nonzero().squeeze(1).tolist():
            self.trail[b].append(float(goal[b]))
        # On arrival `improve` does this, and better.
        between = (self.reached < 1)[taken]
        if bool(between.any()):
            some = part.select(between)
            if self.options.topology != "keep":
                some, info = flip_to_delaunay(some, FlipOptions(rule="shape"))
                rows = taken.nonzero().squeeze(1)[between]
                self.flips[rows] += info.flips
            part = put(part, between, smooth(some, self.options.smooth)[0])
        self.batch = put(self.batch, taken, part)
        if self.progress is not None:
            left = int((self.status == Status.RUNNING).sum())
            self.progress(Progress("deform", left, 0, int(self.steps.max())))

    def _remember(self, part: MeshBatch, flat: Tensor, going: Tensor, taken: Tensor) -> None:
        """Where the triangle is that bounds the step of each mesh about to be given up."""
        near = going & ~taken & (0.1 * self.length < self.options.smallest_step)
        if not bool(near.any()):
            return
        offsets = part.triangle_offsets.tolist()
        for i, b in enumerate(going.nonzero().squeeze(1).tolist()):
            if bool(near[b]):
                row = offsets[i] + int(flat[offsets[i] : offsets[i + 1]].argmin())
                x, y = part.points[part.triangles[row]].to(torch.float64).mean(0).tolist()
                self.places[b] = x, y

    def _explain(self, stuck: Tensor, messages: list[str]) -> None:
        at_goal = self.given.with_points(self.target).select(stuck)
        meshes = stuck.nonzero().squeeze(1).tolist()
        found: dict[int, str] = {}
        for problem in diagnose(at_goal):
            found.setdefault(meshes[problem.mesh], problem.message)
        for b in meshes:
            done = f"{100 * float(self.reached[b]):.4g} percent of the motion"
            if int(self.status[b]) == Status.ITERATION_LIMIT:
                messages[b] = f"stopped after {int(self.steps[b])} steps, {done}; raise max_steps to go on"
            else:
                x, y = self.places.get(b, (float("nan"), float("nan")))
                messages[b] = f"stuck after {done} near ({x:.6g}, {y:.6g}): no step keeps every triangle upright"
            if b in found:
                self.status[b] = Status.INFEASIBLE
                messages[b] += f"; at the goal no valid mesh exists: {found[b]}"
