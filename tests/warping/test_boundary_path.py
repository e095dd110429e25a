import math

import meshes
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchmesh import InvalidMeshError, MeshBatch, MeshWarning, femwarp, join, largest_step, quality
from torchmesh.warping.boundary_path import BoundaryPath, least_positive_root

LAST = torch.ones(1, dtype=torch.float64)


def test_the_root_is_the_least_positive_one():
    generator = torch.Generator().manual_seed(0)
    a, b = torch.randn((2, 2000), generator=generator, dtype=torch.float64)
    c = torch.rand(2000, generator=generator, dtype=torch.float64) + 1e-3
    a[:200] = 0.0
    b[100:300] = 0.0
    a[300:400] *= 1e-12
    root = least_positive_root(a, b, c)
    for i in range(len(a)):
        # By the schoolbook in decimals long enough that nothing cancels.
        roots = _positive_roots(float(a[i]), float(b[i]), float(c[i]))
        assert float(root[i]) == pytest.approx(min(roots, default=math.inf), rel=1e-9)


def _positive_roots(a: float, b: float, c: float) -> list[float]:
    from decimal import Decimal, getcontext

    getcontext().prec = 80
    p, q, r = Decimal(a), Decimal(b), Decimal(c)
    if p == 0:
        return [float(-r / q)] if q < 0 else []
    d = q * q - 4 * p * r
    roots = [] if d < 0 else [(-q - d.sqrt()) / (2 * p), (-q + d.sqrt()) / (2 * p)]
    return [float(t) for t in roots if t > 0]


@pytest.mark.parametrize("scale", [1e-120, 1.0, 1e120])
def test_the_root_has_no_unit(scale):
    a, b, c = (torch.tensor([v], dtype=torch.float64) for v in (1.0, -3.0, 2.0))
    assert least_positive_root(a * scale, b * scale, c * scale).item() == pytest.approx(1.0)
    assert least_positive_root(a, b, -c).item() == 0.0
    assert least_positive_root(a, b, 0 * c).item() == 0.0


@given(st.integers(0, 10_000), st.sampled_from([1.0, 1e-100, 1e100]))
@settings(max_examples=40)
def test_the_mesh_is_valid_just_before_the_largest_step_and_not_after(seed, unit):
    mesh = [meshes.ring(9, 2), meshes.delaunay(20, seed), meshes.disc(7, 2)][seed % 3]
    generator = torch.Generator().manual_seed(seed)
    way = torch.randn(mesh.points.shape, generator=generator, dtype=torch.float64)
    mesh = mesh.with_points(mesh.points * unit)
    step = largest_step(mesh, mesh.points + way * unit).item()
    assert 0 < step < math.inf
    for part, valid in ((0.0, True), (0.5, True), (1 - 1e-6, True), (1 + 1e-6, False)):
        assert (quality(mesh.with_points(mesh.points + part * step * unit * way)).inverted.item() == 0) is valid


def test_a_motion_that_flattens_nothing_has_no_bound():
    mesh = meshes.ring()
    assert largest_step(mesh, mesh.points).item() == math.inf
    assert largest_step(mesh, mesh.points + 3.0).item() == math.inf
    assert largest_step(mesh, 2 * mesh.points).item() == math.inf
    # Shrunk to nothing at the goal, turned inside out at twice the way.
    assert largest_step(mesh, 0 * mesh.points).item() == pytest.approx(1.0)
    assert largest_step(mesh, -mesh.points).item() == pytest.approx(0.5)
    assert largest_step(meshes.TANGLED["jittered"](), meshes.grid(8, 7).points).item() == 0.0


def test_a_vertex_in_no_triangle_bounds_nothing_however_far_it_is():
    mesh = meshes.ring()
    goal = -mesh.points
    far = torch.tensor([[1e16, 0.0]], dtype=torch.float64)
    with pytest.warns(MeshWarning, match="no triangle"):
        more = MeshBatch.from_arrays(torch.cat([mesh.points, far]), mesh.triangles)
    for there in (far, -far, torch.zeros_like(far)):
        assert torch.equal(largest_step(more, torch.cat([goal, there])), largest_step(mesh, goal))


def test_each_mesh_has_its_own_step():
    parts = [meshes.ring(), meshes.grid(), meshes.disc()]
    batch = join(parts)
    goal = batch.points * torch.tensor([-1.0, 0.5], dtype=torch.float64)
    together = largest_step(batch, goal)
    alone = [largest_step(m, m.points * torch.tensor([-1.0, 0.5], dtype=torch.float64)).item() for m in parts]
    assert together.tolist() == alone


