"""FEMWARP and relaxation."""

from dataclasses import replace

import meshes
import numpy as np
import pytest
import torch
from exact import inverted
from linear_elements import stiffness

from torchmesh import InvalidMeshError, MeshBatch, femwarp, join, relax

GOOD = [name for name in meshes.VALID if name != "bowtie"]


@pytest.mark.parametrize("name", GOOD)
def test_femwarp_solves_the_linear_elements(name, rng):
    mesh = meshes.VALID[name]()
    target = mesh.points.numpy() + 0.1 * rng.normal(size=mesh.points.shape)
    fixed = mesh.fixed.numpy()
    k = stiffness(mesh)
    inner = np.linalg.solve(k[np.ix_(~fixed, ~fixed)], -k[np.ix_(~fixed, fixed)] @ target[fixed])
    warped = femwarp(mesh, torch.from_numpy(target)).points.numpy()
    np.testing.assert_array_equal(warped[fixed], target[fixed])
    # Two direct solvers, condition below a thousand.
    np.testing.assert_allclose(warped[~fixed], inner, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", list(meshes.VALID))
def test_femwarp_reproduces_affine_motion(name, rng):
    mesh = meshes.VALID[name]()
    matrix, shift = rng.normal(size=(2, 2)), rng.normal(size=2)
    target = mesh.points @ torch.from_numpy(matrix) + torch.from_numpy(shift)
    only_rim = torch.where(mesh.fixed[:, None], target, torch.full_like(target, torch.nan))
    # A solve with condition below a thousand on coordinates of size a few.
    torch.testing.assert_close(femwarp(mesh, only_rim).points, target, rtol=0, atol=1e-12)


def test_femwarp_of_no_motion_stays():
    mesh = meshes.delaunay()
    torch.testing.assert_close(femwarp(mesh, mesh.points).points, mesh.points, rtol=0, atol=1e-13)


def test_femwarp_keeps_everything_but_the_points():
    mesh = meshes.l_shape()
    before = mesh.points.clone()
    warped = femwarp(mesh, 2 * mesh.points)
    assert torch.equal(mesh.points, before)
    assert warped.triangles is mesh.triangles
    assert torch.equal(warped.constrained_edges, mesh.constrained_edges)
    assert torch.equal(warped.fixed, mesh.fixed)


def test_femwarp_holds_fixed_interior_vertices_at_their_new_position():
    points, triangles = meshes.grid_arrays(4, 4)
    held = np.zeros(len(points), bool)
    held[12] = True
    mesh = MeshBatch.from_arrays(points, triangles, held)
    target = mesh.points.clone()
    target[12] += 0.1
    warped = femwarp(mesh, target)
    assert torch.equal(warped.points[12], target[12])
    assert bool((warped.points[~mesh.fixed] != mesh.points[~mesh.fixed]).any())


def test_femwarp_without_free_vertices_moves_the_boundary():
    mesh = meshes.grid(1, 1)
    assert torch.equal(femwarp(mesh, mesh.points + 1).points, mesh.points + 1)


def test_femwarp_takes_numpy_and_float32():
    mesh = meshes.grid()
    assert torch.equal(femwarp(mesh, 2 * mesh.points.numpy()).points, femwarp(mesh, 2 * mesh.points).points)
    single = mesh.to(torch.float32)
    warped = femwarp(single, 2 * single.points)
    assert warped.points.dtype == torch.float32
    # Single precision of numbers up to two.
    torch.testing.assert_close(warped.points, 2 * single.points, rtol=0, atol=3e-7)


def test_a_far_motion_tangles():
    assert inverted(meshes.moved_hole()) > 5
    assert inverted(meshes.moved_hole(0.1)) == 0


@pytest.mark.parametrize(
    "warp", [lambda m: femwarp(m, 1.5 * m.points + m.points.flip(1)), relax], ids=["femwarp", "relax"]
)
def test_joined_equals_alone(warp):
    parts = [meshes.VALID[name]() for name in (*meshes.VALID, *meshes.VALID)] + [
        meshes.grid(12, 11),
        meshes.ring(30, 6),
    ]
    for mesh, together in zip(parts, warp(join(parts)).split(), strict=True):
        assert torch.equal(warp(mesh).points, together.points)


def test_femwarp_refuses_an_inverted_mesh_and_names_it():
    bad = meshes.jittered(cells=0.9)
    with pytest.raises(InvalidMeshError, match=r"mesh 1: triangles row \d+ is inverted.*improve it first"):
        femwarp(join([meshes.grid(), bad]), torch.cat([meshes.grid().points, bad.points]))


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1e200])
def test_femwarp_refuses_places_that_are_not_finite(bad):
    mesh = meshes.grid(2, 2)
    target = mesh.points.clone()
    target[3, 1] = bad
    with pytest.raises(InvalidMeshError, match=r"mesh 0: new_points row 3 .*finite"):
        femwarp(mesh, target)
    with pytest.raises(InvalidMeshError, match=r"mesh 1: new_points row 12 .*finite"):
        femwarp(join([mesh, mesh]), torch.cat([mesh.points, target]))
    with pytest.raises(InvalidMeshError, match=r"mesh 1: points row 3 .*(finite|overflow)"):
        femwarp(join([mesh, mesh.with_points(target)]), torch.cat([mesh.points, mesh.points]))


