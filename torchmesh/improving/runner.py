"""Stages, the work that they did, and the log that a runner keeps of them.

A *stage* is a function from a state to another state.  It works on every mesh that it is given, and on nothing else.
The *runner* gives it the meshes that are to take it, puts the result back, and writes the log.
"""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from ..errors import what_failed
from ..mesh.batch import MeshBatch, put
from ..mesh.ragged import counts_from_offsets, put_rows, take, true_rows
from ..optimising.moves import Monitor
from .report import Progress, Step
from .state import State

_log = logging.getLogger(__name__)

# A minimisation reports its progress once in so many iterations.
_ITERATIONS_BETWEEN_REPORTS = 10


@dataclass(frozen=True, eq=False)
class Work:
    """What a stage did, per mesh (B,).

    took        bool, whether the mesh took the stage
    flips       int64, the edges flipped
    iterations  int64, the steps of the minimiser
    cavities    int64, the cavities that were re-triangulated
    kept        bool; false if the stage was an attempt that did not lower the number of inverted triangles
    """

    took: Tensor
    flips: Tensor
    iterations: Tensor
    cavities: Tensor
    kept: Tensor

    @classmethod
    def done(cls, state: State, **columns: Tensor | None) -> "Work":
        """The work of a stage that all meshes of `state` took.

        A column that is missing or None is zero; `kept` is true unless it is given.
        """
        none = torch.zeros_like(state.status)
        every = torch.ones_like(none, dtype=torch.bool)
        known = {name: column for name, column in columns.items() if column is not None}
        return replace(cls(every, none, none, none, every), **known)

    @classmethod
    def nothing(cls, state: State) -> "Work":
        """The work of a stage that no mesh of `state` took."""
        work = cls.done(state)
        return replace(work, took=torch.zeros_like(work.took))

    def plus(self, more: "Work") -> "Work":
        """This work and `more` on the same meshes."""
        sums = {name: getattr(self, name) + getattr(more, name) for name in ("flips", "iterations", "cavities")}
        return replace(self, **sums)

    def put(self, at: Tensor, part: "Work") -> "Work":
        """This work with that on the meshes `at` (B,) bool replaced by `part`."""
        rows = true_rows(at)
        columns = {f.name: put_rows(getattr(self, f.name), rows, getattr(part, f.name)) for f in fields(self)}
        return Work(**columns)

    def over(self, at: Tensor) -> "Work":
        """The same work as columns over the whole batch, of which the meshes `at` (B,) bool took the stage."""
        if len(self.took) == len(at):
            return self
        columns = {f.name: getattr(self, f.name) for f in fields(self)}
        whole = {name: torch.zeros(len(at), dtype=c.dtype, device=at.device) for name, c in columns.items()}
        rows = true_rows(at)
        return Work(**{name: put_rows(whole[name], rows, column) for name, column in columns.items()})


Stage = Callable[[State, Monitor | None], tuple[State, Work]]


