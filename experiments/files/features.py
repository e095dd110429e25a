"""The features that format_table.py looks for, each with a small mesh that has it: a square of triangles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import meshio
import numpy as np

import torchmesh as tm
from torchmesh.files.formats.format import Document
from torchmesh.files.formats.groups import families, numbered
from torchmesh.files.formats.registry import FORMATS

CELLS = 4  # along the square's side


def square(corner: int = 0) -> tuple[np.ndarray, list[tuple[str, np.ndarray]], np.ndarray]:
    """A square of triangles: vertices (V, 3), cells, and for each triangle whether it lies on the right.

    corner  4: the first cell is a quad; 5: the first cell and the lower half of its neighbour are a pentagon
    """
    side = CELLS + 1
    x, y = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    at = (np.arange(CELLS)[:, None] * side + np.arange(CELLS)).ravel()
    lower = np.column_stack([at, at + 1, at + side + 1])
    upper = np.column_stack([at, at + side + 1, at + side])
    triangles = np.stack([lower, upper], 1).reshape(-1, 3)
    cells = []
    if corner == 4:
        cells, triangles = [("quad", np.array([[0, 1, side + 1, side]]))], triangles[2:]
    if corner == 5:
        cells, triangles = (
            [("polygon", np.array([[0, 1, 2, side + 2, side + 1]]))],
            triangles[[1, *range(4, len(triangles))]],
        )
    right = points[triangles].mean(1)[:, 0] > 0.5
    return points, [("triangle", triangles), *cells], right


def plain(corner: int = 0, **fields: dict) -> meshio.Mesh:
    """The square with these fields."""
    points, cells, _ = square(corner)
    return meshio.Mesh(points, cells, **fields)


def of_kind(mesh: meshio.Mesh, kind: str) -> int:
    return sum(len(block.data) for block in mesh.cells if block.type == kind)


@dataclass(frozen=True)
class Feature:
    """A column of the table.

    make   gives a mesh with the feature, for the format of that name
    there  says whether a file that was read, as meshio's mesh and as ours, has it
    """

    title: str
    make: Callable[[str], meshio.Mesh]
    there: Callable[[Document, tm.MeshBatch], bool]


def with_lines(_: str) -> meshio.Mesh:
    points, cells, _right = square()
    return meshio.Mesh(points, [*cells, ("line", np.array([[0, 1], [1, 2]]))])


def with_six_nodes(_: str) -> meshio.Mesh:
    points, cells, _right = square()
    triangles = cells[0][1]
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), 1)
    edges, node = np.unique(sides, axis=0, return_inverse=True)
    nodes = len(points) + node.reshape(-1, 3)
    return meshio.Mesh(
        np.concatenate([points, points[edges].mean(1)]), [("triangle6", np.concatenate([triangles, nodes], 1))]
    )


def with_regions(form: str) -> meshio.Mesh:
    points, cells, right = square()
    name = FORMATS[form].region_name or ("cell_tags" if form == "med" else "gmsh:physical")
    return meshio.Mesh(points, cells, cell_data={name: [1 + right.astype(np.int64)]})


def with_names(form: str) -> meshio.Mesh:
    """A mesh with a part of its boundary named `wall`, as the format does that."""
    points, cells, _ = square()
    cells = [*cells, ("line", np.array([[0, 1], [1, 2]]))]
    if form == "med":
        mesh = meshio.Mesh(points, cells, cell_data={"cell_tags": [np.zeros(len(cells[0][1]), int), np.full(2, -7)]})
        mesh.cell_tags, mesh.point_tags = {-7: ["wall"]}, {}
        return mesh
    if form in ("abaqus", "unv", "cgns"):
        return meshio.Mesh(points, cells, cell_sets={"wall": [np.zeros(0, int), np.arange(2)]})
    if form == "exodus":
        return meshio.Mesh(points, cells[:1], point_sets={"wall": np.arange(3)})
    name = "su2:tag" if form == "su2" else "gmsh:physical"
    data = {name: [np.full(len(cells[0][1]), 5 if form == "gmsh" else 0), np.full(2, 7)]}
    groups = {"wall": np.array([7, 1])} | ({"air": np.array([5, 2])} if form == "gmsh" else {})
    return meshio.Mesh(points, cells, cell_data=data, field_data=groups)


def has_names(document: Document, _: tm.MeshBatch) -> bool:
    mesh = document.mesh
    sets = [name.lower() for name in (*mesh.cell_sets, *mesh.point_sets)]
    return "wall" in {**numbered(mesh), **families(mesh)} or "wall" in sets


def field(kind: str, values: np.ndarray) -> Callable[[str], meshio.Mesh]:
    return lambda _: plain(**{kind: {"u": [values] if kind == "cell_data" else values}})


def has(kind: str, shape: tuple[int, ...]) -> Callable[[Document, tm.MeshBatch], bool]:
    def there(document: Document, _: tm.MeshBatch) -> bool:
        value = getattr(document.mesh, kind).get("u")
        value = value[0] if kind == "cell_data" and value else value
        return value is not None and np.shape(value)[1:] == shape

    return there


POINTS, TRIANGLES = (CELLS + 1) ** 2, 2 * CELLS**2
FEATURES = [
    Feature("lines", with_lines, lambda document, _: of_kind(document.mesh, "line") == 2),
    Feature("quads", lambda _: plain(4), lambda document, _: of_kind(document.mesh, "quad") == 1),
    Feature("polygons", lambda _: plain(5), lambda document, _: of_kind(document.mesh, "polygon") == 1),
    Feature("six nodes", with_six_nodes, lambda document, _: of_kind(document.mesh, "triangle6") == TRIANGLES),
    Feature("regions", with_regions, lambda _, mesh: len(mesh.constrained_edges) == CELLS),
    Feature("names", with_names, has_names),
    Feature("point data", field("point_data", np.arange(POINTS) / 7), has("point_data", ())),
    Feature("vectors", field("point_data", np.arange(3.0 * POINTS).reshape(-1, 3) / 7), has("point_data", (3,))),
    Feature("cell data", field("cell_data", np.arange(TRIANGLES) / 7), has("cell_data", ())),
]  # fmt: skip
