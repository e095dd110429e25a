"""The content of a mesh file, and what of it binds the triangles: regions, lines, quads."""

from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np

from ..errors import InvalidMeshError
from .curved_cells import Kinds, straightened
from .fields import REGION_TAGS, Regions, triangle_regions
from .formats.format import Document
from .quads import interfaces_of_quads, quads_of, regions_of_all, sides_of, tells_kinds_alone

# What polygons of so many corners are.
_POLYGONS = {3: "triangle", 4: "quad"}

_LINEAR = ("vertex", "line", "triangle", "quad", "polygon", "pixel")

# line4, ...: they stay as they are, and their vertices are fixed.
_HIGHER_ORDER = ("line",)


@dataclass
class Content:
    """A file's mesh taken apart.

    mesh         meshio's mesh: arrays in native byte order, polygons of three corners among the triangles; triangles
                 of six nodes, quads of eight and nine, and lines of three, are there by their corners
    kinds        what these cells are in the file
    middles      (R, 3) the mid-side nodes of the triangle rows, -1 for straight ones
    rows         (R, 3) triangle rows of all blocks, in file order
    first        (T,) the first row of each triangle; some files list a triangle once for each of its groups
    triangle     (R,) the triangle of each row
    quad_rows, quad_first, quad  likewise for quads: (S, 4), (Q,) and (S,)
    quad_middles (S, 5) the mid-side nodes of the quad rows, and their middles; -1 where there are none
    region       (T,) the number of the region that each triangle is in
    constrained  (K, 2) edges that no flip may remove
    pinned       (V,) bool, vertices of cells that must not change shape
    elsewhere    (V,) bool, vertices of any cells that are not triangles
    sides        named groups of edges (K, 2) to which the file refers as sides of elements
    told_by      what of the file tells the regions
    """

    mesh: meshio.Mesh
    kinds: Kinds
    middles: np.ndarray
    rows: np.ndarray
    first: np.ndarray
    triangle: np.ndarray
    region: np.ndarray
    constrained: np.ndarray
    pinned: np.ndarray
    elsewhere: np.ndarray
    sides: dict[str, np.ndarray]
    told_by: Regions
    quad_rows: np.ndarray
    quad_first: np.ndarray
    quad: np.ndarray
    quad_middles: np.ndarray

    @classmethod
    def of(cls, document: Document, path: Path, regions: str | None = None) -> "Content":
        """Raises InvalidMeshError, naming `path`, for cells that cannot be dealt with.

        regions  what tells the regions, as for `Regions.of`
        """
        mesh, kinds = checked(document.mesh, path)
        try:
            told_by = Regions.of(mesh, regions)
        except ValueError as error:
            raise InvalidMeshError(f"{path}: {error}") from None
        # The mesh that is written instead takes it over, as it does all attributes that meshio's type does not declare.
        mesh.told_by = told_by.data
        blocks = [b.data for b in mesh.cells if b.type == "triangle"]
        rows = np.concatenate([np.zeros((0, 3), np.int64), *blocks]).astype(np.int64)
        first = triangle = np.arange(len(rows))
        if document.repeats_triangles:
            first, triangle = merged_rows(rows)
        faces, middles = rows[first], kinds.of_triangles(mesh)
        region = triangle_regions(mesh, triangle, len(first), told_by)
        if kinds.curved and (middles < 0).any() and (middles >= 0).any():
            # No edge flips between straight and curved triangles: each keeps its kind.
            region = np.unique(2 * region + (middles[first, 0] >= 0), return_inverse=True)[1].reshape(-1)
        none = np.zeros((0, 2), np.int64)
        lines = np.concatenate([none, *(b.data for b in mesh.cells if b.type == "line" and len(b.data))])
        quad_rows, quad_first, quad = quads_of(mesh, document.repeats_triangles)
        quads = quad_rows[quad_first]
        edges = np.concatenate([_edges(faces), sides_of(quads)])
        on_edge = np.isin(_keys(lines, len(mesh.points)), _keys(edges, len(mesh.points)))
        sides = np.concatenate([none, *document.sides.values()])
        between = interfaces_of_quads(mesh, (faces, first), (quads, quad_first), told_by)
        kept = np.concatenate([_interfaces(faces, region), between, lines[on_edge], _shared(sides, edges)])
        constrained = np.unique(np.sort(kept, 1), axis=0)
        pinned, elsewhere = _pinned(mesh, np.concatenate([faces.reshape(-1), quads.reshape(-1)]), lines[~on_edge])
        of_quads = kinds.of_quads(mesh)
        for nodes in (middles, of_quads):
            elsewhere[nodes[nodes >= 0]] = True
        return cls(
            mesh, kinds, middles, rows, first, triangle, region, constrained, pinned, elsewhere, document.sides,
            told_by, quad_rows, quad_first, quad, of_quads,
        )  # fmt: skip

    @property
    def quads(self) -> np.ndarray:
        """(Q, 4) the quads, each once, in file order."""
        return self.quad_rows[self.quad_first]

    @property
    def curved_quads(self) -> np.ndarray:
        """(Q,) bool: the quad has mid-side nodes."""
        return np.asarray(self.quad_middles[self.quad_first, 0] >= 0)

    @property
    def region_count(self) -> int:
        """In how many regions the triangles and quads lie."""
        if not len(self.quads):
            return int(self.region.max(initial=0)) + 1
        return len(np.unique(regions_of_all(self.mesh, self.first, self.quad_first, self.told_by)))

    @property
    def kinds_alone(self) -> tuple[str, ...]:
        """The names of cell data that tells triangles from quads, and no more: no border of regions."""
        return tells_kinds_alone(self.mesh, self.first, self.quad_first, self.told_by)

    @property
    def bound_by_regions(self) -> str:
        """In words, the interfaces whose edges no flip may remove; empty where there are none."""
        if not self.region_count > 1:
            return ""
        return f"interfaces between regions by {self.told_by}"

    @property
    def bound_by_lines(self) -> bool:
        """Are there constrained edges that lie between no two regions: lines, or sides to which the file refers?"""
        faces = self.rows[self.first]
        count = len(self.mesh.points)
        of_quads = interfaces_of_quads(self.mesh, (faces, self.first), (self.quads, self.quad_first), self.told_by)
        between = _keys(np.concatenate([_interfaces(faces, self.region), of_quads]), count)
        return bool((~np.isin(_keys(self.constrained, count), between)).any())

    @property
    def seams(self) -> np.ndarray:
        """(V,) bool: the vertex lies between lines that differ in a region tag or a set, or ends named sides."""
        lines = [i for i, block in enumerate(self.mesh.cells) if block.type == "line" and len(block.data)]
        low, high = np.full(len(self.mesh.points), np.inf), np.full(len(self.mesh.points), -np.inf)
        seams = np.zeros(len(self.mesh.points), bool)
        columns = [[data[i] for i in lines] for n, data in self.mesh.cell_data.items() if n in REGION_TAGS]
        for members in self.mesh.cell_sets.values():
            columns.append([np.isin(np.arange(len(self.mesh.cells[i].data)), members[i]) for i in lines])
        for column in columns if lines else []:
            low[:], high[:] = np.inf, -np.inf
            for i, values in zip(lines, column, strict=True):
                for end in self.mesh.cells[i].data.T:
                    np.minimum.at(low, end, values.reshape(-1))
                    np.maximum.at(high, end, values.reshape(-1))
            seams |= low < high
        for edges in self.sides.values():
            seams |= np.bincount(edges.reshape(-1), minlength=len(seams)) == 1
        return seams

    @property
    def fixed(self) -> np.ndarray | None:
        """(V,) bool from the point data of that name; None if there is none."""
        marks = self.mesh.point_data.get("fixed")
        return None if marks is None else (marks.reshape(len(marks), -1) != 0).any(1)


