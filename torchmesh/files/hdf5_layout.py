"""How meshes lie in an HDF5 file (`hdf5` has the drawing): the tables, their shapes, and what becomes of errors."""

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor

from ..errors import InvalidMeshError, MeshIOError
from ..mesh.batch import MeshBatch, constraint_owner
from ..mesh.ragged import offsets_from_counts, spread
from .messages import about

FORMAT, VERSION = "torchmesh meshes", 1

# Rows in a compressed chunk.  A chunk then has some hundred kilobytes, or a few meshes of the usual size.
CHUNK_ROWS = 8192

TABLES = ("points", "triangles", "constrained_edges")

# Where no mesh has quads, there is no table of them, as in files of earlier versions.
QUADS = "quads"

# The shape of a row of each table, and the kinds of numbers that it may hold, as numpy has them.
SHAPES: dict[str, tuple[tuple[int, ...], str]] = {
    "points": ((2,), "f"),
    "fixed": ((), "biu"),
    "triangles": ((3,), "iu"),
    "constrained_edges": ((2,), "iu"),
    "frames": ((3, 3), "f"),
    **{f"{name}_offsets": ((), "iu") for name in TABLES},
}
OF_QUADS: dict[str, tuple[tuple[int, ...], str]] = {
    QUADS: ((4,), "iu"),
    f"{QUADS}_offsets": ((), "iu"),
}

Fields = Mapping[str, Tensor | Sequence[str]]


def checked_fields(
    batch: MeshBatch, point_fields: Mapping[str, Tensor], mesh_fields: Fields
) -> dict[str, Tensor | Sequence[str]]:
    """The fields by the names of their datasets.  Raises InvalidMeshError for a bad name or number of rows."""
    fields: dict[str, Tensor | Sequence[str]] = {}
    groups = (("point_fields", point_fields, len(batch.points)), ("mesh_fields", mesh_fields, len(batch)))
    for group, given, count in groups:
        for name, values in given.items():
            if "/" in name or name in ("", "."):
                raise InvalidMeshError(f"{group}/{name}: a field's name is not empty, is no dot and has no slash")
            if isinstance(values, Tensor):
                _check_kind(f"{group}/{name}", values)
            if len(values) != count:
                raise InvalidMeshError(f"{group}/{name} must have {count} rows, not {len(values)}")
            fields[f"{group}/{name}"] = values
    return fields


def _check_kind(name: str, values: Tensor) -> None:
    """Raise InvalidMeshError for a field without rows, with rows of no numbers, or of a type that HDF5 has not."""
    if values.ndim == 0:
        raise InvalidMeshError(f"{name} is a single number: a field has a row for each point or mesh")
    if 0 in values.shape[1:]:
        raise InvalidMeshError(f"{name} has the shape {tuple(values.shape)}: there is nothing to store")
    if values.dtype == torch.bfloat16:
        raise InvalidMeshError(f"{name} is {values.dtype}, which HDF5 has not: use .to(torch.float32), which is exact")


def tables_of(batch: MeshBatch) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """The tables of a batch as they are stored, and the offsets (B+1,) of those that have any."""
    owner = constraint_owner(batch)
    edges = batch.constrained_edges - batch.point_offsets[owner][:, None]
    tables = {
        "points": batch.points,
        "fixed": batch.fixed,
        "triangles": batch.triangles - spread(batch.point_offsets[:-1], batch.triangle_offsets)[:, None],
        # Constrained edges are stored mesh by mesh, whatever their order was.
        "constrained_edges": edges[torch.argsort(owner, stable=True)],
        "frames": batch.frames,
        QUADS: batch.quads - spread(batch.point_offsets[:-1], batch.quad_offsets)[:, None],
    }
    offsets = {
        "points": batch.point_offsets,
        "triangles": batch.triangle_offsets,
        "constrained_edges": offsets_from_counts(torch.bincount(owner, minlength=len(batch))),
        QUADS: batch.quad_offsets,
    }
    return tables, offsets


@contextlib.contextmanager
def as_our_errors(path: Path, what: str) -> Iterator[None]:
    """Turns what h5py raises for missing, foreign, short and damaged files into a MeshIOError that names the file."""
    try:
        yield
    except (MeshIOError, InvalidMeshError):
        raise
    except FileNotFoundError:
        raise MeshIOError(f"{path}: there is no such file") from None
    except Exception as error:
        reason = os.strerror(error.errno) if isinstance(error, OSError) and error.errno else str(error)
        raise MeshIOError(about(path, f"{what}; not a file of torchmesh.save_batch, or damaged: {reason}")) from None
