"""`improve_files`: whole folders of mesh files, improved by many processes, with a manifest and resumption.

    in/a/x.vtu  ->  out/a/x.vtu          the path below the folder that all inputs share comes again
    in/b/x.vtu  ->  out/b/x.vtu
                    out/manifest.jsonl   gets a line for each mesh while the run goes on
                    out/manifest.parquet is the same as a table, written at the end

A run into a folder that has a manifest continues the earlier run.  It keeps the results whose input has not changed,
which were made with the same options, and whose file still exists.
"""

import contextlib
import dataclasses
import hashlib
import os
import pickle
import stat
import warnings
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from ..errors import MeshIOError, MeshWarning, MissingDependencyError
from ..files.field_transfer import FieldChoice, check_choice
from ..files.surface import HeightChoice, check_height
from ..improving.options import ImproveOptions
from ..mesh.typed import typed
from . import manifest
from .batches import Job, fingerprint
from .crew import Crew
from .folder_lock import locked_folder
from .inputs import Paths, find_jobs, skipped_files
from .local_worker import LocalWorker
from .manifest import FileResult
from .ray_worker import RayWorker, ray_cluster
from .workers import Worker

# Vertices in a batch.  A mesh of 2,200 triangles takes 164 ms alone, 44 ms in a batch of nine, and 37 ms in one of 30
# or of 60, measured by experiments/speed/throughput.py.
BUDGET = 30_000


@typed
def improve_files(
    paths: Paths,
    out: str | os.PathLike[str],
    options: ImproveOptions | None = None,
    *,
    engine: Literal["local", "ray"] = "local",
    workers: int | None = None,
    budget: int = BUDGET,
    suffix: str | None = None,
    redo: bool = False,
    strict: bool = False,
    fields: FieldChoice = "interpolate",
    regions: str | None = None,
    height: HeightChoice = "interpolate",
) -> Iterator[FileResult]:
    """Improves mesh files into the folder `out`.  The work is done while you iterate over the results.

    paths    a file, a folder (every mesh file below it), a pattern such as "in/**/*.vtu", or several of them
    out      the folder of results, made if it does not exist; the folders of the inputs come again below it
    options  as for `improve`
    engine   "local": processes of this machine with one thread each; "ray": the Ray cluster of RAY_ADDRESS or the
             one that `ray.init` has connected to, else a local one (the files must lie on storage that all machines
             share)
    workers  number of processes or tasks; None: one for each processor
    budget   greatest number of vertices in a batch; a larger mesh is a batch of its own.  Memory grows with it
    suffix   the extension of the outputs, such as ".vtu"; None: that of each input
    redo     begin anew, whatever `out` holds from earlier runs
    strict   a file that would not hold everything that is in its input is an error, and is not written
    fields   what becomes of the fields of the files, as for `write`
    regions  what tells the regions of the files, as for `read`
    height   what becomes of the heights of surfaces, as for `write`

    Every file is written whole or not at all, and the manifest after it.  The process, its workers or the machine may
    therefore be killed at any time, and the same call continues.  A result of an earlier run has `resumed` set; errors
    are tried again.  The result for a mesh depends neither on the batches nor on the number of workers.

    Raises MeshIOError when no file matches, when two inputs would have the same output, when an output is an input,
    when another run writes to `out`, or when `out` cannot be written; ValueError for a bad argument;
    MissingDependencyError for engine "ray" without Ray.  What is wrong with a single file is in its result.
    """
    return Run.plan(
        paths, out, options, engine, workers, budget, suffix, redo, strict, fields, regions, height
    ).results()


