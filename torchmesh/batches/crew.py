"""Jobs spread over workers, none lost when a worker dies.

    JobPool -- a batch of jobs --> Crew: one thread for each worker --> LocalWorker   a process of this machine
       ^                             |                             `--> RayWorker     tasks on a Ray cluster
       `-- what a dead worker left --+-- results, as they come -->

A worker is given the jobs of one batch, streams their results back, and is given more.  When it dies, the jobs that it
has not answered are halved and handed out again, so that of many meshes the one that kills its worker is soon alone.
When it kills a worker twice alone, the result of its job is an error.  The pools of the standard library do not serve:
they break as a whole when one worker dies, and answer only when all of a batch is done.
"""

import queue
import threading
from collections import deque
from collections.abc import Callable, Generator, Sequence
from pathlib import Path

from .batches import Job
from .manifest import FileResult
from .workers import Worker, WorkerLost

# Bytes of a file for each vertex, as a first guess; `JobPool` learns better from the files of its kind that were read.
_BYTES_PER_VERTEX = 50

# A job is an error when so many workers have died over it while it was their only job.
_DEATHS = 2

# With so many jobs left, sharing them fairly is not yet a question, and summing their sizes would take long.
_MANY_JOBS = 1000


class JobPool:
    """The jobs that are not done yet, handed out in batches; its methods may be called from any thread.

    jobs     largest first is best, because a large one at the end would leave other workers idle
    workers  how many will take jobs
    budget   greatest number of vertices in a batch, estimated from the sizes of the files
    """

    def __init__(self, jobs: Sequence[Job], workers: int, budget: int) -> None:
        self._jobs = deque(jobs)
        self._again: deque[list[Job]] = deque()
        self._workers, self._budget = workers, budget
        self._deaths: dict[str, int] = {}
        self._sizes: dict[str, tuple[int, int]] = {}  # bytes and vertices of the files read, by extension
        self._change = threading.Condition()
        self._busy = 0
        self._closed = False

    def take(self) -> list[Job]:
        """Jobs for one batch, empty when nothing is left.  Call `finish` when their work has ended.

        While others are at work this waits, because their jobs may come back.
        """
        with self._change:
            while not self._closed:
                if self._again or self._jobs:
                    jobs = self._again.popleft() if self._again else self._next()
                    self._busy += 1
                    return jobs
                if not self._busy:
                    break
                self._change.wait()
        return []

    def finish(self) -> None:
        """Ends the work on the jobs of one `take`."""
        with self._change:
            self._busy -= 1
            self._change.notify_all()

    def give_back(self, jobs: list[Job], reason: str) -> list[FileResult]:
        """Takes the jobs of a worker that died, to hand them out again in smaller batches.

        Returns the result of a job that is not tried again, because too many workers have died over it alone.
        """
        with self._change:
            if len(jobs) > 1:
                half = len(jobs) // 2
                self._again += [jobs[:half], jobs[half:]]
            for job in jobs if len(jobs) == 1 else ():
                self._deaths[job.name] = self._deaths.get(job.name, 0) + 1
                if self._deaths[job.name] >= _DEATHS:
                    text = f"{job.file}: its worker died {_DEATHS} times over it alone ({reason})"
                    return [FileResult(name=job.name, file=job.file, error=text)]
                self._again.append([job])
            self._change.notify_all()
        return []

    def learn(self, job: Job, result: FileResult) -> None:
        """Improves the estimate of vertices from a file that was read."""
        if result.vertices:
            with self._change:
                size, vertices = self._sizes.get(Path(job.file).suffix, (0, 0))
                self._sizes[Path(job.file).suffix] = (size + job.size, vertices + result.vertices)

    def close(self) -> None:
        """Hands out no more jobs, and lets those go who wait for some."""
        with self._change:
            self._closed = True
            self._change.notify_all()

    def _next(self) -> list[Job]:
        """Jobs within the budget, or when less is left, a fair share of it for each idle worker; at least one job."""
        left = sum(self._vertices(job) for job in self._jobs) if len(self._jobs) < _MANY_JOBS else float("inf")
        idle = max(self._workers - self._busy, 1)
        share = min(self._budget, left / idle)
        jobs = [self._jobs.popleft()]
        total = self._vertices(jobs[0])
        while self._jobs and total + self._vertices(self._jobs[0]) <= share * (1 + 1e-9):
            total += self._vertices(self._jobs[0])
            jobs.append(self._jobs.popleft())
        return jobs

    def _vertices(self, job: Job) -> float:
        """The vertices of a file, estimated from its size."""
        size, vertices = self._sizes.get(Path(job.file).suffix, (0, 0))
        return job.size * vertices / size if vertices else job.size / _BYTES_PER_VERTEX


class Crew:
    """Workers that share jobs.

    jobs    as for `JobPool`
    make    makes a worker
    count   number of workers; no more are made than there are jobs
    budget  greatest number of vertices in a batch
    """

    def __init__(self, jobs: Sequence[Job], make: Callable[[], Worker], count: int, budget: int) -> None:
        self._make, self._count = make, max(1, min(count, len(jobs)))
        self._pool = JobPool(jobs, self._count, budget)
        self._workers: list[Worker] = []
        self._hiring = threading.Lock()
        self._stopping = False
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
                    result = self._results.get(timeout=1)  # Windows cannot interrupt a wait without a limit
                except queue.Empty:
                    continue
                if result is None:
                    ended += 1
                elif isinstance(result, BaseException):
                    raise result
                else:
                    yield result
        finally:
            with self._hiring:
                self._stopping = True
            self._pool.close()
            for worker in self._workers:
                worker.stop()
            for thread in threads:
                thread.join(timeout=10)
            for worker in self._workers:
                worker.close()

    def _serve(self) -> None:
        """The main function of a thread: gives jobs to one worker until no job is left that could come back."""
        worker: Worker | None = None
        try:
            while jobs := self._pool.take():
                try:
                    worker = worker or self._hire()
                    if worker is not None:
                        self._run(worker, jobs)
                finally:
                    self._pool.finish()
        except BaseException as error:
            self._results.put(error)
        finally:
            self._results.put(None)

    def _hire(self) -> Worker | None:
        """A new worker; None when the crew stops."""
        with self._hiring:  # so that whoever stops the crew sees every worker
            if self._stopping:
                return None
            worker = self._make()
            self._workers.append(worker)
            return worker

    def _run(self, worker: Worker, jobs: list[Job]) -> None:
        """Passes on the results of one batch; gives back what the worker leaves when it dies."""
        waiting = {job.name: job for job in jobs}
        try:
            for result in worker.run(jobs):
                self._pool.learn(waiting.pop(result.name), result)
                self._results.put(result)
        except WorkerLost as lost:
            if not self._stopping:
                for result in self._pool.give_back(list(waiting.values()), str(lost)):
                    self._results.put(result)
