"""Surfaces: improved in plan, with heights that belong to positions; what folds over is refused."""

import meshes
import meshio
import numpy as np
import pytest
import torch

import torchmesh as tm
from torchmesh.errors import InvalidMeshError
from torchmesh.files.source import Source


def save(path, points, triangles, **data):
    meshio.Mesh(points, [("triangle", np.asarray(triangles))], **data).write(path, file_format="vtu")
    return path


def bed(x, y):
    """A height that linear interpolation reproduces exactly."""
    return 3 * x - 2 * y + 7


def tangled_bed(path, height=bed):
    mesh = meshes.moved_hole()
    x, y = mesh.points.numpy().T
    return mesh, save(path, np.stack([x, y, height(x, y)], 1), mesh.triangles)


def test_terrain_is_improved_as_its_plan_is_and_z_is_read_where_vertices_are_now(tmp_path):
    # A linear z would be a tilted plane, so a ripple that is zero at the vertices that move is added at the corners.
    mesh, path = tangled_bed(tmp_path / "in.vtu", lambda x, y: bed(x, y) + 0.5 * (x == x.min()) * (y == y.min()))
    read = tm.read(path)
    assert torch.equal(read.points, mesh.points)
    better, _ = tm.improve(read)
    assert torch.equal(better.points, tm.improve(mesh)[0].points)
    tm.write(tmp_path / "out.vtu", better, like=path)
    out, before = meshio.read(tmp_path / "out.vtu").points, meshio.read(path).points
    x, y, z = out.T
    moved = (out[:, :2] != before[:, :2]).any(1)
    assert moved.any()
    assert (out[~moved] == before[~moved]).all()
    beside_the_corner = np.hypot(x - x.min(), y - y.min()) < 0.3
    np.testing.assert_allclose(z[~beside_the_corner], bed(x, y)[~beside_the_corner], rtol=0, atol=1e-13)


def test_heights_that_are_kept_ride_with_their_vertices(tmp_path):
    _, path = tangled_bed(tmp_path / "in.vtu", lambda x, y: np.sin(3 * x) * y)
    better, _ = tm.improve(tm.read(path))
    tm.write(tmp_path / "out.vtu", better, like=path, height="keep")
    assert (meshio.read(tmp_path / "out.vtu").points[:, 2] == meshio.read(path).points[:, 2]).all()
    with pytest.raises(ValueError, match="height must be one of interpolate, keep"):
        tm.write(tmp_path / "out.vtu", better, like=path, height="drop")


def test_noise_in_z_costs_x_and_y_no_bit_and_stays_at_unmoved_vertices(tmp_path, rng):
    points, triangles = meshes.grid_arrays(4, 4)
    noise = 1e-7 * rng.normal(size=(len(points), 1))
    path = save(tmp_path / "in.vtu", np.hstack([points, noise]), triangles)
    mesh = tm.read(path)
    assert (mesh.points.numpy() == points).all()
    tm.write(tmp_path / "out.vtu", mesh, like=path)
    assert (meshio.read(tmp_path / "out.vtu").points[:, 2:] == noise).all()


@pytest.mark.parametrize("across", [0, 1])
@pytest.mark.parametrize("seen", [1, -1])
def test_an_upright_plane_has_the_coordinates_of_the_file_whichever_side_it_is_seen_from(
    tmp_path, across, seen, recwarn
):
    points, triangles = meshes.delaunay_arrays(40, 3)
    space = np.insert(points, across, 0.25, axis=1)
    path = save(tmp_path / "in.vtu", space, triangles[:, ::seen])
    mesh = tm.read(path)
    assert (mesh.points.numpy() == points).all()
    assert bool(tm.quality(mesh).upright.all())
    tm.write(tmp_path / "out.vtu", mesh, like=path)
    back = meshio.read(tmp_path / "out.vtu")
    assert (back.points == space).all()
    assert (back.cells_dict["triangle"] == triangles[:, ::seen]).all()
    assert not recwarn.list


def test_a_wavy_wall_is_a_map_of_the_plane_of_x_and_z(tmp_path):
    points, triangles = meshes.grid_arrays(6, 6)
    space = np.stack([points[:, 0], np.sin(4 * points[:, 0]) * 0.2, points[:, 1]], 1)
    source = Source.open(save(tmp_path / "in.vtu", space, triangles))
    assert source.surface.axis == 1
    assert (source.mesh.points.numpy() == points).all()


def patch(rows=12):
    points, triangles = meshes.grid_arrays(rows, rows)
    return 2 * points - 1, triangles


def bulb(points):
    """More than half of a sphere over the square."""
    radius = np.abs(points).max(1)
    polar, turn = 0.75 * np.pi * radius, np.arctan2(points[:, 1], points[:, 0])
    return np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], 1)


def arch(points):
    turn = 2 * points[:, 0]
    return np.stack([np.sin(turn), points[:, 1], np.cos(turn)], 1)


@pytest.mark.parametrize("shape", [bulb, arch])
def test_what_folds_over_is_refused_with_the_place(tmp_path, shape):
    points, triangles = patch()
    path = save(tmp_path / "in.vtu", shape(points), triangles)
    with pytest.raises(InvalidMeshError, match=r"no map of a plane: it bends over at \("):
        tm.read(path)


def test_a_closed_surface_and_a_wall_all_round_are_refused(tmp_path):
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    path = save(tmp_path / "in.vtu", corners, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    with pytest.raises(InvalidMeshError, match="no map of a plane: it is closed"):
        tm.read(path)
    points, triangles = patch()
    turn = np.pi * points[:, 0]
    path = save(tmp_path / "wall.vtu", np.stack([np.cos(turn), np.sin(turn), points[:, 1]], 1), triangles)
    with pytest.raises(InvalidMeshError, match="no map of a plane"):
        tm.read(path)


@pytest.mark.parametrize("steepness", [1e-3, 0.1, 0.5])
def test_a_tangle_in_a_slope_is_no_fold(tmp_path, steepness):
    _, path = tangled_bed(tmp_path / "in.vtu", lambda x, y: steepness * np.sin(6 * x + y))
    before = tm.read(path)
    assert int(tm.quality(before).inverted) > 10
    assert bool(tm.improve(before)[1].valid.all())


def test_metres_over_degrees_are_no_fold(tmp_path):
    _, path = tangled_bed(tmp_path / "in.vtu", lambda x, y: -4000 + 900 * np.sin(3 * x + 2 * y))
    assert len(tm.read(path)) == 1
