"""Meshes for `torch.utils.data.DataLoader`: from files by `save_batch`, or generated without end.

loader = DataLoader(tm.datasets.MeshDataset("meshes.h5"), batch_size=32, collate_fn=tm.datasets.collate)
loader = DataLoader(tm.datasets.GeneratedMeshes(["holes"]), batch_size=32, collate_fn=tm.datasets.collate,
                    num_workers=4)

A batch is read from a file at once.  `in_memory=True` reads a file once and takes batches out of memory.
"""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset, IterableDataset, get_worker_info

from ..errors import MeshIOError
from ..files.hdf5_reading import BatchFile
from ..mesh.batch import MeshBatch, join, triangle_mesh, vertex_mesh
from ..mesh.connectivity import edges, triangle_components
from ..mesh.kept_edges import constrained_half_edges
from ..mesh.numbers import numbers_of
from .domains import FAMILIES, DomainOptions, pairs

__all__ = ["GeneratedMeshes", "Graph", "InMemoryMeshes", "Item", "MeshDataset", "Pair", "collate", "graph"]

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


class Item(NamedTuple):
    """Meshes, or pairs of them, with what is known of each mesh.

    meshes  a `MeshBatch` or a `Pair`
    fields  by name: (B, ...) tensors, or B strings; of generated meshes their `family`, `seed`, number of `domain`, and
            number of `inverted` triangles
    """

    meshes: "MeshBatch | Pair"
    fields: dict[str, Any]


class MeshDataset(Dataset):
    """The meshes of one or several files by `save_batch`, one after another.

    paths      a file or files, as `torchmesh generate` makes them
    pairs      items are `Pair`s, for files with the point field "undeformed", in place of a mesh
    fields     items are `Item`s, with the mesh fields of the file: family and seed of generated meshes
    in_memory  everything is read now, once; for files that fit

    `dataset[i]` is a batch of one mesh, `dataset[[4, 0, 2]]` and `dataset[2:5]` are batches, on the CPU.  A DataLoader
    asks for a whole batch at once, so that it is read at once.  Each process opens the files for itself when it first
    reads from them, so that workers of a DataLoader may be forked or spawned.  Raises MeshIOError, naming the file, for
    one that is no such file or lacks the field.
    """

    def __init__(
        self,
        paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
        *,
        pairs: bool = False,
        fields: bool = False,
        in_memory: bool = False,
    ) -> None:
        self.paths = [Path(p) for p in ([paths] if isinstance(paths, str | os.PathLike) else paths)]
        self.pairs, self.fields = pairs, fields
        counts = []
        for path in self.paths:
            with BatchFile(path) as file:
                counts.append(len(file))
                if pairs and _UNDEFORMED not in file.point_fields:
                    raise MeshIOError(f"{path}: has no point field {_UNDEFORMED!r}, so no pairs")
        self._ends = np.cumsum(counts)
        self._open: dict[int, BatchFile] = {}
        self._process = os.getpid()
        self._whole = self._read(np.arange(len(self))) if in_memory and len(self) else None

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    def __getitem__(self, index: Any) -> "MeshBatch | Pair | Item":
        return self.__getitems__(index)

    def __getitems__(self, index: Any) -> "MeshBatch | Pair | Item":
        """The meshes of several numbers as one batch; a DataLoader calls this."""
        numbers = numbers_of(index, len(self))
        return self._read(numbers.numpy()) if self._whole is None else taken(self._whole, numbers)

    def _read(self, numbers: np.ndarray) -> "MeshBatch | Pair | Item":
        """The meshes of these numbers, each file's at once."""
        which = np.searchsorted(self._ends, numbers, side="right")
        first = np.concatenate([[0], self._ends])[which]
        order = np.argsort(which, kind="stable")
        parts = [self._of_file(int(w), (numbers - first)[which == w]) for w in np.unique(which)]
        if not parts:
            raise IndexError("a batch needs a mesh at least")
        whole = collate(parts)
        return whole if (np.diff(order) == 1).all() else taken(whole, torch.from_numpy(np.argsort(order)))

    def _of_file(self, which: int, rows: np.ndarray) -> "MeshBatch | Pair | Item":
        """Meshes of one file."""
        file = self._file(which)
        mesh = file.read(rows)
        meshes: MeshBatch | Pair = mesh
        if self.pairs:
            meshes = Pair(mesh.with_points(file.read_point_field(_UNDEFORMED, rows)), mesh)
        return Item(meshes, file.read_mesh_fields(rows)) if self.fields else meshes

    def _file(self, which: int) -> BatchFile:
        # HDF5 handles do not survive a fork.
        if self._process != os.getpid():
            self._open, self._process = {}, os.getpid()
        if which not in self._open:
            self._open[which] = BatchFile(self.paths[which])
        return self._open[which]

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_open": {}}


