"""The grids of an XDMF file: a mesh, and tags of its cells and facets as FEniCSx writes them, changed in place.

    Grid "mesh"          Topology (triangles), Geometry, Attribute ...
    Grid "cell_tags"     the same triangles, in any order and not all of them; Attribute with their tags
    Grid "facet_tags"    edges; Attribute with their tags

Data stands as text in the file, or in HDF5 files beside it.
"""

import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path

import meshio
import numpy as np

from ..fields import means_regions
from .vtk_xml import as_text, escaped
from .xdmf_mixed import read_grid
from .xdmf_text import XdmfText

_FLAT = ("triangle", "quad", "triangle6", "quad8", "quad9")


@dataclass
class _Tags:
    """A grid of tags.

    grid    its element
    rows    for tags of triangles the row of each among the cells of the mesh; None for those of lines
    block   for lines the number of their block in the mesh
    names   the names of its attributes in the mesh, by those in the file
    """

    grid: ET.Element
    rows: np.ndarray | None
    block: int
    names: dict[str, str] = field(default_factory=dict)


@dataclass
class XdmfGrids:
    """A file that was read.

    path   where it was
    text   its text
    main   the grid of the mesh
    tags   the grids of tags
    """

    path: Path
    text: XdmfText
    main: ET.Element
    tags: list[_Tags] = field(default_factory=list)

    @property
    def changeable(self) -> bool:
        """Can it be changed in place?  Cells of several types in one list cannot, nor data in binary files."""
        topology = self.main.find("Topology")
        kinds = "" if topology is None else topology.get("TopologyType") or topology.get("Type") or ""
        formats = {item.get("Format") for item in self.text.root.iter("DataItem") if item.find("DataItem") is None}
        return kinds.lower() not in ("mixed", "") and formats <= {"XML", "HDF"}

    @property
    def titles(self) -> dict[str, str]:
        """The names of the grids of triangles and of lines."""
        lines = [tags.grid.get("Name", "") for tags in self.tags if tags.rows is None]
        found = {"triangle": self.main.get("Name", ""), "line": lines[0] if lines else ""}
        return {kind: name for kind, name in found.items() if name}

    def write(self, path: Path, before: meshio.Mesh, after: meshio.Mesh) -> None:
        """Writes the file with the points, cells and data of `after`, which has the rows of `before`."""
        edits: list[tuple[int, int, bytes]] = []
        stored: dict[str, np.ndarray] = {}
        main = sum(block.type in _FLAT for block in after.cells)
        self._put_mesh(before, after, main, edits, stored)
        for tags in self.tags:
            self._put_tags(tags, before, after, main, edits, stored)
        files = self._files(path)
        for item in self.text.root.iter("DataItem"):
            if item.get("Format") == "HDF":
                name, _, inside = (item.text or "").strip().partition(":")
                if name != files[name]:
                    begin, end = self.text.places[item][2:]
                    edits.append((begin, end, f"{files[name]}:{inside}".encode()))
        path.write_bytes(self.text.edited(edits))
        for name, new in files.items():
            own = {key.partition(":")[2]: values for key, values in stored.items() if key.partition(":")[0] == name}
            _copy_hdf5(self.path.resolve().parent / name, path.parent / new, own)

    def _files(self, path: Path) -> dict[str, str]:
        """The HDF5 files that it refers to: the name of each in the file, and what it is called beside `path`."""
        items = [item for item in self.text.root.iter("DataItem") if item.get("Format") == "HDF"]
        names = list(dict.fromkeys((item.text or "").strip().partition(":")[0] for item in items))
        if len(names) == 1:
            return {names[0]: f"{path.stem}.h5"}
        return {name: f"{path.stem}_{number}.h5" for number, name in enumerate(names)}

    def _put_mesh(
        self, before: meshio.Mesh, after: meshio.Mesh, main: int, edits: list[tuple[int, int, bytes]],
        stored: dict[str, np.ndarray],
    ) -> None:  # fmt: skip
        geometry, topology = self.main.find("Geometry/DataItem"), self.main.find("Topology/DataItem")
        width = before.points.shape[1]
        self._put(geometry, before.points, after.points[:, :width], edits, stored)
        self._put(topology, _joined(before, main), _joined(after, main), edits, stored)
        known: dict[str, set[str]] = {"Node": set(), "Cell": set()}
        for attribute in self.main.findall("Attribute"):
            name, centre = attribute.get("Name", ""), attribute.get("Center", "")
            old, new = _values(before, name, centre, main), _values(after, name, centre, main)
            known.setdefault(centre, set()).add(name)
            if old is not None and new is None:
                edits.append((*self.text.places[attribute][:2], b""))
            elif old is not None and new is not None:
                self._put(attribute.find("DataItem"), old, new, edits, stored)
        tagged = {name for tags in self.tags for name in tags.names.values()}
        end = self.text.places[self.main][3]
        for centre, data in (("Node", after.point_data), ("Cell", after.cell_data)):
            for name in data:
                if name not in known[centre] and (centre == "Node" or name not in tagged):
                    values = _values(after, name, centre, main)
                    assert values is not None
                    edits.append((end, end, _attribute(name, centre, values)))

    def _put_tags(
        self, tags: _Tags, before: meshio.Mesh, after: meshio.Mesh, main: int, edits: list[tuple[int, int, bytes]],
        stored: dict[str, np.ndarray],
    ) -> None:  # fmt: skip
        """Puts the new nodes of tagged cells into their grid, and values that changed."""
        cells = before.cells[tags.block].data if tags.rows is None else _joined(before, main)[tags.rows]
        if tags.rows is not None:
            new = _joined(after, main)[tags.rows]
            given = self._topology(tags)
            changed = (np.sort(cells, 1) != np.sort(new, 1)).any(1)
            self._put(tags.grid.find("Topology/DataItem"), given, np.where(changed[:, None], new, given), edits, stored)
        for attribute in tags.grid.findall("Attribute"):
            name = tags.names[attribute.get("Name", "")]
            if name not in after.cell_data:
                edits.append((*self.text.places[attribute][:2], b""))
                continue
            if tags.rows is None:
                old, values = before.cell_data[name][tags.block], after.cell_data[name][tags.block]
            else:
                old, values = (np.concatenate(mesh.cell_data[name][:main])[tags.rows] for mesh in (before, after))
            self._put(attribute.find("DataItem"), old, values, edits, stored)

    def _topology(self, tags: _Tags) -> np.ndarray:
        """The nodes of tagged cells, in the order of the file."""
        mesh = _read(self.path, self.text.domain, tags.grid)
        return np.concatenate([block.data for block in mesh.cells])

    def _put(
        self, item: ET.Element | None, old: np.ndarray, new: np.ndarray, edits: list[tuple[int, int, bytes]],
        stored: dict[str, np.ndarray],
    ) -> None:  # fmt: skip
        if item is None or np.array_equal(old, new, equal_nan=np.asarray(new).dtype.kind == "f"):
            return
        if item.get("Format") == "HDF":
            stored[(item.text or "").strip()] = new
            return
        begin, end = self.text.places[item][2:]
        text = self.text.data[begin:end]
        before, after = text[: len(text) - len(text.lstrip())], text[len(text.rstrip()) :]
        edits.append((begin, end, before + as_text(np.asarray(new), True) + after))