def test_femwarp_refuses_another_number_of_points():
    mesh = meshes.grid()
    for other in (mesh.points[1:], torch.zeros(len(mesh.points), 3)):
        with pytest.raises(InvalidMeshError, match="new_points must be"):
            femwarp(mesh, other)
    for other in (mesh.points > 0, mesh.points.to(torch.complex128)):
        with pytest.raises(InvalidMeshError, match="new_points must be real numbers"):
            femwarp(mesh, other)
    for other in ("here", [[0.0], [1.0, 2.0]], None):
        with pytest.raises(InvalidMeshError, match="new_points is not a rectangular array"):
            femwarp(mesh, other)


# --- relax ---


@pytest.mark.parametrize("name", ["grid", "disc", "equilateral", "ring", "delaunay"])
def test_relax_puts_every_free_vertex_at_the_mean_of_its_neighbours(name):
    mesh = meshes.disturbed(meshes.VALID[name](), 1.0, 4)
    relaxed = relax(mesh)
    neighbours = {v: set() for v in range(len(mesh.points))}
    for row in mesh.triangles.tolist():
        for v in row:
            neighbours[v] |= set(row) - {v}
    for v in (~mesh.fixed).nonzero().squeeze(1).tolist():
        mean = relaxed.points[sorted(neighbours[v])].mean(0)
        torch.testing.assert_close(relaxed.points[v], mean, rtol=0, atol=1e-13)
    assert torch.equal(relaxed.points[mesh.fixed], mesh.points[mesh.fixed])


@pytest.mark.parametrize("name", ["grid", "disc", "equilateral", "delaunay"])
def test_relax_untangles_inside_a_convex_boundary(name):
    # Tutte 1963; the interior is scattered over the whole plane first.
    mesh = meshes.disturbed(meshes.VALID[name](), 100.0, 5)
    assert inverted(mesh) > 10
    assert inverted(relax(mesh)) == 0


def test_relax_forgets_where_the_free_vertices_were():
    first, second = (relax(meshes.disturbed(meshes.ring(), size, seed)) for size, seed in ((0.1, 1), (3.0, 2)))
    assert torch.equal(first.points, second.points)


def test_the_boundary_has_a_gradient_by_the_adjoint():
    mesh = meshes.jittered(5, 4, 0.2, 3)
    goal = (mesh.points * 1.1 + 0.3).requires_grad_()
    assert torch.autograd.gradcheck(lambda p: femwarp(mesh, p).points, (goal,))
    assert torch.autograd.gradgradcheck(lambda p: femwarp(mesh, p).points, (goal,))
    femwarp(mesh, goal).points.square().sum().backward()
    assert goal.grad is not None
    # What is not read has none.
    assert (goal.grad[~mesh.fixed] == 0).all()
    assert (goal.grad[mesh.fixed] != 0).any()


def test_the_gradient_is_of_every_mesh_of_a_batch_and_of_held_vertices():
    batch = join([meshes.grid(), meshes.ring()])
    hold = torch.zeros_like(batch.fixed)
    hold[(~batch.fixed).nonzero()[0]] = True
    goal = (batch.points + 0.1).requires_grad_()
    assert torch.autograd.gradcheck(lambda p: femwarp(batch, p, hold=hold).points, (goal,))
    single = batch.to(torch.float32)
    warped = femwarp(single, goal).points
    assert warped.dtype == torch.float32
    assert warped.requires_grad


def test_a_warp_without_a_gradient_has_none_and_the_same_bits():
    mesh = meshes.ring()
    goal = mesh.points * 1.2
    plain = femwarp(mesh, goal)
    assert not plain.points.requires_grad
    assert torch.equal(femwarp(mesh, goal.clone().requires_grad_()).points, plain.points)
    with torch.no_grad():
        assert not femwarp(mesh, goal.clone().requires_grad_()).points.requires_grad


def test_a_piece_without_a_fixed_vertex_is_refused():
    mesh = join([meshes.grid(4, 4), meshes.grid(4, 4)])
    two = MeshBatch.from_arrays(torch.cat([mesh.points[:25], mesh.points[25:] + 3]), mesh.triangles)
    free = two.fixed.clone()
    free[25:] = False
    for move in (lambda m: femwarp(m, m.points + 1), relax):
        with pytest.raises(InvalidMeshError, match="mesh 1: no vertex of the piece with vertex 25 is fixed"):
            move(join([meshes.grid(4, 4), replace(two, fixed=free)]))
