"""Arrays of which no mesh can be made, and what is made of them; a mesh that needs no wipe comes back as it is."""

import meshes
import numpy as np
import pytest
import torch
from exact import boundary, directed_edges, double_area

from experiments.robustness.attack import cracks
from torchmesh import InvalidMeshError, MeshBatch, clean

SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.4, 0.5]])
FAN = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])


def areas(points, triangles):
    return [double_area(*points[row, :2]) for row in triangles.tolist()]


def test_nothing_is_done_to_a_sound_mesh():
    mesh = meshes.delaunay()
    points, triangles, quads, log = clean(mesh.points, mesh.triangles)
    assert torch.equal(points, mesh.points)
    assert torch.equal(triangles, mesh.triangles)
    assert quads is None
    assert not log.changed
    assert log.lines[0] == "nothing to mend"
    assert log.old_vertex.tolist() == list(range(len(mesh.points)))
    assert log.old_triangle.tolist() == list(range(len(mesh.triangles)))


def test_a_soup_of_triangles_becomes_one_mesh():
    given, faces = meshes.grid_arrays(5, 4)
    soup = given[faces].reshape(-1, 2)
    points, triangles, _, log = clean(soup, np.arange(len(soup)).reshape(-1, 3))
    assert len(points) == len(given)
    assert (points[triangles] == given[faces]).all()
    assert max(directed_edges(triangles).values()) == 1
    assert len(boundary(triangles)) == 2 * (5 + 4)
    assert str(log).endswith(f"1 component of {len(faces)} triangles")


def test_the_tolerance_is_a_length():
    given, faces = meshes.grid_arrays(3, 3)
    rng = np.random.default_rng(0)
    soup = given[faces].reshape(-1, 2) + rng.uniform(-1e-5, 1e-5, (3 * len(faces), 2))
    rows = np.arange(len(soup)).reshape(-1, 3)
    assert len(clean(soup, rows)[0]) == len(soup)
    points, triangles, _, _ = clean(soup, rows, tolerance=1e-4)
    assert len(points) == len(given)
    assert len(triangles) == len(faces)


@pytest.mark.parametrize("bad", [-1.0, float("nan"), float("inf")])
def test_a_tolerance_that_is_no_length_is_refused(bad):
    with pytest.raises(InvalidMeshError, match="tolerance"):
        clean(SQUARE, FAN, tolerance=bad)


def test_triangles_that_are_there_twice_or_have_a_corner_twice_go():
    faces = np.concatenate([FAN, [[4, 3, 0], [3, 3, 4], [2, 4, 1]]])
    points, triangles, _, log = clean(SQUARE, faces)
    assert triangles.tolist() == FAN.tolist()
    assert (points == SQUARE).all()
    assert "2 triangles that were there twice were removed" in log.lines
    assert "1 triangle with a corner twice was removed" in log.lines
    assert log.old_triangle.tolist() == [0, 1, 2, 3]


def test_unused_vertices_are_dropped_whatever_they_are():
    given = np.concatenate([[[np.nan, 0]], SQUARE, [[7, 7], [np.inf, 1e300]]])
    points, triangles, _, log = clean(given, FAN + 1)
    assert (points == SQUARE).all()
    assert triangles.tolist() == FAN.tolist()
    assert log.new_vertex.tolist() == [-1, 0, 1, 2, 3, 4, -1, -1]
    with pytest.raises(InvalidMeshError, match=r"points row 0 .*finite"):
        clean(given, FAN)


def test_a_slit_stays_open_unless_it_is_to_be_sewn():
    given, faces = cracks.two_lips(np.random.default_rng(0), flips=0)
    points, triangles, _, log = clean(given, faces)
    assert (points == given).all()
    assert triangles.tolist() == faces.tolist()
    assert any("slit" in line for line in log)
    points, triangles, _, log = clean(given, faces, sew=True)
    assert len(points) == len(given) - 2
    assert (points[triangles] == given[faces]).all()
    assert len(boundary(triangles)) == len(boundary(faces)) - 4


def test_blocks_with_an_interface_of_their_own_each_become_one_mesh():
    given, faces = meshes.grid_arrays(4, 4)
    both = np.concatenate([given, given + np.array([1, 0])])
    points, triangles, _, _ = clean(both, np.concatenate([faces, faces + len(given)]))
    assert len(points) == 2 * len(given) - 5
    assert len(boundary(triangles)) == 4 * 4 + 2 * 4
    assert min(areas(points, triangles)) > 0


