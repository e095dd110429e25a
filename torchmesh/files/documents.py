"""Mesh files of any format, as documents."""

from pathlib import Path

from ..errors import MeshError, MeshIOError
from .formats.format import Document
from .formats.registry import format_in
from .messages import translated


def load(path: Path) -> Document:
    """Reads a file.  Raises MeshIOError with one line, whatever is wrong with it."""
    try:
        if path.is_dir():
            raise MeshIOError(f"{path}: is a directory, not a mesh file")
        if not path.exists():
            raise MeshIOError(f"{path}: there is no such file")
        form = format_in(path)
        if path.stat().st_size == 0:
            raise MeshIOError(f"{path}: the file is empty")
        with translated(path, "read", form.name):
            return form.read(path)
    except MeshError:
        raise
    except OSError as error:
        raise MeshIOError(f"{path}: cannot be read: {error.strerror or error}") from None
