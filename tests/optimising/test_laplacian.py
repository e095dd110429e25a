"""The stiffness matrix of the Laplacian and its parts, against matrices that are assembled from hat functions."""

import meshes
import numpy as np
import pytest
import torch
from linear_elements import stiffness
from scipy.sparse.linalg import spsolve

from torchmesh.mesh import connectivity
from torchmesh.mesh.triangle import corners
from torchmesh.optimising.laplacian import InnerStiffness, cotangent_weights, harmonic_extension

GOOD = [name for name in meshes.VALID if name != "bowtie"]


@pytest.mark.parametrize("name", GOOD)
def test_cotangent_weights_are_the_stiffness_matrix(name):
    mesh = meshes.VALID[name]()
    weights = cotangent_weights(corners(mesh.points, mesh.triangles))
    k = np.zeros((len(mesh.points),) * 2)
    for w, (i, j) in zip(weights, ((1, 2), (2, 0), (0, 1)), strict=True):
        np.add.at(k, (mesh.triangles[:, i].numpy(), mesh.triangles[:, j].numpy()), -w.numpy())
    k = k + k.T
    k -= np.diag(k.sum(1))
    # Entries are cotangents: for the worst sliver about 30.
    np.testing.assert_allclose(k, stiffness(mesh), rtol=0, atol=1e-11)


def test_products_with_the_inner_stiffness_are_those_of_the_assembled_matrix():
    mesh = meshes.jittered(6, 5, 0.2, 1)
    weights = cotangent_weights(corners(mesh.points, mesh.triangles))
    twin = connectivity.twins(mesh.triangles)
    known = mesh.fixed.clone()
    known[(~known).nonzero()[3]] = True
    stiffness = InnerStiffness.of(mesh.triangles, twin, weights, known)
    dense = torch.zeros(len(known), len(known), dtype=torch.float64)
    for row, *by_corner in zip(mesh.triangles.tolist(), *(w.tolist() for w in weights), strict=True):
        for corner, weight in enumerate(by_corner):
            i, j = row[(corner + 1) % 3], row[(corner + 2) % 3]
            dense[i, i] += weight
            dense[j, j] += weight
            dense[i, j] -= weight
            dense[j, i] -= weight
    values = torch.randn(len(known), dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    inner = dense[~known]
    assert stiffness.size == len(inner)
    assert torch.allclose(stiffness @ values[~known], inner[:, ~known] @ values[~known], rtol=1e-12, atol=1e-12)
    assert torch.allclose(stiffness.diagonal(), inner[:, ~known].diagonal(), rtol=1e-12)
    assert torch.allclose(stiffness.load(values), -inner[:, known] @ values[known], rtol=1e-12, atol=1e-12)


def test_harmonic_extension_of_any_number_of_columns(rng):
    mesh = meshes.grid()
    one = torch.ones(len(mesh.triangles), dtype=torch.float64)
    values = torch.from_numpy(rng.normal(size=(len(mesh.points), 3)))
    wide = harmonic_extension(mesh.triangles, (one, one, one), mesh.fixed, values, mesh.point_offsets)
    for column in range(3):
        single = values[:, column : column + 1]
        narrow = harmonic_extension(mesh.triangles, (one, one, one), mesh.fixed, single, mesh.point_offsets)
        torch.testing.assert_close(wide[:, column : column + 1], narrow, rtol=0, atol=1e-14)
    # No maximum inside (the weights are positive).
    assert float(wide[~mesh.fixed].max()) < float(values[mesh.fixed].max())


def test_harmonic_extension_agrees_with_scipys_solver():
    from scipy.sparse import csr_matrix

    mesh = meshes.delaunay()
    k, fixed = csr_matrix(stiffness(mesh)), mesh.fixed.numpy()
    values = mesh.points[:, :1] ** 2
    expected = spsolve(k[~fixed][:, ~fixed].tocsc(), -k[~fixed][:, fixed] @ values.numpy()[fixed])
    weights = cotangent_weights(corners(mesh.points, mesh.triangles))
    got = harmonic_extension(mesh.triangles, weights, mesh.fixed, values, mesh.point_offsets)
    np.testing.assert_allclose(got[~mesh.fixed].numpy().ravel(), expected.ravel(), rtol=0, atol=1e-12)
