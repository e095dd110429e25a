"""What a file format is, and what one file of it holds."""

import abc
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from ..fields import REGION_TAGS, region_tag
from .groups import FAMILY, as_sets, families, is_group, numbered, numbers_for, with_positive_numbers

# meshio's name of a cell type: line, triangle, quad, polygon, vertex.  "higher" stands for all of _HIGHER.
FLAT = ("triangle", "quad")
LINEAR = ("line", *FLAT)
ALL_BUT_POLYGONS = ("vertex", *LINEAR, "higher")
ALL_CELLS = ("vertex", *LINEAR, "polygon", "higher")
_HIGHER = re.compile(r"^(line|quad)\d+$|^triangle6$")

# Where a format has no cells of the second order, their corners are written.
_STRAIGHT = {"triangle6": ("triangle", 3), "quad8": ("quad", 4), "quad9": ("quad", 4), "line3": ("line", 2)}


@dataclass(frozen=True)
class Document:
    """One mesh file as it was read.

    mesh               the part of it that meshio's mesh type can hold
    format             the name of its format
    binary             is it binary; None where the format does not leave the choice
    rest               the part that meshio's mesh type cannot hold, in the way of the format; None if there is none
    repeats_triangles  does it list a triangle once for each group that the triangle is in
    sides              named groups of edges (K, 2), given by their vertices, to which the file refers as sides of
                       elements; these edges must stay
    tied               vertices that the file pairs with others, so that they must not slide
    by_element         names for what the file says of single elements that a flip leaves without a meaning
    at_nodes           the rows of the nodes to which the file gives values, such as loads, by the name of what gives
                       them.  These lines are copied as they are, so that their values may be wrong once a node moves
    skipped            names for what of the file was not read
    node_numbers       (V,) what the file calls its nodes, by row; None where it has no numbers of its own
    cell_numbers       what it calls its cells, by their type and in file order; empty where it has no numbers
    units              what it says of units, in words; empty where it says nothing
    """

    mesh: meshio.Mesh
    format: str
    binary: bool | None = None
    rest: Any = None
    repeats_triangles: bool = False
    sides: dict[str, np.ndarray] = field(default_factory=dict)
    tied: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    by_element: tuple[str, ...] = ()
    at_nodes: dict[str, np.ndarray] = field(default_factory=dict)
    skipped: tuple[str, ...] = ()
    depths: bool = False
    node_numbers: Sequence[Any] | np.ndarray | None = None
    cell_numbers: Mapping[str, Sequence[Any] | np.ndarray] = field(default_factory=dict)
    units: str = ""


def numbers_by_type(mesh: meshio.Mesh, numbers: Iterable[np.ndarray]) -> dict[str, np.ndarray]:
    """What a file calls its cells, by their type, from the numbers of each block of cells."""
    found: dict[str, list[np.ndarray]] = {}
    for block, own in zip(mesh.cells, numbers, strict=True):
        found.setdefault(block.type, []).append(own)
    return {kind: np.concatenate(parts) for kind, parts in found.items()}


def counted_by_type(mesh: meshio.Mesh, first: int) -> dict[str, np.ndarray]:
    """The numbers of cells that a file counts for each type on its own, from `first`."""
    counts: dict[str, int] = {}
    for block in mesh.cells:
        counts[block.type] = counts.get(block.type, 0) + len(block.data)
    return {kind: first + np.arange(count) for kind, count in counts.items()}


def counted_through(mesh: meshio.Mesh, first: int, kinds: Sequence[str]) -> dict[str, np.ndarray]:
    """The numbers of cells of these types that a file counts together in the order of its blocks, from `first`."""
    found: dict[str, list[np.ndarray]] = {}
    for block in mesh.cells:
        if block.type in kinds:
            found.setdefault(block.type, []).append(first + np.arange(len(block.data)))
            first += len(block.data)
    return {kind: np.concatenate(parts) for kind, parts in found.items()}


