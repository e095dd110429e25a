"""CGNS files (.cgns) in HDF5 or ADF: planar zones, changed in place.  Cells of structured ones are quads.

    Base                            in HDF5, a node is a group with attributes name, label, type, and a dataset " data"
      Zone                          the numbers of vertices and cells
        GridCoordinates             CoordinateX, CoordinateY, CoordinateZ
        airfoil, fluid, ...         sections: a type, the range of numbers (ElementRange), nodes (ElementConnectivity)
        ZoneBC                      boundary conditions: vertices or elements, by their numbers, and a family
        FlowSolution                values at vertices or in cells
      Family                        a name, perhaps of more than one condition

Vertices and elements are numbered from 1 in each zone.  https://cgns.org/standard/SIDS/grid.html (SIDS, file mapping)
"""

import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from ..swelling import check_hdf5
from .cgns_adf import AdfNode, AdfStore
from .cgns_sections import NUMBERS, Section, sections_of
from .cgns_structured import Structure
from .cgns_tree import Node, Tree, new_tree
from .format import Document, Format, numbers_by_type


@dataclass
class CgnsFile:
    """A file.

    data      its bytes
    sections  its elements
    axes      for each zone the arrays of coordinates
    fields    for each field at vertices the array of each zone
    ends      the vertex behind the last one of each zone
    types     the types of boundary conditions, by their names
    """

    data: bytes
    sections: list[Section] = field(default_factory=list)
    axes: list[list[str]] = field(default_factory=list)
    fields: dict[str, list[str]] = field(default_factory=dict)
    ends: list[int] = field(default_factory=list)
    types: dict[str, str] = field(default_factory=dict)

    def patched(self, before: meshio.Mesh, after: meshio.Mesh) -> bytes:
        """The bytes with the points, cells and point data of `after`, which has the rows of `before`."""
        if is_adf(self.data):
            store = AdfStore(self.data)
            self._patch(store, before, after)
            return bytes(store.data)
        import h5py

        memory = io.BytesIO(self.data)
        with h5py.File(memory, "r+") as file:
            self._patch(file, before, after)
        return memory.getvalue()

    def _patch(self, file: Any, before: meshio.Mesh, after: meshio.Mesh) -> None:
        for zone, (start, end) in enumerate(zip([0, *self.ends], self.ends, strict=False)):
            for axis, path in enumerate(self.axes[zone]):
                _put(file[path], before.points[start:end, axis], after.points[start:end, axis])
            for name, paths in self.fields.items():
                if name in after.point_data:
                    _put(file[paths[zone]], before.point_data[name][start:end], after.point_data[name][start:end])
                else:
                    del file[paths[zone].rsplit("/", 1)[0]]
        for section, old, new in zip(self.sections, before.cells, after.cells, strict=True):
            changed = np.flatnonzero((old.data != new.data).any(1))
            if len(changed):
                nodes = file[section.path][()]
                at = section.places[changed, None] + np.arange(new.data.shape[1])
                nodes.reshape(-1)[at] = new.data[changed] - section.start + 1
                file[section.path][...] = nodes


def is_adf(data: bytes) -> bool:
    return b"ADF Database" in data[:32]


def _put(dataset: Any, old: np.ndarray, new: np.ndarray) -> None:
    """Puts numbers into a dataset where they differ from what was read."""
    if not np.array_equal(old, new, equal_nan=True):
        dataset[...] = np.asarray(new).astype(dataset.dtype).reshape(dataset.shape)


@dataclass(frozen=True)
class CgnsFormat(Format):
    """Conditions, and sections of which there are several, are cell sets and point sets.

    The `rest` of a document is a `CgnsFile`.
    """

    def read(self, path: Path) -> Document:
        with open(path, "rb") as stream:
            if is_adf(stream.read(32)):
                data = path.read_bytes()
                return _Reader(CgnsFile(data), AdfNode.root(data)).document(self.name)
        import h5py

        check_hdf5(path)
        with h5py.File(path, "r") as file:
            return _Reader(CgnsFile(path.read_bytes()), Node(file)).document(self.name)

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        # In memory first, because HDF5 crashes the process when a disk is full.
        if like is not None and same_rows and set(mesh.point_data) <= set(like.mesh.point_data):
            path.write_bytes(like.rest.patched(like.mesh, mesh))
        else:
            path.write_bytes(new_tree(mesh, NUMBERS, {} if like is None else like.rest.types))

    def remarks(self, like: Document | None, same_rows: bool) -> list[str]:
        return ["it is in HDF5 instead of ADF"] if like is not None and not same_rows and is_adf(like.rest.data) else []

    def left_behind(self, document: Document, target: Format, same_rows: bool) -> list[str]:
        return [] if target is self and same_rows else [*document.skipped, *document.by_element]


