"""Reading parts of a file of meshes, none of whose statements about itself is believed before it is checked."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..errors import MeshIOError
from ..mesh.batch import MeshBatch
from ..mesh.ragged import counts_from_offsets, offsets_from_counts, spread
from .hdf5_heaps import check_heaps
from .hdf5_layout import CHUNK_ROWS, FORMAT, OF_QUADS, QUADS, SHAPES, TABLES, VERSION, as_our_errors
from .swelling import check_attributes

# The greatest factor by which deflate can compress (RFC 1951): what is stated beyond it was never stored.
_DEFLATE = 1032

# Bytes of a table that do no harm, however few of them are stored.
_HARMLESS = 1 << 26

# A table of more bytes that is compressed by more than this factor is not unpacked at once.
_AT_ONCE, _FACTOR = 1 << 30, 200

# The strings of such a file are written when it is begun, and lie in its first bytes.
_FIRST_BYTES = 1 << 26

# Which meshes of a file: all (None), one by its number, a slice, or numbers in any order.
Meshes = int | slice | Sequence[int] | np.ndarray | None


class BatchFile:
    """A file that `save_batch` wrote, open for reading parts of it.

    with tm.BatchFile("meshes.h5") as file:
        print(len(file)); mesh = file.read(7)
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        import h5py

        self.path = Path(path)
        with as_our_errors(self.path, "cannot be read"):
            self._file = h5py.File(self.path, "r")
            check_heaps(self.path, _FIRST_BYTES)
            check_attributes(self._file)
            if self._file.attrs.get("format") != FORMAT:
                raise MeshIOError(f"{path}: this is HDF5, but no file of torchmesh.save_batch")
            if self._file.attrs["version"] > VERSION:
                raise MeshIOError(f"{path}: written by a newer torchmesh (version {self._file.attrs['version']})")
            missing = [
                n for n in (*TABLES, *(f"{t}_offsets" for t in TABLES), "fixed", "frames") if n not in self._file
            ]
            if missing:
                raise MeshIOError(f"{path}: damaged, it lacks {', '.join(missing)}")
            self._check_shapes()
            tables = (*TABLES, QUADS) if QUADS in self._file else TABLES
            self._offsets = {name: self._ends(name) for name in tables}

    def _check_shapes(self) -> None:
        """Raises MeshIOError for a table whose shape or type is not that of its kind; nothing is read for that."""
        meshes, points = self._length("points_offsets") - 1, self._length("points")
        known = SHAPES | OF_QUADS if QUADS in self._file else SHAPES
        for name, (shape, kinds) in known.items():
            table = self._table(name)
            if table.dtype.kind not in kinds or table.shape[1:] != shape:
                found = f"{table.dtype} {table.shape}"
                raise MeshIOError(
                    f"{self.path}: damaged, {name} is a table of {found}, and not of rows of shape {shape}"
                )
        if self._table("points").dtype.itemsize not in (4, 8):
            raise MeshIOError(f"{self.path}: damaged, its points are neither single nor double precision")
        offsets = {self._length(name) for name in known if name.endswith("_offsets")}
        if len(offsets | {self._length("frames") + 1}) > 1:
            raise MeshIOError(f"{self.path}: damaged, its tables differ in their number of meshes")
        if self._length("fixed") != points:
            raise MeshIOError(f"{self.path}: damaged, 'fixed' and 'points' differ in length")
        for group, count in (("point_fields", points), ("mesh_fields", meshes)):
            for name in self._names(group):
                if self._length(f"{group}/{name}") != count:
                    raise MeshIOError(f"{self.path}: damaged, {group}/{name} does not have {count} rows")

    def _table(self, name: str) -> Any:
        """A dataset by its name.  Raises MeshIOError if it is none, or states more rows than it can have."""
        import h5py

        table = self._file.get(name)
        if not isinstance(table, h5py.Dataset) or not table.shape:
            raise MeshIOError(f"{self.path}: damaged, {name} is no table")
        needed, stored = table.size * table.dtype.itemsize, table.id.get_storage_size()
        if needed > max(_HARMLESS, _DEFLATE * stored):
            raise MeshIOError(
                f"{self.path}: damaged, {name} says that it has {needed:.3g} bytes, and is stored in {stored:.3g}"
            )
        return table

    def _length(self, name: str) -> int:
        return int(self._table(name).shape[0])

    def _names(self, group: str) -> list[str]:
        """The names in a group of fields; none if the group is missing."""
        import h5py

        fields = self._file.get(group, {})
        if not isinstance(fields, h5py.Group | dict):
            raise MeshIOError(f"{self.path}: damaged, {group} is no group of fields")
        return list(fields)

    def _ends(self, name: str) -> np.ndarray:
        """(B+1,) the row of a table at which each mesh begins, and the end."""
        ends = self._table(f"{name}_offsets")[:].astype(np.int64)
        if not len(ends) or ends[0] != 0 or (np.diff(ends) < 0).any() or ends[-1] != self._length(name):
            raise MeshIOError(f"{self.path}: damaged, {name}_offsets do not fit {name}")
        return ends

    def __len__(self) -> int:
        return len(self._offsets["points"]) - 1

    @property
    def point_fields(self) -> list[str]:
        """The names of the fields that belong to the points."""
        return self._names("point_fields")

    def __enter__(self) -> "BatchFile":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the file.  What was read stays."""
        self._file.close()

    def read(self, meshes: Meshes = None) -> MeshBatch:
        """Some of the meshes as one batch; see `load_batch`."""
        rows = self._rows(meshes)
        with as_our_errors(self.path, "cannot be read"):
            points, fixed = self._gather("points", "points", rows), self._gather("fixed", "points", rows)
            triangles = self._gather("triangles", "triangles", rows).to(torch.int64)
            edges = self._gather("constrained_edges", "constrained_edges", rows).to(torch.int64)
            frames = self._gather("frames", None, rows)
            quads = torch.zeros((0, 4), dtype=torch.int64)
            if QUADS in self._offsets:
                quads = self._gather(QUADS, QUADS, rows).to(torch.int64)
        ends = {name: self._counted(name, rows) for name in self._offsets}
        ends.setdefault(QUADS, torch.zeros_like(ends["points"]))
        count = counts_from_offsets(ends["points"])
        for name, corners in (("triangles", triangles), ("constrained_edges", edges), (QUADS, quads)):
            if bool(((corners < 0) | (corners >= spread(count, ends[name])[:, None])).any()):
                raise MeshIOError(f"{self.path}: damaged, {name} name points that are not there")
        first = ends["points"][:-1]
        return MeshBatch(
            points,
            triangles + spread(first, ends["triangles"])[:, None],
            fixed.to(torch.bool),
            edges + spread(first, ends["constrained_edges"])[:, None],
            ends["points"],
            ends["triangles"],
            frames,
            quads=quads + spread(first, ends[QUADS])[:, None],
            quad_offsets=ends[QUADS],
        )

    def read_fields(self, meshes: Meshes = None) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Point fields and mesh fields of some of the meshes; see `load_fields`."""
        rows = self._rows(meshes)
        out: tuple[dict[str, Tensor], dict[str, Any]] = {}, {}
        with as_our_errors(self.path, "cannot be read"):
            for group, table, record in zip(("point_fields", "mesh_fields"), ("points", None), out, strict=True):
                for name in self._names(group):
                    record[name] = self._gather(f"{group}/{name}", table, rows)
        return out

    def read_point_field(self, name: str, meshes: Meshes = None) -> Tensor:
        """One point field (V, ...) of some of the meshes; see `load_fields`."""
        rows = self._rows(meshes)
        with as_our_errors(self.path, "cannot be read"):
            found: Tensor = self._gather(f"point_fields/{name}", "points", rows)
        return found

    def read_mesh_fields(self, meshes: Meshes = None) -> dict[str, Any]:
        """The mesh fields (B, ...) of some of the meshes; see `load_fields`."""
        rows = self._rows(meshes)
        with as_our_errors(self.path, "cannot be read"):
            return {name: self._gather(f"mesh_fields/{name}", None, rows) for name in self._names("mesh_fields")}

    def _rows(self, meshes: Meshes) -> np.ndarray:
        """(B',) the numbers of the meshes that are asked for."""
        everything = np.arange(len(self))
        if meshes is None:
            return everything
        if isinstance(meshes, slice):
            return everything[meshes]
        wanted = np.atleast_1d(np.asarray(meshes))
        if wanted.size and not np.issubdtype(wanted.dtype, np.integer):
            raise TypeError(f"meshes are asked for by whole numbers or a slice, not {wanted.dtype}")
        bad = wanted[(wanted < -len(self)) | (wanted >= len(self))]
        if len(bad):
            raise IndexError(f"{self.path} has {len(self)} meshes; there is no mesh {int(bad[0])}")
        return wanted.astype(np.int64) % max(1, len(self))

    def _counted(self, name: str, rows: np.ndarray) -> Tensor:
        """(B'+1,) the offsets of a table that has the meshes `rows` only."""
        return offsets_from_counts(torch.from_numpy(np.diff(self._offsets[name])[rows]))

    def _gather(self, name: str, table: str | None, rows: np.ndarray) -> Any:
        """The rows of a dataset that belong to the meshes `rows`.  Neighbours are read at once.

        table  whose offsets the dataset has; None: it has a row for each mesh
        """
        dataset = self._table(name)
        ends = np.arange(len(self) + 1) if table is None else self._offsets[table]
        slabs, wanted = _slabs(ends[rows], ends[rows + 1])
        self._check_request(dataset, sum(stop - start for start, stop in slabs))
        parts = [dataset[start:stop] for start, stop in slabs]
        found = (parts[0] if len(parts) == 1 else np.concatenate(parts)) if parts else dataset[:0]
        if len(wanted) != len(found) or (np.diff(wanted) != 1).any():
            found = found[wanted]
        if dataset.dtype.kind == "O":
            return [value.decode() for value in found]
        return torch.from_numpy(found)

    def _check_request(self, dataset: Any, rows: int) -> None:
        """Raises MeshIOError for so many rows of compressed data that they would fill the memory of most machines."""
        needed = rows * dataset.dtype.itemsize * int(np.prod(dataset.shape[1:], dtype=np.int64))
        if needed > _AT_ONCE and needed > _FACTOR * dataset.id.get_storage_size():
            raise MeshIOError(
                f"{self.path}: {dataset.name} would swell to {needed:.3g} bytes, so that it may be damaged; "
                "if not, read fewer meshes at once"
            )


def _slabs(starts: np.ndarray, stops: np.ndarray) -> tuple[list[tuple[int, int]], np.ndarray]:
    """What to read for the runs of rows from `starts` to `stops` (M,), and which rows of that, (N,), they are.

    Runs that are less than a chunk apart are read at once, with what is between them: it would be unpacked anyway.
    """
    if not len(starts):
        return [], np.zeros(0, np.int64)
    order = np.argsort(starts, kind="stable")
    begin, end = starts[order], np.maximum.accumulate(stops[order])
    new = np.append(True, begin[1:] > end[:-1] + CHUNK_ROWS)
    last = np.append(np.flatnonzero(new)[1:], len(order)) - 1
    first, past = begin[new], end[last]
    # Where each slab begins among the rows that are read, less where it begins in the file.
    shift = np.cumsum(past - first) - past
    of_run = np.empty(len(order), dtype=np.int64)
    of_run[order] = shift[np.cumsum(new) - 1]
    counts = stops - starts
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return list(zip(first.tolist(), past.tolist(), strict=True)), within + np.repeat(starts + of_run, counts)