def read_grids(path: Path, text: XdmfText) -> tuple[meshio.Mesh, XdmfGrids, dict[str, np.ndarray]]:
    """The mesh with its tags as cell data, the grids, and the tagged edges by name.  Raises ValueError."""
    grids = text.domain.findall("Grid")
    if not grids or any(grid.get("GridType", "Uniform") != "Uniform" for grid in grids):
        raise ValueError("it has a collection of grids, or none; give each part its own file")
    meshes = [_read(path, text.domain, grid) for grid in grids]
    flat = [k for k, mesh in enumerate(meshes) if any(block.type in _FLAT for block in mesh.cells)]
    first = flat[0] if flat else 0
    whole, file = meshes[first], XdmfGrids(path, text, grids[first])
    cells = list(whole.cells)
    data = {name: dict(enumerate(values)) for name, values in whole.cell_data.items()}
    sides: dict[str, np.ndarray] = {}
    for grid, mesh in zip(grids, meshes, strict=True):
        if grid is file.main:
            continue
        title = grid.get("Name", "a grid")
        if not np.array_equal(mesh.points, whole.points):
            raise ValueError(f"its grid {title!r} has points of its own; give each mesh its own file")
        if len(mesh.cells) != 1:
            raise ValueError(f"its grid {title!r} has cells of several types")
        nodes = np.asarray(mesh.cells[0].data, np.int64)
        rows = _rows(whole, nodes, title) if mesh.cells[0].type in _FLAT else None
        tags = _Tags(grid, rows, len(cells))
        if rows is None:
            cells.append(meshio.CellBlock(mesh.cells[0].type, nodes))
        for own, (given, *_) in mesh.cell_data.items():
            values = np.asarray(given)
            values = values[:, 0] if values.ndim == 2 and values.shape[1] == 1 else values
            found = {tags.block: values} if rows is None else _on_mesh(whole, rows, values)
            name = own if not set(found) & set(data.get(own, ())) else f"{title}:{own}"
            # Tags of cells tell regions, whatever they are called.
            name = name if rows is None or means_regions(name) else f"tags:{name}"
            tags.names[own] = name
            data.setdefault(name, {}).update(found)
            if mesh.cells[0].type == "line" and values.dtype.kind in "iu" and values.ndim == 1:
                sides |= {f"{name}-{tag}": nodes[values == tag] for tag in np.unique(values).tolist() if tag}
        file.tags.append(tags)
    cell_data = {name: _on_all(cells, found) for name, found in data.items()}
    return meshio.Mesh(whole.points, cells, point_data=whole.point_data, cell_data=cell_data), file, sides


