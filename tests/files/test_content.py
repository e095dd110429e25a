"""Lines and vertex cells of a file bind its triangles, and quads are elements beside them."""

import meshio
import numpy as np
import pytest
from file_contents import flipped, grid_arrays, load, moved, save

from torchmesh.errors import MeshWarning
from torchmesh.files.mesh_files import read, write


def test_line_cells_inside_the_mesh_are_constrained_edges(tmp_path):
    points, faces = grid_arrays()
    lines = np.array([[6, 7], [0, 1], [8, 16]])  # an inner edge, a boundary edge, a bar across edges
    curve = np.array([[11, 17, 12]])  # of second order
    source = save(tmp_path / "a.vtu", meshio.Mesh(points, [("line", lines), ("line3", curve), ("triangle", faces)]))
    mesh = read(source)
    assert mesh.constrained_edges.tolist() == [[6, 7]]
    assert mesh.fixed.sum() == 16 + 5  # the boundary and 8, 16, 11, 17, 12
    assert not mesh.fixed[[6, 7, 13, 18]].any()
    write(tmp_path / "out.vtu", mesh, like=source)
    assert load(tmp_path / "out.vtu").point_data == {}
    np.testing.assert_array_equal(load(tmp_path / "out.vtu").cells_dict["line3"], curve)


def test_vertex_cells_are_fixed_unless_all_vertices_have_one(tmp_path):
    points, faces = grid_arrays()
    some = meshio.Mesh(points, [("vertex", np.array([[12]])), ("triangle", faces)])
    assert read(save(tmp_path / "a.vtu", some)).fixed[12]
    every = meshio.Mesh(points, [("vertex", np.arange(25)[:, None]), ("triangle", faces)])
    assert not read(save(tmp_path / "a.vtu", every)).fixed[12]


def test_quads_are_elements_and_stay_in_their_rows(tmp_path):
    points, faces = grid_arrays()
    more = np.concatenate([points, [[0, -1, 0], [1 / 3, -1, 0], [5, 5, 0]]])
    quad = np.array([[25, 26, 1, 0]])
    mixed = meshio.Mesh(
        more[:27], [("quad", quad), ("triangle", faces)], cell_data={"material": [[9], np.zeros(32, int)]}
    )
    source = save(tmp_path / "in.vtu", mixed)
    mesh = read(source)  # no warning: 25 and 26 belong to the quad
    assert len(mesh.points) == 27
    assert mesh.quads.tolist() == quad.tolist()
    assert mesh.fixed[[0, 25, 26]].all()
    write(tmp_path / "out.vtu", moved(flipped(mesh)), like=source)
    after = load(tmp_path / "out.vtu")
    np.testing.assert_array_equal(after.cells_dict["quad"], quad)
    np.testing.assert_array_equal(after.points[:, :2], moved(mesh).points.numpy())
    save(tmp_path / "loose.vtu", meshio.Mesh(more, [("quad", quad), ("triangle", faces)]))
    with pytest.warns(MeshWarning, match="1 vertices belong to no cell"):
        read(tmp_path / "loose.vtu")
