"""Deform a mesh with its boundary so that nothing tangles on the way.

    +-> boundary a step further, interior by FEMWARP --- would a triangle invert? -- yes --> shorten the step --+
    |                                                       | no                                                |
    |   smooth <- flip <- take it  <------------------------+                                                   |
    +------------------------------------------------------------------------------------------------------------

Every mesh of a batch has steps of its own; meshes that have arrived take no more.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import torch
from torch import Tensor

from ..diagnosing.diagnosis import diagnose
from ..errors import ConvergenceError
from ..mesh.batch import MeshBatch, put
from ..mesh.detached import without_autograd
from ..mesh.interfaces import released
from ..mesh.measure import quality
from ..mesh.ragged import spread
from ..mesh.validation import fit_positions
from ..status import Status
from ..warping.boundary_path import BoundaryPath
from ..warping.femwarp import (
    boundary_goal,
    checked_new_points,
    femwarp,
    unfit_goals,
    what_is_unfit_goal,
    with_held,
)
from .deform_options import DeformOptions
from .layered_motion import Path, with_layers
from .motion import Motion, advance
from .pipeline import improve
from .report import Progress, Report


@dataclass(frozen=True, eq=False)
class DeformReport:
    """What `deform` did, per mesh (B,).

    status    int64 `Status`; VALID where the whole motion was done
    reached   float64, the part of the motion that was done without a tangle; 1 for all of it
    steps     int64, the steps taken
    refused   int64, the steps tried that would have inverted a triangle, and were shortened
    flips     int64, the edges flipped on the way
    path      for each mesh, the parts of the motion at which its steps ended
    messages  for each mesh, why it ended
    report    the `Report` of the improvement on arrival
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
        """(B,) bool: every triangle of the mesh is upright, wherever its boundary is."""
        return self.report.valid

    def check(self) -> "DeformReport":
        """Raise ConvergenceError, which names the meshes, unless every mesh did the whole motion and is valid."""
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


@without_autograd
def deform(
    batch: MeshBatch,
    new_points: Tensor,
    steps: Literal["auto"] | int = "auto",
    options: DeformOptions | None = None,
    *,
    progress: Callable[[Progress], None] | None = None,
    hold: Tensor | None = None,
) -> tuple[MeshBatch, DeformReport]:
    """Move the boundary of a valid batch to `new_points` in steps so small that no triangle ever inverts.

    The interior follows by FEMWARP (Shontz & Vavasis, BIT 50, 2010) from its positions at the time.  On the straight
    way of one step, the area of every triangle is a quadratic in the length of the step, and the least positive root
    bounds the step.  After each step edges flip and vertices are smoothed, so that the next step can be long.  At the
    end `improve` makes the shapes good.  The number and order of vertices stay the same.

    new_points  (V, 2) in the unit of the batch; only the rows of fixed vertices are read
    steps       "auto": as few steps as possible; a number: at least so many, of equal length where possible
    progress    called now and then with a `Progress`
    hold        (V,) bool, further vertices whose rows are read, such as those of an interface whose motion is known

    Vertices on interfaces (constrained edges) follow as all interior vertices do, unless they are fixed or held; the
    smoothing between the steps and the improvement at the end hold them, unless their options say otherwise.

    Layers along walls go as their walls take them, if `improve` keeps them (`ImproveOptions.shapes`).  Where they leave
    no way, the mesh moves as if it had none, and the message says so.

    A mesh stops on the way if its boundary runs into itself, or if its triangles (topology "keep") allow no further
    step.  It is then valid, and the report says where it stopped.  Its status is `Status.STALLED`, or
    `Status.INFEASIBLE` when no valid mesh exists at the goal.  A mesh with a position, or the goal of a fixed vertex,
    that is not finite, or beyond 1e150, comes back as it is, with `Status.NOT_FINITE`.

    Raises InvalidMeshError when a triangle of the other meshes is inverted, or when `new_points` have another shape or
    type.
    """
    options = options or DeformOptions()
    if steps != "auto" and (not isinstance(steps, int) or isinstance(steps, bool) or steps < 1):
        raise ValueError(f"steps must be 'auto' or a number of steps, at least 1, not {steps!r}")
    given, batch = batch, with_held(batch, hold)
    asked = batch.with_points(checked_new_points(batch, new_points))
    unfit = unfit_goals(batch, asked.points)
    moving, target = batch, asked.points
    if bool(unfit.any()):
        # These meshes stand still during the motion, and `improve` leaves them as they are.
        still = spread(unfit, batch.point_offsets)[:, None]
        moving, target = batch.with_points(torch.where(still, 0.0, batch.points)), torch.where(still, 0.0, target)
    if not bool(unfit.all()):
        boundary_goal(batch.select(~unfit), target[spread(~unfit, batch.point_offsets)], "deform")
    target = torch.where(batch.fixed[:, None], target, moving.points)
    longest = 1.0 if steps == "auto" else 1.0 / steps
    motion, let_go = _moved(moving, target, longest, options, progress, options.improve.keeps_shapes, unfit)
    if bool(unfit.any()):
        bad = torch.where(fit_positions(batch.points)[:, None], asked.points, batch.points)
        motion = replace(motion, mesh=put(motion.mesh, unfit, batch.with_points(bad).select(unfit)))
    after, report = _arrived(motion, batch.with_points(target), options, progress)
    if bool(unfit.any()):
        after = put(after, unfit, batch.select(unfit))
        report = replace(report, report=replace(report.report, quality=quality(after)))
        for b in unfit.nonzero().squeeze(1).tolist():
            report.messages[b] = what_is_unfit_goal(batch, asked.points, b)
    for b in let_go.nonzero().squeeze(1).tolist():
        report.messages[b] += "; its layers left no way, and were not kept"
    return (after if hold is None else released(after, given, report.report.vertex_map)), report


