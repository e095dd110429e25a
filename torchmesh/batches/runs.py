"""`improve_files`: whole folders of mesh files, improved by many processes, with a manifest and resumption.

    in/a/x.vtu  ->  out/a/x.vtu          the part of the path below the folder common to all inputs stays
    in/b/x.vtu  ->  out/b/x.vtu
                    out/manifest.jsonl   a line a mesh, while the run goes on
                    out/manifest.parquet the same as a table, at the end

A run into a folder that has a manifest goes on from there: results are kept whose input has not changed,
that were made with the same options, and whose file is still there.
"""

import contextlib
import dataclasses
import glob
import hashlib
import os
import pickle
import shutil
import sys
import warnings
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from ..errors import MeshIOError, MeshWarning, MissingDependencyError
from ..files.formats.registry import format_of, known_extensions
from ..improving.options import ImproveOptions
from . import manifest
from .batches import Job, fingerprint
from .manifest import FileResult
from .workers import Crew, LocalWorker, RayWorker, Worker, ray_cluster

# Vertices of a batch: meshes of 2,200 triangles cost 164 ms alone, 44 ms by nine, 37 ms by 30 and by 60;
# experiments/speed/throughput.py measures it on files.
BUDGET = 30_000


_STAGING = ".torchmesh-run"


Paths = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]


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
) -> Iterator[FileResult]:
    """Improves mesh files into the folder `out`; iterate over the results, or nothing is done.

    paths    a file, a folder (every mesh file below it), a pattern such as "in/**/*.vtu", or several of them
    out      the folder of results, made if it is not there; the inputs' folders come again below it
    options  as for `improve`
    engine   "local": processes of this machine with one thread each; "ray": a Ray cluster, RAY_ADDRESS or
             the one that `ray.init` has connected to, else a local one (files on storage all machines share)
    workers  how many; None: one for each processor that is there
    budget   vertices in a batch at most, a larger mesh being a batch of its own; memory grows with it
    suffix   the extension of the outputs, ".vtu"; None: that of each input
    redo     begin anew, whatever `out` holds from earlier runs

    Every file is written whole or not at all, and the manifest after it: the process, its workers or
    the machine may be killed at any time, and the same call goes on from there.  A result of an
    earlier run comes with `resumed`; errors are tried again.  What each mesh becomes depends neither
    on the batches nor on the number of workers.

    Raises MeshIOError when no file matches, two inputs would have one output or an output is an
    input, another run writes to `out`, or `out` cannot be written; ValueError for a bad argument;
    MissingDependencyError for engine "ray" without Ray.  What is wrong with one file is in its result.
    """
    return Run.plan(paths, out, options, engine, workers, budget, suffix, redo).results()


@dataclass(frozen=True)
class Run:
    """Files to improve, as `improve_files` takes them: what is done already, and what is left to do.

    kept      results of earlier runs that still hold
    jobs      the files left
    changed   why some results of earlier runs do not hold: reasons with their counts
    """

    out: Path
    options: ImproveOptions
    engine: str
    workers: int | None
    budget: int
    kept: list[FileResult]
    jobs: list[Job]
    changed: dict[str, int] = field(default_factory=dict)

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
    ) -> "Run":
        """Finds the files and compares them with the manifest; see `improve_files` for arguments and errors."""
        options = options or ImproveOptions()
        if engine not in ("local", "ray"):
            raise ValueError(f"engine must be 'local' or 'ray', not {engine!r}")
        for name, value in (("workers", workers), ("budget", budget)):
            if value is not None and value < 1:
                raise ValueError(f"{name} must be at least 1, not {value}")
        try:
            pickle.dumps(options)
        except Exception as error:
            raise ValueError(f"the options cannot be sent to another process: {error}") from None
        out = Path(out)
        jobs = _jobs(paths, out, suffix)
        if out.exists() and not out.is_dir():
            raise MeshIOError(f"{out}: is not a folder")
        known = {} if redo else manifest.load(out)
        label, kept, left, changed = settings(options), [], [], dict[str, int]()
        for job in jobs:
            result = known.get(job.name)
            reason = "" if result is None else _stale(job, result, label)
            if result is None or reason:
                left.append(job)
                if reason:
                    changed[reason] = changed.get(reason, 0) + 1
            else:
                kept.append(result)
        left.sort(key=lambda job: (-job.size, job.name))  # no large one is left to the end
        return cls(out, options, engine, workers, budget, kept, left, changed)

    def results(self) -> Iterator[FileResult]:
        """The kept results, then the others as they are made; each is in the manifest when it is given."""
        with _alone(self.out):
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
        label = settings(self.options)
        with contextlib.ExitStack() as stack:
            kind: type[LocalWorker] | type[RayWorker] = LocalWorker
            count = self.workers or processors()
            if self.engine == "ray":
                kind, count = RayWorker, stack.enter_context(ray_cluster(self.workers))

            def hire() -> Worker:
                return kind(self.options, self.budget, label)

            crew = Crew(self.jobs, hire, count, self.budget)
            for result in stack.enter_context(contextlib.closing(crew.results())):
                yield dataclasses.replace(result, options=label)