@dataclass(frozen=True)
class Format(abc.ABC):
    """A file format: how it is read and written, and what it can hold.

    name         as warnings and errors call it
    extensions   in lower case with the dot; the first is the usual one
    cells        the cell types that it can hold
    point_data   "all"; "scalars": fields of one component only; "none"
    cell_data    "all"; "regions": one integer field, called `region_name`; "none"
    region_name  the name of the integer cell data (or point data) that is part of the format
    cell_sets    can it hold named sets of cells
    point_sets   can it hold named sets of points
    set_arrays   are sets written as data of 0 and 1 under their names
    field_data   can it hold data of the whole mesh, or names of groups
    names_only   of field data, can it hold names of groups only
    families     can it hold the families of MED
    planar       have its points two coordinates instead of three
    index_type   the integer type of cell rows where it must be a certain one
    counts       does a file say how many points and cells it has, or where it ends
    """

    name: str
    extensions: tuple[str, ...]
    cells: tuple[str, ...] = ALL_CELLS
    point_data: str = "all"
    cell_data: str = "all"
    region_name: str = ""
    cell_sets: bool = False
    point_sets: bool = False
    set_arrays: bool = False
    field_data: bool = False
    names_only: bool = False
    families: bool = False
    planar: bool = False
    index_type: type | None = None
    counts: bool = True

    @abc.abstractmethod
    def read(self, path: Path) -> Document:
        """Reads a file that exists and is not empty.  Any exception means that it cannot be read."""

    @abc.abstractmethod
    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        """Writes a mesh that `fit` gave.  Any exception means that it cannot be written.

        like       a file of this format whose style (text or binary, version) and `rest` the new one takes over
        same_rows  has the mesh the points and cells of `like`, row by row
        """

    def patches(self, document: Document) -> bool:
        """Is `document` rewritten in place, so that all of it but the moved vertices and flipped elements stays?"""
        return False

    def patch(self, path: Path, mesh: meshio.Mesh, like: Document) -> None:
        """Writes `like` with the points and triangles of `mesh`, which has the points and cells of `like`, row by row.

        Only called for a document that `patches` accepts.  Any exception means that it cannot be written.
        """
        raise NotImplementedError

    def remarks(self, like: Document | None, same_rows: bool) -> list[str]:
        """What is written otherwise than in `like`, and nothing is lost by it; arguments as those of `write`."""
        return []

    def conversions(self, mesh: meshio.Mesh) -> list[str]:
        """What of a mesh, as `fit` takes it, a new file holds in another way, and nothing is lost by it."""
        return []

    def recognises(self, head: bytes) -> bool:
        """Can a file with these first bytes (4096 at most) be of this format?

        Only asked where several formats share an extension.
        """
        return True

    def left_behind(self, document: Document, target: "Format", same_rows: bool) -> list[str]:
        """Names for what a file of this format has besides its mesh, and loses when that is written as `target`."""
        return list(document.skipped)

    def fit(self, mesh: meshio.Mesh) -> tuple[meshio.Mesh, set[str]]:
        """The mesh without what the format cannot hold, and names for what was taken away."""
        mesh, nameless = self._with_its_groups(mesh)
        mesh, straight = self._in_its_types(mesh)
        kept = [i for i, b in enumerate(mesh.cells) if self._holds(b.type)]
        lost = {f"{b.type} cells" for i, b in enumerate(mesh.cells) if i not in kept} | straight | nameless
        cells = [mesh.cells[i] for i in kept]
        if self.index_type is not None:
            cells = [meshio.CellBlock(b.type, b.data.astype(self.index_type)) for b in cells]
        cell_data = self._fit_cell_data(mesh, kept, lost)
        point_data = self._fit_point_data(mesh, lost)
        if self.set_arrays:
            for name, members in mesh.cell_sets.items():
                flags = [np.isin(np.arange(len(b.data)), members[i]).astype(np.int32) for i, b in enumerate(mesh.cells)]
                cell_data.setdefault(name, [flags[i] for i in kept])
            for name, rows in mesh.point_sets.items():
                point_data.setdefault(name, np.isin(np.arange(len(mesh.points)), rows).astype(np.int32))
        gone = [
            name for name, sets in mesh.cell_sets.items() if any(map(len, sets)) and not any(len(sets[i]) for i in kept)
        ]
        lost |= {f"cell set {name!r}" for name in (gone if self.cell_sets else mesh.cell_sets)}
        if not self.point_sets:
            lost |= {f"point set {name!r}" for name in mesh.point_sets}
        if not self.field_data:
            lost |= {f"field data {name!r}" for name in mesh.field_data}
        fitted = meshio.Mesh(
            mesh.points[:, :2] if self.planar else mesh.points,
            cells,
            point_data=point_data,
            cell_data=cell_data,
            field_data=dict(mesh.field_data),
            cell_sets={n: [s[i] for i in kept] for n, s in mesh.cell_sets.items() if n not in gone}
            if self.cell_sets and not self.set_arrays
            else None,
            point_sets=mesh.point_sets if self.point_sets and not self.set_arrays else None,
            info=mesh.info,
        )
        # meshio's readers put attributes on a mesh that its type does not declare, such as the families of MED.
        vars(fitted).update({name: value for name, value in vars(mesh).items() if name not in vars(fitted)})
        if self.names_only:
            lost |= self._fit_names(mesh, fitted, kept)
        return fitted, lost

    def _with_its_groups(self, mesh: meshio.Mesh) -> tuple[meshio.Mesh, set[str]]:
        """The mesh with the families of MED as names of numbers or as sets, and names for those that are neither."""
        groups = {} if self.families else families(mesh)
        if not groups:
            return mesh, set()
        made = meshio.Mesh.copy(mesh)
        vars(made).update({name: value for name, value in vars(mesh).items() if name not in vars(made)})
        del made.cell_tags
        names: dict[str, np.ndarray] = {}
        tag = None
        if self.field_data:
            with_positive_numbers(made, FAMILY)
            tag = region_tag(made) if self.names_only else next(t for t in REGION_TAGS if t in made.cell_data)
            names = numbers_for(made, groups, tag)
            made.field_data = {**made.field_data, **names}
        rest = {name: masks for name, masks in groups.items() if name not in names}
        if self.cell_sets:
            made.cell_sets.update(as_sets(rest))
            rest = {}
        told = [0, *(number for number, own in mesh.cell_tags.items() if own)]
        told_by_names = not rest and bool(np.isin(np.concatenate(mesh.cell_data[FAMILY]), told).all())
        if told_by_names and self.cell_data != "all" and tag != FAMILY:
            del made.cell_data[FAMILY]  # its numbers say no more than the names, which are there
        return made, {f"group {name!r}" for name in rest}

    def _fit_names(self, mesh: meshio.Mesh, fitted: meshio.Mesh, kept: list[int]) -> set[str]:
        """Takes away field data that is no name of a group, and names whose cells are gone or not numbered any more."""
        before, after, lost = numbered(mesh), numbered(fitted), set()
        for name, value in mesh.field_data.items():
            was = before.get(name)
            now = after.get(name, [np.zeros(len(block.data), bool) for block in fitted.cells])
            whole = was is None or all(np.array_equal(was[i], mask) for i, mask in zip(kept, now, strict=True))
            gone = was is not None and not any(mask.any() for mask in now)
            if not is_group(value) or not whole or gone:
                del fitted.field_data[name]
                lost.add(f"field data {name!r}")
        return lost

    def _holds(self, kind: str) -> bool:
        """Can it hold cells of this type?"""
        return kind in self.cells or (_HIGHER.match(kind) is not None and "higher" in self.cells)

    def _in_its_types(self, mesh: meshio.Mesh) -> tuple[meshio.Mesh, set[str]]:
        """The mesh with cells of the second order by their corners, where the format does not have them."""
        cells, lost = [], set()
        for block in mesh.cells:
            kind, data = block.type, block.data
            if kind in _STRAIGHT and kind != "line3" and not self._holds(kind) and self._holds(_STRAIGHT[kind][0]):
                lost.add(f"mid-side nodes of {kind} cells")
            if kind in _STRAIGHT and not self._holds(kind) and self._holds(_STRAIGHT[kind][0]):
                kind, width = _STRAIGHT[kind]
                data = data[:, :width]
            cells.append(meshio.CellBlock(kind, data))
        if all(one.type == other.type for one, other in zip(cells, mesh.cells, strict=True)):
            return mesh, lost
        made = meshio.Mesh.copy(mesh)
        made.cells = cells
        vars(made).update({name: value for name, value in vars(mesh).items() if name not in vars(made)})
        return _without_middles(mesh, made), lost

    def _fit_cell_data(self, mesh: meshio.Mesh, kept: list[int], lost: set[str]) -> dict[str, list[np.ndarray]]:
        """The cell data of the blocks `kept`; adds to `lost`."""
        cell_data = {name: [values[i] for i in kept] for name, values in mesh.cell_data.items()}
        if self.cell_data == "all":
            return cell_data
        tag = region_tag(mesh) if self.cell_data == "regions" else None
        # Gmsh's number of an entity says nothing that a user has named: it goes without a word.
        lost |= {f"cell data {name!r}" for name in cell_data if name not in (tag, "gmsh:geometrical")}
        return {self.region_name: [v.astype(np.int64) for v in cell_data[tag]]} if tag else {}

    def _fit_point_data(self, mesh: meshio.Mesh, lost: set[str]) -> dict[str, np.ndarray]:
        """The point data that the format can hold; adds to `lost`."""

        def held(name: str, values: np.ndarray) -> bool:
            if self.point_data == "none":
                return name == self.region_name
            return self.point_data == "all" or np.ndim(values) == 1

        lost |= {f"point data {name!r}" for name, values in mesh.point_data.items() if not held(name, values)}
        return {name: values for name, values in mesh.point_data.items() if held(name, values)}


def _without_middles(mesh: meshio.Mesh, made: meshio.Mesh) -> meshio.Mesh:
    """`made` without those nodes of the cells of `mesh` that are in no cell of its own."""
    gone, row = np.zeros(len(mesh.points), bool), np.zeros(len(mesh.points), np.int64)
    for block in mesh.cells:
        gone[np.asarray(block.data)] = True
    for block in made.cells:
        gone[np.asarray(block.data)] = False
    row[~gone] = np.arange(int((~gone).sum()))
    made.points = made.points[~gone]
    made.point_data = {name: values[~gone] for name, values in made.point_data.items()}
    made.cells = [meshio.CellBlock(block.type, row[block.data]) for block in made.cells]
    sets = {name: np.asarray(rows, np.int64) for name, rows in made.point_sets.items()}
    made.point_sets = {name: row[rows[~gone[rows]]] for name, rows in sets.items()}
    return made
