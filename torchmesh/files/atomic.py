"""Write a file whole or not at all."""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ..errors import MeshIOError


def check_target(path: str | os.PathLike[str]) -> Path:
    """The path, if a file can be put there.  Raises MeshIOError where not."""
    path = Path(path)
    folder = Path(os.path.realpath(path)).parent
    if path.is_dir():
        raise MeshIOError(f"{path}: is a directory")
    if not folder.is_dir():
        raise MeshIOError(f"{path}: the directory {folder} does not exist")
    try:
        with tempfile.TemporaryDirectory(prefix=".torchmesh-", dir=folder):
            return path
    except OSError as error:
        raise MeshIOError(f"{path}: cannot be written: {error.strerror or error}") from None


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A path to write to, which takes the place of `path` when the block ends well, and else vanishes."""
    target = Path(os.path.realpath(check_target(path)))
    folder = None
    try:
        folder = Path(tempfile.mkdtemp(prefix=".torchmesh-", dir=target.parent))
        yield folder / target.name
        os.replace(folder / target.name, target)
    except OSError as error:
        if isinstance(error, MeshIOError):
            raise
        raise MeshIOError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)
