"""What a mesh file holds besides its triangles, and what of it binds them: regions, lines, quads."""

from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np

from ..errors import InvalidMeshError
from . import formats
from . import gmsh as formats_gmsh

_LINEAR = ("vertex", "line", "triangle", "quad", "polygon", "pixel")


_FLAT_HIGHER = ("line", "quad")  # line3, quad8, ...: kept as they are, with their vertices fixed


@dataclass
class Content:
    """A file's mesh taken apart.

    mesh       meshio's mesh, arrays native and polygons of three corners among the triangles
    rows       (R, 3) triangle rows of all blocks, in file order
    first      (T,) the row of each triangle; Gmsh lists one again for each of its groups
    triangle   (R,) the triangle of each row
    region     (T,) which triangles belong together
    walls      (K, 2) edges no flip may remove
    pinned     (V,) bool, vertices of cells that must not change shape
    elsewhere  (V,) bool, vertices of any cells that are not triangles
    """

    mesh: meshio.Mesh
    rows: np.ndarray
    first: np.ndarray
    triangle: np.ndarray
    region: np.ndarray
    walls: np.ndarray
    pinned: np.ndarray
    elsewhere: np.ndarray

    @classmethod
    def of(cls, document: formats.Document, path: Path) -> "Content":
        mesh = _native(document.mesh)
        _check_cells(mesh, path)
        rows = np.concatenate([b.data for b in mesh.cells if b.type == "triangle"]).astype(np.int64)
        count = len(mesh.points)
        for block in mesh.cells:
            outside = ((block.data < 0) | (block.data >= count)).any(1)
            if outside.any():
                row = int(outside.argmax())
                raise InvalidMeshError(
                    f"{path}: {block.type} cells row {row} is {block.data[row].tolist()}: "
                    f"rows of points run from 0 to {count - 1}"
                )
        first = triangle = np.arange(len(rows))
        if isinstance(document.rest, formats_gmsh.MshFile) and document.rest.version == "2.2":
            _, first, triangle = np.unique(np.sort(rows, 1), axis=0, return_index=True, return_inverse=True)
            order = first.argsort()
            first, triangle = first[order], order.argsort()[triangle.reshape(-1)]
        region = _regions(mesh, triangle, len(first))
        walls, pinned, elsewhere = _walls(mesh, rows[first], region)
        return cls(mesh, rows, first, triangle, region, walls, pinned, elsewhere)

    @property
    def seams(self) -> np.ndarray:
        """(V,) bool: the vertex lies between lines that differ in a region tag or a set."""
        lines = [i for i, block in enumerate(self.mesh.cells) if block.type == "line" and len(block.data)]
        low, high = np.full(len(self.mesh.points), np.inf), np.full(len(self.mesh.points), -np.inf)
        seams = np.zeros(len(self.mesh.points), bool)
        columns = [[data[i] for i in lines] for n, data in self.mesh.cell_data.items() if n in formats.REGION_TAGS]
        for members in self.mesh.cell_sets.values():
            columns.append([np.isin(np.arange(len(self.mesh.cells[i].data)), members[i]) for i in lines])
        for column in columns if lines else []:
            low[:], high[:] = np.inf, -np.inf
            for i, values in zip(lines, column, strict=True):
                for end in self.mesh.cells[i].data.T:
                    np.minimum.at(low, end, values.reshape(-1))
                    np.maximum.at(high, end, values.reshape(-1))
            seams |= low < high
        return seams

    @property
    def fixed(self) -> np.ndarray | None:
        """(V,) bool from the point data of that name, None without it."""
        marks = self.mesh.point_data.get("fixed")
        return None if marks is None else (marks.reshape(len(marks), -1) != 0).any(1)


def _native(mesh: meshio.Mesh) -> meshio.Mesh:
    """The mesh in the machine's byte order, one-component fields flat, three-cornered polygons called triangles."""

    def native(array: np.ndarray) -> np.ndarray:
        return np.array(array, array.dtype.newbyteorder("="))

    mesh = meshio.Mesh.copy(mesh)
    mesh.points = native(mesh.points)
    for i, block in enumerate(mesh.cells):
        three = block.type == "polygon" and block.data.shape[1] == 3
        if block.data.ndim == 2 and block.data.dtype.kind in "iu":
            mesh.cells[i] = meshio.CellBlock("triangle" if three else block.type, native(block.data).astype(np.int64))

    def column(array: np.ndarray) -> np.ndarray:
        """Fields of one component have one dimension, however the file says it."""
        return native(array[:, 0] if array.ndim == 2 and array.shape[1] == 1 else array)

    mesh.point_data = {name: column(values) for name, values in mesh.point_data.items()}
    mesh.cell_data = {name: [column(v) for v in values] for name, values in mesh.cell_data.items()}
    mesh.cell_sets.pop("gmsh:bounding_entities", None)
    for name, members in mesh.cell_sets.items():
        members = [*members, *[None] * (len(mesh.cells) - len(members))]
        mesh.cell_sets[name] = [
            np.zeros(0, np.int64) if m is None else np.array(m, np.int64).reshape(-1) for m in members
        ]
    return mesh


