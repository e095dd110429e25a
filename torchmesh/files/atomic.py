"""Write a file whole or not at all."""

import contextlib
import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ..errors import MeshIOError


def check_target(path: str | os.PathLike[str]) -> Path:
    """The path, if a file can be written there.  Raises MeshIOError if not."""
    path = Path(path)
    folder = real_target(path).parent
    try:
        with tempfile.TemporaryDirectory(prefix=".torchmesh-", dir=folder):
            return path
    except OSError as error:
        raise MeshIOError(f"{path}: cannot be written: {_reason(error)}") from None


def real_target(path: str | os.PathLike[str]) -> Path:
    """The path of the file that `path` leads to through links.

    Raises MeshIOError for a directory, for anything else that is no regular file, and where the folder is missing.
    """
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise MeshIOError(f"{path}: is a directory")
    if not target.parent.is_dir():
        raise MeshIOError(f"{path}: the directory {target.parent} does not exist")
    if target.exists() and not target.is_file():
        raise MeshIOError(f"{path}: is not a regular file")
    return target


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A path to write to.  Its file takes the place of `path` when the block ends well, and vanishes otherwise.

    Other files that the block makes beside it are moved with it.  A file that is replaced hands on its permissions.
    Raises MeshIOError for every OSError.
    """
    target = real_target(path)
    folder = None
    try:
        # A new folder in the same file system: from there files are moved in one step, when all are complete.
        folder = Path(tempfile.mkdtemp(prefix=".torchmesh-", dir=target.parent))
        made = folder / target.name
        yield made
        for file in (*sorted(other for other in folder.iterdir() if other != made), made):
            final = target.parent / file.name
            if final.exists():
                shutil.copymode(final, file)
            os.replace(file, final)
    except OSError as error:
        if isinstance(error, MeshIOError):
            raise
        raise MeshIOError(f"{path}: cannot be written: {_reason(error)}") from None
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def full_disk_named(folder: Path) -> Iterator[None]:
    """Inside, a library writes to the folder.  Where it fails because nothing more can be written, this is raised.

    Libraries such as netCDF say "HDF error" or "Permission denied" when a disk is full.  Raises OSError.
    """
    try:
        yield
    except (MeshIOError, FileNotFoundError):
        raise
    except Exception as error:
        if not (isinstance(error, OSError) and error.errno in _FULL):
            _probe(folder)
        raise


# What the system says when a disk, a user's share of it, or a file must not grow.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)

# Bytes that are written to find out whether a disk is full: more than what is left in the last block of a file.
_PROBE = 1 << 16


def _probe(folder: Path) -> None:
    """Raises OSError if some bytes more cannot be written to the folder because it is full."""
    try:
        with tempfile.TemporaryFile(dir=folder) as stream:
            stream.write(bytes(_PROBE))
    except OSError as error:
        if error.errno in _FULL:
            raise


def _reason(error: OSError) -> str:
    return error.strerror or " ".join(str(error).split())