def _moved(
    batch: MeshBatch,
    target: Tensor,
    longest: float,
    options: DeformOptions,
    progress: Callable[[Progress], None] | None,
    keep_layers: bool,
    unfit: Tensor,
) -> tuple[Motion, Tensor]:
    """The motion at its end with layers carried along, and (B,) bool which meshes were stuck and moved without them.

    unfit  (B,) bool, meshes that do not move
    """
    mesh, path = batch, BoundaryPath.of(batch, target, straight=options.path == "straight")
    has_layers = torch.zeros(len(batch), dtype=torch.bool, device=batch.points.device)
    way: Path = path
    if keep_layers:
        mesh, way, has_layers = with_layers(batch, path)
    motion = Motion.begin(mesh, way, longest)
    motion = replace(motion, status=torch.where(unfit, int(Status.NOT_FINITE), motion.status))
    while bool(motion.going.any()):
        before, motion = motion, advance(motion, options)
        if progress is not None and bool((motion.steps > before.steps).any()):
            progress(Progress("deform", int(before.going.sum()), 0, int(motion.steps.max())))
    free = replace(motion.mesh, fixed=batch.fixed, constrained_edges=batch.constrained_edges)
    motion = replace(motion, mesh=free if mesh is not batch else motion.mesh)
    again = has_layers & (motion.status != Status.VALID) & ~unfit
    if bool(again.any()):
        goal = target[spread(again, batch.point_offsets)]
        bare, _ = _moved(batch.select(again), goal, longest, options, progress, False, unfit[again])
        motion = motion.put(again, bare)
    return motion, again


def _arrived(
    motion: Motion, goal: MeshBatch, options: DeformOptions, progress: Callable[[Progress], None] | None
) -> tuple[MeshBatch, DeformReport]:
    """Say what stopped the meshes that are stuck, and improve all.

    goal  the batch that was given, at the positions where it was to go
    """
    stuck = (motion.status != Status.VALID) & (motion.status != Status.NOT_FINITE)
    status, messages = _explained(motion, stuck, goal)
    warped = stuck & (status != Status.INFEASIBLE) & (options.finish == "improve")
    mesh = motion.mesh
    if bool(warped.any()):
        rows = spread(warped, goal.point_offsets)
        mesh = put(mesh, warped, femwarp(mesh.select(warped), goal.points[rows]))
    after, report = improve(mesh, options.improve, progress=progress)
    status = torch.where(warped & report.valid, int(Status.VALID), status)
    for b in warped.nonzero().squeeze(1).tolist():
        end = "untangled at the goal" if bool(report.valid[b]) else f"not untangled there: {report.messages[b]}"
        messages[b] = f"{messages[b]}; {end}"
    return after, DeformReport(
        status, motion.reached, motion.steps, motion.refused, motion.flips, motion.trail, messages, report
    )


def _explained(motion: Motion, stuck: Tensor, goal: MeshBatch) -> tuple[Tensor, list[str]]:
    """The status of each mesh (B,), with INFEASIBLE where no valid mesh exists at the goal, and why it ended."""
    status, messages = motion.status.clone(), [f"arrived in {n} steps" for n in motion.steps.tolist()]
    meshes = stuck.nonzero().squeeze(1).tolist()
    if not meshes:
        return status, messages
    found: dict[int, str] = {}
    for problem in diagnose(goal.select(stuck)):
        found.setdefault(meshes[problem.mesh], problem.message)
    for b in meshes:
        done = f"{100 * float(motion.reached[b]):.4g} percent of the motion"
        if int(status[b]) == Status.ITERATION_LIMIT:
            messages[b] = f"stopped after {int(motion.steps[b])} steps, {done}; raise max_steps to go on"
        else:
            x, y = motion.blocked[b].tolist()
            messages[b] = f"stuck after {done} near ({x:.6g}, {y:.6g}): no step keeps every triangle upright"
        if b in found:
            status[b] = Status.INFEASIBLE
            messages[b] += f"; at the goal no valid mesh exists: {found[b]}"
    return status, messages
