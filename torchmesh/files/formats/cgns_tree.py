"""The tree of nodes of a CGNS file in HDF5: how it is read, and a new one.

Arrays stand in HDF5 with their axes in the order of C, which is the other way round than in CGNS.
"""

import abc
import io
from collections.abc import Iterator, Mapping
from typing import Any

import meshio
import numpy as np

_LONGEST_NAME = 32
DATA = " data"
_LETTERS = {"i4": "I4", "i8": "I8", "f4": "R4", "f8": "R8", "i1": "C1"}


class Tree(abc.ABC):
    """A node with the nodes below it.

    location  its path from the root
    """

    location: str

    @property
    @abc.abstractmethod
    def name(self) -> str: ...

    @property
    @abc.abstractmethod
    def label(self) -> str: ...

    @abc.abstractmethod
    def every(self) -> "Iterator[Tree]":
        """The nodes below it."""

    @abc.abstractmethod
    def data(self) -> Any:
        """Its array.  Raises ValueError without one, or for one that is not of numbers."""

    @property
    def path(self) -> str:
        """Where its data stand."""
        return f"{self.location}/{DATA}"

    def children(self, label: str, name: str | None = None) -> "Iterator[Tree]":
        """The nodes below it with a label, and with a name if one is given."""
        for child in self.every():
            if child.label == label and name in (None, child.name):
                yield child

    def whole(self, what: str) -> np.ndarray:
        """Its array of whole numbers.  Raises ValueError."""
        found = self.data()
        if found.dtype.kind not in "iu" or not found.size:
            raise ValueError(f"{what} ({self.name!r}) are no whole numbers")
        return np.asarray(found, np.int64)

    def text(self) -> str:
        return _text(np.asarray(self.data()).astype(np.uint8).tobytes())


class Node(Tree):
    """A node of a file in HDF5: a group."""

    def __init__(self, group: Any) -> None:
        self.group = group
        self.location = str(group.name)

    @property
    def name(self) -> str:
        return self.location.rsplit("/", 1)[-1]

    @property
    def label(self) -> str:
        return _text(self.group.attrs.get("label", b""))

    def every(self) -> "Iterator[Node]":
        import h5py

        for key in self.group:
            child = self.group.get(key)
            if isinstance(child, h5py.Group):
                yield Node(child)

    def data(self) -> Any:
        found = self.group[DATA][()] if DATA in self.group else None
        if not isinstance(found, np.ndarray) or found.dtype.kind not in "iuf":
            raise ValueError(f"its node {self.name!r} has no data")
        return found


def _text(value: Any) -> str:
    raw = bytes(value) if isinstance(value, (bytes, np.bytes_)) else str(value).encode()
    return raw.split(b"\0")[0].decode("utf-8", "replace").strip()


def new_tree(mesh: meshio.Mesh, numbers: Mapping[str, int], types: Mapping[str, str]) -> bytes:
    """The bytes of a file with one zone; cell sets and point sets become boundary conditions.

    numbers  CGNS' number of each type of cells
    types    the types of boundary conditions by their names; others are those of their family
    """
    import h5py

    memory = io.BytesIO()
    with h5py.File(memory, "w", track_order=True) as file:
        _attributes(file, "HDF5 MotherNode", "Root Node of HDF5 File", "MT")
        file[" format"] = np.frombuffer(b"IEEE_LITTLE_32\0", np.int8)
        file[" hdf5version"] = np.frombuffer(
            f"HDF5 Version {h5py.version.hdf5_version}".encode().ljust(33, b"\0"), np.int8
        )
        _node(file, "CGNSLibraryVersion", "CGNSLibraryVersion_t", np.array([3.4], np.float32))
        points = np.asarray(mesh.points, float)
        base = _node(file, "Base", "CGNSBase_t", np.array([2, points.shape[1]], np.int32))
        faces = sum(len(b.data) for b in mesh.cells if b.type not in ("vertex", "line", "line3"))
        zone = _node(base, "Zone", "Zone_t", np.array([[len(points)], [faces], [0]], np.int32))
        _node(zone, "ZoneType", "ZoneType_t", "Unstructured")
        grid = _node(zone, "GridCoordinates", "GridCoordinates_t")
        for axis, column in zip("XYZ", points.T, strict=False):
            _node(grid, f"Coordinate{axis}", "DataArray_t", np.ascontiguousarray(column))
        starts = np.cumsum([1, *(len(b.data) for b in mesh.cells)])
        for k, block in enumerate(mesh.cells):
            section = _node(zone, f"{block.type}-{k + 1}", "Elements_t", np.array([numbers[block.type], 0], np.int32))
            _node(section, "ElementRange", "IndexRange_t", np.array([starts[k], starts[k + 1] - 1], np.int32))
            _node(section, "ElementConnectivity", "DataArray_t", (block.data + 1).astype(np.int32).reshape(-1))
        _conditions(base, zone, mesh, starts, types)
        if mesh.point_data:
            solution = _node(zone, "FlowSolution", "FlowSolution_t")
            _node(solution, "GridLocation", "GridLocation_t", "Vertex")
            for name, values in mesh.point_data.items():
                kind = values.dtype.newbyteorder("=") if values.dtype.str[1:] in _LETTERS else np.float64
                _node(solution, name.replace("/", "-"), "DataArray_t", np.ascontiguousarray(values, kind))
    return memory.getvalue()


def _conditions(base: Any, zone: Any, mesh: meshio.Mesh, starts: np.ndarray, types: Mapping[str, str]) -> None:
    found = [
        (name, "EdgeCenter" if any(len(m) for b, m in zip(mesh.cells, members, strict=True) if "line" in b.type) else
         "CellCenter", np.concatenate([start + np.asarray(m) for start, m in zip(starts, members, strict=False)]))
        for name, members in mesh.cell_sets.items()
    ]  # fmt: skip
    found += [(name, "Vertex", 1 + np.asarray(rows)) for name, rows in mesh.point_sets.items()]
    if not found:
        return
    holder = _node(zone, "ZoneBC", "ZoneBC_t")
    for name, place, members in found:
        short = name.replace("/", "-")[:_LONGEST_NAME]
        node = _node(holder, short, "BC_t", types.get(name, "FamilySpecified"))
        _node(node, "FamilyName", "FamilyName_t", short)
        if short not in base:
            _node(_node(base, short, "Family_t"), short, "FamilyName_t", short)  # Gmsh takes the name below
        _node(node, "GridLocation", "GridLocation_t", place)
        _node(node, "PointList", "IndexArray_t", members.astype(np.int32)[:, None])


def _node(parent: Any, name: str, label: str, data: np.ndarray | str | None = None) -> Any:
    """A new node below a group, under a name of its own."""
    short, count = name[:_LONGEST_NAME], 1
    while short in parent:
        count += 1
        short = f"{name[: _LONGEST_NAME - 4]}-{count}"
    group = parent.create_group(short, track_order=True)
    if isinstance(data, str):
        data = np.frombuffer(data.encode(), np.int8)
    _attributes(group, short, label, "MT" if data is None else _LETTERS[data.dtype.str[1:]])
    group.attrs.create("flags", np.array([1], np.int32))
    if data is not None:
        group[DATA] = data
    return group


def _attributes(group: Any, name: str, label: str, letters: str) -> None:
    for key, value, width in (("name", name, 33), ("label", label, 33), ("type", letters, 3)):
        group.attrs.create(key, value.encode(), dtype=f"S{width}")
