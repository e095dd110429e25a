"""`improve`: the strategy on a batch, on submeshes of large meshes, or in several processes, and the report."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.ragged import segment_count
from ..status import Status
from ..untangling.untangling import check_reference
from .forked import can_fork, in_processes, one_thread
from .local_repair import on_submeshes
from .options import ImproveOptions
from .report import Progress, Report, left_over
from .runner import Job, Log
from .state import Edits, State
from .strategies import improve_batch
from .travel import travel_of

if TYPE_CHECKING:
    from ..remeshing.remeshing import RemeshInfo


def improve(
    batch: MeshBatch,
    options: ImproveOptions | None = None,
    *,
    progress: Callable[[Progress], None] | None = None,
    observe: Callable[[str, MeshBatch], None] | None = None,
    hold: Tensor | None = None,
) -> tuple[MeshBatch, Report]:
    """Give every mesh of the batch upright triangles of good shape, as far as its boundary allows.

    The number and order of the vertices stay, except under topology "full"; so do the positions of fixed vertices, and
    the boundary and constrained edges.  The result for a mesh does not depend on the other meshes of the batch.  The
    report says for every mesh what was tried and how it ended.  Nothing is raised for a mesh that could not be solved;
    `report.check()` does that.

    progress  called now and then with a `Progress`
    observe   called after each stage with its name and the whole batch at that time, for example by `report_page` and
              `animate`; the first call has "initial" and the batch as given.  With one mesh, the calls are the rows of
              `report.steps[0]`
    hold      (V,) bool, vertices that do not slide; it is read with boundary="slide" only

    A large batch is shared among forked processes where that is safe (`ImproveOptions.workers`); `progress` is then
    called once for each shard.
    Raises InvalidMeshError when `options.reference` is not a valid mesh of the same triangles.
    """
    options = options or ImproveOptions()
    if options.reference is not None:
        check_reference(batch, options.reference)
    workers = options.workers or torch.get_num_threads()
    shared = observe is None and hold is None and options.separable and can_fork(batch.points.device)
    log = Log(len(batch), progress, observe)
    with one_thread():
        state = State.of(batch, options, hold)
        log.mark("initial", state, torch.ones_like(state.valid))
        state = whole_job(options, workers if shared else 1)(state, log)
    return state.mesh, report_on(state, log, options)


def whole_job(options: ImproveOptions, workers: int) -> Job:
    """The strategy in the wrappers that the options ask for; a wrapper has no effect where it is not needed."""
    job: Job = partial(improve_batch, options=options)
    if options.local:
        job = on_submeshes(job, options)
    return in_processes(job, workers) if workers > 1 else job


def report_on(state: State, log: Log, options: ImproveOptions) -> Report:
    """The report on a finished state."""
    return Report(
        status=state.status,
        valid=state.valid,
        certified=state.certified,
        quality=state.quality,
        steps=log.steps,
        messages=[_message(b, state, log, options) for b in range(len(state))],
        moved=_moved(state),
        remeshed=_remeshed(state) if options.topology == "full" else None,
        sizes=state.conformity,
        travel=travel_of(state),
    )


def _message(b: int, state: State, log: Log, options: ImproveOptions) -> str:
    """Why the work on mesh `b` ended."""
    status, reason = Status(int(state.status[b])), state.reasons[b]
    text = status.message
    if status == Status.INFEASIBLE:
        text = reason
    elif status in (Status.STALLED, Status.ITERATION_LIMIT) and log.steps[b][-1].inverted:
        text = left_over(reason or text, log.steps[b], not options.may_flip)
    return text + state.notes[b]


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
