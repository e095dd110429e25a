"""Checks of the files that a command will write, made before the work begins."""

import os
from pathlib import Path

from .errors import UsageError


def check_distinct(*paths: Path | None) -> None:
    """Raises UsageError if two of the paths name one file; None stands for a file that is not wanted."""
    taken: set[str] = set()
    for path in paths:
        if path is None:
            continue
        real = os.path.realpath(path)
        if real in taken:
            raise UsageError(f"{path} is named twice: each file needs its own name")
        taken.add(real)


def target_of(source: Path, target: Path | None, in_place: bool) -> Path:
    """The file to write; raises UsageError if it is missing, or its input and that was not asked for."""
    if target is None:
        if in_place:
            return source
        raise UsageError("Missing argument 'OUT', the file to write")
    if not in_place and source.exists() and target.exists() and os.path.samefile(source, target):
        raise UsageError(f"{target}: it would take the place of its input; add --in-place if it is to")
    return target


def check_mesh_target(target: Path) -> None:
    """Raises MeshIOError unless a mesh file of this name can be written."""
    from ..files.atomic import check_target, real_target
    from ..files.formats.registry import format_of
    from ..files.pvd import is_pvd

    real_target(target)
    if not is_pvd(target):
        format_of(target)
    check_target(target)
