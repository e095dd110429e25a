"""The independent check of results finds each fault, and decides signs that rounding cannot."""

import meshes
import numpy as np
import pytest
import torch

import torchmesh as tm
from torchmesh.bench import exact_check


def test_it_finds_every_fault():
    mesh = meshes.grid(4, 4)
    free = int((~mesh.fixed).nonzero()[0])
    assert exact_check.faults(mesh, mesh) == []

    def with_point(row, x, y):
        points = mesh.points.clone()
        points[row] = torch.tensor([x, y])
        return mesh.with_points(points)

    assert "inverted or flat" in exact_check.faults(mesh, with_point(free, 2.0, 2.0))[0]
    assert "fixed vertices have moved" in exact_check.faults(mesh, with_point(0, -0.1, 0.0))
    flat = mesh.points.clone()
    flat[mesh.triangles[0, 2]] = 0.5 * (flat[mesh.triangles[0, 0]] + flat[mesh.triangles[0, 1]])
    assert exact_check.inverted(flat.numpy(), mesh.triangles.numpy()[:1]) == 1
    fewer = tm.MeshBatch.from_arrays(mesh.points, mesh.triangles[1:], mesh.fixed)
    assert exact_check.faults(mesh, fewer) == ["another boundary", "another Euler number"]
    twice = torch.cat([mesh.triangles, mesh.triangles[:1]]).numpy()
    assert max(exact_check.directed(twice).values()) == 2


# The determinant is 2^-60 of its products.  With the smallest unit the products underflow, with the largest they
# overflow: both are left to the rationals.
@pytest.mark.parametrize("unit", [1.0, 2.0**-530, 2.0**520])
def test_it_sees_what_floating_point_does_not(unit):
    points = unit * np.array([[0.0, 0.0], [1.0, 1.0], [1 + 2**-30, 1 + 2**-30 + 2**-52]])
    assert exact_check.inverted(points, np.array([[0, 1, 2]])) == 0
    assert exact_check.inverted(points, np.array([[0, 2, 1]])) == 1


def test_a_boundary_that_crosses_itself_is_not_simple():
    mesh = meshes.ring()
    assert exact_check.boundary_is_simple(mesh)
    points = mesh.points.clone()
    points[[0, 8]] = mesh.points[[8, 0]]  # two opposite vertices of the hole
    assert not exact_check.boundary_is_simple(mesh.with_points(points))
    points = mesh.points.clone()
    points[:16] += 5  # the hole leaves the domain
    assert not exact_check.boundary_is_simple(mesh.with_points(points))
