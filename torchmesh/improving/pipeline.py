"""The whole job: untangle by every means that the options allow, then make the shapes good.

      tangled meshes                                     valid meshes
   +-- relax: neighbours' means, triangles kept      +-> flips that lower the smoother's energy <-+
   |-- flip and untangle-beta, in turn               |   smooth (inverse mean ratio) -------------+
   |-- re-triangulate pockets                        |        | no flip is left, or quality settles
   +-- regularised, triangles kept       ------------+        +-> smooth with a ceiling -> polish the worst -> certify

Every mesh goes down its own road; the meshes on one stretch of road travel as one batch.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch, join
from ..untangling.untangling import check_reference
from .forked import can_fork, one_thread, over_processes, shard_borders
from .local_repair import improve_by_excerpts
from .options import ImproveOptions
from .report import Progress, Report, join_reports
from .stages import Job


def improve(
    batch: MeshBatch,
    options: ImproveOptions | None = None,
    *,
    progress: Callable[[Progress], None] | None = None,
    observe: Callable[[str, MeshBatch], None] | None = None,
    hold: Tensor | None = None,
) -> tuple[MeshBatch, Report]:
    """Give every mesh of the batch upright triangles of good shape, as far as its boundary admits.

    Vertices keep their number and order (but for topology "full"), fixed ones their place; boundary and
    constrained edges stay.  Each mesh's result is the same whatever else is in the batch.  The report says for
    every mesh what was tried and how it ended; nothing is raised for a mesh that could not be
    solved (`report.check()` does that).

    progress  called now and then with a `Progress`
    observe   called after each stage with its name and the whole batch as it is then, as for `report_page` and
              `animate`; first with "initial" and the batch as given.  With one mesh, the calls are the rows of
              `report.steps[0]`
    hold      (V,) bool, vertices that do not slide; needs boundary="slide", without which none does

    A large batch is shared among forked processes where that is safe (`ImproveOptions.workers`); `progress`
    is then called once a shard.
    Raises InvalidMeshError when `options.reference` is not a valid mesh of the same triangles.
    """
    options = options or ImproveOptions()
    if options.reference is not None:
        check_reference(batch, options.reference)
    workers = options.workers or torch.get_num_threads()
    separable = observe is None and hold is None and options.separable
    if workers > 1 and separable and can_fork(batch.points.device):
        borders = shard_borders(batch.triangle_offsets, workers)
        if len(borders) > 2:
            return _improve_in_shards(batch, options, progress, borders, workers)
    with one_thread():
        return _improve(batch, options, progress, observe, hold)


def _improve_in_shards(
    batch: MeshBatch,
    options: ImproveOptions,
    progress: Callable[[Progress], None] | None,
    borders: list[int],
    workers: int,
) -> tuple[MeshBatch, Report]:
    # What one mesh of many needs is loaded here once, and not by every process of every call.
    import shapely  # noqa: F401

    from ..remeshing import condensation as gathering  # noqa: F401
    from ..untangling import retriangulation  # noqa: F401

    place = torch.arange(len(batch), device=batch.points.device)

    def task(i: int) -> tuple[MeshBatch, Report]:
        return _improve(batch.select((place >= borders[i]) & (place < borders[i + 1])), options)

    parts, reports = [], []
    for i, (part, report) in enumerate(over_processes(task, len(borders) - 1, workers)):
        parts.append(part)
        reports.append(report)
        if progress is not None:
            left = int((~report.valid).sum())
            progress(Progress(f"shard {i + 1} of {len(borders) - 1}", len(batch) - borders[i + 1], left))
    return join(parts), join_reports(reports)


def _improve(
    batch: MeshBatch,
    options: ImproveOptions,
    progress: Callable[[Progress], None] | None = None,
    observe: Callable[[str, MeshBatch], None] | None = None,
    hold: Tensor | None = None,
) -> tuple[MeshBatch, Report]:
    if options.local:
        return improve_by_excerpts(batch, lambda part, watch: _improve_whole(part, options, progress, watch), observe)
    return _improve_whole(batch, options, progress, observe, hold)


def _improve_whole(
    batch: MeshBatch,
    options: ImproveOptions,
    progress: Callable[[Progress], None] | None = None,
    observe: Callable[[str, MeshBatch], None] | None = None,
    hold: Tensor | None = None,
) -> tuple[MeshBatch, Report]:
    job = Job(batch, options, progress, observe, hold)
    job.diagnose()
    if options.method == "paper":
        job.paper()
    else:
        job.untangle()
        job.refine()
        if options.topology != "keep" and options.smooth.targets is None:
            job.relocate()
            if options.slides:
                job.smooth_again()
            if options.topology != "full":
                job.polish()
    job.count_moved()
    if options.topology == "full":
        job.remesh()
    return job.batch, job.report()
