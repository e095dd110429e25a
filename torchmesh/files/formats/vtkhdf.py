"""VTK's files in HDF5 (.vtkhdf): unstructured grids and polygons of one step, changed in place.

    VTKHDF                  attributes Version and Type
      NumberOfPoints, NumberOfCells, NumberOfConnectivityIds      one number for each part
      Points, Connectivity, Offsets, Types                        the parts one behind another
      PointData, CellData, FieldData                              a dataset for each array
      Vertices, Lines, Polygons, Strips                           in files of polygons, each with cells of its own

https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html
"""

import io
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from ..swelling import check_hdf5
from . import vtk_cells
from .format import Document, Format

# The groups of cells of polygons in the order of their data; VTK's type of cells with one (two) and more nodes.
_POLYGONS = {"Vertices": (1, 2), "Lines": (3, 4), "Polygons": (7, 7), "Strips": (6, 6)}
_GROUP_OF = {"vertex": "Vertices", "line": "Lines"}


@dataclass
class _Part:
    """Cells of one part of a file.

    name    of their dataset of nodes
    nodes   where its nodes begin there
    points  the first of its points
    blocks  its blocks, with places in the dataset and cells among all cells
    first   the first of them among the blocks of the mesh
    """

    name: str
    nodes: int
    points: int
    blocks: list[vtk_cells.Block]
    first: int


@dataclass
class VtkHdf:
    """A file.

    data   its bytes
    kind   UnstructuredGrid or PolyData
    parts  the parts
    cells  the number of its cells
    """

    data: bytes
    kind: str
    parts: list[_Part] = field(default_factory=list)
    cells: int = 0

    def in_file(self, mesh: meshio.Mesh) -> dict[str, np.ndarray]:
        """The cell data of a mesh in the rows of the file."""
        blocks = [block for part in self.parts for block in part.blocks]
        found = {}
        for name, values in mesh.cell_data.items():
            own = [np.asarray(v) for v in values]
            empty = np.zeros((self.cells, *own[0].shape[1:]), np.result_type(*own))
            found[name] = vtk_cells.spread(blocks, own, empty)
        return found


@dataclass(frozen=True)
class VtkHdfFormat(Format):
    """The `rest` of a document is a `VtkHdf`."""

    def read(self, path: Path) -> Document:
        import h5py

        check_hdf5(path)
        with h5py.File(path, "r") as file:
            if "VTKHDF" not in file:
                raise ValueError("it has no group VTKHDF")
            mesh, rest = _parse(file["VTKHDF"], path.read_bytes())
        return Document(mesh, self.name, rest=rest)

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        import h5py

        # In memory first, because HDF5 crashes the process when a disk is full.
        patched = like is not None and same_rows
        memory = io.BytesIO(like.rest.data if patched and like is not None else b"")
        with h5py.File(memory, "r+" if patched else "w") as file:
            if patched and like is not None:
                _patch(file["VTKHDF"], like, mesh)
            else:
                _new_file(file, mesh, "UnstructuredGrid" if like is None else like.rest.kind)
                if like is not None:
                    _copy_field_data(like.rest.data, file)
        path.write_bytes(memory.getvalue())


VTKHDF = VtkHdfFormat("vtkhdf", (".vtkhdf",), cell_sets=True, point_sets=True, set_arrays=True)


