"""Areas pushed above a bound: the gradient against autograd, and meshes that only area can untangle."""

import meshes
import numpy as np
import pytest
import torch
from scipy.sparse import csc_matrix

from torchmesh.mesh.triangle import corners
from torchmesh.optimising.energies import UntangleBeta
from torchmesh.optimising.jacobian import invariants, target_of
from torchmesh.optimising.levenberg import LevenbergOptions, _gauss_newton, push_areas
from torchmesh.optimising.projected_newton import NewtonSystem


def scrambled():
    """A square grid with its free vertices thrown about, and the system towards the grid's own triangles."""
    mesh = meshes.grid(5, 5)
    throw = torch.randn(mesh.points.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    points = torch.where(mesh.fixed[:, None], mesh.points, mesh.points + 0.4 * throw)
    return (
        mesh,
        points,
        NewtonSystem(points, mesh.triangles, ~mesh.fixed, target_of(corners(mesh.points, mesh.triangles))),
    )


def test_the_gradient_is_that_of_untangle_beta_and_the_matrix_that_of_gauss_and_newton():
    mesh, points, system = scrambled()
    free = ~mesh.fixed
    gradient, entries = _gauss_newton(system, points, 0.3)

    def lacks(x):
        there = points.clone().masked_scatter(free[:, None].expand(-1, 2), x)
        _, det = invariants(corners(there, system.triangles), system.target)
        return (0.3 - det).clamp_min(0) / 2

    x = points[free].reshape(-1)
    jacobian = torch.autograd.functional.jacobian(lacks, x).numpy()
    np.testing.assert_allclose(gradient, 2 * jacobian.T @ lacks(x).numpy(), rtol=1e-10, atol=1e-12)
    matrix = csc_matrix(
        (entries, system.places.indices, system.places.indptr), shape=(system.size, system.size)
    ).toarray()
    matrix = matrix[np.ix_(system.number, system.number)]
    np.testing.assert_allclose(matrix, 2 * jacobian.T @ jacobian, rtol=1e-10, atol=1e-10)
    assert system.energy(points, UntangleBeta(0.15))[0] == pytest.approx(float(lacks(x).square().sum()))


def test_scrambled_areas_become_positive_and_the_energy_never_rises():
    _, points, system = scrambled()
    assert int((system.energy(points, UntangleBeta(0.15))[1] <= 0).sum()) > 10
    found = push_areas(system, points, 0.3)
    assert bool((found.det > 0).all())
    assert found.energy < found.start


def test_a_mesh_that_is_valid_stays_where_it_is():
    mesh, _, system = scrambled()
    found = push_areas(system, mesh.points, 0.3)
    assert found.iterations == 0
    assert torch.equal(found.points, mesh.points)


def test_where_no_vertex_is_free_nothing_moves():
    mesh, points, _ = scrambled()
    system = NewtonSystem(
        points, mesh.triangles, torch.zeros_like(mesh.fixed), target_of(corners(mesh.points, mesh.triangles))
    )
    found = push_areas(system, points, 0.3)
    assert torch.equal(found.points, points)
    assert found.iterations == 0


def test_options_refuse_by_name():
    with pytest.raises(ValueError, match=r"LevenbergOptions\.poor"):
        LevenbergOptions(poor=0.9)
    with pytest.raises(ValueError, match=r"LevenbergOptions\.less"):
        LevenbergOptions(less=2.0)
