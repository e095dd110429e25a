"""Which files a run improves, and where the result of each goes."""

import contextlib
import fnmatch
import glob
import os
from collections import deque
from collections.abc import Iterable
from pathlib import Path

from ..errors import MeshIOError
from ..files.formats.registry import format_of, known_extensions
from ..files.formats.vtm import parts_of
from ..files.pvd import PVD, is_pvd, pvd_steps
from .batches import Job
from .folder_lock import STAGING

Paths = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]


def find_jobs(paths: Paths, out: Path, suffix: str | None) -> list[Job]:
    """A job for every file that the paths name, sorted by name; arguments are those of `improve_files`.

    Raises MeshIOError.
    """
    if suffix is not None:
        suffix = suffix if suffix.startswith(".") else f".{suffix}"
        if suffix.lower() != PVD:
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
        root, found = _matches(os.fspath(path), results)
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


def _matches(path: str, results: str) -> tuple[str, list[str]]:
    """The folder that a path or pattern begins at, and the files that it names.

    results  the folder of results, whose content is no input
    """
    if os.path.isfile(path):
        return os.path.dirname(path), [path]
    if os.path.isdir(path):
        return path, _sorted_out(path, results)[0]
    if not glob.has_magic(path):
        return os.path.dirname(path), []
    root = path
    while glob.has_magic(root):
        root = os.path.dirname(root)
    parts = path.split(os.sep)
    if "**" not in parts:
        return root, [f for f in glob.glob(path) if _is_given(f)]
    first = parts.index("**")
    before, pattern = os.sep.join([*parts[:first], ""]), parts[first:]
    pattern += ["*"] if pattern[-1] == "**" else []
    folders = glob.glob(before) if glob.has_magic(before) else [before]
    found = [
        os.path.join(folder, file)
        for folder in folders
        if os.path.isdir(folder or os.curdir)
        for file in files_below(folder, results)
        if _fits(file.split(os.sep), pattern)
    ]
    return root, [f for f in found if _is_given(f)]


def skipped_files(paths: Paths, out: Path) -> list[str]:
    """The files in the folders among the paths that are no inputs, because their extension is no mesh format's."""
    given = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    results = os.path.abspath(out)
    folders = [os.fspath(path) for path in given if os.path.isdir(path)]
    return sorted({file for folder in folders for file in _sorted_out(folder, results)[1]})


def _sorted_out(folder: str, results: str) -> tuple[list[str], list[str]]:
    """The mesh files below a folder, with links to such that are gone, and the other files.

    The steps of a collection (.pvd), the blocks of a list (.vtm), the data of an XDMF file, and the elements and the
    segments beside nodes (.node) are part of these, and stand in neither list.
    """
    known = {*known_extensions(), PVD}
    found = [os.path.join(folder, file) for file in files_below(folder, results)]
    parts: set[str] = set()
    for file in found:
        if is_pvd(Path(file)):
            with contextlib.suppress(MeshIOError):  # which is said when it is read
                parts.update(os.path.abspath(step) for _, step in pvd_steps(Path(file)))
        elif file.lower().endswith((".xdmf", ".xmf")):
            parts.update(os.path.abspath(os.path.splitext(file)[0] + end) for end in (".h5", ".hdf5", ".bin"))
        elif file.lower().endswith(".node"):
            ends = (".ele", ".poly", ".edge", ".neigh", ".area")
            parts.update(os.path.abspath(os.path.splitext(file)[0] + end) for end in ends)
        elif file.lower().endswith(".vtm"):
            parts.update(os.path.abspath(part) for part in parts_of(Path(file)))
    found = [file for file in found if os.path.abspath(file) not in parts]
    meshes = [file for file in found if os.path.splitext(file)[1].lower() in known and _is_given(file)]
    return meshes, sorted({*found} - {*meshes})


def _is_given(file: str) -> bool:
    """Is this a file, or a link to one that is gone, which is to be told?  Devices and pipes are none."""
    return os.path.isfile(file) or (os.path.islink(file) and not os.path.exists(file))


def files_below(folder: str, results: str = "") -> list[str]:
    """The paths, from `folder` on, of all files in it and in the folders below it, each folder once.

    results  a folder that is left out

    A symbolic link to a folder is followed only if that is not above the link and not visited without the link: links
    that lead back would otherwise make the search endless.  Folders and files whose names begin with a dot are hidden.
    """
    found: list[str] = []
    links: deque[str] = deque()
    # A folder is known by its device and its number, which all paths to it share.
    visited = {_identity(results)} if results else set()
    visited.discard(_identity(folder or os.curdir))

    def walk(start: str) -> None:
        for at, folders, files in os.walk(os.path.join(folder, start) or os.curdir):
            # What is yielded for one folder stands before what is below it, and the list of folders steers the walk.
            if (identity := _identity(at)) in visited:
                folders.clear()
                continue
            visited.add(identity)
            folders[:] = sorted(name for name in folders if not name.startswith("."))
            below = os.path.relpath(at, folder or os.curdir)
            names = [os.path.normpath(os.path.join(below, name)) for name in folders]
            links.extend(name for name in names if os.path.islink(os.path.join(folder, name)))
            found.extend(os.path.normpath(os.path.join(below, name)) for name in files if not name.startswith("."))

    walk("")
    while links:
        link = links.popleft()
        path = os.path.join(folder, link)
        target = os.path.realpath(path)
        above = _below(os.path.join(os.path.realpath(os.path.dirname(path) or os.curdir), ""), target)
        if not above and _identity(target) not in visited:
            walk(link)
    return found


def _identity(folder: str) -> tuple[int, int]:
    """What the paths of one folder share; a folder that is not there has none."""
    try:
        state = os.stat(folder)
    except OSError:
        return -1, -1
    return state.st_dev, state.st_ino


def _fits(parts: list[str], pattern: list[str]) -> bool:
    """Whether the parts of a path match a pattern in which ** stands for any number of folders."""
    if not pattern:
        return not parts
    if pattern[0] == "**":
        return _fits(parts, pattern[1:]) or (bool(parts) and _fits(parts[1:], pattern))
    return bool(parts) and fnmatch.fnmatch(parts[0], pattern[0]) and _fits(parts[1:], pattern[1:])


def _below(path: str, folder: str) -> bool:
    return path.startswith(os.path.join(folder, ""))
