"""`improve`: the strategy on a batch, on submeshes of large meshes, or in several processes, and the report."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from ..errors import what_failed
from ..mesh.batch import MeshBatch
from ..mesh.detached import without_autograd
from ..mesh.interfaces import interface_vertices, released
from ..mesh.measure import quality
from ..mesh.quads import has_quads
from ..mesh.ragged import segment_count, true_rows
from ..mesh.rows import check_rows
from ..mesh.unfit import on_a_line, unfit_meshes, what_is_unfit
from ..mesh.validation import fit_positions
from ..optimising.targets import as_targets, check_fit
from ..remeshing.sizing import size_field
from ..status import Status
from ..untangling.untangling import check_reference
from ..warping.femwarp import checked_hold, with_held
from .anew import can_be_made_anew, making_anew
from .columns import Edits
from .faults import INTERFACES_HELD
from .forked import can_fork, in_processes, one_thread
from .layers import keeping_layers
from .local_repair import on_submeshes
from .needed import where_needed
from .options import ImproveOptions
from .report import Progress, Report, left_over, triangles_left
from .runner import Job, Log
from .state import State
from .strategies import improve_batch
from .stretched import keeping_stretch
from .trail import has_rewired
from .travel import travel_of

if TYPE_CHECKING:
    from ..mesh.regions import RegionAreas
    from ..remeshing.remeshing import RemeshInfo


@without_autograd
def improve(
    batch: MeshBatch,
    options: ImproveOptions | None = None,
    *,
    progress: Callable[[Progress], None] | None = None,
    observe: Callable[[str, MeshBatch], None] | None = None,
    hold: Tensor | None = None,
    walls: Mapping[str, Tensor] | Callable[[], Mapping[str, Tensor]] | None = None,
) -> tuple[MeshBatch, Report]:
    """Give every mesh of the batch upright triangles and quads of good shape, as far as its boundary allows.

    The number and order of the vertices stay, except under topology "full"; so do the positions of fixed vertices, and
    the boundary and constrained edges.  The result for a mesh does not depend on the other meshes of the batch.  The
    report says for every mesh what was tried and how it ended.  Nothing is raised for a mesh that could not be solved;
    `report.check()` does that.

    progress  called now and then with a `Progress`
    observe   called after each stage with its name and the whole batch at that time, for example by `report_page` and
              `animate`; the first call has "initial" and the batch as given.  With one mesh, call n belongs to
              `report.steps[0][n]`
    hold      (V,) bool, vertices that neither slide nor move with interfaces that are free
    walls     by name, boundary or constrained edges (K, 2) int64, rows of vertices of the batch: the message says at
              which of these walls layers were kept; or a function that gives them where layers are found.  None: it
              says where the walls are

    A large batch is shared among forked processes where that is safe (`ImproveOptions.workers`); `progress` is then
    called once for each shard.

    A mesh with a position that is not finite, or beyond 1e150, comes back as it is, with `Status.NOT_FINITE`.  An error
    inside a stage touches one mesh only, which goes on with the other stages and ends with `Status.FAILED`; the message
    names the stage and the error, and `report.valid` says whether the mesh is valid all the same.

    The result carries no gradient, whatever the points require; `nn`, `losses`, `metrics` and `femwarp` have one.

    Raises InvalidMeshError when rows of the batch are out of range, when `options.reference` is not a valid mesh of the
    same triangles, and when sizes or targets do not fit the batch.
    """
    options = options or ImproveOptions()
    check_rows(batch)
    if has_quads(batch):
        from .mixed import improve_mixed

        return improve_mixed(improve, batch, options, progress=progress, observe=observe, hold=hold, walls=walls)
    hold = None if hold is None else checked_hold(batch, hold)
    if options.reference is not None:
        check_reference(batch, options.reference)
    workers = options.workers or torch.get_num_threads()
    shared = observe is None and hold is None and options.separable and can_fork(batch.points.device)
    log = Log(len(batch), progress, observe)
    given = batch
    if hold is not None and options.at_interfaces == "free":
        batch = with_held(batch, hold & interface_vertices(batch))
    with one_thread():
        unfit = unfit_meshes(batch)
        work, elsewhere = (batch, None) if bool(fit_positions(batch.points).all()) else on_a_line(batch, unfit)
        _check_options(work, options)
        called = walls if callable(walls) else lambda: walls or {}
        state = _begun(work, options, hold, called).ended(unfit, Status.NOT_FINITE)
        state = state.explained({b: what_is_unfit(batch, b)[0] for b in true_rows(unfit).tolist()})
        log.mark("initial", state, torch.ones_like(state.valid))
        state = whole_job(options, workers if shared else 1)(state, log)
        report = report_on(_measured_from(work, state), log, options)
        improved = state.mesh if batch is given else released(state.mesh, given, report.vertex_map)
        if elsewhere is None:
            return improved, report
        improved = improved.with_points(_put_back(state, batch.points, elsewhere))
        return improved, replace(report, quality=quality(improved))


def _begun(
    work: MeshBatch, options: ImproveOptions, hold: Tensor | None, walls: Callable[[], Mapping[str, Tensor]]
) -> State:
    """The state before any stage; where boundary vertices slide, those of straight sides are in order in it.

    An error in one mesh is noted for it alone: the mesh then goes on as if nothing in it slid.
    """
    begun, in_line, errors = work, None, dict[int, Exception]()
    if options.slides and options.at_boundary == "slide":
        from ..smoothing.boundary_order import in_order_or_errors

        begun, in_line, errors = in_order_or_errors(work, hold)
    state = State.of(begun, options, hold)
    state = replace(state, origin=replace(state.origin, walls=walls))
    if errors:
        own = [(("boundary order", what_failed(errors[b])),) if b in errors else () for b in range(len(state))]
        state = replace(state, failures=tuple(a + b for a, b in zip(own, state.failures, strict=True)))
    if in_line is not None:
        state = state.noted({b: _in_line_text(int(in_line[b])) for b in true_rows(in_line).tolist()})
    return state


def _measured_from(work: MeshBatch, state: State) -> State:
    """The state with the positions of `work` as given: putting the boundary in order is part of the way."""
    origin = state.origin
    moved = (origin.mesh.points != work.points).any(1)
    if not bool(moved.any()):
        return state
    return replace(state, origin=replace(origin, mesh=work, stays=origin.stays & ~moved))


def _check_options(batch: MeshBatch, options: ImproveOptions) -> None:
    """Raise for options that do not fit the batch; inside a stage the error would be noted mesh by mesh."""
    if not isinstance(options.remesh.sizes, str):
        size_field(batch, options.remesh.sizes)
    targets = as_targets(options.smooth.targets)
    if targets is not None:
        check_fit(batch, targets)


def _put_back(state: State, given: Tensor, rows: Tensor) -> Tensor:
    """(V, 2) the points of a finished state; the vertices `rows` (R,) are put back to their `given` positions."""
    now = rows if state.names is None else state.names.vertex_map().old_to_new[rows]
    points = state.mesh.points.clone()
    points[now[now >= 0]] = given[rows[now >= 0]]
    return points


def _in_line_text(count: int) -> str:
    return f"; {count} boundary vertices that had passed each other were put back in order along their straight side"


def whole_job(options: ImproveOptions, workers: int) -> Job:
    """The strategy in the wrappers that the options ask for; a wrapper has no effect where it is not needed."""
    job: Job = partial(improve_batch, options=options)
    if can_be_made_anew(options):
        job = making_anew(job, options)
    if options.scope == "damage":
        from .damage import improve_damage

        job = partial(improve_damage, options=options)
    if options.local and options.scope == "all":
        job = on_submeshes(job, options)
    if options.keeps_shapes:
        # With scope "damage", `improve_damage` itself sees to stretched meshes.
        inner = keeping_stretch(job, options) if options.scope == "all" else job
        # With layers held, the mesh is measured again: their triangles do not count then, and it may be good enough.
        job = keeping_layers(where_needed(inner, options), without=inner)
    job = in_processes(job, workers) if workers > 1 else job
    return where_needed(job, options)


def report_on(state: State, log: Log, options: ImproveOptions) -> Report:
    """The report on a finished state."""
    regions, travel = _areas_of_regions(state), travel_of(state)
    return Report(
        status=state.status,
        valid=state.valid,
        certified=state.certified,
        quality=state.quality,
        steps=log.steps,
        messages=[
            _message(b, state, log, options) + _regions_text(b, regions) + _motion_text(float(travel.max[b]), options)
            for b in range(len(state))
        ],
        moved=_moved(state),
        remeshed=_remeshed(state) if options.topology == "full" else None,
        sizes=state.conformity,
        travel=travel,
        regions=regions,
        notes=[note.removeprefix("; ") for note in state.notes],
        rewired=has_rewired(state.given, state.mesh),
    )


def _motion_text(far: float, options: ImproveOptions) -> str:
    """That a vertex of a mesh went further than it should, if it did."""
    if options.max_motion is None or not far > options.max_motion:
        return ""
    return f"; max_motion could not be had: a vertex is {far:.3g} local widths from where it was given"


def _tangled_at_interface(b: int, state: State) -> bool:
    """Whether an inverted triangle of mesh `b` has a corner on an interface that is held."""
    if state.origin.interfaces == "free" or not len(state.mesh.constrained_edges):
        return False
    rows = slice(*state.mesh.triangle_offsets[b : b + 2].tolist())
    inverted = state.mesh.triangles[rows][~state.quality.upright[rows]]
    return bool(interface_vertices(state.mesh)[inverted].any())


def _areas_of_regions(state: State) -> "RegionAreas | None":
    """The areas of the regions before and after, where interfaces were free to move."""
    if state.origin.interfaces != "free" or not len(state.origin.mesh.constrained_edges):
        return None
    from ..mesh.regions import region_areas

    return region_areas(state.given, state.mesh, None if state.names is None else state.names.vertex_map())


def _regions_text(b: int, regions: "RegionAreas | None") -> str:
    """By how much the regions of mesh `b` have changed."""
    change = torch.zeros(0) if regions is None else 100 * regions.change[regions.mesh == b]
    if len(change) < 2 or bool((change == 0).all()):
        return ""
    low, high = float(change.min()), float(change.max())
    return f"; interfaces moved: the areas of {len(change):,} regions changed by {low:+.3g} to {high:+.3g} percent"


def _message(b: int, state: State, log: Log, options: ImproveOptions) -> str:
    """Why the work on mesh `b` ended."""
    status, fault = Status(int(state.status[b])), state.faults[b]
    text = status.message
    if status in (Status.INFEASIBLE, Status.NOT_FINITE):
        text = fault
    elif status == Status.PARTLY:
        text = f"{text}: {triangles_left(log.steps[b][-1].inverted)}; {fault}"
    elif status == Status.FAILED:
        text = "; ".join(f"the stage {name} failed: {error}" for name, error in state.failures[b])
        text = left_over(text, log.steps[b], not options.may_flip) if log.steps[b][-1].inverted else text
    elif status in (Status.STALLED, Status.ITERATION_LIMIT) and log.steps[b][-1].inverted:
        text = left_over(fault or state.reasons[b] or text, log.steps[b], not options.may_flip)
        text += INTERFACES_HELD if _tangled_at_interface(b, state) else ""
    return text if status == Status.NOT_FINITE else text + state.notes[b]


def _moved(state: State) -> Tensor:
    """(B,) int64, the number of given vertices that are still there but at another position."""
    given = state.given
    if state.names is None:
        return segment_count((state.mesh.points != given.points).any(1), given.point_offsets)
    row = state.of_given_vertices(state.names.vertex_map().old_to_new)
    elsewhere = (state.mesh.points[row.clamp_min(0)] != given.points).any(1) & (row >= 0)
    return segment_count(elsewhere, given.point_offsets)


def _remeshed(state: State) -> "RemeshInfo":
    """What splits and collapses did, under topology "full"."""
    from ..remeshing.remeshing import RemeshInfo

    assert state.sizes is not None
    assert state.conformity is not None
    edits = Edits.none(state.status) if state.edits is None else state.edits
    return RemeshInfo(
        edits.splits, edits.collapses, edits.flips, edits.rounds, state.vertex_names.vertex_map(), state.sizes,
        state.conformity,
    )  # fmt: skip