@pytest.mark.parametrize("push", [0.0, 1e-8])
def test_a_hanging_vertex_divides_its_neighbour(push):
    # Vertex 4 is the middle of the side 0 - 2 of one triangle, up to rounding.
    given = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5 + push], [0.3, 0.7]])
    faces = np.array([[0, 1, 2], [0, 4, 5], [4, 2, 5], [2, 3, 5], [3, 0, 5]])
    points, triangles, _, log = clean(given, faces)
    assert (points == given).all()
    assert len(triangles) == 6
    assert log.old_triangle.tolist() == [0, 0, 1, 2, 3, 4]
    assert sum(areas(points, triangles)) == 2
    assert min(areas(points, triangles)) > 0
    assert boundary(triangles) == {(0, 1), (1, 2), (2, 3), (3, 0)}
    assert MeshBatch.from_arrays(points, triangles).fixed.tolist() == [True] * 4 + [False] * 2


def test_hanging_vertices_of_a_refined_half():
    """Cells of one against two, in a mesh that is joined round both ends of the seam."""
    coarse, faces = meshes.grid_arrays(2, 1)
    fine, more = meshes.grid_arrays(8, 3)
    both = np.concatenate([coarse, fine + np.array([0, 1])])
    points, triangles, _, _ = clean(both, np.concatenate([faces, more + len(coarse)]))
    assert max(directed_edges(triangles).values()) == 1
    assert len(boundary(triangles)) == 2 + 2 + 8 + 6
    assert sum(areas(points, triangles)) == 4
    assert min(areas(points, triangles)) > 0


def test_a_vertex_that_hangs_in_the_side_of_a_quad_divides_it():
    given = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1], [1, 0.5]])
    points, triangles, quads, log = clean(given, [[1, 4, 6], [4, 5, 6], [6, 5, 2]], [[0, 1, 2, 3]])
    assert quads.shape == (0, 4)
    assert len(triangles) == 6
    assert log.old_triangle.tolist() == [0, 1, 2, 3, 3, 3]
    assert sum(areas(points, triangles)) == 4
    assert min(areas(points, triangles)) > 0
    assert max(directed_edges(triangles).values()) == 1


def test_quads_with_corners_twice():
    given = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    _, triangles, quads, log = clean(given, np.zeros((0, 3), int), [[0, 1, 2, 3], [2, 0, 0, 1], [0, 1, 0, 1]])
    assert quads.tolist() == [[0, 1, 2, 3]]
    assert len(triangles) == 1
    assert log.old_triangle.tolist() == [1]


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_winding_is_made_consistent(share, rng):
    given, faces = meshes.grid_arrays(6, 5)
    turned = rng.random(len(faces)) < share
    mixed = np.where(turned[:, None], faces[:, ::-1], faces)
    points, triangles, _, log = clean(given, mixed)
    assert min(areas(points, triangles)) > 0
    assert max(directed_edges(triangles).values()) == 1
    assert log.changed == bool(turned.any())


def test_flat_triangles_on_the_boundary_go():
    given = np.array([[0, 0], [2, 0], [2, 2], [0, 2], [1, 0], [1, 1]])
    faces = [[0, 1, 4], [0, 4, 5], [4, 1, 5], [1, 2, 5], [2, 3, 5], [3, 0, 5]]
    _, triangles, _, log = clean(given, faces)
    assert triangles.tolist() == faces[1:]
    assert "1 flat triangle on the boundary was removed" in log.lines


def test_sheets_that_lie_over_each_other_stay_apart():
    given, faces = meshes.grid_arrays(3, 3)
    both = np.concatenate([given, given])
    # The other sheet is a cell with the other diagonal, so that no triangle is there twice.
    a, b, c, d = np.array([0, 1, 5, 4]) + len(given)
    rows = np.concatenate([faces, [[a, b, d], [b, c, d]]])
    points, triangles, _, log = clean(both, rows)
    MeshBatch.from_arrays(points, triangles)
    assert any("lie over each other" in line for line in log)


def test_components_are_listed():
    given, faces = meshes.grid_arrays(2, 2)
    rows = np.concatenate([faces[:1], faces + len(given)])
    *_, log = clean(np.concatenate([given, given + 10]), rows)
    assert log.lines[-1] == "2 components of 8, 1 triangles"


def test_arrays_come_back_as_they_were_given(rng):
    given, faces = meshes.grid_arrays(2, 2)
    points, triangles, _, _ = clean(given.astype(np.float32), faces.astype(np.int32))
    assert (points.dtype, triangles.dtype) == (np.float32, np.int64)
    points, triangles, _, _ = clean(torch.from_numpy(given), torch.from_numpy(faces))
    assert isinstance(points, torch.Tensor)
    assert isinstance(triangles, torch.Tensor)
    space = given @ np.linalg.qr(rng.normal(size=(3, 3)))[0][:2]
    points, triangles, _, log = clean(space.tolist(), faces.tolist())
    assert (points == space).all()
    assert not log.changed


def test_errors_of_from_arrays_name_the_command():
    for faces in (np.concatenate([FAN, FAN[:1]]), np.concatenate([FAN, [[3, 3, 4]]])):
        with pytest.raises(InvalidMeshError, match="torchmesh clean IN OUT"):
            MeshBatch.from_arrays(SQUARE, faces)
