"""The invariants of the Jacobian and their derivatives, against matrices and autograd."""

import math

import numpy as np
import pytest
import torch

from torchmesh.mesh.triangle import Corners
from torchmesh.optimising.energies import InverseMeanRatio, Regularised, UntangleBeta
from torchmesh.optimising.jacobian import EdgeMap, Target, equilateral, invariants, select_rows, target_of


def one_triangle(*xy):
    return Corners(*(torch.tensor([float(v)], dtype=torch.float64) for v in xy))


def test_invariants_of_the_target_itself():
    t = one_triangle(1, 1, 3, 1, 2, 1 + math.sqrt(3))
    for target in (equilateral(2.0), target_of(t)):
        stretch, det = invariants(t, target)
        # J is the identity: ||J||^2 = 2 and det J = 1.
        assert stretch.item() == pytest.approx(2, rel=1e-14)
        assert det.item() == pytest.approx(1, rel=1e-14)


def test_invariants_of_a_target_are_those_of_the_matrix(rng):
    shape, target = rng.normal(size=(2, 50, 2, 2))
    target[:, 0] *= np.where(np.linalg.det(target) < 0, -1, 1)[:, None]
    j = shape @ np.linalg.inv(target)

    def as_corners(e):
        zero = np.zeros(len(e))
        return Corners(*(torch.from_numpy(v) for v in (zero, zero, e[:, 0, 0], e[:, 1, 0], e[:, 0, 1], e[:, 1, 1])))

    stretch, det = invariants(as_corners(shape), target_of(as_corners(target)))
    condition = np.linalg.cond(target)
    assert np.all(np.abs(stretch.numpy() / (j**2).sum((1, 2)) - 1) < 1e-14 * condition**2)
    assert np.all(np.abs(det.numpy() / np.linalg.det(j) - 1) < 1e-12 * condition**2)


def test_select_rows_takes_tensors_and_leaves_floats():
    keep = torch.tensor([True, False, True])
    values = torch.tensor([1.0, 2.0, 3.0])
    assert select_rows(UntangleBeta(values), keep).beta.tolist() == [1, 3]
    assert select_rows(Regularised(values), keep).eps.tolist() == [1, 3]
    assert select_rows(Regularised(values, 0.5), keep).theta == 0.5
    assert select_rows(InverseMeanRatio(8), keep) == InverseMeanRatio(8)
    target = select_rows(Target(1.0, 0.0, 1.0, values), keep)
    assert (target.g11, target.m.tolist()) == (1.0, [1, 3])
    root = select_rows(EdgeMap(values, 2 * values, 3 * values), slice(1, 3))
    assert torch.stack(root).tolist() == [[2, 3], [4, 6], [6, 9]]


def test_the_root_of_a_metric_squared_is_the_metric_scaled_to_determinant_one(generator):
    factor = torch.randn(40, 2, 2, generator=generator, dtype=torch.float64)
    metric = factor @ factor.mT + 0.01 * torch.eye(2, dtype=torch.float64)
    h11, h12, h22 = EdgeMap.root_of(torch.stack([metric[:, 0, 0], metric[:, 0, 1], metric[:, 1, 1]], 1))
    root = torch.stack([h11, h12, h12, h22], 1).view(-1, 2, 2)
    assert bool((torch.linalg.eigvalsh(root) > 0).all())
    torch.testing.assert_close(root @ root, metric / torch.linalg.det(metric).sqrt()[:, None, None], rtol=1e-9, atol=0)


def test_a_map_of_corners_is_the_map_of_edges(generator):
    t = Corners(*torch.randn(6, 30, generator=generator, dtype=torch.float64))
    edge_map = EdgeMap(*torch.randn(3, 30, generator=generator, dtype=torch.float64))
    edges = torch.stack([t.bx - t.ax, t.by - t.ay, t.cx - t.ax, t.cy - t.ay]).view(2, 2, -1)
    seen = edge_map.corners(t)
    assert bool((torch.stack([seen.ax, seen.ay]) == 0).all())
    assert torch.equal(edge_map.edges(edges).view(4, -1), torch.stack([seen.bx, seen.by, seen.cx, seen.cy]))
