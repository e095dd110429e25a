"""Deform a mesh with its boundary so that nothing tangles on the way.

    +-> boundary a step further, interior follows ------ would a triangle invert? -- yes --> shorten the step --+
    |                                                       | no                                                |
    |   smooth <- flip <- take it  <------------------------+                                                   |
    +------------------------------------------------------------------------------------------------------------

Every mesh of a batch has steps of its own; meshes that have arrived take no more.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

from ..diagnosing.diagnosis import diagnose
from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch, put
from ..mesh.boundary_parts import part_vertices
from ..mesh.detached import without_autograd
from ..mesh.interfaces import released
from ..mesh.measure import quality
from ..mesh.quads import halved, has_quads, whole
from ..mesh.ragged import segment_any, spread, true_rows
from ..mesh.regions import region_areas
from ..mesh.typed import typed
from ..mesh.validation import fit_positions
from ..mesh.vertex_map import VertexMap
from ..optimising.targets import as_targets, narrow, narrow_quads, quad_targets_from
from ..status import Status
from ..warping.boundary_path import BoundaryPath
from ..warping.femwarp import (
    checked_hold,
    checked_new_points,
    femwarp,
    refuse_tangled,
    unfit_goals,
    what_is_unfit_goal,
    with_held,
)
from .deform_options import DeformOptions
from .deform_report import DeformReport
from .history import check_fits, towards_reference
from .layered_motion import Path, with_layers
from .motion import Motion, advance
from .pipeline import improve
from .report import Progress
from .rigid_motion import RigidPath, bodies_of, holding_edges
from .trail import Piece, Trail, has_rewired, settled
from .walls import names_of_walls, no_layer


@typed
def deform(
    batch: MeshBatch,
    new_points: Tensor,
    steps: Literal["auto"] | int = "auto",
    options: DeformOptions | None = None,
    *,
    progress: Callable[[Progress], None] | None = None,
    hold: Tensor | None = None,
    rigid: Tensor | None = None,
    layer: str | Sequence[str] | None = None,
    trail: Trail = False,
) -> tuple[MeshBatch, DeformReport]:
    """Move the boundary of a valid batch to `new_points` in steps so small that no triangle ever inverts.

    The interior follows harmonically from its positions at the time, with small triangles stiffer
    (`DeformOptions.stiffening`; 0 is FEMWARP, Shontz & Vavasis, BIT 50, 2010).  On the straight way of one step, the
    area of every triangle is a quadratic in the length of the step, and the least positive root bounds the step.  After
    each step edges flip and vertices are smoothed, so that the next step can be long.  At the end `improve` makes the
    shapes good.  The number and order of vertices stay the same.

    new_points  (V, 2) in the unit of the batch; only the rows of fixed vertices are read
    steps       "auto": as few steps as possible; a number: at least so many, of equal length where possible
    progress    called now and then with a `Progress`
    hold        (V,) bool, further vertices whose rows are read, such as those of an interface whose motion is known
    rigid       (V,) bool, vertices that follow their body exactly, such as those of a layer: they shift and turn with
                the wall to which edges join them, the edges between them stay, and no stage works on them.  Their own
                rows of `new_points` are not read
    layer       walls: loops of the boundary, "outer:N" or "hole:N", or boxes "X0,Y0,X1,Y1".  The layers of thin
                triangles along them follow, also where the wall bends, and are held on arrival, too.  A batch does not
                know the names that groups have in a file: `torchmesh warp FILE --list` tells the box of each.  Quads
                aim at the shapes that they had before the motion without being named; `rigid` carries them exactly
    trail       whether `report.trail` is to say on which pieces of the motion the triangles stay, for a solver that
                steps along with the mesh.  "apart": smoothing is then no part of the motion, but a change between two
                pieces, for values of a material that goes with the boundary

    Vertices on interfaces (constrained edges) follow as all interior vertices do, unless they are fixed or held; the
    smoothing between the steps and the improvement at the end hold them, unless their options say otherwise.

    Layers along walls go as their walls take them, if `improve` keeps them (`ImproveOptions.shapes`).  Where they leave
    no way, the mesh moves as if it had none, and the message says so; those that `layer` names are never given up.

    A mesh stops on the way if its boundary runs into itself, or if its triangles (topology "keep") allow no further
    step.  It is then valid, and the report says where it stopped.  Its status is `Status.STALLED`, or
    `Status.INFEASIBLE` when no valid mesh exists at the goal.  A mesh with a position, or the goal of a fixed vertex,
    that is not finite, or beyond 1e150, comes back as it is, with `Status.NOT_FINITE`.

    There is no gradient: of steps, flips and smoothing none is defined.  `femwarp` has one.

    Raises InvalidMeshError when a triangle of the other meshes is inverted, when `new_points` have another shape or
    type, when a body of `rigid` has no wall or a wall that bends, or when there is no layer along a wall that `layer`
    names; ValueError when `new_points` requires a gradient.
    """
    if isinstance(new_points, Tensor) and new_points.requires_grad and torch.is_grad_enabled():
        raise ValueError(
            "deform has no gradient: give new_points.detach(), or take femwarp, which is differentiable in the boundary"
        )
    if trail not in (True, False, "apart"):
        raise ValueError(f"trail must be True, False or 'apart', not {trail!r}")
    names = names_of_walls(layer)
    return _deform(batch, new_points, steps, options or DeformOptions(), progress, hold, rigid, names, trail)


@without_autograd
def _deform(
    batch: MeshBatch,
    new_points: Tensor,
    steps: Literal["auto"] | int,
    options: DeformOptions,
    progress: Callable[[Progress], None] | None,
    hold: Tensor | None,
    rigid: Tensor | None,
    layer: tuple[str, ...],
    trail: Trail,
) -> tuple[MeshBatch, DeformReport]:
    if has_quads(batch):
        if options.improve.topology == "full":
            raise ValueError(
                "deform of meshes with quads keeps number and order of vertices: "
                "take topology 'flip', and improve(after, ImproveOptions(topology='full')) on arrival"
            )
        # No quad is ever inverted here, so that there is none to split.
        improve_too = replace(options.improve, local_repair=None, quads="keep")
        if options.improve.reference is not None:
            improve_too = replace(improve_too, reference=halved(options.improve.reference))
        reference = None if options.reference is None else halved(options.reference)
        # What quads are like before the motion is what they are meant to be like.
        meant = None if improve_too.shapes == "equilateral" else quad_targets_from(options.reference or batch)
        if options.smooth.quad_targets is None:
            options = replace(options, smooth=replace(options.smooth, quad_targets=meant))
        if improve_too.smooth.quad_targets is None:
            improve_too = replace(improve_too, smooth=replace(improve_too.smooth, quad_targets=meant))
        options = replace(options, improve=improve_too, reference=reference)
        after, report = _deform(halved(batch), new_points, steps, options, progress, hold, rigid, layer, trail)
        return _in_whole(after, report)
    if steps != "auto" and (not isinstance(steps, int) or isinstance(steps, bool) or steps < 1):
        raise ValueError(f"steps must be 'auto' or a number of steps, at least 1, not {steps!r}")
    given, batch = batch, with_held(batch, hold)
    if options.reference is not None:
        check_fits(batch, options.reference)
    asked = batch.with_points(checked_new_points(batch, new_points))
    unfit = unfit_goals(batch, asked.points)
    moving, target = batch, asked.points
    if bool(unfit.any()):
        # These meshes stand still during the motion, and `improve` leaves them as they are.
        still = spread(unfit, batch.point_offsets)[:, None]
        moving, target = batch.with_points(torch.where(still, 0.0, batch.points)), torch.where(still, 0.0, target)
    if not bool(unfit.all()):
        refuse_tangled(batch.select(~unfit), "deform")
    target = torch.where(batch.fixed[:, None], target, moving.points)
    task = Task.of(moving, target, options, rigid, layer, unfit)
    longest = 1.0 if steps == "auto" else 1.0 / steps
    motion, let_go = _moved(task, longest, options, progress, options.improve.keeps_shapes, trail)
    if bool(unfit.any()):
        bad = torch.where(fit_positions(batch.points)[:, None], asked.points, batch.points)
        motion = replace(motion, mesh=put(motion.mesh, unfit, batch.with_points(bad).select(unfit)))
    after, report = _arrived(motion, task, options, progress)
    if bool(unfit.any()):
        after = put(after, unfit, batch.select(unfit))
        report = replace(report, report=replace(report.report, quality=quality(after)))
        for b in true_rows(unfit).tolist():
            report.messages[b] = what_is_unfit_goal(batch, asked.points, b)
    for b in true_rows(let_go).tolist():
        report.messages[b] += "; its layers left no way, and were not kept"
    after = _as_free(after, task.batch, report.report.vertex_map)
    after = after if hold is None else released(after, given, report.report.vertex_map)
    changed = has_rewired(given, after)
    pieces = None if motion.pieces is None else _trails(motion, given, after)
    return after, replace(report, rewired=changed, trail=pieces)


def _in_whole(after: MeshBatch, report: DeformReport) -> tuple[MeshBatch, DeformReport]:
    """The result of `deform` of quads as halves, in the form that callers see."""
    after = whole(after)
    trail = report.trail and [
        [
            replace(
                piece,
                before=whole(piece.before),
                after=whole(piece.after),
                previous=None if piece.previous is None else whole(piece.previous),
            )
            for piece in pieces
        ]
        for pieces in report.trail
    ]
    return after, replace(report, trail=trail, report=replace(report.report, quality=quality(after)))


@dataclass(frozen=True, eq=False)
class Task:
    """What is to move.

    batch   the batch, with held vertices fixed
    target  (V, 2) where its fixed vertices and their followers go
    held    the batch with the followers of bodies and named layers fixed and their edges constrained
    path    the path of all of these
    follow  (V,) bool, the followers; None: there are none
    unfit   (B,) bool, meshes that do not move
    """

    batch: MeshBatch
    target: Tensor
    held: MeshBatch
    path: Path
    follow: Tensor | None
    unfit: Tensor

    @classmethod
    def of(
        cls,
        batch: MeshBatch,
        goal: Tensor,
        options: DeformOptions,
        rigid: Tensor | None,
        layer: tuple[str, ...],
        unfit: Tensor,
    ) -> "Task":
        """The task in which the boundary goes to `goal` (V, 2)."""
        path: Path = BoundaryPath.of(batch, goal, straight=options.path == "straight")
        if rigid is None and not layer:
            return cls(batch, goal, batch, path, None, unfit)
        if options.improve.topology == "full":
            raise ValueError("deform with rigid or layer needs topology 'keep' or 'flip': under 'full' vertices go")
        held = batch
        if layer:
            along = torch.stack([part_vertices(batch, name) for name in layer]).any(0)
            held, path, has = with_layers(batch, path, along)
            if not bool((has | unfit).all()):
                b = int((~(has | unfit)).nonzero()[0])
                raise InvalidMeshError(f"mesh {b}: {no_layer(batch, b, along, layer)}")
        if rigid is not None:
            mask = checked_hold(batch, rigid, "rigid")
            # A vertex that is fixed goes where it was told to.
            bodies = bodies_of(batch, mask, goal)
            path = RigidPath(path, bodies, batch.points)
            for body in bodies:
                inside = torch.zeros_like(mask)
                inside[torch.cat([body.wall, body.followers])] = True
                held = holding_edges(held, inside)
        end = path.at(torch.ones(len(batch), dtype=torch.float64, device=batch.points.device)).to(goal)
        follow = held.fixed & ~batch.fixed
        return cls(batch, torch.where(follow[:, None], end, goal), held, path, follow, unfit)

    @property
    def unmoved(self) -> Tensor:
        """(B,) bool: the meshes of which nothing has to move."""
        asked = self.held.fixed & (self.target != self.batch.points).any(1)
        return ~segment_any(asked, self.batch.point_offsets)

    def select(self, at: Tensor, options: DeformOptions) -> "Task":
        """The task of the meshes `at` (B,) bool, which have no followers."""
        rows = spread(at, self.batch.point_offsets)
        return Task.of(self.batch.select(at), self.target[rows], options, None, (), self.unfit[at])


def _moved(
    task: Task,
    longest: float,
    options: DeformOptions,
    progress: Callable[[Progress], None] | None,
    keep_layers: bool,
    trail: Trail,
) -> tuple[Motion, Tensor]:
    """The motion at its end with layers carried along, and (B,) bool which meshes were stuck and moved without them."""
    mesh, way = task.held, task.path
    has_layers = torch.zeros(len(mesh), dtype=torch.bool, device=mesh.points.device)
    if keep_layers and task.follow is None:
        mesh, way, has_layers = with_layers(mesh, way)
    motion = Motion.begin(mesh, way, longest, trail)
    motion = motion.arrived(task.unmoved & ~task.unfit)
    motion = replace(motion, status=torch.where(task.unfit, int(Status.NOT_FINITE), motion.status))
    while bool(motion.going.any()):
        before, motion = motion, advance(motion, options)
        if progress is not None and bool((motion.steps > before.steps).any()):
            progress(Progress("deform", int(before.going.sum()), 0, int(motion.steps.max())))
    free = replace(motion.mesh, fixed=task.held.fixed, constrained_edges=task.held.constrained_edges)
    motion = replace(motion, mesh=free if mesh is not task.held else motion.mesh)
    again = has_layers & (motion.status != Status.VALID) & ~task.unfit
    if bool(again.any()):
        targets = narrow(as_targets(options.targets), task.batch, again)
        shapes = narrow_quads(options.smooth.quad_targets, task.batch, again)
        narrowed = replace(options, smooth=replace(options.smooth, targets=targets, quad_targets=shapes))
        part = task.select(again, options)
        motion = motion.put(again, _moved(part, longest, narrowed, progress, False, trail)[0])
    return motion, again


def _arrived(
    motion: Motion, task: Task, options: DeformOptions, progress: Callable[[Progress], None] | None
) -> tuple[MeshBatch, DeformReport]:
    """Say what stopped the meshes that are stuck, and improve all."""
    goal = task.batch.with_points(task.target)
    stuck = (motion.status != Status.VALID) & (motion.status != Status.NOT_FINITE)
    status, messages = _explained(motion, stuck, goal)
    warped = stuck & (status != Status.INFEASIBLE) & (options.finish == "improve")
    mesh = motion.mesh
    if bool(warped.any()):
        rows = spread(warped, goal.point_offsets)
        mesh = put(mesh, warped, femwarp(mesh.select(warped), goal.points[rows]))
    if options.reference is not None:
        mesh = towards_reference(mesh, options.reference, motion.status == Status.VALID, options)
    after, report = improve(mesh, options.arrival, progress=progress, hold=task.follow)
    if report.regions is not None and task.follow is not None:
        # The edges of followers are no borders of regions.
        free = replace(task.batch, points=mesh.points, triangles=mesh.triangles)
        report = replace(report, regions=region_areas(free, after))
    status = torch.where(warped & report.valid, int(Status.VALID), status)
    for b in true_rows(warped).tolist():
        end = "untangled at the goal" if bool(report.valid[b]) else f"not untangled there: {report.messages[b]}"
        messages[b] = f"{messages[b]}; {end}"
    flips = motion.flips + report.flipped
    nothing = torch.zeros_like(stuck)
    return after, DeformReport(
        status, motion.reached, motion.steps, motion.refused, flips, motion.path_ends, messages, report, nothing
    )


def _as_free(mesh: MeshBatch, before: MeshBatch, vertex_map: VertexMap | None) -> MeshBatch:
    """`mesh` with the constrained edges and, of followers, the freedom that `before` has."""
    if vertex_map is not None or len(mesh.constrained_edges) == len(before.constrained_edges):
        return mesh
    return replace(mesh, fixed=before.fixed, constrained_edges=before.constrained_edges)


def _as_given(mesh: MeshBatch, given: MeshBatch) -> MeshBatch:
    """`mesh` with vertices and edges as free as in `given`, where their number is the same."""
    if len(mesh.points) != len(given.points):
        return mesh
    return replace(mesh, fixed=given.fixed, constrained_edges=given.constrained_edges)


def _trails(motion: Motion, given: MeshBatch, after: MeshBatch) -> list[list[Piece]]:
    """The trails to the meshes `after`, whose vertices and edges are as free as those of the meshes given."""
    assert motion.pieces is not None
    trails = []
    for pieces, mesh, end, reached in zip(
        motion.pieces, given.split(), after.split(), motion.reached.tolist(), strict=True
    ):
        start = pieces or (Piece(mesh, mesh, reached, reached),)
        trail = []
        for piece in settled(start, end, motion.apart):
            first, last, old = (
                m if m is None else _as_given(m, mesh) for m in (piece.before, piece.after, piece.previous)
            )
            assert first is not None
            assert last is not None
            trail.append(replace(piece, before=first, after=last, previous=old))
        trails.append(trail)
    return trails


def _explained(motion: Motion, stuck: Tensor, goal: MeshBatch) -> tuple[Tensor, list[str]]:
    """The status of each mesh (B,), with INFEASIBLE where no valid mesh exists at the goal, and why it ended."""
    status, messages = motion.status.clone(), [f"arrived in {_steps(n)}" for n in motion.steps.tolist()]
    meshes = true_rows(stuck).tolist()
    if not meshes:
        return status, messages
    found: dict[int, str] = {}
    for problem in diagnose(goal.select(stuck)):
        found.setdefault(meshes[problem.mesh], problem.message)
    for b in meshes:
        done = f"{100 * float(motion.reached[b]):.4g} percent of the motion"
        if int(status[b]) == Status.ITERATION_LIMIT:
            messages[b] = f"stopped after {_steps(int(motion.steps[b]))}, {done}; raise max_steps to go on"
        else:
            x, y = motion.blocked[b].tolist()
            messages[b] = f"stuck after {done} near ({x:.6g}, {y:.6g}): no step keeps every triangle upright"
        if b in found:
            status[b] = Status.INFEASIBLE
            messages[b] += f"; at the goal no valid mesh exists: {found[b]}"
    return status, messages


def _steps(count: int) -> str:
    """'1 step', '3 steps'"""
    return f"{count} step{'' if count == 1 else 's'}"