class InMemoryMeshes(Dataset):
    """The meshes of a batch that there is already, or of a `Pair` or `Item` of batches.

    Items are as those of `MeshDataset`.
    """

    def __init__(self, meshes: "MeshBatch | Pair | Item") -> None:
        self.meshes = meshes

    def __len__(self) -> int:
        inner = self.meshes.meshes if isinstance(self.meshes, Item) else self.meshes
        return len(inner.deformed if isinstance(inner, Pair) else inner)

    def __getitem__(self, index: Any) -> "MeshBatch | Pair | Item":
        return self.__getitems__(index)

    def __getitems__(self, index: Any) -> "MeshBatch | Pair | Item":
        """The meshes of several numbers as one batch; a DataLoader calls this."""
        return taken(self.meshes, numbers_of(index, len(self)))


def taken(meshes: Any, numbers: Tensor) -> Any:
    """The meshes of these numbers (M,) int64, of a batch, or of a `Pair` or `Item` of batches."""
    if isinstance(meshes, Pair):
        return Pair(*(part[numbers] for part in meshes))
    if isinstance(meshes, Item):
        fields = {
            name: value[numbers] if isinstance(value, Tensor) else [value[i] for i in numbers.tolist()]
            for name, value in meshes.fields.items()
        }
        return Item(taken(meshes.meshes, numbers), fields)
    return meshes[numbers]


class Graph(NamedTuple):
    """A batch as a graph network wants it.

    edge_index  (2, 2E) int64, every edge in both directions
    node_mesh   (V,) int64, the mesh of each vertex
    region      (T,) int64, the region of each triangle, from 0 in each mesh; regions are what constrained edges divide
    """

    edge_index: Tensor
    node_mesh: Tensor
    region: Tensor


def graph(batch: MeshBatch) -> Graph:
    """Edges, and what belongs to which mesh and region; on the device of the batch."""
    edge = edges(batch.triangles, batch.twin).T
    locked = constrained_half_edges(batch)
    # These are numbered through the batch, by their first triangles.
    component = triangle_components(batch.triangles, batch.twin, locked)
    owner = triangle_mesh(batch)
    lowest = torch.full((len(batch),), len(component), device=owner.device)
    lowest = lowest.scatter_reduce(0, owner, component, "amin")
    return Graph(torch.cat([edge, edge.flip(0)], 1), vertex_mesh(batch), component - lowest[owner])


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

    What is a batch already comes back as it is.

    This is for `DataLoader(collate_fn=...)`.  Tensors and numbers are stacked as `default_collate` does.
    """
    if isinstance(items, MeshBatch | Pair | Item):
        return items
    first = items[0]
    if isinstance(first, str):
        return list(items)
    if isinstance(first, Item):
        return Item(collate([item.meshes for item in items]), _fields([item.fields for item in items]))
    if isinstance(first, MeshBatch):
        return join(items)
    if isinstance(first, dict):
        return {key: collate([item[key] for item in items]) for key in first}
    if isinstance(first, tuple):
        parts = [collate(part) for part in zip(*items, strict=True)]
        return type(first)(*parts) if hasattr(first, "_fields") else tuple(parts)
    return torch.utils.data.default_collate(list(items))


def _fields(several: list[dict[str, Any]]) -> dict[str, Any]:
    """The fields of several batches, one after another."""
    out: dict[str, Any] = {}
    for name in several[0]:
        values = [fields[name] for fields in several]
        out[name] = torch.cat(values) if isinstance(values[0], Tensor) else [v for part in values for v in part]
    return out
