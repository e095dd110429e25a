"""Many mesh files through `improve`: read until a batch is full, improve it, write each file.

    files --- read ---> meshes, up to `budget` vertices ---> improve ---> write, file by file
            a file that cannot be read                if the batch fails,
            is a result with an error                 each file is a batch of its own

A batch is bounded by its number of vertices, because time and memory follow the vertices and not the number of meshes.
The result for a mesh does not depend on the batch that it is in.
"""

import contextlib
import hashlib
import itertools
import os
import shutil
import socket
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch

from ..errors import MeshError, MeshIOError, MeshWarning
from ..files.field_transfer import FieldChoice
from ..files.surface import HeightChoice
from ..files.time_series import Series, read_series
from ..improving.options import ImproveOptions
from ..mesh.batch import MeshBatch
from ..mesh.measure import Quality
from ..status import Status
from .file_improvement import ImprovedFile, improve_series
from .manifest import FileResult


@dataclass(frozen=True)
class Job:
    """One file to improve.

    name     its path below the folder of results, with / between the parts
    file     the input, as it was given
    output   the file to write, below the folder of results as that was given
    staging  a folder in the folder of results, where the file is written first
    size     bytes of the input, by which work is shared out; 0 where the size is not known
    strict   is the output an error, and not written, if it would not hold everything that is in the input
    regions  what tells the regions of the file, as for `read`
    height   what becomes of the heights of a surface, as for `write`
    """

    name: str
    file: str
    output: str
    staging: str
    size: int = 0
    strict: bool = False
    regions: str | None = None
    height: HeightChoice = "interpolate"


@dataclass
class _Opened:
    """A file that was read and waits to be improved.

    facts    the fields of its `FileResult` that are known so far
    seconds  wall time spent on it so far
    """

    job: Job
    series: Series
    facts: dict = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def vertices(self) -> int:
        return len(self.series.batch.points)

    @property
    def elements(self) -> int:
        """The number of its triangles and quads."""
        return len(self.series.batch.triangles) + len(self.series.batch.quads)


def improve_jobs(
    jobs: Sequence[Job],
    options: ImproveOptions,
    budget: int,
    label: str = "",
    fields: FieldChoice = "interpolate",
) -> Iterator[FileResult]:
    """The result of each job, as soon as its file is written.

    budget  greatest number of vertices in a batch; a larger mesh is a batch of its own
    label   the settings in words, for the field `options` of each result
    fields  what becomes of the fields of the files, as for `write`

    Nothing is raised for a file, whatever is wrong with it: its result says what is.
    """
    waiting: list[_Opened] = []
    for job in jobs:
        opened = _read(job, label)
        if isinstance(opened, FileResult):
            yield opened
            continue
        if waiting and not _fits(opened, waiting, budget):
            yield from _improve(waiting, options, fields)
            waiting = []
        waiting.append(opened)
    if waiting:
        yield from _improve(waiting, options, fields)


def _fits(opened: _Opened, waiting: list[_Opened], budget: int) -> bool:
    same_dtype = opened.series.batch.points.dtype == waiting[0].series.batch.points.dtype
    return same_dtype and sum(one.vertices for one in waiting) + opened.vertices <= budget


def _read(job: Job, label: str) -> _Opened | FileResult:
    started = time.perf_counter()
    facts: dict = {"options": label, "worker": f"{socket.gethostname()}:{os.getpid()}"}
    try:
        with _recorded_warnings() as said:
            with contextlib.suppress(OSError):  # the reader's message for a missing file is clearer
                facts |= fingerprint(job.file)
            series = read_series(job.file, regions=job.regions)
    except Exception as error:
        return _failed(job, facts, error, time.perf_counter() - started)
    facts["warnings"] = _texts(said)
    facts |= {"vertices": len(series.batch.points), "triangles": len(series.batch.triangles), "steps": len(series)}
    return _Opened(job, series, facts, time.perf_counter() - started)


def _improve(waiting: list[_Opened], options: ImproveOptions, fields: FieldChoice) -> Iterator[FileResult]:
    """Improves the files as one batch.  If that raises, which no mesh should cause, each file is improved alone."""
    started = time.perf_counter()
    try:
        improved = improve_series(
            [opened.series for opened in waiting], options, fields=fields, height=waiting[0].job.height
        )
    except Exception as error:
        if len(waiting) == 1:
            spent = waiting[0].seconds + time.perf_counter() - started
            yield _failed(waiting[0].job, waiting[0].facts, error, spent)
            return
        for opened in waiting:
            yield from _improve([opened], options, fields)
        return
    seconds = time.perf_counter() - started
    total = sum(opened.elements for opened in waiting)
    for opened, one in zip(waiting, improved, strict=True):
        opened.seconds += seconds * opened.elements / total
        yield _write(opened, one)