def processors() -> int:
    """The processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0)) or 1
    return os.cpu_count() or 1


def settings(options: ImproveOptions) -> str:
    """The version, and what of the options is not the default, in words: two runs with one text give one result."""
    from importlib.metadata import version

    changes = ", ".join(_changes(options, ImproveOptions()))
    return f"torchmesh {version('torchmesh-untangle')}" + (f", {changes}" if changes else "")


def _changes(value: Any, default: Any, name: str = "") -> Iterator[str]:
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
    """Why an earlier result does not hold for the job; empty if it does."""
    if result.error is not None or result.output is None:
        return "an error then"
    if result.options != label:
        return f"other options: then {result.options or 'unknown'}; now {label}"
    try:
        state = os.stat(job.file)
        # A file that was only copied or touched is known by its content.
        if (state.st_size, state.st_mtime_ns) != (result.bytes, result.modified) and (
            state.st_size != result.bytes or fingerprint(job.file)["digest"] != result.digest
        ):
            return "the input has changed"
    except OSError:
        return "the input has changed"
    try:
        same = os.stat(job.output).st_size == result.output_bytes
    except OSError:
        same = False
    return "" if same else "the result is gone or has changed"


def _jobs(paths: Paths, out: Path, suffix: str | None) -> list[Job]:
    """A job for every file that the paths name, sorted by name; raises MeshIOError."""
    if suffix is not None:
        suffix = suffix if suffix.startswith(".") else f".{suffix}"
        format_of(Path(f"*{suffix}"))
    given = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    inside = os.path.abspath(out)
    files: dict[str, str] = {}  # absolute path to the path as given
    roots: list[str] = []
    for path in given:
        root, found = _matches(os.fspath(path))
        # Results of an earlier run, in a folder among the inputs, are no inputs.
        among = _below(inside, os.path.abspath(root))
        mine = [file for file in found if not (among and _below(os.path.abspath(file), inside))]
        if not mine:
            raise MeshIOError(f"{path}: there is no such file, or no mesh file below it")
        roots.append(os.path.abspath(root))
        for file in mine:
            files.setdefault(os.path.abspath(file), file)
    if not files:
        raise MeshIOError("no files were given")
    try:
        root = os.path.commonpath(roots)
    except ValueError:
        raise MeshIOError(f"the files lie on different drives: {', '.join(sorted(set(roots)))}") from None
    jobs: dict[str, Job] = {}
    for absolute, file in sorted(files.items()):
        place = Path(os.path.relpath(absolute, root))
        place = place if suffix is None else place.with_suffix(suffix)
        key, output = os.path.normcase(place), out / place
        if key in jobs:
            raise MeshIOError(f"{output}: {jobs[key].file} and {file} would both be written to it")
        if os.path.exists(output) and os.path.samefile(output, file):
            raise MeshIOError(f"{file}: it would be overwritten by its own result; choose another folder than {out}")
        size = 0
        with contextlib.suppress(OSError):
            size = os.path.getsize(file)
        jobs[key] = Job(place.as_posix(), file, os.fspath(output), os.fspath(out / _STAGING), size)
    return list(jobs.values())


def _matches(path: str) -> tuple[str, list[str]]:
    """The folder a path, folder or pattern begins at, and the files it names."""
    if os.path.isfile(path):
        return os.path.dirname(path), [path]
    if os.path.isdir(path):
        known = known_extensions()
        found = glob.glob(os.path.join(glob.escape(path), "**", "*"), recursive=True)
        return path, [f for f in found if os.path.splitext(f)[1].lower() in known and os.path.isfile(f)]
    if not glob.has_magic(path):
        return os.path.dirname(path), []
    root = path
    while glob.has_magic(root):
        root = os.path.dirname(root)
    return root, [f for f in glob.glob(path, recursive=True) if os.path.isfile(f)]


def _below(path: str, folder: str) -> bool:
    return path.startswith(os.path.join(folder, ""))


@contextlib.contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Inside, the folder is there and this process the only one that writes to it.

    Nothing of what a killed run was writing is left over.  Raises MeshIOError.
    """
    staging, path = out / _STAGING, out / f"{_STAGING}.lock"
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock = open(path, "ab")  # noqa: SIM115
    except OSError as error:
        raise MeshIOError(f"{out}: cannot be written: {error.strerror or error}") from None
    with lock:
        # A run that has just ended took its lock file away: what was locked must still be that file.
        if (
            not _locked(lock.fileno())
            or not path.exists()
            or not os.path.samestat(os.fstat(lock.fileno()), path.stat())
        ):
            raise MeshIOError(f"{out}: another run is writing to this folder; wait for its end, or take another folder")
        shutil.rmtree(staging, ignore_errors=True)
        try:
            yield
        finally:
            shutil.rmtree(staging, ignore_errors=True)
            with contextlib.suppress(OSError):  # Windows keeps a file that is open
                path.unlink()


def _locked(handle: int) -> bool:
    """Locks an open file, until it is closed or the process ends; False if another process has it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True  # a file system without locks
    return True
