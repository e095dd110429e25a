"""One batch over several processes: runs of meshes, called shards, are each worked on in a fork of this process.

Python's threads do not help: the work is many short tensor operations, between which threads wait for each other.  A
fork shares the batch without a copy, starts in milliseconds, and sends back only its results.  Each mesh is worked on
by itself, so the result is the same to the bit.
"""

import contextlib
import itertools
import multiprocessing
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import torch
from torch import Tensor

from ..errors import MeshWarning
from ..mesh.measure import Quality
from ..remeshing.sizing import SizeConformity
from .report import Progress, Step
from .runner import Job, Log
from .state import State

# Least and approximate greatest number of triangles in a shard: fewer do not repay a process, and more do not fit the
# cache.
_LEAST, _MOST = 20_000, 100_000


_R = TypeVar("_R")


def can_fork(device: torch.device) -> bool:
    """Whether it is safe here to fork a process that works on tensors of `device`.

    It is safe on Linux, with one Python thread, outside a daemonic worker (which may not have children).  The thread in
    which tqdm watches its progress bars does not count: it sleeps, and holds no lock but tqdm's own now and then.
    """
    threads = sum(type(thread).__name__ != "TMonitor" for thread in threading.enumerate())
    return (
        sys.platform == "linux"
        and device.type == "cpu"
        and threads == 1
        and not multiprocessing.current_process().daemon
    )