def _on_all(cells: list[meshio.CellBlock], found: dict[int, np.ndarray]) -> list[np.ndarray]:
    """The values of every block; 0 in those that have none."""
    kind = np.result_type(*found.values())
    shape = next(iter(found.values())).shape[1:]
    return [np.asarray(found.get(i, np.zeros((len(b.data), *shape))), kind) for i, b in enumerate(cells)]


def _on_mesh(mesh: meshio.Mesh, rows: np.ndarray, values: np.ndarray) -> dict[int, np.ndarray]:
    """The tags of some cells of the mesh, in all of its blocks; 0 for cells without one."""
    sizes = [len(block.data) for block in mesh.cells]
    whole = np.zeros((sum(sizes), *values.shape[1:]), values.dtype)
    whole[rows] = values
    return dict(enumerate(np.split(whole, np.cumsum(sizes)[:-1])))


def _read(path: Path, domain: ET.Element, grid: ET.Element) -> meshio.Mesh:
    mesh = read_grid(path, domain, grid)
    if mesh.points is None or not mesh.cells:
        raise ValueError(f"its grid {grid.get('Name', '')!r} has no Geometry or no Topology")
    return mesh


def _rows(mesh: meshio.Mesh, nodes: np.ndarray, title: str) -> np.ndarray:
    """The row of each tagged cell among the cells of the mesh, by its nodes in any order.  Raises ValueError."""
    own = _joined(mesh, len(mesh.cells))
    if own.shape[1:] != nodes.shape[1:]:
        raise ValueError(f"its grid {title!r} has cells of another type than the mesh")
    both = np.concatenate([np.sort(own, 1), np.sort(nodes, 1)])
    _, first, place = np.unique(both, axis=0, return_index=True, return_inverse=True)
    rows = first[place.reshape(-1)[len(own) :]]
    if (rows >= len(own)).any():
        raise ValueError(f"its grid {title!r} has cells that the mesh has not")
    return rows


def _joined(mesh: meshio.Mesh, count: int) -> np.ndarray:
    """The nodes of the first blocks, which are of one type in a file that can be changed."""
    rows = [np.asarray(block.data, np.int64) for block in mesh.cells[:count]]
    return np.concatenate(rows) if len({row.shape[1] for row in rows}) == 1 else np.zeros((0, 0), np.int64)


def _values(mesh: meshio.Mesh, name: str, centre: str, count: int) -> np.ndarray | None:
    """The values of an attribute of the main grid; None if the mesh has none of this name."""
    if centre == "Node":
        return mesh.point_data.get(name)
    values = mesh.cell_data.get(name) if centre == "Cell" else None
    return None if values is None else np.concatenate([np.asarray(v) for v in values[:count]])


def _attribute(name: str, centre: str, values: np.ndarray) -> bytes:
    """The element of a new attribute, with its values as text."""
    kind = "Scalar" if values.ndim == 1 else "Vector"
    values = values.astype(np.int32) if values.dtype.kind == "b" else values
    number = "Float" if values.dtype.kind == "f" else "Int"
    size = " ".join(map(str, values.shape))
    return (
        f'<Attribute Name="{escaped(name)}" AttributeType="{kind}" Center="{centre}"><DataItem DataType="{number}" '
        f'Dimensions="{size}" Format="XML" Precision="{values.dtype.itemsize}">\n{as_text(values, True).decode()}\n'
        "</DataItem></Attribute>\n"
    ).encode()


def _copy_hdf5(source: Path, target: Path, changes: dict[str, np.ndarray]) -> None:
    """Copies an HDF5 file, with other values in some of its datasets."""
    import h5py

    target.write_bytes(source.read_bytes())
    with h5py.File(target, "r+") as file:
        for name, values in changes.items():
            dataset = file[name]
            dataset[...] = np.asarray(values).reshape(dataset.shape).astype(dataset.dtype)
