"""Mesh files of any format, as documents: `load` reads one, `save` writes one."""

from pathlib import Path

import meshio

from ..errors import MeshError, MeshIOError
from .atomic import full_disk_named, real_target, replacing
from .formats.format import Document
from .formats.registry import format_in, format_of
from .messages import translated, warn


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


def save(path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
    """Writes `mesh` in the format of the path's extension, whole or not at all.

    The file follows `like` where that has the same format: in text or binary, version, and content that meshio's
    mesh cannot hold.  Content that is tied to rows is taken only if the mesh has the points and cells of `like`, row
    by row (`same_rows`).

    Raises MeshIOError.  A MeshWarning names what the format cannot hold.
    """
    form = format_of(path)
    real_target(path)
    fitted, lost = form.fit(mesh)
    if lost:
        warn(f"{path}: {form.name} files do not hold {', '.join(sorted(lost))}; dropped")
    with translated(path, "write", form.name), replacing(path) as made, full_disk_named(made.parent):
        form.write(made, fitted, like if like is not None and like.format == form.name else None, same_rows)
