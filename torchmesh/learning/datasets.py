"""Meshes for `torch.utils.data.DataLoader`: from files by `save_batch`, or generated without end.

loader = DataLoader(tm.datasets.MeshDataset("meshes.h5"), batch_size=32, collate_fn=tm.datasets.collate)
loader = DataLoader(tm.datasets.GeneratedMeshes(["holes"]), batch_size=32, collate_fn=tm.datasets.collate,
                    num_workers=4)
"""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch.utils.data import Dataset, IterableDataset, get_worker_info

from ..errors import MeshIOError
from ..files.hdf5 import BatchFile
from ..mesh.batch import MeshBatch, join
from .domains import FAMILIES, DomainOptions, pairs

__all__ = ["GeneratedMeshes", "MeshDataset", "Pair", "collate"]

# The point field of a file that holds the undeformed points.
_UNDEFORMED = "undeformed"

# Generated meshes are split out of batches of so many; the number changes no mesh.
_AT_ONCE = 64


def __dir__() -> list[str]:
    return __all__


class Pair(NamedTuple):
    """Meshes before and after a motion; the triangles of both are the same."""

    undeformed: MeshBatch
    deformed: MeshBatch


class MeshDataset(Dataset):
    """The meshes of one or several files by `save_batch`, one after another.

    paths  a file or files, as `torchmesh generate` makes them
    pairs  items are `Pair`s, for files with the point field "undeformed", in place of a mesh

    An item is a batch of one mesh, on the CPU.  Each process opens the files for itself when it first reads from them,
    so that workers of a DataLoader may be forked or spawned.  Raises MeshIOError, naming the file, for one that is no
    such file or lacks the field.
    """

    def __init__(
        self, paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], *, pairs: bool = False
    ) -> None:
        self.paths = [Path(p) for p in ([paths] if isinstance(paths, str | os.PathLike) else paths)]
        self.pairs = pairs
        counts = []
        for path in self.paths:
            with BatchFile(path) as file:
                counts.append(len(file))
                if pairs and _UNDEFORMED not in file.point_fields:
                    raise MeshIOError(f"{path}: has no point field {_UNDEFORMED!r}, so no pairs")
        self._ends = np.cumsum(counts)
        self._open: dict[int, BatchFile] = {}
        self._process = os.getpid()

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    def __getitem__(self, index: int) -> MeshBatch | Pair:
        if not -len(self) <= index < len(self):
            raise IndexError(f"there are {len(self)} meshes; there is no mesh {index}")
        index %= len(self)
        which = int(np.searchsorted(self._ends, index, side="right"))
        row = index - (int(self._ends[which - 1]) if which else 0)
        file = self._file(which)
        mesh = file.read(row)
        if not self.pairs:
            return mesh
        return Pair(mesh.with_points(file.read_fields(row)[0][_UNDEFORMED]), mesh)

    def _file(self, which: int) -> BatchFile:
        # HDF5 handles do not survive a fork.
        if self._process != os.getpid():
            self._open, self._process = {}, os.getpid()
        if which not in self._open:
            self._open[which] = BatchFile(self.paths[which])
        return self._open[which]

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_open": {}}


class GeneratedMeshes(IterableDataset):
    """The endless stream of `tm.domains`, mesh by mesh; workers of a DataLoader share its domains.

    families, options  as for `tm.domains.stream`: seed, triangles, tangled, motions, shard, drawing
    pairs              items are `Pair`s in place of deformed meshes

    Worker i of n takes the domains i, i + n, ...  So any number of workers gives the same meshes, in another order.
    """

    def __init__(self, families: Sequence[str] = tuple(FAMILIES), *, pairs: bool = False, **options: Any) -> None:
        self.options = DomainOptions(families, **options)
        self.pairs = pairs

    def __iter__(self) -> Iterator[MeshBatch | Pair]:
        worker = get_worker_info()
        options = vars(self.options).copy()
        if worker is not None:
            first, step = options["shard"]
            options["shard"] = (first + step * worker.id, step * worker.num_workers)
        for moved in pairs(options.pop("families"), batch=_AT_ONCE, **options):
            deformed = moved.deformed.split()
            yield from map(Pair, moved.undeformed.split(), deformed) if self.pairs else deformed


def collate(items: Sequence[Any]) -> Any:
    """Make one batch of a list of meshes; of a list of tuples or dicts, make one of each part.

    This is for `DataLoader(collate_fn=...)`.  Tensors and numbers are stacked as `default_collate` does.
    """
    first = items[0]
    if isinstance(first, MeshBatch):
        return join(items)
    if isinstance(first, dict):
        return {key: collate([item[key] for item in items]) for key in first}
    if isinstance(first, tuple):
        parts = [collate(part) for part in zip(*items, strict=True)]
        return type(first)(*parts) if hasattr(first, "_fields") else tuple(parts)
    return torch.utils.data.default_collate(list(items))