def _check_cells(mesh: meshio.Mesh, path: Path) -> None:
    kinds = {block.type for block in mesh.cells if len(block.data)}
    for kind in sorted(kinds):
        if kind.startswith("triangle") and kind != "triangle":
            raise InvalidMeshError(f"{path}: it has second-order triangles ({kind}); convert it to linear ones first")
        if kind not in _LINEAR and kind.rstrip("0123456789") not in _FLAT_HIGHER:
            raise InvalidMeshError(
                f"{path}: it has {kind} cells; only planar meshes of linear triangles can be improved"
            )
    if "triangle" not in kinds:
        found = f"it has {' and '.join(sorted(kinds))} cells only" if kinds else "it has no cells"
        raise InvalidMeshError(f"{path}: no triangles: {found}")


def _regions(mesh: meshio.Mesh, triangle: np.ndarray, count: int) -> np.ndarray:
    """(count,) which triangles agree in all region tags and cell sets (of all their rows)."""
    columns = [on_triangles(mesh, mesh.cell_data[name]) for name in region_names(mesh)]
    for members in mesh.cell_sets.values():
        flags = [np.isin(np.arange(len(b.data)), m) for b, m in zip(mesh.cells, members, strict=True)]
        columns.append(on_triangles(mesh, flags))
    code = np.zeros(len(triangle), np.int64)
    for column in columns:
        values, place = np.unique(column, return_inverse=True)
        code = np.unique(code * len(values) + place.reshape(-1), return_inverse=True)[1].reshape(-1)
    if len(triangle) == count:
        return code
    # The rows of one triangle come in any order: a sum of random words names their set.
    words = np.random.default_rng(0).integers(1 << 62, size=int(code.max()) + 1, dtype=np.uint64)
    total = np.zeros(count, np.uint64)
    np.add.at(total, triangle, words[code])
    return np.unique(total, return_inverse=True)[1].reshape(-1)


def on_triangles(mesh: meshio.Mesh, values: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([v for b, v in zip(mesh.cells, values, strict=True) if b.type == "triangle"])


def region_names(mesh: meshio.Mesh) -> list[str]:
    """The cell data that tells regions; `read` states the rule."""
    names = []
    for name, blocks in mesh.cell_data.items():
        values = on_triangles(mesh, blocks)
        if values.dtype.kind in "iub" and values.ndim == 1:
            known = name in formats.REGION_TAGS
            if known or 2 * len(np.unique(values)) <= len(values):
                names.append(name)
    return names


def _walls(mesh: meshio.Mesh, faces: np.ndarray, region: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The edges to keep (K, 2), the vertices to keep in place (V,), the vertices of other cells (V,)."""
    count = len(mesh.points)
    ends = np.sort(np.stack([faces, np.roll(faces, -1, 1)], 2).reshape(-1, 2), 1)
    keys = ends[:, 0] * count + ends[:, 1]
    order = keys.argsort(kind="stable")
    side = np.repeat(region, 3)[order]
    parts = (keys[order][1:] == keys[order][:-1]) & (side[1:] != side[:-1])
    walls = [ends[order[1:][parts]]]
    pinned, elsewhere = np.zeros(count, bool), np.zeros(count, bool)
    for block in mesh.cells:
        if block.type == "triangle" or not len(block.data):
            continue
        elsewhere[block.data] = True
        if block.type == "line":
            pair = np.sort(block.data, 1)
            edge = np.isin(pair[:, 0] * count + pair[:, 1], keys)
            walls.append(pair[edge])
            pinned[pair[~edge]] = True
        elif block.type != "vertex":
            pinned[block.data] = True
    points = [b.data.reshape(-1) for b in mesh.cells if b.type == "vertex"]
    if points and not np.isin(faces, np.concatenate(points)).all():
        pinned[np.concatenate(points)] = True
    return np.unique(np.concatenate(walls), axis=0), pinned, elsewhere
