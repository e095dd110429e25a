"""Jobs spread over worker processes, of this machine or of a Ray cluster, none lost when a worker dies.

    jobs -> Crew: one thread a worker -> LocalWorker   a process of this machine
                                      \\> RayWorker     tasks on a Ray cluster

A worker is given jobs for one batch, streams their results back, and is given more.  When it dies, the
jobs it had not answered are halved and given out again, so that of many meshes the one that kills its
worker is soon alone; killed twice when alone, a job's result is an error.  The pools of the standard
library break as a whole when one worker dies, and answer only when all of a batch is done.

The process is a fresh interpreter that talks over its standard streams: nothing is forked, on no system,
and the caller's script needs no `if __name__ == "__main__"`.
"""

import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from ..errors import MeshError, MissingDependencyError
from ..improving.options import ImproveOptions
from .batches import Job, improve_jobs
from .manifest import FileResult

# Bytes of a file for each vertex, until files of its kind have been read.
_BYTES_PER_VERTEX = 50


# Starts of a worker that may fail, one after another, before the run is given up.
_STARTS = 3


# Deaths of its worker, when it is the only job, that make a job's result an error.
_DEATHS = 2


class WorkerLost(Exception):
    """A worker died, or its machine did; says how."""


class Worker(Protocol):
    """One that does the jobs of one batch after another, each run beginning after the last one ended."""

    def run(self, jobs: Sequence[Job]) -> Iterator[FileResult]:
        """The result of each job; raises WorkerLost."""
        ...

    def stop(self) -> None:
        """Ends it at once, from any thread; `run` then ends or raises WorkerLost."""
        ...

    def close(self) -> None:
        """Gives back what it holds, when `run` has ended."""
        ...


