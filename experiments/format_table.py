"""What each file format keeps: measured by writing, reading, improving and writing again; the README's table.

    python experiments/format_table.py

For every format and every feature a small mesh that has the feature is written as a file, read by `tm.read`, a
vertex moved, and written by `tm.write(..., like=file)`; then it is looked for in the result.
"""

import contextlib
import io
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np

import torchmesh as tm
from torchmesh.files import formats
from torchmesh.files.formats import FORMATS

CELLS = 4  # of the square's side; one of them a quad, a pentagon or nothing where such are asked for


def square(corner: int = 0) -> tuple[np.ndarray, list[tuple[str, np.ndarray]], np.ndarray]:
    """Vertices (V, 3), cells, and for each triangle whether it lies on the right: a square of triangles.

    corner  4: the first cell is a quad; 5: the first cell and its neighbour's lower half are a pentagon
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
    points, cells, _ = square(corner)
    return meshio.Mesh(points, cells, **fields)


def of_kind(mesh: meshio.Mesh, kind: str) -> int:
    return sum(len(block.data) for block in mesh.cells if block.type == kind)


@dataclass(frozen=True)
class Feature:
    """A column of the table: how to make it for a format, and how to see that it is there."""

    title: str
    make: Callable[[str], meshio.Mesh]
    there: Callable[[formats.Document, tm.MeshBatch], bool]


def with_lines(_: str) -> meshio.Mesh:
    points, cells, _right = square()
    return meshio.Mesh(points, [*cells, ("line", np.array([[0, 1], [1, 2]]))])


def with_regions(form: str) -> meshio.Mesh:
    points, cells, right = square()
    name = formats._CANONICAL.get(form, "cell_tags" if form == "med" else "gmsh:physical")
    return meshio.Mesh(points, cells, cell_data={name: [1 + right.astype(np.int64)]})


def with_names(form: str) -> meshio.Mesh:
    """A part of the boundary called `wall`, in the way of the format."""
    points, cells, _ = square()
    cells = [*cells, ("line", np.array([[0, 1], [1, 2]]))]
    if form == "med":
        mesh = meshio.Mesh(points, cells, cell_data={"cell_tags": [np.zeros(len(cells[0][1]), int), np.full(2, -7)]})
        mesh.cell_tags, mesh.point_tags = {-7: ["wall"]}, {}
        return mesh
    if form == "abaqus":
        return meshio.Mesh(points, cells, cell_sets={"wall": [np.zeros(0, int), np.arange(2)]})
    if form == "exodus":
        return meshio.Mesh(points, cells[:1], point_sets={"wall": np.arange(3)})
    name = "su2:tag" if form == "su2" else "gmsh:physical"
    data = {name: [np.full(len(cells[0][1]), 5 if form == "gmsh" else 0), np.full(2, 7)]}
    groups = {"wall": np.array([7, 1])} | ({"air": np.array([5, 2])} if form == "gmsh" else {})
    return meshio.Mesh(points, cells, cell_data=data, field_data=groups)


def has_names(document: formats.Document, _: tm.MeshBatch) -> bool:
    mesh = document.mesh
    if document.format == "med":
        return ["wall"] in list(getattr(mesh, "cell_tags", {}).values())
    sets = [name.lower() for name in (*mesh.cell_sets, *mesh.point_sets)]
    groups = {name for name, value in mesh.field_data.items() if np.shape(value) == (2,)}
    return ("wall" in groups and document.format in ("gmsh", "su2")) or "wall" in sets


def field(kind: str, values: np.ndarray) -> Callable[[str], meshio.Mesh]:
    return lambda _: plain(**{kind: {"u": [values] if kind == "cell_data" else values}})


def has(kind: str, shape: tuple[int, ...]) -> Callable[[formats.Document, tm.MeshBatch], bool]:
    def there(document: formats.Document, _: tm.MeshBatch) -> bool:
        value = getattr(document.mesh, kind).get("u")
        value = value[0] if kind == "cell_data" and value else value
        return value is not None and np.shape(value)[1:] == shape

    return there


POINTS, TRIANGLES = (CELLS + 1) ** 2, 2 * CELLS**2
FEATURES = [
    Feature("lines", with_lines, lambda document, _: of_kind(document.mesh, "line") == 2),
    Feature("quads", lambda _: plain(4), lambda document, _: of_kind(document.mesh, "quad") == 1),
    Feature("polygons", lambda _: plain(5), lambda document, _: of_kind(document.mesh, "polygon") == 1),
    Feature("regions", with_regions, lambda _, mesh: len(mesh.constrained_edges) == CELLS),
    Feature("names", with_names, has_names),
    Feature("point data", field("point_data", np.arange(POINTS) / 7), has("point_data", ())),
    Feature("vectors", field("point_data", np.arange(3.0 * POINTS).reshape(-1, 3) / 7), has("point_data", (3,))),
    Feature("cell data", field("cell_data", np.arange(TRIANGLES) / 7), has("cell_data", ())),
]  # fmt: skip


def kept(form: str, feature: Feature, folder: Path) -> bool:
    """Does the feature come through a file of the format, twice?"""
    extension = FORMATS[form].extensions[0]
    first, second = folder / f"first{extension}", folder / f"second{extension}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            formats.save(first, feature.make(form), None, False)
            if not feature.there(formats.load(first), tm.read(first)):
                return False
        except tm.MeshError:
            return False
        tm.write(second, moved(tm.read(first)), like=first)
        return feature.there(formats.load(second), tm.read(second))


def moved(mesh: tm.MeshBatch) -> tm.MeshBatch:
    """One vertex by a third of a cell, so that its coordinates are no short decimal fractions."""
    points = mesh.points.clone()
    points[CELLS + 2] += 1 / (9 * CELLS)
    return mesh.with_points(points)


def positions(form: str, folder: Path) -> str:
    """How exactly coordinates come back."""
    path = folder / f"exact{FORMATS[form].extensions[0]}"
    points = np.random.default_rng(0).random((3, 3)) * (1, 1, 0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        formats.save(path, meshio.Mesh(points, [("triangle", np.array([[0, 1, 2]]))]), None, False)
        found = tm.read(path).points.double().numpy()
    order = np.lexsort(found.T), np.lexsort(points[:, :2].T)  # STL has its own order
    error = np.abs(found[order[0]] - points[order[1], :2]).max()
    return "exact" if error == 0 else f"{int(-np.log10(error))} digits"


def modes(form: str, folder: Path) -> str:
    """Text or binary, and whether `like` decides where there are both."""
    if form not in ("vtu", "vtk", "gmsh", "ply", "stl"):
        return {"med": "binary", "exodus": "binary", "h5m": "binary", "hmf": "binary"}.get(form, "text")
    for binary in (True, False):
        path = folder / f"mode{FORMATS[form].extensions[0]}"
        mesh, name = plain(), {"gmsh": "gmsh", "vtk": "vtk"}.get(form, form)
        with contextlib.redirect_stderr(io.StringIO()):  # meshio warns of text formats
            meshio.write(path, mesh, file_format=name, binary=binary)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tm.write(path, moved(tm.read(path)), like=path)
            if formats.load(path).binary is not binary:
                return "either"
    return "both"


def table() -> list[str]:
    """The lines of the table, a row for each format."""
    titles = ["format", "extensions", "text, binary", "coordinates", *(feature.title for feature in FEATURES)]
    lines = ["| " + " | ".join(titles) + " |", "|" + "---|" * len(titles)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for form, spec in FORMATS.items():
            cells = [form, " ".join(spec.extensions), modes(form, folder), positions(form, folder)]
            cells += ["yes" if kept(form, feature, folder) else "" for feature in FEATURES]
            lines.append("| " + " | ".join(cells) + " |")
    return lines


if __name__ == "__main__":
    print("\n".join(table()))