def checked(mesh: meshio.Mesh, path: Path) -> tuple[meshio.Mesh, Kinds]:
    """A copy as of `_native`, with straight cells, and what these are in the file.

    Raises InvalidMeshError, naming `path`, for cells that cannot be dealt with.
    """
    mesh = _native(mesh)
    _check_rows(mesh, path)
    mesh, kinds = straightened(mesh)
    _check_types(mesh, path)
    return mesh, kinds


def _native(mesh: meshio.Mesh) -> meshio.Mesh:
    """A copy in the machine's byte order; fields of one component are flat, polygons triangles and quads."""

    def native(array: np.ndarray) -> np.ndarray:
        return np.array(array, array.dtype.newbyteorder("="))

    def column(array: np.ndarray) -> np.ndarray:
        return native(array[:, 0] if array.ndim == 2 and array.shape[1] == 1 else array)

    mesh = meshio.Mesh.copy(mesh)
    mesh.points = native(mesh.points)
    for i, block in enumerate(mesh.cells):
        if block.data.ndim == 2 and block.data.dtype.kind in "iu":
            kind = _POLYGONS.get(block.data.shape[1], "polygon") if block.type == "polygon" else block.type
            mesh.cells[i] = meshio.CellBlock(kind, native(block.data).astype(np.int64))
    mesh.point_data = {name: column(values) for name, values in mesh.point_data.items()}
    mesh.cell_data = {name: [column(v) for v in values] for name, values in mesh.cell_data.items()}
    mesh.cell_sets.pop("gmsh:bounding_entities", None)
    for name, members in mesh.cell_sets.items():
        members = [*members, *[None] * (len(mesh.cells) - len(members))]
        mesh.cell_sets[name] = [
            np.zeros(0, np.int64) if m is None else np.array(m, np.int64).reshape(-1) for m in members
        ]
    return mesh


