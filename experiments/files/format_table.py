"""What each file format keeps: measured by writing, reading, improving and writing again; the README's table.

    python -m experiments.files.format_table

For every format and every feature a small mesh that has the feature is written as a file and read by `tm.read`.  A
vertex is moved, and `tm.write(..., like=file)` writes the mesh; then the feature is looked for in the result.
"""

import contextlib
import io
import sys
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path

import meshio
import numpy as np

import torchmesh as tm
from experiments.files.features import CELLS, FEATURES, Feature, plain
from experiments.shared import arguments, tables
from torchmesh.files.documents import load
from torchmesh.files.drafts import Draft
from torchmesh.files.formats.registry import FORMATS
from torchmesh.files.source import Source


def kept(form: str, feature: Feature, folder: Path) -> bool:
    """Whether the feature survives a file of the format, and another one written after it."""
    extension = FORMATS[form].extensions[0]
    first, second = folder / f"first{extension}", folder / f"second{extension}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            Draft.of(first, feature.make(form)).save()
            given = Source.open(first)
            if not feature.there(given.document, given.mesh):
                return False
        except tm.MeshError:
            return False
        tm.write(second, moved(given.mesh), like=first)
        found = Source.open(second)
        return feature.there(found.document, found.mesh)


def moved(mesh: tm.MeshBatch) -> tm.MeshBatch:
    """One vertex moves by a ninth of a cell, so that its coordinates are no short decimal fractions."""
    points = mesh.points.clone()
    points[CELLS + 2] += 1 / (9 * CELLS)
    return mesh.with_points(points)


def positions(form: str, folder: Path) -> str:
    """How exactly the coordinates come back."""
    path = folder / f"exact{FORMATS[form].extensions[0]}"
    points = np.random.default_rng(0).random((3, 3)) * (1, 1, 0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        Draft.of(path, meshio.Mesh(points, [("triangle", np.array([[0, 1, 2]]))])).save()
        found = tm.read(path).points.double().numpy()
    order = np.lexsort(found.T), np.lexsort(points[:, :2].T)  # STL has an order of its own
    error = np.abs(found[order[0]] - points[order[1], :2]).max()
    return "exact" if error == 0 else f"{int(-np.log10(error))} digits"


def modes(form: str, folder: Path) -> str:
    """Text or binary: "both" if `like` decides between them, "either" if the format has both and it does not."""
    if form not in ("vtu", "vtk", "gmsh", "ply", "stl"):
        binary = dict.fromkeys(("med", "exodus", "h5m", "hmf", "vtkhdf", "selafin", "cgns"), "binary")
        return {**binary, "vtp": "both"}.get(form, "text")
    for binary in (True, False):
        path = folder / f"mode{FORMATS[form].extensions[0]}"
        with contextlib.redirect_stderr(io.StringIO()):  # meshio warns of text formats
            meshio.write(path, plain(), file_format=form, binary=binary)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tm.write(path, moved(tm.read(path)), like=path)
            if load(path).binary is not binary:
                return "either"
    return "both"


def table() -> str:
    """The table, a row for each format."""
    titles = ["format", "extensions", "text, binary", "coordinates", *(feature.title for feature in FEATURES)]
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for form, spec in FORMATS.items():
            cells = [form, " ".join(spec.extensions), modes(form, folder), positions(form, folder)]
            rows.append([*cells, *("yes" if kept(form, feature, folder) else "" for feature in FEATURES)])
    return tables.table(titles, rows)


def main(argv: Sequence[str] | None = None) -> int:
    arguments.parse(arguments.parser(__doc__), argv)
    print(table())
    return 0


if __name__ == "__main__":
    sys.exit(main())
