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

from . import io
from .errors import MeshError, MeshWarning
from .manifest import FileResult
from .mesh import MeshBatch, join
from .pipeline import ImproveOptions, Report, improve
from .quality import Quality, quality
from .status import Status


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
    mesh: MeshBatch
    facts: dict = field(default_factory=dict)  # what is known of the result by now
    seconds: float = 0.0


def improve_jobs(jobs: Sequence[Job], options: ImproveOptions, budget: int, label: str = "") -> Iterator[FileResult]:
    """The result of each job, as soon as its file is written.

    budget  vertices of a batch at most; a larger mesh is a batch of its own
    label   the settings, for the record

    Nothing is raised for a file, whatever is wrong with it: its result says so.
    """
    waiting: list[_Open] = []
    size = 0
    for job in jobs:
        opened = _read(job, label)
        if isinstance(opened, FileResult):
            yield opened
            continue
        count = len(opened.mesh.points)
        other = bool(waiting) and waiting[0].mesh.points.dtype != opened.mesh.points.dtype
        if waiting and (other or size + count > budget):
            yield from _improve(waiting, options)
            waiting, size = [], 0
        waiting.append(opened)
        size += count
    if waiting:
        yield from _improve(waiting, options)


def _read(job: Job, label: str) -> _Open | FileResult:
    started = time.perf_counter()
    facts: dict = {"options": label, "worker": f"{socket.gethostname()}:{os.getpid()}"}
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", MeshWarning)
            with contextlib.suppress(OSError):  # the reader says it better
                facts |= fingerprint(job.file)
            mesh = io.read(job.file)
    except Exception as error:
        return _failed(job, facts, error, time.perf_counter() - started)
    facts["warnings"] = _texts(said)
    facts |= {"vertices": len(mesh.points), "triangles": len(mesh.triangles)}
    return _Open(job, mesh, facts, time.perf_counter() - started)


def _improve(waiting: list[_Open], options: ImproveOptions) -> Iterator[FileResult]:
    """The meshes as one batch; if that raises, which no mesh should make it do, each alone."""
    started = time.perf_counter()
    try:
        batch = join([opened.mesh for opened in waiting])
        before = quality(batch)
        after, report = improve(batch, options)
    except Exception as error:
        if len(waiting) == 1:
            spent = waiting[0].seconds + time.perf_counter() - started
            yield _failed(waiting[0].job, waiting[0].facts, error, spent)
            return
        for opened in waiting:
            yield from _improve([opened], options)
        return
    seconds = time.perf_counter() - started
    total = sum(len(opened.mesh.triangles) for opened in waiting)
    for b, (opened, mesh) in enumerate(zip(waiting, after.split(), strict=True)):
        opened.seconds += seconds * len(opened.mesh.triangles) / total
        yield _write(opened, mesh, b, before, report)


def _write(opened: _Open, mesh: MeshBatch, b: int, before: Quality, report: Report) -> FileResult:
    started = time.perf_counter()
    job, facts = opened.job, opened.facts
    facts["inverted_before"], facts["inverted_after"] = int(before.inverted[b]), int(report.quality.inverted[b])
    for stage, q in (("before", before), ("after", report.quality)):
        facts[f"imr_average_{stage}"], facts[f"imr_maximum_{stage}"] = float(q.mean[b]), float(q.max[b])
    facts["message"] = report.messages[b]
    target = Path(job.output)
    folder = Path(job.staging) / f"{os.getpid()}"
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", MeshWarning)
            target.parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir(parents=True, exist_ok=True)
            io.write(folder / target.name, mesh, like=job.file)
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
        status=Status(int(report.status[b])).name.lower(),
        valid=bool(report.valid[b]),
        seconds=opened.seconds + time.perf_counter() - started,
        **facts,
    )


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
