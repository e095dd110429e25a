"""The interior follows its boundary, and small triangles keep their shapes."""

import meshes
import numpy as np
import pytest
import torch
from linear_elements import stiffness

import torchmesh as tm
from torchmesh.warping.boundary_path import first_flat
from torchmesh.warping.femwarp import carried
from torchmesh.warping.stiffened import carried_stiffly

GOOD = [name for name in meshes.VALID if name != "bowtie"]


def moved_at_random(mesh, rng, by=0.1):
    return mesh.points + by * torch.from_numpy(rng.normal(size=mesh.points.shape))


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("name", GOOD)
def test_it_is_an_affine_fit_and_a_stiffer_harmonic_extension(name, power, rng):
    """The same with dense matrices: least squares by numpy, and elements one by one."""
    mesh = meshes.VALID[name]()
    points, fixed = mesh.points.numpy(), mesh.fixed.numpy()
    goal = moved_at_random(mesh, rng)
    asked = (goal - mesh.points).numpy()[fixed]
    linear = np.column_stack([points, np.ones(len(points))])
    affine = linear @ np.linalg.lstsq(linear[fixed], asked, rcond=None)[0]
    k = np.zeros((len(points), len(points)))
    areas = tm.quality(mesh).area
    for row, area in zip(mesh.triangles, areas, strict=True):
        one = tm.MeshBatch.from_arrays(mesh.points[row], [[0, 1, 2]])
        k[np.ix_(row, row)] += float((areas.mean() / area) ** power) * stiffness(one)
    rest = np.linalg.solve(k[np.ix_(~fixed, ~fixed)], -k[np.ix_(~fixed, fixed)] @ (asked - affine[fixed]))
    after = carried_stiffly(mesh, goal, power).points.numpy()
    np.testing.assert_array_equal(after[fixed], goal.numpy()[fixed])
    # Direct solvers and fits, condition below some thousands.
    np.testing.assert_allclose(after[~fixed], (points + affine)[~fixed] + rest, rtol=0, atol=1e-11)


def test_without_stiffening_it_is_femwarp(rng):
    mesh = meshes.jittered()
    goal = torch.where(mesh.fixed[:, None], moved_at_random(mesh, rng), mesh.points)
    assert torch.equal(carried_stiffly(mesh, goal, 0.0).points, carried(mesh, goal).points)


@pytest.mark.parametrize("name", list(meshes.VALID))
def test_affine_motion_is_reproduced(name, rng):
    mesh = meshes.VALID[name]()
    matrix, shift = rng.normal(size=(2, 2)), rng.normal(size=2)
    goal = mesh.points @ torch.from_numpy(matrix) + torch.from_numpy(shift)
    torch.testing.assert_close(carried_stiffly(mesh, goal, 1.0).points, goal, rtol=0, atol=1e-11)


def loose(mesh, *positions):
    """The mesh with vertices at these positions that are in no triangle, in front of the others."""
    points = torch.cat([mesh.points.new_tensor(positions), mesh.points])
    with pytest.warns(tm.MeshWarning, match="no triangle"):
        return tm.MeshBatch.from_arrays(points, mesh.triangles + len(positions))


def together(*parts):
    """One mesh of all these parts."""
    starts = np.cumsum([0, *[len(part.points) for part in parts[:-1]]]).tolist()
    triangles = torch.cat([part.triangles + start for part, start in zip(parts, starts, strict=True)])
    return tm.MeshBatch.from_arrays(torch.cat([part.points for part in parts]), triangles)


def test_a_vertex_in_no_triangle_does_not_count(rng):
    mesh = meshes.delaunay()
    goal = moved_at_random(mesh, rng)
    after = carried_stiffly(mesh, goal, 1.0).points
    more = loose(mesh, [2.0, 2.0], [-3.0, 5.0])
    far = torch.tensor([[1e6, 0.0], [-3.0, 5.0]], dtype=torch.float64)
    assert torch.equal(carried_stiffly(more, torch.cat([far, goal]), 1.0).points, torch.cat([far, after]))