def _parse(root: Any, data: bytes) -> tuple[meshio.Mesh, VtkHdf]:
    """Raises ValueError for anything but a file of one step whose numbers agree."""
    kind = root.attrs.get("Type", b"")
    kind = kind.decode(errors="replace") if isinstance(kind, bytes) else str(kind)
    if kind not in ("UnstructuredGrid", "PolyData"):
        raise ValueError(f"it holds a {kind or 'file of another kind'}, not an unstructured grid or polygons")
    if "Steps" in root and int(root["Steps"].attrs.get("NSteps", 1)) > 1:
        raise ValueError("it has several steps; save each as .vtu, and list them in a .pvd")
    points = np.asarray(root["Points"])
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError("its points have not 3 coordinates")
    counts = [int(n) for n in np.asarray(root["NumberOfPoints"]).reshape(-1)]
    if min(counts, default=0) < 0 or sum(counts) != len(points):
        raise ValueError(f"it says that it has {sum(counts)} points and has {len(points)}")
    file = VtkHdf(data, kind)
    cells: list[tuple[str, np.ndarray]] = []
    for group in ("",) if kind == "UnstructuredGrid" else _POLYGONS:
        if group and group not in root:
            continue
        holder, name = (root[group] if group else root), f"{group}/Connectivity".lstrip("/")
        nodes, ends = (np.asarray(holder[key]).astype(np.int64) for key in ("Connectivity", "Offsets"))
        numbers = [np.asarray(holder[key]).reshape(-1) for key in ("NumberOfCells", "NumberOfConnectivityIds")]
        if [len(n) for n in numbers] != [len(counts)] * 2 or any((n < 0).any() for n in numbers):
            raise ValueError("the numbers of its parts do not agree")
        types = np.asarray(root["Types"]).astype(np.int64) if not group else None
        at, begin, start = 0, 0, 0
        for count, some, width in zip(counts, *(n.tolist() for n in numbers), strict=True):
            offsets, own = ends[at : at + some + 1], nodes[begin : begin + width]
            if types is not None:
                kinds = types[at - len(file.parts) :][:some]
            else:
                one, more = _POLYGONS[group]
                kinds = np.where(np.diff(offsets) == (2 if group == "Lines" else 1), one, more)
            found = [replace(block, cells=block.cells + file.cells) for block in vtk_cells.blocks(kinds, offsets, own)]
            file.parts.append(_Part(name, begin, start, found, len(cells)))
            file.cells += some
            cells += [(block.kind, block.nodes + start) for block in found]
            at, begin, start = at + some + 1, begin + width, start + count
    mesh = meshio.Mesh(points, cells)
    blocks = [block for part in file.parts for block in part.blocks]
    for key, rows in (("PointData", len(points)), ("CellData", file.cells)):
        for name, dataset in root.get(key, {}).items():
            values = np.asarray(dataset)
            if values.dtype.kind not in "iuf":
                continue
            if len(values) != rows:
                raise ValueError(f"the array {name!r} has {len(values)} rows instead of {rows}")
            if key == "PointData":
                mesh.point_data[name] = values
            elif blocks:
                mesh.cell_data[name] = [values[block.cells] for block in blocks]
    return mesh, file


def _patch(root: Any, like: Document, mesh: meshio.Mesh) -> None:
    """Writes the points, cells and data of `mesh` where they differ from what was read."""
    file: VtkHdf = like.rest

    def put(name: str, old: np.ndarray, new: np.ndarray) -> None:
        if not np.array_equal(old, new, equal_nan=np.asarray(new).dtype.kind == "f"):
            root[name][...] = np.asarray(new).astype(root[name].dtype)

    put("Points", like.mesh.points, np.pad(mesh.points, ((0, 0), (0, 3 - mesh.points.shape[1]))))
    for part in file.parts:
        nodes = np.asarray(root[part.name]).astype(np.int64)
        new = [meshio.CellBlock(b.type, b.data - part.points) for b in mesh.cells[part.first :][: len(part.blocks)]]
        shifted = [replace(b, places=np.where(b.places < 0, -1, b.places + part.nodes)) for b in part.blocks]
        put(part.name, nodes, vtk_cells.renewed(nodes, shifted, new))
    data = (("PointData", like.mesh.point_data, mesh.point_data),
            ("CellData", file.in_file(like.mesh), file.in_file(mesh)))  # fmt: skip
    for group, before, after in data:
        for name in set(before) - set(after):
            del root[group][name]
        for name, values in after.items():
            if name in before:
                put(f"{group}/{name}", before[name], values)
            else:
                root.require_group(group)[name] = vtk_cells.storable(np.asarray(values))


def _new_file(file: Any, mesh: meshio.Mesh, kind: str) -> None:
    """Fills a new file."""
    root = file.create_group("VTKHDF")
    root.attrs["Version"] = np.array([2, 0])
    root.attrs.create("Type", kind.encode(), dtype=f"S{len(kind)}")
    points = np.pad(mesh.points, ((0, 0), (0, 3 - mesh.points.shape[1])))
    root["NumberOfPoints"] = np.array([len(points)])
    root["Points"] = points
    order: list[int] = []
    for group in ("",) if kind == "UnstructuredGrid" else _POLYGONS:
        own = [i for i, b in enumerate(mesh.cells) if not group or _GROUP_OF.get(b.type, "Polygons") == group]
        types, offsets, nodes = vtk_cells.arrays([mesh.cells[i] for i in own])
        order += own
        holder = root.create_group(group) if group else root
        holder["NumberOfCells"] = np.array([len(types)])
        holder["NumberOfConnectivityIds"] = np.array([len(nodes)])
        holder["Offsets"], holder["Connectivity"] = offsets, nodes
        if not group:
            root["Types"] = types.astype(np.uint8)
    for name, values in mesh.point_data.items():
        root.require_group("PointData")[name] = vtk_cells.storable(np.asarray(values))
    for name, blocks in mesh.cell_data.items():
        rows = [np.asarray(blocks[i]) for i in order]
        root.require_group("CellData")[name] = vtk_cells.storable(np.concatenate(rows))


def _copy_field_data(data: bytes, file: Any) -> None:
    """Copies the data of the whole file from another one."""
    import h5py

    with h5py.File(io.BytesIO(data), "r") as other:
        if "FieldData" in other["VTKHDF"]:
            other.copy("VTKHDF/FieldData", file["VTKHDF"])
