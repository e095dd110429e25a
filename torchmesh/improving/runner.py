"""Stages, what they did, and the log that a runner keeps of them.

A *stage* is a function from a state to another state: it works on every mesh that it is handed, and on nothing else.
The *runner* hands it the meshes that are to take it, puts the result back, and writes the log.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..optimising.moves import Monitor
from .report import Progress, Step
from .state import State

# A minimisation tells how far it is once in so many iterations.
_ITERATIONS_BETWEEN_REPORTS = 10


@dataclass(frozen=True, eq=False)
class Work:
    """What a stage did, per mesh (B,).

    took        bool, the mesh took the stage at all
    flips       int64 edges flipped
    iterations  int64 steps of the minimiser
    cavities    int64 cavities that were re-triangulated
    kept        bool, false where the stage was an attempt that brought no fewer inverted triangles
    """

    took: Tensor
    flips: Tensor
    iterations: Tensor
    cavities: Tensor
    kept: Tensor

    @classmethod
    def done(cls, state: State, **columns: Tensor | None) -> "Work":
        """What was done on all meshes of `state`; columns that are missing or None are zero, and everything is kept."""
        none = torch.zeros_like(state.status)
        every = torch.ones_like(none, dtype=torch.bool)
        known = {name: column for name, column in columns.items() if column is not None}
        return replace(cls(every, none, none, none, every), **known)

    @classmethod
    def nothing(cls, state: State) -> "Work":
        """No mesh of `state` took the stage."""
        work = cls.done(state)
        return replace(work, took=torch.zeros_like(work.took))

    def plus(self, more: "Work") -> "Work":
        """This work and `more` on the same meshes."""
        sums = {name: getattr(self, name) + getattr(more, name) for name in ("flips", "iterations", "cavities")}
        return replace(self, **sums)

    def over(self, at: Tensor) -> "Work":
        """The same seen from the whole batch, of which the meshes `at` (B,) bool took the stage."""
        columns = {f.name: getattr(self, f.name) for f in fields(self)}
        whole = {name: torch.zeros(len(at), dtype=c.dtype, device=at.device) for name, c in columns.items()}
        rows = at.nonzero().squeeze(1)
        return Work(**{name: whole[name].index_copy(0, rows, column) for name, column in columns.items()})


Stage = Callable[[State, Monitor | None], tuple[State, Work]]


class Log:
    """The steps of every mesh, and whoever watches.

    steps     for each mesh its rows, in order
    progress  is told before each stage, and now and then within a minimisation
    observe   is called after each stage with its name and the whole batch

    A log may be a view of another: some of its meshes, seen as they are within the whole batch.
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

    def view(
        self,
        meshes: Tensor,
        whole: Callable[[MeshBatch], MeshBatch],
        step: Callable[[int, Step], Step] = lambda _, step: step,
    ) -> "Log":
        """A log of some meshes that writes into this one.

        meshes  (B',) int64, which meshes of this log they are
        whole   makes the whole batch of theirs, for the observer
        step    makes a row about the whole mesh of one about what is worked on, by its number in the view
        """
        observe = self.observe
        view = Log(0, self.progress, None if observe is None else lambda stage, batch: observe(stage, whole(batch)))
        rows = meshes.tolist()
        view.steps = [self.steps[b] for b in rows]
        view._as_whole = lambda i, row: self._as_whole(rows[i], step(i, row))
        return view

    def begin(self, stage: str, state: State, at: Tensor) -> Monitor | None:
        """A stage begins on the meshes `at` (B,) bool; returns the monitor for its minimisations."""
        self._started = time.perf_counter()
        if self.progress is None:
            return None
        report, meshes, inverted = self.progress, int(at.sum()), int(state.quality.inverted[at].sum())
        report(Progress(stage, meshes, inverted))

        def monitor(iteration: int, energy: Tensor) -> None:
            if iteration % _ITERATIONS_BETWEEN_REPORTS == 0:
                report(Progress(stage, meshes, inverted, iteration, float(energy.sum())))

        return monitor

    def end(self, stage: str, state: State, at: Tensor, work: Work) -> None:
        """The stage has brought the batch to `state`; `work` is over the meshes `at`."""
        self._write(stage, state, at, time.perf_counter() - self._started, work)

    def mark(self, name: str, state: State, at: Tensor, *, seconds: float = 0.0, kept: bool = True) -> None:
        """A row for the meshes `at` (B,) bool that is no stage: where they stand."""
        work = Work.done(state)
        work = replace(work, kept=torch.full_like(work.kept, kept))
        self._write(name, state, at, seconds, Work(*(getattr(work, f.name)[at] for f in fields(work))))

    def _write(self, name: str, state: State, at: Tensor, seconds: float, work: Work) -> None:
        q = state.quality
        columns = (q.mean[at], q.max[at], q.inverted[at], work.flips, work.iterations, work.cavities, work.kept)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        for b, (mean, worst, inverted, flips, iterations, cavities, kept) in zip(
            at.nonzero().squeeze(1).tolist(), rows, strict=True
        ):
            step = Step(name, mean, worst, inverted, flips, iterations, seconds, cavities, kept)
            self.steps[b].append(self._as_whole(b, step))
        if self.observe is not None:
            self.observe(name, state.mesh)


# The whole job on a state, or a part of it, or over processes.
Job = Callable[[State, Log], State]


class Runner:
    """Runs stages; its log is the only thing that changes."""

    def __init__(self, log: Log) -> None:
        self.log = log

    def __call__(self, name: str, stage: Stage, state: State, at: Tensor) -> tuple[State, Work]:
        """The meshes `at` (B,) bool of `state` take the stage; the others stay as they are."""
        if not bool(at.any()):
            return state, Work.nothing(state)
        part, work = stage(state.select(at), self.log.begin(name, state, at))
        state = state.put(at, part)
        self.log.end(name, state, at, work)
        return state, work.over(at)
