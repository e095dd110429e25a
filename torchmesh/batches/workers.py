"""What a `Crew` asks of a worker: one that does the jobs of one batch after another, somewhere else."""

from collections.abc import Iterator, Sequence
from typing import Protocol

from .batches import Job
from .manifest import FileResult


class WorkerLost(Exception):
    """A worker, or the machine that it was on, died; the message says how."""


class Worker(Protocol):
    """Does the jobs of one batch after another; a run begins after the one before it has ended."""

    def run(self, jobs: Sequence[Job]) -> Iterator[FileResult]:
        """The result of each job, as soon as it is there; raises WorkerLost."""
        ...

    def stop(self) -> None:
        """Ends the worker at once, from any thread; `run` then ends or raises WorkerLost."""
        ...

    def close(self) -> None:
        """Gives back what the worker holds, after `run` has ended."""
        ...
