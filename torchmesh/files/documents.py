"""Mesh files of any format, as documents."""

import os
from pathlib import Path

import meshio
import numpy as np

from ..errors import MeshError, MeshIOError
from .formats.format import Document
from .formats.registry import format_in
from .messages import about, in_one_line, translated, warn


def load(path: Path) -> Document:
    """Reads a file.  Raises MeshIOError with one line, whatever is wrong with it."""
    with in_one_line(path):
        try:
            if path.is_dir():
                raise MeshIOError(f"{path}: is a directory, not a mesh file")
            if not path.exists():
                raise MeshIOError(f"{path}: there is no such file")
            if not path.is_file():
                raise MeshIOError(f"{path}: is not a regular file")
            form = format_in(path)
            if path.stat().st_size == 0:
                raise MeshIOError(f"{path}: the file is empty")
            with translated(path, "read", form.name):
                document = form.read(path)
                _check(document.mesh)
                _check_data(document.mesh)
            if not form.counts and _ends_in_a_line(path):
                warn(about(path, "it ends in the middle of a line; the file may be cut short"))
            return document
        except MeshError:
            raise
        except OSError as error:
            raise MeshIOError(f"{path}: cannot be read: {error.strerror or error}") from None


def _check(mesh: meshio.Mesh) -> None:
    """Raises ValueError if points or cells are not the tables that all who use them expect."""
    points = mesh.points
    if not isinstance(points, np.ndarray) or points.ndim != 2 or points.dtype.kind not in "fiu":
        raise ValueError("its points are not rows of coordinates")
    if not 2 <= points.shape[1] <= 3 and len(points):
        raise ValueError(f"its points have {points.shape[1]} coordinates instead of 2 or 3")
    for block in mesh.cells:
        if block.type.startswith("polyhedron"):
            continue
        rows = np.asarray(block.data)
        if rows.ndim != 2 or rows.dtype.kind not in "iu":
            raise ValueError(f"its {block.type} cells are not rows of whole numbers of at most 64 bits")
        width = meshio._mesh.num_nodes_per_cell.get(block.type, rows.shape[1])
        if len(rows) and rows.shape[1] != width:
            raise ValueError(f"its {block.type} cells have {rows.shape[1]} vertices instead of {width}")


def _check_data(mesh: meshio.Mesh) -> None:
    """Raises ValueError if data has not one row for each point, or for each cell of each block."""
    for name, values in mesh.point_data.items():
        if np.ndim(values) < 1 or len(values) != len(mesh.points):
            raise ValueError(f"its point data {name!r} has not one row for each of {len(mesh.points)} points")
    for name, blocks in mesh.cell_data.items():
        if len(blocks) != len(mesh.cells):
            raise ValueError(f"its cell data {name!r} is given for {len(blocks)} of {len(mesh.cells)} blocks of cells")
        for block, values in zip(mesh.cells, blocks, strict=True):
            if np.ndim(values) < 1 or len(values) != len(block.data):
                raise ValueError(
                    f"its cell data {name!r} has not one row for each of {len(block.data)} {block.type} cells"
                )


def _ends_in_a_line(path: Path) -> bool:
    """Whether the last character of a file is not the end of a line."""
    with open(path, "rb") as stream:
        stream.seek(-1, os.SEEK_END)
        return stream.read(1) not in b"\r\n"