CGNS = CgnsFormat("cgns", (".cgns",), tuple(NUMBERS), cell_data="none", point_data="scalars", cell_sets=True,
                  point_sets=True)  # fmt: skip


class _Reader:
    """What is found in the zones of a file."""

    def __init__(self, file: CgnsFile, root: Tree) -> None:
        self.file = file
        self.root = root
        self.points: list[np.ndarray] = []
        self.point_data: dict[str, list[np.ndarray]] = {}
        self.groups: dict[str, list[np.ndarray]] = {}
        self.vertices: dict[str, list[np.ndarray]] = {}
        self.by_element: dict[str, None] = {}
        self.skipped: dict[str, None] = {}
        self.units = ""

    def document(self, name: str) -> Document:
        bases = list(self.root.children("CGNSBase_t"))
        zones = [(base, zone) for base in bases for zone in base.children("Zone_t")]
        if not zones:
            raise ValueError("it has no zone")
        for base, zone in zones:
            kept = len(self.file.sections)
            self._read_zone(base, zone)
            self.units = self.units or _units(base) or _units(zone)
            if len(zones) > 1:
                faces = [s.number for s in self.file.sections[kept:] if s.kind not in ("line", "line3", "vertex")]
                self._group(zone.name, kept, np.concatenate([np.zeros(0, np.int64), *faces]))
        widths = {table.shape[1] for table in self.points}
        if len(widths) > 1:
            raise ValueError("its zones have two and three coordinates")
        cells = [(s.kind, s.nodes) for s in self.file.sections]
        mesh = meshio.Mesh(np.concatenate(self.points), cells)
        for key, values in self.point_data.items():
            if len(values) == len(zones):
                mesh.point_data[key] = np.concatenate(values)
            else:
                self.skipped[f"{key!r}, which not all zones have"] = None
        self.file.fields = {key: paths for key, paths in self.file.fields.items() if key in mesh.point_data}
        mesh.cell_sets = {
            key: [*rows, *[np.zeros(0, np.int64)] * (len(cells) - len(rows))] for key, rows in self.groups.items()
        }
        mesh.point_sets = {key: np.unique(np.concatenate(rows)) for key, rows in self.vertices.items()}
        one = len(zones) == 1
        return Document(
            mesh, name, rest=self.file, by_element=tuple(self.by_element), skipped=tuple(self.skipped),
            node_numbers=1 + np.arange(len(mesh.points)) if one else None,
            cell_numbers=numbers_by_type(mesh, [s.number for s in self.file.sections]) if one else {},
            units=self.units,
        )  # fmt: skip

    def _read_zone(self, base: Tree, zone: Tree) -> None:
        start = self.file.ends[-1] if self.file.ends else 0
        structure = Structure.of(zone, start)
        count = int(zone.whole("the numbers of its zone").reshape(-1)[0]) if structure is None else structure.count
        grids = list(zone.children("GridCoordinates_t"))
        for more in grids[1:]:
            self.skipped[f"the coordinates {more.name!r}"] = None
        arrays = {node.name: node for node in grids[0].children("DataArray_t")} if grids else {}
        names = [f"Coordinate{axis}" for axis in "XYZ"]
        names = names[: 3 if names[2] in arrays else 2]
        if not set(names) <= set(arrays):
            raise ValueError(f"its zone {zone.name!r} has no CoordinateX and CoordinateY")
        table = [np.asarray(arrays[key].data()).reshape(-1) for key in names]
        if any(len(column) != count for column in table):
            raise ValueError(f"its zone {zone.name!r} says {count} vertices and has {len(table[0])}")
        self.points.append(np.stack(table, 1))
        self.file.axes.append([arrays[key].path for key in names])
        self.file.ends.append(start + count)
        first = len(self.file.sections)
        if structure is not None:
            self.file.sections.append(structure.quads())
            self.by_element[f"the structure of the zone {zone.name!r}"] = None
        sections = [
            (int(next(node.children("IndexRange_t")).whole("a range").reshape(-1)[0]), node)
            for node in zone.children("Elements_t")
        ]
        for begin, node in sorted(sections, key=lambda pair: pair[0]):
            self.file.sections += sections_of(node, begin, start, count)
            if list(node.children("DataArray_t", "ParentElements")):
                self.by_element[f"the parents of {node.name!r}"] = None
        self._read_conditions(base, zone, first, start, structure)
        self._name_sections([(begin, node) for begin, node in sections], first)
        self._read_fields(zone, count)

    def _read_conditions(self, base: Tree, zone: Tree, first: int, start: int, structure: Structure | None) -> None:
        families = {node.name: node for node in base.children("Family_t")}
        for holder in zone.children("ZoneBC_t"):
            for node in holder.children("BC_t"):
                family = next((child.text() for child in node.children("FamilyName_t")), "")
                named = families[family].children("FamilyName_t") if family in families else iter(())
                names = [child.name for child in named] or [family or node.name]
                place = next((child.text() for child in node.children("GridLocation_t")), "Vertex")
                for name in names:
                    self.file.types[name] = node.text()
                if structure is not None:
                    self._read_sides(structure, node, names, place, first)
                    continue
                numbers = _members(node)
                for name in names:
                    if place == "Vertex" and not list(node.children("IndexRange_t", "ElementRange")):
                        self.vertices.setdefault(name, []).append(start + numbers - 1)
                    else:
                        self._group(name, first, numbers)

    def _read_sides(self, structure: Structure, node: Tree, names: list[str], place: str, first: int) -> None:
        """A condition of a structured zone: lines along a side of it, or else vertices."""
        lines, rows = structure.condition(node, place, 2 + sum(len(s.number) for s in self.file.sections[first:]))
        if lines is not None:
            self.file.sections.append(lines)
        for name in names:
            if lines is not None:
                self._group(name, first, lines.number)
            elif len(rows):
                self.vertices.setdefault(name, []).append(rows)

    def _name_sections(self, sections: list[tuple[int, Tree]], first: int) -> None:
        """Sections are groups by their names, unless conditions have their elements; a single one of faces is none."""
        taken = [np.zeros(0, np.int64)]
        for rows in self.groups.values():
            taken += [s.number[r] for s, r in zip(self.file.sections[first:], rows[first:], strict=False)]
        known = np.unique(np.concatenate(taken))
        faces = {s.path for s in self.file.sections[first:] if s.kind not in ("line", "line3", "vertex")}
        for _, node in sections:
            own = [s for s in self.file.sections[first:] if s.path.startswith(f"{node.location}/")]
            numbers = np.concatenate([np.zeros(0, np.int64), *(s.number for s in own)])
            if not np.isin(numbers, known).any() and (len(faces) > 1 or not {s.path for s in own} & faces):
                self._group(node.name, first, numbers)

    def _group(self, name: str, first: int, numbers: np.ndarray) -> None:
        """Adds elements of a zone, whose sections begin at `first`, to the cell set of this name."""
        rows = self.groups.setdefault(name, [])
        rows += [np.zeros(0, np.int64)] * (len(self.file.sections) - len(rows))
        for k in range(first, len(self.file.sections)):
            found = np.flatnonzero(np.isin(self.file.sections[k].number, numbers))
            rows[k] = np.union1d(rows[k], found)

    def _read_fields(self, zone: Tree, count: int) -> None:
        solutions = list(zone.children("FlowSolution_t"))
        for node in solutions:
            place = next((child.text() for child in node.children("GridLocation_t")), "Vertex")
            for array in node.children("DataArray_t"):
                name = array.name if len(solutions) == 1 else f"{node.name}/{array.name}"
                values = np.asarray(array.data()).reshape(-1)
                if place != "Vertex" or len(values) != count:
                    self.by_element[f"{name!r} of cells"] = None
                    continue
                self.point_data.setdefault(name, []).append(values)
                self.file.fields.setdefault(name, []).append(array.path)


def _units(node: Tree) -> str:
    """The unit of length that a node states, as CGNS calls it."""
    for child in node.children("DimensionalUnits_t"):
        raw = np.asarray(child.data()).astype(np.uint8).tobytes()
        word = raw[32:64].split(b"\0")[0].decode("latin-1").strip()  # mass, length, time, temperature, angle
        return "" if word in ("Null", "UserDefined") else word
    return ""


def _members(node: Tree) -> np.ndarray:
    """The numbers of the vertices or elements of a condition."""
    for child in (*node.children("IndexRange_t"), *node.children("IndexArray_t")):
        numbers = child.whole("a boundary condition").reshape(-1)
        if child.name in ("PointRange", "ElementRange") and len(numbers) == 2:
            low, high = int(numbers[0]), int(numbers[1])
            if not 0 < low <= high < 1 << 40 or high - low > 1 << 30:
                raise ValueError(f"its condition {node.name!r} has no range of numbers")
            return np.arange(low, high + 1)
        if child.name in ("PointList", "ElementList"):
            return numbers
    return np.zeros(0, np.int64)
