"""Thousands of meshes in one compressed file.

HDF5 was chosen because it does all of the following with a library that is a dependency anyway: chunks are
compressed (shuffle and gzip) and carry checksums, a part can be read without the rest, a file can be written batch
after batch, and other languages read it.  npz unpacks whole arrays to get at one mesh, safetensors does not compress,
and Zarr is a folder of many files and another dependency.

    /               attributes: format, version
    points          (V, 2) float64 or float32        fixed              (V,) bool
    triangles       (T, 3) rows of the mesh's own    constrained_edges  (K, 2) likewise
    quads           (Q, 4) likewise, if there are any
    *_offsets       (B+1,) int64: points, triangles, constrained_edges, quads     frames  (B, 3, 3)
    point_fields/*  (V, ...)                         mesh_fields/*      (B, ...)

The triangles and constrained edges of a mesh count its vertices from 0, so that a mesh can be read alone.
"""

import contextlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch
from ..mesh.typed import typed
from .atomic import replacing
from .hdf5_layout import CHUNK_ROWS, FORMAT, QUADS, VERSION, Fields, as_our_errors, checked_fields, tables_of
from .hdf5_reading import BatchFile, Meshes


@typed
def save_batch(
    path: str | os.PathLike[str],
    batch: MeshBatch,
    *,
    point_fields: Mapping[str, Tensor] | None = None,
    mesh_fields: Fields | None = None,
) -> None:
    """Writes all meshes of `batch` to one file without loss.  The file appears whole or not at all.

    point_fields  tensors (V, ...) that belong to the points, by name
    mesh_fields   tensors (B, ...), or B strings, that belong to the meshes, by name

    Raises MeshIOError, naming the file, if it cannot be written, and InvalidMeshError for a field of another length.
    """
    with BatchWriter(path) as writer:
        writer.append(batch, point_fields=point_fields, mesh_fields=mesh_fields)


def load_batch(path: str | os.PathLike[str], meshes: Meshes = None) -> MeshBatch:
    """The meshes of a file that `save_batch` wrote, on the CPU, bit for bit as they were saved.

    meshes  which of them: a number from 0 (negative from the end), a slice, numbers in any order; None means all

    Raises MeshIOError, naming the file, if `save_batch` did not write it, or if it is cut short or damaged;
    IndexError for a number that is not there.
    """
    with BatchFile(path) as file:
        return file.read(meshes)


def load_fields(path: str | os.PathLike[str], meshes: Meshes = None) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """The point fields (V, ...) and mesh fields (B, ...) of a file that `save_batch` wrote.

    `meshes` and errors are those of `load_batch`.
    """
    with BatchFile(path) as file:
        return file.read_fields(meshes)


class BatchWriter:
    """Writes a file of meshes batch by batch.  It takes the place of `path` when the block ends well.

    with tm.BatchWriter("meshes.h5") as writer:
        writer.append(batch)
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._stack = contextlib.ExitStack()
        self._fields: set[str] = set()
        self.meshes = 0

    def __enter__(self) -> "BatchWriter":
        import h5py

        with contextlib.ExitStack() as stack:
            target = stack.enter_context(replacing(self.path))
            with as_our_errors(self.path, "cannot be written"):
                self._file = stack.enter_context(h5py.File(target, "w", track_order=True))
            self._file.attrs["format"], self._file.attrs["version"] = FORMAT, VERSION
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None and not self.meshes:
            error = InvalidMeshError(f"{self.path}: no mesh was appended")
            self._stack.__exit__(type(error), error, None)
            raise error
        self._stack.__exit__(kind, error, trace)

    def append(
        self,
        batch: MeshBatch,
        *,
        point_fields: Mapping[str, Tensor] | None = None,
        mesh_fields: Fields | None = None,
    ) -> None:
        """Adds the meshes of `batch` after those written so far.

        All batches have one dtype and fields of the same names.  Raises InvalidMeshError and MeshIOError as
        `save_batch` does.
        """
        fields = checked_fields(batch, point_fields or {}, mesh_fields or {})
        if self.meshes and set(fields) != self._fields:
            raise InvalidMeshError(f"{self.path}: every batch must have the fields {sorted(self._fields)}")
        self._fields = set(fields)
        tables, offsets = tables_of(batch)
        if not len(batch.quads) and QUADS not in self._file:
            # The table begins with the first quads, and counts the meshes before them.
            del tables[QUADS], offsets[QUADS]
        elif QUADS not in self._file and self.meshes:
            offsets[QUADS] = torch.cat([offsets[QUADS].new_zeros(self.meshes), offsets[QUADS]])
        with as_our_errors(self.path, "cannot be written"):
            for name, ends in offsets.items():
                dataset = self._file.get(f"{name}_offsets")
                last = 0 if dataset is None else int(dataset[-1])
                self._add(f"{name}_offsets", ends[0 if dataset is None else 1 :] + last)
            for name, values in (tables | fields).items():
                self._add(name, values)
        self.meshes += len(batch)

    def _add(self, name: str, values: Tensor | Sequence[str]) -> None:
        """Appends rows to a dataset, which is made with the first ones."""
        import h5py

        if isinstance(values, Tensor):
            rows = values.detach().cpu().numpy()
            if name in ("triangles", "constrained_edges", QUADS):
                rows = rows.astype(np.int32 if not rows.size or rows.max() < 2**31 else np.int64)
            kind = rows.dtype
        else:
            rows, kind = np.array(list(values), dtype=object), h5py.string_dtype()
        dataset = self._file.get(name)
        if dataset is None:
            dataset = self._file.create_dataset(
                name,
                shape=(0, *rows.shape[1:]),
                maxshape=(None, *rows.shape[1:]),
                dtype=kind,
                chunks=(CHUNK_ROWS, *rows.shape[1:]),
                compression="gzip",
                shuffle=True,
                fletcher32=isinstance(values, Tensor),
            )
        elif dataset.dtype != kind or dataset.shape[1:] != rows.shape[1:]:
            raise InvalidMeshError(
                f"{self.path}: {name} was {dataset.dtype} {dataset.shape[1:]} and is now {kind} {rows.shape[1:]}"
            )
        start = len(dataset)
        dataset.resize(start + len(rows), axis=0)
        dataset[start:] = rows
