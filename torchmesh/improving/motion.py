"""A batch on its way along the path of its boundary, step by step.

    Motion --- advance: try a step, take it where no triangle inverts, flip and smooth ---> Motion

Nothing in a motion ever changes: a step gives back another one.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ..flipping.delaunay import FlipOptions, flip_to_delaunay
from ..mesh.batch import MeshBatch, put
from ..mesh.frozen import frozen_triangles
from ..mesh.interfaces import holding
from ..mesh.measure import quality, upright
from ..mesh.ragged import put_rows, segment_any, segment_min, spread, true_rows
from ..mesh.rounding import rounded, unrounded
from ..optimising.metric_field import MetricField
from ..optimising.targets import as_targets, narrow, narrow_quads
from ..smoothing.smoothing import smooth
from ..status import Status
from ..warping.boundary_path import first_flat
from ..warping.stiffened import carried_stiffly
from .deform_options import DeformOptions
from .layered_motion import Path
from .needed import meshes_beyond
from .trail import Piece, Trail, longer


@dataclass(frozen=True, eq=False)
class Motion:
    """B meshes on their way.

    mesh     the batch as it is now
    path     the path of its boundary
    longest  the greatest length of a step, as a part of the motion
    status   (B,) int64 `Status`: RUNNING while the mesh is under way
    reached  (B,) float64, the part of the motion that is done
    length   (B,) float64, the length of the next step to try.  It follows from the last step that was tried: a mesh in
             a narrow passage stays in it for a while
    steps    (B,) int64, the steps taken
    refused  (B,) int64, the steps tried that would have inverted a triangle
    flips    (B,) int64, the edges flipped
    ends     for each round of steps, (B,) float64 the part of the motion at which a mesh ended its step; NaN if it took
             none
    blocked  (B, 2) float64, for a mesh that is about to be given up the centre of the triangle that bounds its step
    pieces   for each mesh the pieces of its trail so far; None: no trail is kept
    apart    whether changes at rest are kept apart from the motion in these trails
    """

    mesh: MeshBatch
    path: Path
    longest: float
    status: Tensor
    reached: Tensor
    length: Tensor
    steps: Tensor
    refused: Tensor
    flips: Tensor
    ends: tuple[Tensor, ...]
    blocked: Tensor
    pieces: tuple[tuple[Piece, ...], ...] | None = None
    apart: bool = False

    @classmethod
    def begin(cls, batch: MeshBatch, path: Path, longest: float, trail: Trail = False) -> "Motion":
        """The motion before the first step."""
        device = batch.points.device
        status = torch.full((len(batch),), Status.RUNNING, device=device)
        reached = torch.zeros(len(batch), dtype=torch.float64, device=device)
        none = torch.zeros_like(status)
        blocked = torch.full((len(batch), 2), torch.nan, dtype=torch.float64, device=device)
        length = torch.full_like(reached, longest)
        pieces = ((),) * len(batch) if trail else None
        apart = trail == "apart"
        return cls(batch, path, longest, status, reached, length, none, none, none, (), blocked, pieces, apart)

    def arrived(self, at: Tensor) -> "Motion":
        """This motion before its first step, with that of the meshes `at` (B,) bool, which stand still, taken."""
        if not bool(at.any()):
            return self
        pieces = self.pieces
        if pieces is not None:
            still = zip(self.mesh.split(), at.tolist(), strict=True)
            pieces = tuple((Piece(mesh, mesh, 0.0, 1.0),) if stands else () for mesh, stands in still)
        return replace(
            self,
            status=torch.where(at, int(Status.VALID), self.status),
            reached=torch.where(at, 1.0, self.reached),
            steps=self.steps + at,
            ends=(torch.where(at, 1.0, torch.nan).to(self.reached),),
            pieces=pieces,
        )

    @property
    def going(self) -> Tensor:
        """(B,) bool: the mesh is under way."""
        return self.status == Status.RUNNING

    def put(self, at: Tensor, part: "Motion") -> "Motion":
        """This motion with the meshes `at` (B,) bool replaced by `part`, which begins where they began."""
        rows = true_rows(at)
        names = ("status", "reached", "length", "steps", "refused", "flips", "blocked")
        columns: dict[str, Any] = {name: put_rows(getattr(self, name), rows, getattr(part, name)) for name in names}
        nothing = torch.full_like(self.reached, torch.nan)
        ends = []
        for i in range(max(len(self.ends), len(part.ends))):
            mine = self.ends[i] if i < len(self.ends) else nothing
            theirs = part.ends[i] if i < len(part.ends) else nothing[rows]
            ends.append(put_rows(mine, rows, theirs))
        pieces = None
        if self.pieces is not None and part.pieces is not None:
            new = dict(zip(rows.tolist(), part.pieces, strict=True))
            pieces = tuple(new.get(b, old) for b, old in enumerate(self.pieces))
        return replace(self, mesh=put(self.mesh, at, part.mesh), ends=tuple(ends), pieces=pieces, **columns)

    @property
    def path_ends(self) -> list[list[float]]:
        """For each mesh, the parts of the motion at which its steps ended."""
        if not self.ends:
            return [[] for _ in self.status]
        rows = torch.stack(self.ends, 1).tolist()
        return [[end for end in row if not math.isnan(end)] for row in rows]


def advance(motion: Motion, options: DeformOptions) -> Motion:
    """Every mesh that is under way tries a step, and takes it if no triangle inverts."""
    trial = _trial(motion, options)
    after = replace(
        motion,
        length=_next_length(motion, trial, options),
        refused=motion.refused + (trial.going & ~trial.taken),
        blocked=_blocked(motion, trial, options),
    )
    if bool(trial.taken.any()):
        after = _stepped(after, trial, options)
    return replace(after, status=_next_status(after, trial, options))


@dataclass(frozen=True, eq=False)
class _Trial:
    """A step that the meshes `going` try.

    going   (B,) bool, the meshes that try it
    goal    (B,) float64, the part of the motion at which the step ends
    before  these meshes before the step
    moved   these meshes after the step
    flat    (T,) the part of the way to `moved` at which each triangle is first flat
    limit   (B',) the least of these in each mesh
    taken   (B,) bool, the meshes that take the step
    """

    going: Tensor
    goal: Tensor
    before: MeshBatch
    moved: MeshBatch
    flat: Tensor
    limit: Tensor
    taken: Tensor


def _trial(motion: Motion, options: DeformOptions) -> _Trial:
    """What the next step of the meshes under way would bring."""
    going = motion.going
    goal = (motion.reached + motion.length).clamp_max(1.0)
    goal = torch.where(1.0 - goal < options.control.negligible, 1.0, goal)
    before = motion.mesh.select(going)
    points = motion.path.at(torch.where(going, goal, motion.reached)).to(before.points)
    moved = carried_stiffly(before, points[spread(going, motion.mesh.point_offsets)], options.stiffening)
    flat = first_flat(before, moved.points)
    limit = segment_min(flat, before.triangle_offsets)
    # Rounding may invert a triangle where the quadratic does not.
    sound = ~segment_any(~upright(moved), before.triangle_offsets)
    taken = torch.zeros_like(going)
    taken[going] = (options.part * limit >= 1) & sound
    return _Trial(going, goal, before, moved, flat, limit, taken)


def _next_length(motion: Motion, trial: _Trial, options: DeformOptions) -> Tensor:
    """(B,) the length of the next step, by what the largest step without inversion was."""
    control, going, refused = options.control, trial.going, trial.going & ~trial.taken
    ratio = torch.ones_like(motion.length)
    ratio[going] = (options.part * trial.limit).clamp(control.shrink, control.grow)
    ratio[refused] = ratio[refused].clamp_max(control.after_refusal)
    length = torch.where(going, ratio * (trial.goal - motion.reached), motion.length)
    return length.clamp_max(motion.longest)


def _blocked(motion: Motion, trial: _Trial, options: DeformOptions) -> Tensor:
    """(B, 2) `Motion.blocked` after a trial: the centres of the triangles that bound steps near the smallest length."""
    near = trial.going & ~trial.taken & (options.control.shrink * motion.length < options.smallest_step)
    if not bool(near.any()):
        return motion.blocked
    blocked, part = motion.blocked.clone(), trial.before
    offsets = part.triangle_offsets.tolist()
    for i, b in enumerate(true_rows(trial.going).tolist()):
        if bool(near[b]):
            row = offsets[i] + int(trial.flat[offsets[i] : offsets[i + 1]].argmin())
            blocked[b] = part.points[part.triangles[row]].to(torch.float64).mean(0)
    return blocked


def _stepped(motion: Motion, trial: _Trial, options: DeformOptions) -> Motion:
    """The motion after the step, with edges flipped and vertices smoothed in the meshes that go on and need it."""
    taken, moved = trial.taken, trial.moved.select(trial.taken[trial.going])
    reached, flips, part = torch.where(taken, trial.goal, motion.reached), motion.flips, moved
    # `improve` does the same on arrival, and better.
    between = (reached < 1)[taken]
    if options.bound is not None and bool(between.any()):
        between &= meshes_beyond(moved, quality(moved), options.bound, frozen_triangles(holding(moved)))
    if bool(between.any()):
        begun = part.select(between)
        # Which edges flip must not hang on rounding errors.
        some = start = rounded(begun, torch.ones(len(begun), dtype=torch.bool, device=between.device))
        whole = taken.index_put((true_rows(taken),), between)
        targets = narrow(as_targets(options.targets), motion.mesh, whole)
        if options.may_flip:
            metric = targets if isinstance(targets, MetricField) else None
            some, info = flip_to_delaunay(some, FlipOptions(rule="shape"), metric=metric)
            flips = flips.index_add(0, true_rows(whole), info.flips)
        shapes = narrow_quads(options.smooth.quad_targets, motion.mesh, whole)
        done = smooth(some, replace(options.smooth, targets=targets, quad_targets=shapes))[0]
        done = unrounded(done, start, begun, holding(begun).fixed)
        good = ~segment_any(~upright(done), done.triangle_offsets)
        part = put(part, between, done if bool(good.all()) else put(begun, good, done.select(good)))
    return replace(
        motion,
        mesh=put(motion.mesh, taken, part),
        reached=reached,
        steps=motion.steps + taken,
        flips=flips,
        ends=(*motion.ends, torch.where(taken, trial.goal, torch.nan)),
        pieces=_longer_trails(motion, trial, moved, part),
    )


def _longer_trails(
    motion: Motion, trial: _Trial, moved: MeshBatch, after: MeshBatch
) -> tuple[tuple[Piece, ...], ...] | None:
    """The trails after a step that took meshes to `moved`, where they became `after`."""
    if motion.pieces is None:
        return None
    trails = list(motion.pieces)
    before = trial.before.select(trial.taken[trial.going]).split()
    rows = true_rows(trial.taken).tolist()
    for b, old, there, then in zip(rows, before, moved.split(), after.split(), strict=True):
        step = Piece(old, there, float(motion.reached[b]), float(trial.goal[b]))
        trails[b] = longer(trails[b], step, then, motion.apart)
    return tuple(trails)


def _next_status(motion: Motion, trial: _Trial, options: DeformOptions) -> Tensor:
    """(B,) the status of the meshes after a step."""
    status = motion.status.clone()
    status[trial.taken & (motion.reached >= 1)] = Status.VALID
    going = status == Status.RUNNING
    status[going & (motion.length < options.smallest_step)] = Status.STALLED
    status[going & (motion.steps >= options.max_steps)] = Status.ITERATION_LIMIT
    return status