def shard_borders(triangle_offsets: Tensor, workers: int) -> list[int]:
    """Where to cut the meshes of a batch into shards with similar numbers of triangles.

    triangle_offsets  (B+1,)

    Returns [0, ..., B], the first meshes of the shards and the end.  The number of shards is a multiple of that of the
    workers; there is only one shard if several would be too short.
    """
    meshes, total = len(triangle_offsets) - 1, int(triangle_offsets[-1])
    workers = min(workers, meshes, total // _LEAST)
    if workers < 2:
        return [0, meshes]
    runs = workers * -(-total // (workers * _MOST))
    goals = torch.arange(1, runs, device=triangle_offsets.device) * total // runs
    inner = torch.searchsorted(triangle_offsets, goals).unique().tolist()
    return [0, *(cut for cut in inner if 0 < cut < meshes), meshes]


def in_processes(job: Job, workers: int) -> Job:
    """The job that does `job` in forked processes, each with a shard of the meshes, if the batch is large enough.

    job  must keep the number and order of vertices and triangles
    """

    def shared(state: State, log: Log) -> State:
        borders = shard_borders(state.mesh.triangle_offsets, workers)
        shards = len(borders) - 1
        if shards < 2:
            return job(state, log)
        # Modules that only few meshes need are imported once here, and not by every process of every call.
        import shapely  # noqa: F401

        from ..remeshing import relocation  # noqa: F401
        from ..untangling import retriangulation  # noqa: F401

        def task(i: int) -> Shard:
            at = (state.meshes >= borders[i]) & (state.meshes < borders[i + 1])
            own = Log(int(at.sum()))
            return Shard.of(job(state.select(at), own), own)

        done = []
        for i, shard in enumerate(over_processes(task, shards, workers)):
            done.append(shard)
            if log.progress is not None:
                left = int((shard.quality.inverted > 0).sum())
                log.progress(Progress(f"shard {i + 1} of {shards}", len(state) - borders[i + 1], left))
        for steps, more in zip(log.steps, (rows for shard in done for rows in shard.steps), strict=True):
            steps += more
        return Shard.joined(state, done)

    return shared


@dataclass(frozen=True, eq=False)
class Shard:
    """What a process sends back: the columns of the state that may have changed, and the rows of the log."""

    points: Tensor
    triangles: Tensor
    quality: Quality
    status: Tensor
    reasons: tuple[str, ...]
    faults: tuple[str, ...]
    impossible: Tensor
    notes: tuple[str, ...]
    certified: Tensor
    conformity: SizeConformity | None
    failures: tuple[tuple[tuple[str, str], ...], ...]
    steps: list[list[Step]]

    @classmethod
    def of(cls, state: State, log: Log) -> "Shard":
        """The shard with a finished state and its log."""
        return cls(
            state.mesh.points, state.mesh.triangles, state.quality, state.status, state.reasons, state.faults,
            state.impossible, state.notes, state.certified, state.conformity, state.failures, log.steps,
        )  # fmt: skip

    @staticmethod
    def joined(state: State, shards: "list[Shard]") -> State:
        """`state` with the results of its shards, which are given in order."""
        starts = itertools.accumulate((len(s.points) for s in shards), initial=0)
        triangles = torch.cat([s.triangles + start for s, start in zip(shards, starts, strict=False)])
        columns = [f.name for f in fields(Quality)]
        return replace(
            state,
            mesh=replace(state.mesh, points=torch.cat([s.points for s in shards]), triangles=triangles),
            quality=Quality(*(torch.cat([getattr(s.quality, name) for s in shards]) for name in columns)),
            status=torch.cat([s.status for s in shards]),
            reasons=tuple(text for s in shards for text in s.reasons),
            faults=tuple(text for s in shards for text in s.faults),
            impossible=torch.cat([s.impossible for s in shards]),
            notes=tuple(text for s in shards for text in s.notes),
            certified=torch.cat([s.certified for s in shards]),
            conformity=_joined_conformity(shards),
            failures=tuple(failures for s in shards for failures in s.failures),
        )


def _joined_conformity(shards: list[Shard]) -> SizeConformity | None:
    """The conformities of all shards together, with NaN for shards that have none; None if no shard has one."""
    if all(s.conformity is None for s in shards):
        return None
    rows = [torch.full_like(s.quality.mean, torch.nan) for s in shards]
    columns = (
        [n if s.conformity is None else getattr(s.conformity, f.name) for s, n in zip(shards, rows, strict=True)]
        for f in fields(SizeConformity)
    )
    return SizeConformity(*(torch.cat(column) for column in columns))


def over_processes(task: Callable[[int], _R], count: int, workers: int) -> Iterator[_R]:
    """The results of task(0), ..., task(count - 1), in this order, computed in `workers` forks of this process.

    An exception of the task is raised here.  If a worker dies, what it has not finished is computed in this process,
    with a MeshWarning.  An interrupt kills the workers.
    """
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool

    global _task
    _task = task
    try:
        context = multiprocessing.get_context("fork")
        with ProcessPoolExecutor(workers, mp_context=context, initializer=_prepare) as pool:
            with warnings.catch_warnings():
                # The fork also copies idle threads of torch, about which Python warns; the workers use none of them.
                warnings.simplefilter("ignore", DeprecationWarning)
                futures = [pool.submit(_pickled, i) for i in range(count)]
            try:
                for i, future in enumerate(futures):
                    try:
                        result = pickle.loads(future.result())
                    except BrokenProcessPool:
                        message = "a worker process died, perhaps for want of memory; its meshes are done here"
                        warnings.warn(MeshWarning(message), stacklevel=2)
                        result = task(i)
                    yield result
            except (KeyboardInterrupt, GeneratorExit):
                # Nobody waits for their results any more.
                for process in list((pool._processes or {}).values()):
                    process.kill()
                raise
            finally:
                pool.shutdown(wait=True, cancel_futures=True)
    finally:
        _task = None


def _prepare() -> None:
    """What a worker does first.  An interrupt from the terminal reaches it too, and ends it without a word."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    torch.set_num_threads(1)


# The task of `over_processes`, which forks find here.
_task: Callable[[int], Any] | None = None


def _pickled(i: int) -> bytes:
    # The result is sent as bytes, since torch would hand over every tensor in a shared file of its own.
    assert _task is not None
    return pickle.dumps(_task(i), protocol=pickle.HIGHEST_PROTOCOL)


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """A context in which tensor operations use one thread.

    The operations are short, so a second thread gains little; and where its core is busy with something else, every
    operation waits for it.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