def _check_types(mesh: meshio.Mesh, path: Path) -> None:
    types = {block.type for block in mesh.cells if len(block.data)}
    for name in sorted(types):
        if name != "triangle" and name.startswith("triangle"):
            raise InvalidMeshError(
                f"{path}: it has {name} cells; of curved triangles those of six nodes can be improved: convert it first"
            )
        if name.startswith("quad") and name != "quad":
            raise InvalidMeshError(
                f"{path}: it has {name} cells; of quads those of four, eight and nine nodes can be improved: save it "
                "with elements of first or second order (Gmsh: -order 2, MFEM: SetCurvature(2))"
            )
        if name not in _LINEAR and name.rstrip("0123456789") not in _HIGHER_ORDER:
            raise InvalidMeshError(
                f"{path}: it has {name} cells; only planar meshes of triangles and quads can be improved"
            )
    if "triangle" not in types and "quad" not in types:
        found = f"it has {' and '.join(sorted(types))} cells only" if types else "it has no cells"
        raise InvalidMeshError(f"{path}: no triangles: {found}")


def _check_rows(mesh: meshio.Mesh, path: Path) -> None:
    count = len(mesh.points)
    for block in mesh.cells:
        outside = ((block.data < 0) | (block.data >= count)).any(1)
        if outside.any():
            row = int(outside.argmax())
            raise InvalidMeshError(
                f"{path}: {block.type} cells row {row} is {block.data[row].tolist()}: "
                f"rows of points run from 0 to {count - 1}"
            )


def merged_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first row of each triangle (T,), and the triangle of each row (R,), of rows that repeat triangles."""
    _, first, triangle = np.unique(np.sort(rows, 1), axis=0, return_index=True, return_inverse=True)
    order = first.argsort()
    return first[order], order.argsort()[triangle.reshape(-1)]


def _edges(faces: np.ndarray) -> np.ndarray:
    """(3T, 2) the edges of each triangle, the lower vertex first."""
    return np.sort(np.stack([faces, np.roll(faces, -1, 1)], 2).reshape(-1, 2), 1)


def _keys(edges: np.ndarray, count: int) -> np.ndarray:
    """(K,) a number for each edge, the same for both directions; `count` is the number of vertices."""
    return edges.min(1) * count + edges.max(1)


def _interfaces(faces: np.ndarray, region: np.ndarray) -> np.ndarray:
    """(K, 2) the edges between triangles of different regions, the lower vertex first."""
    if not len(faces):
        return np.zeros((0, 2), np.int64)
    edges = _edges(faces)
    keys = _keys(edges, int(faces.max()) + 1)
    order = keys.argsort(kind="stable")
    side = np.repeat(region, 3)[order]
    differ = (keys[order][1:] == keys[order][:-1]) & (side[1:] != side[:-1])
    return edges[order[1:][differ]]


def _shared(edges: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """(K, 2) those of the edges that are among `sides` (N, 2) twice: they lie between two elements."""
    if not len(edges):
        return edges
    count = max(int(sides.max()), int(edges.max())) + 1
    keys, copies = np.unique(_keys(sides, count), return_counts=True)
    return edges[np.isin(_keys(edges, count), keys[copies > 1])]


def _pinned(mesh: meshio.Mesh, corners: np.ndarray, bars: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The vertices (V,) that must stay in place, and the vertices (V,) of cells that are not triangles or quads.

    corners  (N,) the corners of triangles and quads
    bars     (L, 2) lines that are no edges of these

    Vertex cells bind their vertices only if some corner has none: programs write one for every vertex.
    """
    pinned, elsewhere = np.zeros(len(mesh.points), bool), np.zeros(len(mesh.points), bool)
    pinned[bars] = True
    for block in mesh.cells:
        if block.type in ("triangle", "quad") or not len(block.data):
            continue
        elsewhere[block.data] = True
        if block.type not in ("line", "vertex"):
            pinned[block.data] = True
    points = [b.data.reshape(-1) for b in mesh.cells if b.type == "vertex"]
    if points and not np.isin(corners, np.concatenate(points)).all():
        pinned[np.concatenate(points)] = True
    return pinned, elsewhere
