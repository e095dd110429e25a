"""Many mesh files through `improve`: read until a batch is full, improve it, write each mesh.

    files --- read ---> meshes, up to `budget` vertices ---> improve ---> write, one by one
            a broken file                       a batch that fails is done mesh by mesh
            is a result of its own

A batch is bounded by its vertices, for they, and not the number of meshes, are what time and memory
follow.  What a mesh becomes does not depend on the batch it travels in.
"""

import contextlib
import hashlib
import os
import shutil
import socket
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import Tensor

from ..errors import MeshError, MeshWarning
from ..files import mesh_files as io
from ..files.time_series import Series, read_series, write_series
from ..improving.options import ImproveOptions
from ..improving.pipeline import improve
from ..improving.report import Report
from ..mesh.batch import MeshBatch, join
from ..mesh.measure import Quality, quality
from ..status import Status
from .manifest import FileResult


@dataclass(frozen=True)
class Job:
    """One file to improve.

    name     its path below the folder of results, with / between its parts
    file     the input, as it was given
    output   the file to write, as the folder of results was given
    staging  a folder in the file system of `output` where it is written first
    size     bytes of the input, by which work is shared out; 0 where it cannot be told
    """

    name: str
    file: str
    output: str
    staging: str
    size: int = 0


@dataclass
class _Open:
    """A file that was read, on its way."""

    job: Job
    series: Series  # of one step, most times
    facts: dict = field(default_factory=dict)  # what is known of the result by now
    seconds: float = 0.0
    hold: Tensor | None = None

    @property
    def batch(self) -> MeshBatch:
        return self.series.batch


def improve_jobs(jobs: Sequence[Job], options: ImproveOptions, budget: int, label: str = "") -> Iterator[FileResult]:
    """The result of each job, as soon as its file is written.

    budget  vertices of a batch at most; a larger mesh is a batch of its own
    label   the settings, for the record

    Nothing is raised for a file, whatever is wrong with it: its result says so.
    """
    waiting: list[_Open] = []
    size = 0
    for job in jobs:
        opened = _read(job, options, label)
        if isinstance(opened, FileResult):
            yield opened
            continue
        count = len(opened.batch.points)
        other = bool(waiting) and waiting[0].batch.points.dtype != opened.batch.points.dtype
        if waiting and (other or size + count > budget):
            yield from _improve(waiting, options)
            waiting, size = [], 0
        waiting.append(opened)
        size += count
    if waiting:
        yield from _improve(waiting, options)


def _read(job: Job, options: ImproveOptions, label: str) -> _Open | FileResult:
    started = time.perf_counter()
    facts: dict = {"options": label, "worker": f"{socket.gethostname()}:{os.getpid()}"}
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", MeshWarning)
            with contextlib.suppress(OSError):  # the reader says it better
                facts |= fingerprint(job.file)
            series = read_series(job.file)
            hold = torch.cat([io.held(series.sources[s]) for s in _first_steps(series)]) if options.slides else None
    except Exception as error:
        return _failed(job, facts, error, time.perf_counter() - started)
    facts["warnings"] = _texts(said)
    facts |= {"vertices": len(series.batch.points), "triangles": len(series.batch.triangles), "steps": len(series)}
    return _Open(job, series, facts, time.perf_counter() - started, hold)


def _first_steps(series: Series) -> list[int]:
    """For each mesh of a series the first step that has it."""
    return [series.mesh_of_step.index(m) for m in range(len(series.batch))]


def _improve(waiting: list[_Open], options: ImproveOptions) -> Iterator[FileResult]:
    """The meshes as one batch; if that raises, which no mesh should make it do, each alone."""
    started = time.perf_counter()
    try:
        batch = join([opened.batch for opened in waiting])
        before = quality(batch)
        hold = torch.cat([opened.hold for opened in waiting if opened.hold is not None]) if options.slides else None
        after, report = improve(batch, options, hold=hold)
    except Exception as error:
        if len(waiting) == 1:
            spent = waiting[0].seconds + time.perf_counter() - started
            yield _failed(waiting[0].job, waiting[0].facts, error, spent)
            return
        for opened in waiting:
            yield from _improve([opened], options)
        return
    seconds = time.perf_counter() - started
    total, meshes, first = len(batch.triangles), after.split(), 0
    for opened in waiting:
        rows = slice(first, first + len(opened.batch))
        first = rows.stop
        opened.seconds += seconds * len(opened.batch.triangles) / total
        yield _write(opened, meshes[rows], rows, before, report)