def test_another_shape_is_refused():
    with pytest.raises(InvalidMeshError, match=r"new_points must be \(80, 2\).* not \(3, 2\)"):
        largest_step(meshes.ring(), torch.zeros(3, 2))


@pytest.mark.parametrize("degrees", [-179.0, -90.0, 10.0, 120.0, 180.0])
@pytest.mark.parametrize("shift", [0.0, 3.0])
def test_a_hole_that_turns_keeps_its_shape_on_the_way(degrees, shift):
    mesh = meshes.ring()
    hole = torch.arange(80) < 16
    goal = torch.where(hole[:, None], meshes.turned(mesh.points, degrees) + shift, mesh.points)
    path = BoundaryPath.of(mesh, goal)
    assert path.turns
    for t in (0.0, 0.25, 0.5, 1.0):
        place = path.at(t * LAST)
        assert torch.allclose(place[hole], meshes.turned(mesh.points[hole], t * degrees) + t * shift, atol=1e-12)
        assert torch.equal(place[~hole], mesh.points[~hole])
    assert torch.equal(path.at(LAST), goal)


def test_a_body_turns_and_grows_at_once():
    mesh = meshes.ring()
    hole = torch.arange(80) < 16
    goal = torch.where(hole[:, None], 1.2 * meshes.turned(mesh.points, 90.0), mesh.points)
    half = BoundaryPath.of(mesh, goal).at(0.5 * LAST)
    assert torch.allclose(half[hole], 1.1 * meshes.turned(mesh.points[hole], 45.0), atol=1e-12)


def test_what_is_no_rigid_motion_goes_straight():
    mesh = meshes.grid(8, 8)
    bump = mesh.fixed & (mesh.points[:, 1] == 0) & (mesh.points[:, 0] > 0.3) & (mesh.points[:, 0] < 0.7)
    goal = mesh.points + bump[:, None] * torch.tensor([0.0, 0.4], dtype=torch.float64)
    path = BoundaryPath.of(mesh, goal)
    assert not path.turns
    assert torch.allclose(path.at(0.25 * LAST), mesh.points + 0.25 * (goal - mesh.points))
    straight = BoundaryPath.of(mesh, meshes.turned(mesh.points, 90.0), straight=True)
    assert not straight.turns


def test_a_region_inside_turns_as_a_body():
    points, triangles = meshes.grid_arrays(6, 6)
    index = torch.arange(49).reshape(7, 7)
    square = torch.cat([index[2:4, 2], index[4, 2:4], index[3:5, 4].flip(0), index[2, 3:5].flip(0)])
    edges = torch.stack([square, square.roll(-1)], 1)
    mesh = MeshBatch.from_arrays(points, triangles, constrained_edges=edges)
    goal = mesh.points.clone()
    goal[square] = 0.5 + meshes.turned(mesh.points[square] - 0.5, 180.0)
    half = BoundaryPath.of(mesh, goal).at(0.5 * LAST)
    spread = (half[square] - 0.5).norm(dim=1)
    assert torch.allclose(spread, (mesh.points[square] - 0.5).norm(dim=1))


def test_each_mesh_is_at_its_own_place_and_has_the_bits_it_has_alone():
    parts = [meshes.ring(12, 2), meshes.grid(), meshes.ring()]
    batch = join(parts)
    goals = [meshes.turned(m.points, angle) for m, angle in zip(parts, (50.0, 0.0, 140.0), strict=True)]
    t = torch.tensor([0.3, 0.6, 0.9], dtype=torch.float64)
    together = BoundaryPath.of(batch, torch.cat(goals)).at(t).split([len(m.points) for m in parts])
    for b, (mesh, goal) in enumerate(zip(parts, goals, strict=True)):
        assert torch.equal(BoundaryPath.of(mesh, goal).at(t[b : b + 1]), together[b])


def test_the_largest_step_of_a_warp():
    mesh = meshes.ring()
    hole = torch.arange(80) < 16
    goal = mesh.points + hole[:, None] * torch.tensor([3.0, 0.0], dtype=torch.float64)
    step = largest_step(mesh, femwarp(mesh, goal).points)
    for part, valid in ((0.99, True), (1.01, False)):
        there = mesh.points + part * step * (goal - mesh.points)
        assert (quality(femwarp(mesh, there)).inverted.item() == 0) is valid