class LocalWorker:
    """A process of this machine, with one thread of computation; started again when it has died."""

    def __init__(self, options: ImproveOptions, budget: int, label: str) -> None:
        self._settings = pickle.dumps((options, budget, label))
        self._process: subprocess.Popen | None = None
        self._stopped = False

    def run(self, jobs: Sequence[Job]) -> Iterator[FileResult]:
        process = self._running()
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            with _broken_pipes_raise():
                pickle.dump(list(jobs), process.stdin)
                process.stdin.flush()
            while (result := pickle.load(process.stdout)) is not None:
                yield result
        except (EOFError, OSError, pickle.UnpicklingError):
            raise WorkerLost(self._end(process)) from None

    def stop(self) -> None:
        self._stopped = True
        if self._process is not None:
            self._process.kill()

    def close(self) -> None:
        if self._process is not None:
            self._end(self._process)

    def _running(self) -> subprocess.Popen:
        reason = ""
        for _ in range(_STARTS):
            if self._stopped:
                raise WorkerLost("stopped")
            if self._process is not None:
                return self._process
            process = self._process = self._start()
            assert process.stdin is not None
            assert process.stdout is not None
            if self._stopped:
                process.kill()
            try:
                with _broken_pipes_raise():
                    process.stdin.write(self._settings)
                    process.stdin.flush()
                pickle.load(process.stdout)
            except (EOFError, OSError, pickle.UnpicklingError):
                reason = self._end(process)
        if self._process is None:
            raise MeshError(f"a worker process does not start: {reason}")
        return self._process

    def _start(self) -> subprocess.Popen:
        # The child finds the package where this process did, installed or not.
        home = str(Path(__file__).resolve().parents[2])
        code = f"import sys; sys.path.append({home!r}); from torchmesh.batches.workers import serve; serve()"
        one = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        # A group of its own: Ctrl-C is for the parent, which then ends its workers.
        group: dict[str, Any] = (
            {"creationflags": getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)}
            if os.name == "nt"
            else {"start_new_session": True}
        )
        return subprocess.Popen(
            [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=os.environ | one, **group
        )

    def _end(self, process: subprocess.Popen) -> str:
        """Waits for a process that has closed its stream; says how it ended."""
        self._process = None
        for stream in (process.stdin, process.stdout):
            with contextlib.suppress(OSError), _broken_pipes_raise():
                stream.close()  # type: ignore[union-attr]
        try:
            code = process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            code = process.wait()
        if code < 0:
            return f"killed by signal {-code}" + (", perhaps for want of memory" if code == -9 else "")
        return f"exit status {code}"


@contextlib.contextmanager
def _broken_pipes_raise() -> Iterator[None]:
    """Inside, writing to a process that is gone raises BrokenPipeError, as Python has it from its start.

    A library may have put back the system's rule, which is to kill the writer: gmsh does in `initialize`.
    The signal is kept from this thread only, and thrown away: handlers are the caller's own.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows knows no such signal
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPIPE})
    try:
        yield
    finally:
        if signal.SIGPIPE not in before and signal.SIGPIPE in signal.sigpending():
            signal.sigwait({signal.SIGPIPE})
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def serve() -> None:
    """The life of a worker process: settings, then jobs, from standard input; results to standard output."""
    import torch

    torch.set_num_threads(1)
    source, sink = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print must not come between the results
    options, budget, label = pickle.load(source)
    inbox: queue.SimpleQueue[list[Job]] = queue.SimpleQueue()
    threading.Thread(target=_receive, args=(source, inbox), daemon=True).start()
    _send(sink, "ready")
    while True:
        for result in improve_jobs(inbox.get(), options, budget, label):
            _send(sink, result)
        _send(sink, None)


def _receive(source: BinaryIO, inbox: "queue.SimpleQueue[list[Job]]") -> None:
    """Hands jobs on; when the parent is gone, killed perhaps, ends the process in the midst of its work."""
    try:
        while True:
            inbox.put(pickle.load(source))
    finally:
        os._exit(0)


def _send(sink: BinaryIO, message: Any) -> None:
    pickle.dump(message, sink)
    sink.flush()


class RayWorker:
    """Tasks on a Ray cluster, one at a time; the files must be reachable from every machine of it.

    Ray Core and not Ray Data: a streaming task hands over every result as it comes, so what was done
    before a machine died stays done, where Ray Data knows of whole blocks only, and repeats them.
    """

    def __init__(self, options: ImproveOptions, budget: int, label: str) -> None:
        import ray

        self._ray, self._settings = ray, (options, budget, label)
        # Ray would repeat a lost task as a whole: the crew does it better.
        self._task = ray.remote(num_cpus=1, max_retries=0)(_ray_task)
        self._running: Any = None
        self._stopped = False

    def run(self, jobs: Sequence[Job]) -> Iterator[FileResult]:
        self._running = self._task.remote(list(jobs), *self._settings)
        try:
            for reference in self._running:
                yield self._ray.get(reference)
        except self._ray.exceptions.RayTaskError:
            raise
        except self._ray.exceptions.RayError as error:
            raise WorkerLost(" ".join(str(error).split())[:200] or type(error).__name__) from None

    def stop(self) -> None:
        self._stopped = True
        if self._running is not None:
            self._ray.cancel(self._running, force=True)

    def close(self) -> None:
        self._running = None


def _ray_task(jobs: list[Job], options: ImproveOptions, budget: int, label: str) -> Iterator[FileResult]:
    import torch

    torch.set_num_threads(1)
    yield from improve_jobs(jobs, options, budget, label)


@contextlib.contextmanager
def ray_cluster(workers: int | None) -> Iterator[int]:
    """Inside, Ray is there: the cluster of RAY_ADDRESS, or of `ray.init`, or a local one; gives its workers.

    Raises MissingDependencyError without Ray.
    """
    try:
        import ray
    except ImportError:
        raise MissingDependencyError("engine 'ray' needs Ray: pip install 'torchmesh-untangle[ray]'") from None
    own = not ray.is_initialized()
    if own:
        quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "error"}
        try:
            ray.init(address="auto", **quiet)
        except ConnectionError:
            ray.init(address="local", num_cpus=workers, include_dashboard=False, **quiet)
    try:
        yield workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
    finally:
        if own:
            ray.shutdown()


class Crew:
    """Workers and the jobs they share.

    jobs      largest first is best: no large one is then left to the end
    workers   makes each worker
    count     how many; no more are made than there are batches
    budget    vertices of a batch
    """

    def __init__(self, jobs: Sequence[Job], make: Callable[[], Worker], count: int, budget: int) -> None:
        self._jobs = deque(jobs)
        self._again: deque[list[Job]] = deque()
        self._make, self._count, self._budget = make, max(1, min(count, len(jobs))), budget
        self._deaths: dict[str, int] = {}
        self._sizes: dict[str, tuple[int, int]] = {}
        self._change = threading.Condition()
        self._busy = 0
        self._stopping = False
        self._workers: list[Worker] = []
        self._results: queue.SimpleQueue[FileResult | BaseException | None] = queue.SimpleQueue()

    def results(self) -> Generator[FileResult, None, None]:
        """The results, each once, as they come; ends all workers when it ends or is closed."""
        threads = [
            threading.Thread(target=self._serve, daemon=True, name=f"torchmesh worker {n}") for n in range(self._count)
        ]
        try:
            for thread in threads:
                thread.start()
            ended = 0
            while ended < len(threads):
                try:
                    result = self._results.get(timeout=1)  # Windows cannot interrupt a wait without end
                except queue.Empty:
                    continue
                if result is None:
                    ended += 1
                elif isinstance(result, BaseException):
                    raise result
                else:
                    yield result
        finally:
            with self._change:
                self._stopping = True
                self._change.notify_all()
            for worker in self._workers:
                worker.stop()
            for thread in threads:
                thread.join(timeout=10)
            for worker in self._workers:
                worker.close()

    def _serve(self) -> None:
        """The life of a thread: one worker, fed until there is nothing left that could come back."""
        worker: Worker | None = None
        try:
            while jobs := self._take():
                try:
                    worker = worker or self._hire()
                    if worker is not None:
                        self._run(worker, jobs)
                finally:
                    with self._change:
                        self._busy -= 1
                        self._change.notify_all()
        except BaseException as error:
            self._results.put(error)
        finally:
            self._results.put(None)

    def _hire(self) -> Worker | None:
        with self._change:  # so that whoever stops the crew sees every worker
            if self._stopping:
                return None
            worker = self._make()
            self._workers.append(worker)
            return worker

    def _run(self, worker: Worker, jobs: list[Job]) -> None:
        waiting = {job.name: job for job in jobs}
        try:
            for result in worker.run(jobs):
                job = waiting.pop(result.name)
                self._learn(job, result)
                self._results.put(result)
        except WorkerLost as lost:
            if not self._stopping:
                self._give_back(list(waiting.values()), str(lost))

    def _take(self) -> list[Job]:
        """Jobs for one batch; waits while others work, whose jobs may come back; empty at the end."""
        with self._change:
            while not self._stopping:
                if self._again:
                    jobs = self._again.popleft()
                elif self._jobs:
                    jobs = self._next()
                elif self._busy:
                    self._change.wait()
                    continue
                else:
                    break
                self._busy += 1
                return jobs
        return []

    def _next(self) -> list[Job]:
        """A batch's worth of jobs: the budget, or when less is left, a fair share of it for each idle worker."""
        left = sum(self._vertices(job) for job in self._jobs) if len(self._jobs) < 1000 else float("inf")
        idle = max(self._count - self._busy, 1)
        share = min(self._budget, left / idle)
        jobs, total = [self._jobs.popleft()], 0.0
        total = self._vertices(jobs[0])
        while self._jobs and total + self._vertices(self._jobs[0]) <= share * (1 + 1e-9):
            total += self._vertices(self._jobs[0])
            jobs.append(self._jobs.popleft())
        return jobs

    def _vertices(self, job: Job) -> float:
        """An estimate from the file's size."""
        size, vertices = self._sizes.get(Path(job.file).suffix, (0, 0))
        return job.size * vertices / size if vertices else job.size / _BYTES_PER_VERTEX

    def _learn(self, job: Job, result: FileResult) -> None:
        if result.vertices:
            with self._change:
                size, vertices = self._sizes.get(Path(job.file).suffix, (0, 0))
                self._sizes[Path(job.file).suffix] = (size + job.size, vertices + result.vertices)

    def _give_back(self, jobs: list[Job], reason: str) -> None:
        if len(jobs) > 1:
            half = len(jobs) // 2
            parts = [jobs[:half], jobs[half:]]
        elif jobs and self._deaths.get(jobs[0].name, 0) + 1 < _DEATHS:
            self._deaths[jobs[0].name] = self._deaths.get(jobs[0].name, 0) + 1
            parts = [jobs]
        else:
            for job in jobs:
                text = f"{job.file}: its worker died {_DEATHS} times over it alone ({reason})"
                self._results.put(FileResult(name=job.name, file=job.file, error=text))
            parts = []
        with self._change:
            self._again.extend(parts)
            self._change.notify_all()