def _write(opened: _Open, meshes: list[MeshBatch], rows: slice, before: Quality, report: Report) -> FileResult:
    """Writes the meshes of a file, which the batch has at `rows`."""
    started = time.perf_counter()
    job, facts = opened.job, opened.facts
    facts |= _numbers("before", before, opened.batch.split(), rows) | _numbers("after", report.quality, meshes, rows)
    failed = (~report.valid[rows]).nonzero().squeeze(1).tolist()
    shown = rows.start + (failed[0] if failed else 0)
    many = f"mesh {failed[0]} of {len(meshes)}: " if failed and len(meshes) > 1 else ""
    facts["message"] = many + report.messages[shown]
    target = Path(job.output)
    # Process ids alone are not unique: machines of a cluster may share the folder.
    folder = Path(job.staging) / f"{socket.gethostname()}-{os.getpid()}"
    try:
        shutil.rmtree(folder, ignore_errors=True)  # half a file, perhaps, of one that was killed
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", MeshWarning)
            target.parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir(parents=True, exist_ok=True)
            write_series(folder / target.name, join(meshes), opened.series)
        for made in sorted(folder.iterdir()):
            os.replace(made, target.parent / made.name)
        facts["output_bytes"] = target.stat().st_size
    except Exception as error:
        shutil.rmtree(folder, ignore_errors=True)
        return _failed(job, facts, error, opened.seconds + time.perf_counter() - started, str(folder / target.name))
    facts["warnings"] += [text.replace(str(folder / target.name), job.output) for text in _texts(said)]
    return FileResult(
        name=job.name,
        file=job.file,
        output=job.output,
        status=Status(int(report.status[shown])).name.lower(),
        valid=not failed,
        seconds=opened.seconds + time.perf_counter() - started,
        **facts,
    )


def _numbers(stage: str, q: Quality, meshes: list[MeshBatch], rows: slice) -> dict:
    """A file's meshes in numbers: the average is over all their triangles."""
    weights = torch.tensor([len(mesh.triangles) for mesh in meshes], dtype=torch.float64)
    average = q.mean[rows].double() @ (weights / weights.sum()) if len(meshes) > 1 else q.mean[rows.start]
    return {
        f"inverted_{stage}": int(q.inverted[rows].sum()),
        f"imr_average_{stage}": float(average),
        f"imr_maximum_{stage}": float(q.max[rows].max()),
    }


def _failed(job: Job, facts: dict, error: Exception, seconds: float, staged: str = "") -> FileResult:
    expected = isinstance(error, MeshError | OSError)
    text = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, MemoryError):
        text = "there is not enough memory for this mesh"
    elif not expected:
        text = f"{type(error).__name__}: {text}"
    if staged:
        text = text.replace(staged, job.output)
    if job.file not in text and job.output not in text:
        text = f"{job.file}: {text}"
    kept = {key: value for key, value in facts.items() if not key.endswith("_after")}
    return FileResult(name=job.name, file=job.file, error=text, seconds=seconds, **kept)


def _texts(said: list[warnings.WarningMessage]) -> list[str]:
    return list(dict.fromkeys(str(w.message) for w in said if issubclass(w.category, MeshWarning)))


def fingerprint(path: str | os.PathLike[str]) -> dict:
    """`bytes`, `modified` and `digest` of a file, as `FileResult` has them; raises OSError."""
    with open(path, "rb") as stream:
        state = os.fstat(stream.fileno())
        found = hashlib.blake2b(digest_size=16)
        while piece := stream.read(1 << 20):
            found.update(piece)
    return {"bytes": state.st_size, "modified": state.st_mtime_ns, "digest": found.hexdigest()}