def test_each_part_has_an_affine_motion_of_its_own(rng):
    parts, goals = [meshes.jittered(), meshes.ring(), meshes.delaunay()], []
    for part in parts:
        matrix, shift = rng.normal(size=(2, 2)), 100 * rng.normal(size=2)
        goals.append(part.points @ torch.from_numpy(matrix) + torch.from_numpy(shift))
    after = carried_stiffly(together(*parts), torch.cat(goals), 1.0).points
    # Sums of some hundred numbers of the size of the shift.
    torch.testing.assert_close(after, torch.cat(goals), rtol=0, atol=1e-10)


def test_in_a_batch_each_mesh_is_carried_as_alone(rng):
    several = [meshes.ring(), together(meshes.grid(), meshes.ring()), loose(meshes.delaunay(), [1.0, 1.0])]
    goals = [moved_at_random(mesh, rng, by=1e-3) for mesh in several]
    alone = [carried_stiffly(mesh, goal, 1.0).points for mesh, goal in zip(several, goals, strict=True)]
    assert torch.equal(carried_stiffly(tm.join(several), torch.cat(goals), 1.0).points, torch.cat(alone))


def test_no_motion_keeps_every_bit():
    mesh = meshes.jittered()
    assert torch.equal(carried_stiffly(mesh, mesh.points, 1.0).points, mesh.points)


def test_where_the_fixed_vertices_lie_on_a_line_they_shift_the_rest():
    points, triangles = meshes.grid_arrays(4, 4)
    fixed = points[:, 1] == points[:, 1].min()
    mesh = tm.MeshBatch.from_arrays(points, triangles, fixed)
    mesh.fixed[:] = torch.from_numpy(fixed)
    goal = mesh.points + torch.tensor([0.5, -2.0], dtype=torch.float64)
    torch.testing.assert_close(carried_stiffly(mesh, goal, 1.0).points, goal, rtol=0, atol=1e-12)


def test_joined_equals_alone_in_any_unit(rng):
    parts = [meshes.VALID[name]() for name in GOOD]
    goals = [moved_at_random(mesh, rng) for mesh in parts]
    together = carried_stiffly(tm.join(parts), torch.cat(goals), 1.0).split()
    for mesh, goal, joined in zip(parts, goals, together, strict=True):
        alone = carried_stiffly(mesh, goal, 1.0)
        assert torch.equal(alone.points, joined.points)
        scaled = carried_stiffly(mesh.with_points(mesh.points * 2.0**70), goal * 2.0**70, 1.0)
        assert torch.equal(scaled.points, alone.points * 2.0**70)


def test_quads_follow_an_affine_motion_too():
    points = [[x, y] for y in (0.0, 0.2, 1.0) for x in (0.0, 0.3, 1.0)]
    quads = [[0, 1, 4, 3], [1, 2, 5, 4], [3, 4, 7, 6], [4, 5, 8, 7]]
    mesh = tm.MeshBatch.from_arrays(points, np.empty((0, 3), int), quads=quads)
    goal = mesh.points @ torch.tensor([[2.0, 0.3], [-0.1, 0.7]], dtype=torch.float64)
    torch.testing.assert_close(carried_stiffly(mesh, goal, 1.0).points, goal, rtol=0, atol=1e-13)


def test_small_triangles_at_a_moving_body_keep_their_shapes():
    """Fine rings of triangles round a hole in a coarse square: it gets farther until the first triangle is flat."""
    ring = np.linspace(0, 2 * np.pi, 25)[:-1]
    rows = [np.stack([r * np.cos(ring), r * np.sin(ring)], 1) for r in (1, 1.25, 1.6, 2.2, 3.2, 5, 8, 12)]
    n = len(ring)
    corners = [(level * n + i, level * n + (i + 1) % n) for level in range(len(rows) - 1) for i in range(n)]
    triangles = [row for a, b in corners for row in ([a, a + n, b + n], [a, b + n, b])]
    mesh = tm.MeshBatch.from_arrays(np.concatenate(rows), triangles)
    inner = torch.arange(len(mesh.points)) < n
    goal = mesh.points + torch.where(inner[:, None], torch.tensor([8.0, 0.0], dtype=torch.float64), 0.0)
    far = [float(first_flat(mesh, carried_stiffly(mesh, goal, power).points).min()) for power in (0.0, 1.0)]
    assert far[1] > 1.5 * far[0] > 0
