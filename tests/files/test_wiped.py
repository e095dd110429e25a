"""`wiped`: what hangs on the rows of a file goes along when the file is cleaned."""

from pathlib import Path

import meshio
import numpy as np
import pytest

from torchmesh.errors import InvalidMeshError
from torchmesh.files.formats.format import Document
from torchmesh.files.wiped import wiped

POINTS = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5], [0.3, 0.7], [0, 0], [9, 9], [5, 5]])
TRIANGLES = np.array([[6, 1, 2], [0, 4, 5], [4, 2, 5], [2, 3, 5], [3, 0, 5], [3, 0, 5]])


def dirty(**more):
    mesh = meshio.Mesh(
        POINTS,
        [("line", np.array([[6, 1], [0, 6]])), ("triangle", TRIANGLES), ("vertex", np.array([[8]]))],
        point_data={"u": np.arange(9.0), "id": np.arange(9)},
        cell_data={"tag": [np.array([7, 8]), np.arange(6), np.array([9])]},
        cell_sets={"some": [np.array([0]), np.array([0, 4]), np.array([], int)]},
        point_sets={"ends": np.array([6, 7, 2])},
    )
    return Document(mesh, "vtk", **more)


def test_fields_sets_and_other_cells_go_along():
    mesh, log = wiped(dirty(), Path("x.vtk"))
    assert log.old_vertex.tolist() == [0, 1, 2, 3, 4, 5, 8], "vertex 8 has a cell of its own"
    assert (mesh.points == POINTS[log.old_vertex]).all()
    assert mesh.point_data["id"].tolist() == log.old_vertex.tolist()
    lines, triangles, vertex = mesh.cells
    assert lines.data.tolist() == [[0, 1]], "the other line has no length any more"
    assert vertex.data.tolist() == [[6]]
    assert len(triangles.data) == 6
    assert [values.tolist() for values in mesh.cell_data["tag"]] == [[7], [0, 0, 1, 2, 3, 4], [9]]
    assert mesh.cell_sets["some"][1].tolist() == [0, 1, 5], "both halves of triangle 0, and triangle 4"
    assert mesh.point_sets["ends"].tolist() == [0, 2]
    assert log.lines[-1] == "1 component of 6 triangles"


def test_a_format_that_lists_triangles_once_for_each_group_keeps_them():
    mesh, _ = wiped(dirty(repeats_triangles=True), Path("x.msh"))
    assert mesh.cell_data["tag"][1].tolist() == [0, 0, 1, 2, 3, 4, 5]
    assert mesh.cells[1].data[-1].tolist() == mesh.cells[1].data[-2].tolist()


def test_errors_name_the_file():
    document = dirty()
    document.mesh.points = np.where(np.arange(9)[:, None] == 2, np.nan, POINTS)
    with pytest.raises(InvalidMeshError, match=r"^x\.vtk: points row 2"):
        wiped(document, Path("x.vtk"))


def test_a_file_of_quads_alone_is_cleaned():
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [1, 0], [2, 0], [2, 1], [7.0, 7]])
    mesh, log = wiped(
        Document(meshio.Mesh(points, [("quad", np.array([[0, 1, 2, 3], [4, 5, 6, 2]]))]), "vtk"), Path("x")
    )
    assert len(mesh.points) == 6
    assert mesh.cells[0].data.tolist() == [[0, 1, 2, 3], [1, 4, 5, 2]]
    assert log.changed
