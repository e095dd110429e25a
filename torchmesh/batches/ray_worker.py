"""A worker that runs tasks on a Ray cluster."""

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

from ..errors import MissingDependencyError
from ..files.field_transfer import FieldChoice
from ..improving.options import ImproveOptions
from .batches import Job, improve_jobs
from .manifest import FileResult
from .workers import WorkerLost

# Characters of Ray's own message that are kept when a task is lost.
_MESSAGE_LENGTH = 200


class RayWorker:
    """Runs tasks on a Ray cluster, one at a time; every machine of the cluster must reach the files.

    It uses Ray Core and not Ray Data, because a streaming task hands over every result as it comes: what was done
    before a machine died stays done.  Ray Data knows whole blocks only, and repeats them.
    """

    def __init__(self, options: ImproveOptions, budget: int, label: str, fields: FieldChoice = "interpolate") -> None:
        import ray

        self._ray, self._settings = ray, (options, budget, label, fields)
        # Ray would repeat a lost task as a whole; the crew repeats only what was not answered.
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
            raise WorkerLost(" ".join(str(error).split())[:_MESSAGE_LENGTH] or type(error).__name__) from None

    def stop(self) -> None:
        self._stopped = True
        if self._running is not None:
            self._ray.cancel(self._running, force=True)

    def close(self) -> None:
        self._running = None


def _ray_task(
    jobs: list[Job], options: ImproveOptions, budget: int, label: str, fields: FieldChoice
) -> Iterator[FileResult]:
    import torch

    torch.set_num_threads(1)
    yield from improve_jobs(jobs, options, budget, label, fields)


@contextlib.contextmanager
def ray_cluster(workers: int | None) -> Iterator[int]:
    """Inside, Ray is connected: to the cluster of `ray.init`, or of RAY_ADDRESS, or to a local one that is started.

    Gives the number of workers to use: `workers`, or one for each processor of the cluster.  Raises
    MissingDependencyError without Ray.
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