@dataclass(frozen=True)
class Run:
    """A run of `improve_files`: what earlier runs have done, and what is left to do.

    kept      results of earlier runs that still hold
    jobs      the files that are left, largest first
    strict    as for `improve_files`
    changed   why results of earlier runs do not hold, and how many for each reason
    fields    what becomes of the fields of the files
    regions   what tells the regions of the files
    height    what becomes of the heights of surfaces
    skipped   files in the folders given that are no mesh files
    """

    out: Path
    options: ImproveOptions
    engine: str
    workers: int | None
    budget: int
    kept: list[FileResult]
    jobs: list[Job]
    strict: bool = False
    changed: dict[str, int] = field(default_factory=dict)
    fields: FieldChoice = "interpolate"
    regions: str | None = None
    height: HeightChoice = "interpolate"
    skipped: list[str] = field(default_factory=list)

    @classmethod
    def plan(
        cls,
        paths: Paths,
        out: str | os.PathLike[str],
        options: ImproveOptions | None = None,
        engine: str = "local",
        workers: int | None = None,
        budget: int = BUDGET,
        suffix: str | None = None,
        redo: bool = False,
        strict: bool = False,
        fields: FieldChoice = "interpolate",
        regions: str | None = None,
        height: HeightChoice = "interpolate",
    ) -> "Run":
        """Finds the files and compares them with the manifest; arguments and errors are those of `improve_files`."""
        options, out = options or ImproveOptions(), Path(out)
        _check_arguments(options, engine, workers, budget)
        check_choice(fields)
        check_height(height)
        paths = paths if isinstance(paths, str | os.PathLike) else list(paths)
        jobs = [
            dataclasses.replace(job, strict=strict, regions=regions, height=height)
            for job in find_jobs(paths, out, suffix)
        ]
        if out.exists() and not out.is_dir():
            raise MeshIOError(f"{out}: is not a folder")
        known = {} if redo else manifest.load(out)
        label = settings(options, fields, regions, height) + ", strict" * strict
        kept, left, changed = [], [], dict[str, int]()
        for job in jobs:
            result = known.get(job.name)
            reason = "" if result is None else _stale(job, result, label)
            if result is None or reason:
                left.append(job)
                if reason:
                    changed[reason] = changed.get(reason, 0) + 1
            else:
                kept.append(result)
        left.sort(key=lambda job: (-job.size, job.name))  # a large one at the end would leave other workers idle
        return cls(
            out,
            options,
            engine,
            workers,
            budget,
            kept,
            left,
            strict,
            changed,
            fields,
            regions,
            height,
            skipped_files(paths, out),
        )

    def results(self) -> Iterator[FileResult]:
        """The kept results, then the others as they are made; each is in the manifest before it is given."""
        with locked_folder(self.out, manifest.LINES, manifest.TABLE):
            with manifest.Journal(self.out) as journal:
                yield from self.kept
                if self.jobs:
                    with contextlib.closing(self._made()) as made:
                        for result in made:
                            journal.add(result)
                            yield result
            manifest.tidy(self.out)
            try:
                manifest.write_table(self.out)
            except MissingDependencyError as error:
                warnings.warn(MeshWarning(str(error)), stacklevel=2)

    def _made(self) -> Generator[FileResult, None, None]:
        """The results of the jobs, as workers finish them."""
        label = settings(self.options, self.fields, self.regions, self.height) + ", strict" * self.strict
        with contextlib.ExitStack() as stack:
            kind: type[LocalWorker] | type[RayWorker] = LocalWorker
            count = self.workers or processors()
            if self.engine == "ray":
                kind, count = RayWorker, stack.enter_context(ray_cluster(self.workers))

            def hire() -> Worker:
                return kind(self.options, self.budget, label, self.fields)

            crew = Crew(self.jobs, hire, count, self.budget)
            for result in stack.enter_context(contextlib.closing(crew.results())):
                yield dataclasses.replace(result, options=label)


def _check_arguments(options: ImproveOptions, engine: str, workers: int | None, budget: int) -> None:
    """Raises ValueError for an argument that a run cannot work with."""
    if engine not in ("local", "ray"):
        raise ValueError(f"engine must be 'local' or 'ray', not {engine!r}")
    for name, value in (("workers", workers), ("budget", budget)):
        if value is not None and value < 1:
            raise ValueError(f"{name} must be at least 1, not {value}")
    try:
        pickle.dumps(options)
    except Exception as error:
        raise ValueError(f"the options cannot be sent to another process: {error}") from None


def processors() -> int:
    """The number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0)) or 1
    return os.cpu_count() or 1


def settings(
    options: ImproveOptions,
    fields: FieldChoice = "interpolate",
    regions: str | None = None,
    height: HeightChoice = "interpolate",
) -> str:
    """The version and those options that differ from the default, in words.

    Two runs with the same text give the same results.
    """
    from importlib.metadata import version

    beside = [*_changes(fields, "interpolate", "fields"), *_changes(regions, None, "regions")]
    beside += _changes(height, "interpolate", "height")
    # The fewest words: what differs from the default, or from one of the named ways.
    ways = {"": ImproveOptions(), "method='fast'": ImproveOptions.fast(), "method='paper'": ImproveOptions.paper()}
    told = min(([*filter(None, [name]), *_changes(options, way)] for name, way in ways.items()), key=len)
    changes = ", ".join([*told, *beside])
    return f"torchmesh {version('torchmesh-untangle')}" + (f", {changes}" if changes else "")


def _changes(value: Any, default: Any, name: str = "") -> Iterator[str]:
    """'name=value' for each field, at any depth, that differs from the default; data is told by its hash."""
    if dataclasses.is_dataclass(value) and type(value) is type(default):
        for f in dataclasses.fields(value):
            inner = f"{name}.{f.name}" if name else f.name
            yield from _changes(getattr(value, f.name), getattr(default, f.name), inner)
    elif isinstance(value, str | int | float | bool | None):
        if value != default or type(value) is not type(default):
            yield f"{name}={value!r}"
    elif (data := pickle.dumps(value)) != pickle.dumps(default):
        yield f"{name}={type(value).__name__} {hashlib.blake2b(data, digest_size=8).hexdigest()}"


def _stale(job: Job, result: FileResult, label: str) -> str:
    """Why an earlier result does not hold for the job; empty if it holds."""
    if result.error is not None or result.output is None:
        return "an error then"
    if result.options != label:
        return f"other options: then {result.options or 'unknown'}; now {label}"
    try:
        state = os.stat(job.file)
        # A file that was only copied or touched is recognised by its content.
        if (state.st_size, state.st_mtime_ns) != (result.bytes, result.modified) and (
            state.st_size != result.bytes or fingerprint(job.file)["digest"] != result.digest
        ):
            return "the input has changed"
    except OSError:
        return "the input has changed"
    try:
        state = os.lstat(job.output)  # a link is none of our results
        same = stat.S_ISREG(state.st_mode) and state.st_size == result.output_bytes
    except OSError:
        same = False
    return "" if same else "the result is gone or has changed"
