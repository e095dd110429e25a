"""Which files a run improves, and where the result of each goes."""

import contextlib
import glob
import os
from collections.abc import Iterable
from pathlib import Path

from ..errors import MeshIOError
from ..files.formats.registry import format_of, known_extensions
from .batches import Job
from .folder_lock import STAGING

Paths = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]


def find_jobs(paths: Paths, out: Path, suffix: str | None) -> list[Job]:
    """A job for every file that the paths name, sorted by name; arguments are those of `improve_files`.

    Raises MeshIOError.
    """
    if suffix is not None:
        suffix = suffix if suffix.startswith(".") else f".{suffix}"
        format_of(Path(f"*{suffix}"))
    files, root = _given_files(paths, out)
    jobs: dict[str, Job] = {}
    for absolute, file in sorted(files.items()):
        relative = Path(os.path.relpath(absolute, root))
        relative = relative if suffix is None else relative.with_suffix(suffix)
        key, output = os.path.normcase(relative), out / relative
        if key in jobs:
            raise MeshIOError(f"{output}: {jobs[key].file} and {file} would both be written to it")
        if os.path.exists(output) and os.path.samefile(output, file):
            raise MeshIOError(f"{file}: it would be overwritten by its own result; choose another folder than {out}")
        size = 0
        with contextlib.suppress(OSError):
            size = os.path.getsize(file)
        jobs[key] = Job(relative.as_posix(), file, os.fspath(output), os.fspath(out / STAGING), size)
    return list(jobs.values())


def _given_files(paths: Paths, out: Path) -> tuple[dict[str, str], str]:
    """The files that the paths name, as absolute path and path as given, and the folder that all begin at."""
    given = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    results = os.path.abspath(out)
    files: dict[str, str] = {}
    roots: list[str] = []
    for path in given:
        root, found = _matches(os.fspath(path))
        # The folder of results may lie among the inputs: what an earlier run wrote there is not an input.
        among = _below(results, os.path.abspath(root))
        inputs = [file for file in found if not (among and _below(os.path.abspath(file), results))]
        if not inputs:
            raise MeshIOError(f"{path}: there is no such file, or no mesh file below it")
        roots.append(os.path.abspath(root))
        for file in inputs:
            files.setdefault(os.path.abspath(file), file)
    if not files:
        raise MeshIOError("no files were given")
    try:
        return files, os.path.commonpath(roots)
    except ValueError:
        raise MeshIOError(f"the files lie on different drives: {', '.join(sorted(set(roots)))}") from None


def _matches(path: str) -> tuple[str, list[str]]:
    """The folder that a path or pattern begins at, and the files that it names."""
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
