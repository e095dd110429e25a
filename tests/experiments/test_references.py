"""The yardsticks are right: the compiled loop is the smoother's energy, and the Delaunay check is exact."""

import numpy as np
import pytest
import torch
from meshes import delaunay, disturbed, grid

from experiments.speed import references
from torchmesh.mesh.triangle import corners, inverse_mean_ratio


def test_the_serial_loop_is_the_smoothers_energy():
    pytest.importorskip("numba")
    mesh = disturbed(grid(), 0.01, 1)
    points = mesh.points.clone().requires_grad_()
    expected = inverse_mean_ratio(corners(points, mesh.triangles)).square().sum()
    expected.backward()
    gradient = np.empty((len(points), 2))
    energy = references.serial_energy()(mesh.points.numpy(), mesh.triangles.numpy(), gradient)
    # Sums of some sixty terms of order one, in another order.
    assert energy == pytest.approx(float(expected.detach()), rel=1e-13)
    torch.testing.assert_close(torch.from_numpy(gradient), points.grad, rtol=1e-11, atol=1e-11)


def test_the_delaunay_check_counts_the_wrong_edges():
    mesh = delaunay(60)
    points, triangles = mesh.points.numpy(), mesh.triangles.numpy()
    assert references.not_delaunay(points, triangles) == 0
    thin = np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 0.5], [1.0, -0.5]])
    assert references.not_delaunay(thin, np.array([[0, 1, 2], [1, 0, 3]])) == 1
    assert references.not_delaunay(thin, np.array([[0, 3, 2], [3, 1, 2]])) == 0


def test_the_delaunay_check_is_exact_on_a_circle():
    # The corners of a square are on one circle: neither diagonal is wrong, until one corner moves in by one bit.
    square = 1e6 + np.array([[0.0, 0.0], [0.125, 0.0], [0.125, 0.125], [0.0, 0.125]])
    across = np.array([[0, 1, 3], [1, 2, 3]])
    assert references.not_delaunay(square, across) == 0
    square[2, 0] -= 2**-33
    assert references.not_delaunay(square, across) == 1


def test_the_delaunay_check_refuses_what_is_no_mesh():
    with pytest.raises(ValueError, match="the same way"):
        references.interior_edges(np.array([[0, 1, 2], [0, 1, 3]]))
    with pytest.raises(ValueError, match="three triangles"):
        references.interior_edges(np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]]))
