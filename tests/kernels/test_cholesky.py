"""The compiled factorisation against SuperLU and dense matrices: the same solutions, to rounding."""

import gc

import numpy as np
import pytest
import torch
from both_loops import both
from meshes import delaunay, grid, jittered, ring

from torchmesh import join
from torchmesh.kernels import cholesky, library
from torchmesh.mesh.triangle import corners
from torchmesh.optimising.laplacian import cotangent_weights, factorised, harmonic_extension, stiffness_blocks


def rows_of(dense):
    """A dense matrix in compressed rows."""
    some = dense != 0
    offsets = np.concatenate([[0], some.sum(1).cumsum()]).astype(np.int32)
    return offsets, np.nonzero(some)[1].astype(np.int32), dense[some]


def graph(size, edges, rng):
    """A symmetric matrix, strictly diagonally dominant, with entries at the edges."""
    dense = np.zeros((size, size))
    for i, j in edges:
        dense[i, j] = dense[j, i] = -rng.uniform(0.5, 2)
    return dense - np.diag(dense.sum(1) - rng.uniform(0.5, 1, size))


def graphs(rng):
    """Paths, a wheel's hub, parts that hang together by nothing, everything joined to everything, nothing."""
    several = [(i, i + 1) for i in range(20)] + [(i, i + 1) for i in range(25, 60)] + [(61, 99), (3, 9)]
    return [graph(40, [(i, i + 1) for i in range(39)], rng), graph(50, [(0, i) for i in range(1, 50)], rng),
            graph(100, several, rng), graph(30, [(i, j) for i in range(30) for j in range(i)], rng),
            graph(7, [], rng)]  # fmt: skip


def test_solutions_are_those_of_dense_matrices(rng):
    matrices = graphs(rng)
    for dense in matrices:
        right = rng.normal(size=(len(dense), 3))
        (factors,) = factorised(rows_of(dense), np.array([0, len(dense)]), True)
        out = np.empty_like(right)
        factors.solve(right, out)
        np.testing.assert_allclose(out, np.linalg.solve(dense, right), rtol=0, atol=1e-13)


def test_meshes_of_a_batch_have_the_bits_that_they_have_alone(rng, monkeypatch):
    batch = join([delaunay(70, seed=1), ring(), jittered(6, 5, 0.2, 1), grid(9, 8), ring()])
    values = torch.from_numpy(rng.normal(size=(len(batch.points), 2)))

    def extended(mesh, given):
        weights = cotangent_weights(corners(mesh.points, mesh.triangles))
        return harmonic_extension(mesh.triangles, weights, mesh.fixed, given, mesh.point_offsets)

    expected, got = both(lambda: extended(batch, values))
    torch.testing.assert_close(got, expected, rtol=0, atol=1e-12)
    assert not torch.equal(got, expected), "the compiled factorisation was not used"
    with library.using("compiled"):
        alone = [extended(m, v) for m, v in zip(batch.split(), values.split(np.diff(batch.point_offsets).tolist()))]  # noqa: B905
        assert torch.equal(torch.cat(alone), got)
        monkeypatch.setattr(cholesky, "_WORK", 20)
        assert torch.equal(extended(batch, values), got), "groups of meshes change bits"


def test_what_is_kept_of_the_last_pattern_serves_no_other(rng):
    """Matrices of one size: the same pattern with other values, other patterns, and the first again."""
    path, wheel = [(i, i + 1) for i in range(39)], [(0, i) for i in range(1, 40)]
    right, solutions = rng.normal(size=(40, 2)), []
    matrices = [graph(40, edges, rng) for edges in (path, path, wheel, path[:20], path)]
    for dense in [*matrices, *matrices[::-1]]:
        (factors,) = factorised(rows_of(dense), np.array([0, 40]), True)
        out = np.empty_like(right)
        factors.solve(right, out)
        np.testing.assert_allclose(out, np.linalg.solve(dense, right), rtol=0, atol=1e-13)
        solutions.append(out)
    for there, back in zip(solutions[:5], solutions[:4:-1], strict=True):
        np.testing.assert_array_equal(there, back)


def test_a_matrix_without_an_inverse_is_refused_and_the_memory_is_given_back():
    dense = np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 2.0]])
    rows = rows_of(dense)
    with pytest.raises(RuntimeError, match="singular"):
        factorised(rows, np.array([0, 3]), True)
    (factors,) = factorised(rows_of(dense + np.eye(3)), np.array([0, 3]), True)
    with library.using("torch"):
        del factors
        gc.collect()


def test_weights_of_no_edge_leave_vertices_alone():
    mesh = grid(3, 3)
    zero = torch.zeros(len(mesh.triangles), dtype=torch.float64)
    (offsets, columns, _), _ = stiffness_blocks(mesh.triangles, (zero, zero, zero), mesh.fixed)
    assert offsets.tolist() == [0] * len(offsets)
    assert len(columns) == 0