class Log:
    """The steps of every mesh, and the functions of the caller that are called on the way.

    steps     for each mesh its rows, in order
    progress  is called before each stage, and now and then within a minimisation
    observe   is called after each stage, with its name and the whole batch

    A log may be a view of another log: it holds some of its meshes, and writes rows about the whole meshes.
    """

    def __init__(
        self,
        count: int,
        progress: Callable[[Progress], None] | None = None,
        observe: Callable[[str, MeshBatch], None] | None = None,
    ) -> None:
        self.steps: list[list[Step]] = [[] for _ in range(count)]
        self.progress, self.observe = progress, observe
        self._as_whole: Callable[[int, Step], Step] = lambda _, step: step
        self._started = 0.0
        self._of_the_watcher: Exception | None = None

    def view(
        self,
        meshes: Tensor,
        whole: Callable[[MeshBatch], MeshBatch],
        step: Callable[[int, Step], Step] = lambda _, step: step,
    ) -> "Log":
        """A log of some of the meshes, or of parts of them, that writes into this log.

        meshes  (B',) int64, the numbers of the meshes in this log
        whole   takes a batch of these meshes to the whole batch, for the observer
        step    takes the number of a mesh in the view and a row about it to the row about the whole mesh
        """
        observe = self.observe
        view = Log(0, self.progress, None if observe is None else lambda stage, batch: observe(stage, whole(batch)))
        rows = meshes.tolist()
        view.steps = [self.steps[b] for b in rows]
        view._as_whole = lambda i, row: self._as_whole(rows[i], step(i, row))
        return view

    def of_meshes(self, whole: MeshBatch, at: Tensor) -> "Log":
        """A view for work on the meshes `at` (B,) bool of the batch `whole`.

        Once their vertices or triangles have come and gone, the observer is shown these meshes alone.
        """

        def pasted(mesh: MeshBatch) -> MeshBatch:
            rows = ((mesh.points, whole.point_offsets), (mesh.triangles, whole.triangle_offsets))
            same = all(len(now) == int(counts_from_offsets(offsets)[at].sum()) for now, offsets in rows)
            return put(whole, at, mesh) if same else mesh

        return self.view(true_rows(at), pasted)

    def begin(self, stage: str, state: State, at: Tensor) -> Monitor | None:
        """Note that a stage begins on the meshes `at` (B,) bool; returns the monitor for its minimisations."""
        self._started = time.perf_counter()
        if self.progress is None:
            return None
        report, meshes, inverted = self.progress, int(at.sum()), int(state.quality.inverted[at].sum())
        report(Progress(stage, meshes, inverted))

        def monitor(iteration: int, energy: Tensor) -> None:
            if iteration % _ITERATIONS_BETWEEN_REPORTS == 0:
                try:
                    report(Progress(stage, meshes, inverted, iteration, float(energy.sum())))
                except Exception as error:
                    self._of_the_watcher = error
                    raise

        return monitor

    def is_of_the_watcher(self, error: Exception) -> bool:
        """Was the error raised by whoever watches the progress?"""
        return error is self._of_the_watcher

    def end(self, stage: str, state: State, at: Tensor, work: Work) -> None:
        """Note that the stage has ended with `state`; `work` has a row for each of the meshes `at`."""
        self._write(stage, state, at, time.perf_counter() - self._started, work)

    def mark(self, name: str, state: State, at: Tensor, *, seconds: float = 0.0, kept: bool = True) -> None:
        """Write a row about the present state of the meshes `at` (B,) bool, which is not the end of a stage."""
        work = Work.done(state)
        work = replace(work, kept=torch.full_like(work.kept, kept))
        self._write(name, state, at, seconds, Work(*(getattr(work, f.name)[at] for f in fields(work))))

    def amend(self, state: State, at: Tensor) -> None:
        """Put the present quality of the meshes `at` (B,) bool into their last rows: rounding has changed it since."""
        q = state.quality
        for b in true_rows(at).tolist():
            self.amend_row(b, float(q.mean[b]), float(q.max[b]), int(q.inverted[b]))

    def amend_row(self, b: int, mean: float, largest: float, inverted: int) -> None:
        """Put these into the last row of mesh `b`."""
        last = replace(self.steps[b][-1], mean=mean, max=largest, inverted=inverted)
        self.steps[b][-1] = self._as_whole(b, last)

    def add(self, b: int, step: Step) -> None:
        """Add a row about mesh `b`."""
        self.steps[b].append(self._as_whole(b, step))

    def _write(self, name: str, state: State, at: Tensor, seconds: float, work: Work) -> None:
        """Write a row for each of the meshes `at`, of which `work` has a row each, and call the observer."""
        q, meshes = state.quality, true_rows(at)
        of_meshes = (take(column, meshes) for column in (q.mean, q.max, q.inverted))
        columns = (meshes, *of_meshes, work.flips, work.iterations, work.cavities, work.kept)
        if meshes.is_cpu:
            table = list(zip(*(column.tolist() for column in columns), strict=True))
        else:
            # All in one table: another device is waited for once.  Counts are far below 2^53.
            table = torch.stack([column.to(torch.float64) for column in columns]).T.tolist()
        for b, mean, worst, inverted, flips, iterations, cavities, kept in table:
            counts = int(flips), int(iterations)
            step = Step(name, mean, worst, int(inverted), *counts, seconds, int(cavities), bool(kept))
            self.add(int(b), step)
        if self.observe is not None:
            self.observe(name, state.mesh)


# Takes a state through all stages, here or in other processes.
Job = Callable[[State, Log], State]


class Runner:
    """Runs stages; its log is the only thing that changes.

    An error inside a stage does not leave it.  The stage is then run on each half of its meshes, and so on down to
    single ones.  So every other mesh gets the result, to the bit, that it has without the mesh that fails.  That mesh
    stays as it was before the stage, takes the stage no more, and goes on with the other stages; `State.failures` names
    the error.
    Errors of whoever watches the progress are passed on.
    """

    def __init__(self, log: Log) -> None:
        self.log = log

    def __call__(self, name: str, stage: Stage, state: State, at: Tensor) -> tuple[State, Work]:
        """The meshes `at` (B,) bool of `state` take the stage; the others stay as they are."""
        at = at & ~state.has_failed_in(name) if any(state.failures) else at
        if not bool(at.any()):
            return state, Work.nothing(state)
        part, work = self._guarded(name, stage, state.select(at), self.log.begin(name, state, at))
        state = state.put(at, part)
        self.log.end(name, state, at, work)
        return state, work.over(at)

    def quietly(self, name: str, stage: Callable[[State], State], state: State, at: Tensor) -> State:
        """The same for what is no stage in the eyes of the caller: nothing is logged."""
        at = at & ~state.has_failed_in(name) if any(state.failures) else at
        if not bool(at.any()):
            return state
        part, _ = self._guarded(name, lambda part, _: (stage(part), Work.nothing(part)), state.select(at), None)
        return state.put(at, part)

    def _guarded(self, name: str, stage: Stage, state: State, monitor: Monitor | None) -> tuple[State, Work]:
        """The stage on all meshes of `state`, on which it may fail."""
        try:
            return stage(state, monitor)
        except Exception as error:
            if self.log.is_of_the_watcher(error):
                raise
            if len(state) == 1:
                _log.info("stage %s", name, exc_info=True)
                work = Work.nothing(state)
                return state.failed(name, what_failed(error)), replace(work, kept=work.took)
        work = Work.nothing(state)
        first = torch.arange(len(state), device=state.meshes.device) < len(state) // 2
        for half in (first, ~first):
            part, done = self._guarded(name, stage, state.select(half), monitor)
            state, work = state.put(half, part), work.put(half, done)
        return state, work
