"""The kernel against autograd through textbook formulae, as it is and in a metric."""

import itertools
import math

import meshes
import pytest
import torch
from energy_cases import ENERGIES, UPRIGHT_ONLY

from torchmesh.mesh.triangle import Corners, corners, signed_area
from torchmesh.optimising.assembly import chunk_offsets, chunks_of, energy_and_forces
from torchmesh.optimising.energies import Regularised
from torchmesh.optimising.jacobian import EdgeMap, equilateral, invariants


def independent_energy(name, points, triangles, target_sides):
    """The sum over the triangles in textbook notation, points[triangles] and matrices; differentiable."""
    a, b, c = points[triangles].unbind(1)
    w = torch.tensor([[1, 0.5], [0, math.sqrt(3) / 2]], dtype=points.dtype)
    j = torch.stack([b - a, c - a], 2) @ torch.linalg.inv(w) / target_sides[:, None, None]
    norm2, det = j.square().sum((1, 2)), torch.linalg.det(j)
    energy = ENERGIES[name]
    if name in UPRIGHT_ONLY:
        q = norm2 / (2 * det)
        return (q**energy.power + (0 if energy.ceiling is None else (q / energy.ceiling) ** 8)).sum()
    if name == "untangle-beta":
        area = det / 2
        return (((area - energy.beta).abs() - (area - energy.beta)) / 2).square().sum()
    if name == "lifted":
        return torch.sqrt(det**2 + energy.alpha * norm2 + energy.alpha**2).sum()
    chi = (det + torch.sqrt(energy.eps**2 + det**2)) / 2
    return ((1 - energy.theta) * norm2 / chi + energy.theta * (1 + det**2) / chi).sum()


@pytest.mark.parametrize("name", list(ENERGIES))
@pytest.mark.parametrize("sized", [False, True])
def test_energy_and_forces_are_those_of_autograd_through_the_corners(name, sized, generator):
    mesh = meshes.equilateral() if name in UPRIGHT_ONLY else meshes.jittered(cells=0.6)
    points = mesh.points + 0.1 * torch.randn(mesh.points.shape, generator=generator, dtype=torch.float64)
    triangles = mesh.triangles
    sides = torch.rand(len(triangles), generator=generator, dtype=torch.float64) + 0.5
    if not sized:
        sides = torch.ones_like(sides)
    assert name not in UPRIGHT_ONLY or bool((signed_area(corners(points, triangles)) > 0).all())
    rows = torch.stack([2 * triangles.T, 2 * triangles.T + 1], 1).reshape(6, -1)
    phi, gradient, det = energy_and_forces(
        points.reshape(-1), chunks_of(rows, ENERGIES[name], equilateral(sides if sized else 1.0))
    )
    points.requires_grad_()
    expected = independent_energy(name, points, triangles, sides)
    expected.backward()
    scale = float(points.grad.abs().max())
    torch.testing.assert_close(phi.sum(), expected.detach(), rtol=1e-10, atol=0)
    # Slivers cancel: an entry is as exact as the largest forces that meet in it.
    torch.testing.assert_close(gradient.reshape(-1, 2), points.grad, rtol=1e-9, atol=1e-12 * scale)
    area = signed_area(corners(points.detach(), triangles))
    torch.testing.assert_close(det, area / (math.sqrt(3) / 4 * sides**2), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("name", list(ENERGIES))
def test_forces_on_a_triangle_sum_to_nothing(name, generator):
    coordinates = torch.randn(600, generator=generator, dtype=torch.float64)
    rows = torch.arange(600).reshape(100, 6).T
    if name in UPRIGHT_ONLY:
        clockwise = signed_area(Corners(*coordinates[rows])) < 0
        rows = torch.where(clockwise, rows[[0, 1, 4, 5, 2, 3]], rows)
    _, force, _ = energy_and_forces(coordinates, chunks_of(rows, ENERGIES[name], equilateral()))
    force = force.reshape(100, 3, 2)
    # No energy depends on where the triangle is; each sum is exact to the last bits of its terms.
    assert bool((force.sum(1).abs() <= 1e-14 * force.abs().amax((1, 2))[:, None]).all())


def test_rows_may_be_int32_and_in_any_order(generator):
    coordinates = torch.randn(60, generator=generator, dtype=torch.float64)
    rows = torch.arange(60).reshape(10, 6).T
    order = torch.randperm(60, generator=generator)
    position = order.argsort()
    straight = energy_and_forces(coordinates, chunks_of(rows, Regularised(1.0), equilateral()))
    shuffled = energy_and_forces(
        coordinates[order], chunks_of(position[rows].to(torch.int32), Regularised(1.0), equilateral())
    )
    assert torch.equal(straight[0], shuffled[0])
    assert torch.equal(straight[1], shuffled[1][position])


@pytest.mark.parametrize("name", list(ENERGIES))
def test_through_an_edge_map_energy_and_forces_are_those_of_the_triangles_as_they_are_seen(name, generator):
    mesh = meshes.equilateral() if name in UPRIGHT_ONLY else meshes.jittered(cells=0.6)
    count, triangles = len(mesh.triangles), mesh.triangles
    root = torch.randn(count, 2, 2, generator=generator, dtype=torch.float64)
    metric = root @ root.mT + 0.1 * torch.eye(2, dtype=torch.float64)
    edge_map = EdgeMap.root_of(torch.stack([metric[:, 0, 0], metric[:, 0, 1], metric[:, 1, 1]], 1))
    rows = torch.stack([2 * triangles.T, 2 * triangles.T + 1], 1).reshape(6, -1)
    target = equilateral(torch.rand(count, generator=generator, dtype=torch.float64) + 0.5)
    phi, gradient, det = energy_and_forces(
        mesh.points.reshape(-1), chunks_of(rows, ENERGIES[name], target, edge_map=edge_map)
    )
    points = mesh.points.clone().requires_grad_()
    seen = invariants(edge_map.corners(corners(points, triangles)), target)
    value = ENERGIES[name].value(*seen)
    value.sum().backward()
    torch.testing.assert_close(phi, value.detach(), rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(det, seen[1].detach(), rtol=1e-9, atol=1e-12)
    scale = float(points.grad.abs().max())
    torch.testing.assert_close(gradient.reshape(-1, 2), points.grad, rtol=1e-9, atol=1e-12 * scale)


def test_a_mesh_is_cut_at_the_same_of_its_triangles_whatever_else_is_in_the_batch():
    def cuts(counts):
        """Where each mesh is cut, counted from its first triangle."""
        offsets = torch.tensor([0, *counts]).cumsum(0).tolist()
        where = chunk_offsets(offsets)
        assert where[0] == 0
        assert where[-1] == offsets[-1]
        assert all(end - start <= 32768 for start, end in itertools.pairwise(where))
        return [[cut - start for cut in where if start < cut < end] for start, end in itertools.pairwise(offsets)]

    large, small = 100_000, 3000
    assert cuts([large]) == [[32768, 65536, 98304]]
    assert cuts([small, large, small]) == [[], [32768, 65536, 98304], []]
    assert cuts([small] * 30) == [[]] * 30
    assert chunk_offsets([0]) == [0]
