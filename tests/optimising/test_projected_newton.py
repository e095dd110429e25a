"""Second derivatives against autograd, the positive Hessian against numpy's eigenvalues, and minima against L-BFGS."""

import meshes
import numpy as np
import pytest
import torch
from energy_cases import ENERGIES, UPRIGHT_ONLY
from scipy.sparse import csc_matrix

import torchmesh as tm
from torchmesh.mesh.triangle import corners
from torchmesh.optimising.energies import InverseMeanRatio, Regularised
from torchmesh.optimising.jacobian import equilateral, invariants, target_of
from torchmesh.optimising.projected_newton import NewtonSystem, ProjectedOptions, minimise_by_projection


def jittered(amount, n=4):
    mesh = meshes.grid(n, n)
    throw = torch.randn(mesh.points.shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    return mesh.with_points(torch.where(mesh.fixed[:, None], mesh.points, mesh.points + amount / n * throw))


def dense(system, entries):
    """The matrix in the order of the free coordinates."""
    shape = (system.size, system.size)
    ordered = csc_matrix((entries, system.places.indices, system.places.indptr), shape=shape).toarray()
    return ordered[np.ix_(system.number, system.number)]


def summed(mesh, target, energy):
    """The energy as a function of the free coordinates, in plain torch, and these coordinates."""
    free = ~mesh.fixed

    def value(x):
        points = mesh.points.clone().masked_scatter(free[:, None].expand(-1, 2), x)
        touched = free[mesh.triangles].any(1)
        t = corners(points, mesh.triangles[touched])
        return energy.value(*invariants(t, type(target)(*(v[touched] for v in target)))).sum()

    return value, mesh.points[free].reshape(-1)


@pytest.mark.parametrize("name", sorted(set(ENERGIES) - UPRIGHT_ONLY))
def test_gradient_and_hessian_are_those_of_autograd_where_the_hessian_is_positive_and_never_below_it(name):
    mesh, energy = jittered(0.8), ENERGIES[name]
    target = target_of(corners(meshes.grid(4, 4).points, mesh.triangles))
    system = NewtonSystem(mesh.points, mesh.triangles, ~mesh.fixed, target)
    gradient, entries = system.derivatives(mesh.points, energy, ProjectedOptions(floor=0.0))
    value, x = summed(mesh, target, energy)
    expected = torch.autograd.functional.jacobian(value, x).numpy()
    np.testing.assert_allclose(gradient, expected, rtol=1e-9, atol=1e-9 * abs(expected).max())
    # Raising eigenvalues of single triangles only adds to the matrix.
    excess = dense(system, entries) - torch.autograd.functional.hessian(value, x).numpy()
    scale = abs(dense(system, entries)).max()
    assert np.linalg.eigvalsh(excess).min() > -1e-9 * scale
    assert np.linalg.eigvalsh(dense(system, entries)).min() > -1e-9 * scale


def test_the_hessian_of_a_convex_place_is_exact():
    mesh = jittered(0.02)
    # Triangles that are larger than their targets resist a turn.
    target = target_of(corners(0.7 * meshes.grid(4, 4).points, mesh.triangles))
    system = NewtonSystem(mesh.points, mesh.triangles, ~mesh.fixed, target)
    _, entries = system.derivatives(mesh.points, Regularised(1e-3, theta=0.5), ProjectedOptions(floor=0.0))
    value, x = summed(mesh, target, Regularised(1e-3, theta=0.5))
    expected = torch.autograd.functional.hessian(value, x).numpy()
    np.testing.assert_allclose(dense(system, entries), expected, rtol=1e-9, atol=1e-9 * abs(expected).max())


def test_its_minimum_is_the_one_that_smoothing_finds():
    mesh = jittered(0.15, 6)
    smooth, _ = tm.smooth(mesh, tm.SmoothOptions(energy_tolerance=1e-14, gradient_tolerance=1e-10))
    size = torch.full((len(mesh.triangles),), 0.1, dtype=torch.float64)
    system = NewtonSystem(mesh.points, mesh.triangles, ~mesh.fixed, equilateral(size))
    found = minimise_by_projection(system, mesh.points, InverseMeanRatio(), ProjectedOptions(30, 1e-15, 1e-15))
    assert found.iterations < 30
    assert found.energy < found.start
    torch.testing.assert_close(found.points, smooth.points, rtol=0, atol=1e-5)


def test_vertices_that_are_not_free_stay_and_an_isolated_one_does_no_harm():
    mesh = jittered(0.6)
    points = torch.cat([mesh.points, torch.tensor([[9.0, 9.0]], dtype=torch.float64)])
    free = torch.cat([~mesh.fixed, torch.tensor([True])])
    size = torch.full((len(mesh.triangles),), 0.25, dtype=torch.float64)
    system = NewtonSystem(points, mesh.triangles, free, equilateral(size))
    found = minimise_by_projection(system, points, Regularised(0.1))
    assert found.energy < found.start
    assert torch.equal(found.points[~free], points[~free])
    assert bool(found.points.isfinite().all())


def test_where_no_vertex_is_free_nothing_moves():
    mesh = jittered(0.6)
    target = target_of(corners(mesh.points, mesh.triangles))
    system = NewtonSystem(mesh.points, mesh.triangles, torch.zeros_like(mesh.fixed), target)
    assert len(system.number) == 0
    found = minimise_by_projection(system, mesh.points, Regularised(0.1))
    assert torch.equal(found.points, mesh.points)
    assert found.iterations == 0


@pytest.mark.parametrize("field", ["slope_tolerance", "floor"])
def test_options_refuse_by_name(field):
    with pytest.raises(ValueError, match=f"ProjectedOptions.{field} must be at least 0"):
        ProjectedOptions(**{field: -1.0})