def _write(opened: _Opened, improved: ImprovedFile) -> FileResult:
    """Writes the file and says what became of it."""
    started = time.perf_counter()
    job, facts = opened.job, opened.facts
    report, rows = improved.report, improved.rows
    facts |= _quality_facts("before", improved.before, opened.series.batch.split(), rows)
    facts |= _quality_facts("after", report.quality, improved.meshes, rows)
    failed = (~report.valid[rows]).nonzero().squeeze(1).tolist()
    shown = rows.start + (failed[0] if failed else 0)
    many = f"mesh {failed[0]} of {len(improved.meshes)}: " if failed and len(improved.meshes) > 1 else ""
    facts["message"] = many + report.messages[shown]
    curved = improved.curved
    if curved is not None:
        facts["inverted_after"] = curved.all_inverted
        for count, what in ((curved.inverted, "six-node triangles"), (curved.inverted_quads, "curved quads")):
            if count:
                facts["message"] += f"; {count:,} {what} are inverted"
    target = Path(job.output)
    # A process number alone is not unique, because the machines of a cluster may share the folder.
    folder = Path(job.staging) / f"{socket.gethostname()}-{os.getpid()}"
    staged = str(folder / target.name)
    try:
        with _recorded_warnings() as said:
            facts["fields"] = _write_staged(improved, job, target, folder)
        facts["output_bytes"] = target.stat().st_size
    except Exception as error:
        shutil.rmtree(folder, ignore_errors=True)
        return _failed(job, facts, error, opened.seconds + time.perf_counter() - started, staged)
    facts["warnings"] += [text.replace(staged, job.output) for text in _texts(said)]
    return FileResult(
        name=job.name,
        file=job.file,
        output=job.output,
        status=Status(int(report.status[shown])).name.lower(),
        valid=not (failed if curved is None else curved.all_inverted),
        seconds=opened.seconds + time.perf_counter() - started,
        **facts,
    )


def _write_staged(improved: ImprovedFile, job: Job, target: Path, folder: Path) -> str:
    """Writes the file into `folder` and moves what was made, which may be several files, to the folder of `target`.

    Returns what became of the fields, in words.  Raises MeshIOError where a link between the folder of results and the
    target leads elsewhere, and for a strict job that would lose something.  A link at the target itself is replaced,
    and what it leads to is left alone.
    """
    shutil.rmtree(folder, ignore_errors=True)  # a killed process with this number may have left a part of a file
    _refuse_ways_out(target, Path(job.staging).parent)
    target.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    draft = improved.draft(folder / target.name)
    if job.strict:
        draft.refuse()
    draft.tell()
    draft.save()
    for made in sorted(folder.iterdir()):
        os.replace(made, target.parent / made.name)
    return str(draft.fields)


def _refuse_ways_out(target: Path, out: Path) -> None:
    for folder in itertools.takewhile(lambda above: above != out, target.parents):
        if out in folder.parents and folder.is_symlink():
            raise MeshIOError(
                f"{folder}: is a symbolic link in the folder of results, which is not followed; remove it"
            )


def _quality_facts(stage: str, q: Quality, meshes: list[MeshBatch], rows: slice) -> dict:
    """Fields of a `FileResult` from the quality of a file's meshes; the average is over all their elements."""
    weights = torch.tensor([len(mesh.triangles) + len(mesh.quads) for mesh in meshes], dtype=torch.float64)
    average = q.mean[rows].double() @ (weights / weights.sum()) if len(meshes) > 1 else q.mean[rows.start]
    return {
        f"inverted_{stage}": int(q.inverted[rows].sum()),
        f"imr_average_{stage}": float(average),
        f"imr_maximum_{stage}": float(q.max[rows].max()),
    }


def _failed(job: Job, facts: dict, error: Exception, seconds: float, staged: str = "") -> FileResult:
    """The result of a job that has no output.

    staged  where the output was to be written first; the message names `job.output` in its place
    """
    expected = isinstance(error, MeshError | OSError)
    text = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, MemoryError):
        text = "there is not enough memory for this mesh"
    elif not expected:
        text = f"{type(error).__name__}: {text}"
    if staged:
        text = text.replace(staged, job.output)
    # A reader names the file without a "./" before it.
    if job.file not in text and job.output not in text and not text.startswith(f"{Path(job.file)}: "):
        text = f"{job.file}: {text}"
    kept = {key: value for key, value in facts.items() if not key.endswith("_after")}
    return FileResult(name=job.name, file=job.file, error=text, seconds=seconds, **kept)


@contextlib.contextmanager
def _recorded_warnings() -> Iterator[list[warnings.WarningMessage]]:
    """Inside, mesh warnings are recorded and not shown."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", MeshWarning)
        yield said


def _texts(said: list[warnings.WarningMessage]) -> list[str]:
    return list(dict.fromkeys(str(w.message) for w in said if issubclass(w.category, MeshWarning)))


def fingerprint(path: str | os.PathLike[str]) -> dict:
    """`bytes`, `modified` and `digest` of a file, as `FileResult` has them; raises OSError."""
    with open(path, "rb") as stream:
        state = os.fstat(stream.fileno())
        found = hashlib.blake2b(digest_size=16)
        while block := stream.read(1 << 20):
            found.update(block)
    return {"bytes": state.st_size, "modified": state.st_mtime_ns, "digest": found.hexdigest()}
