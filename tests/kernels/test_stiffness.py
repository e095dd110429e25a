"""The blocks of the stiffness matrix, compiled, against their twin of scipy's matrices: the same bits."""

import numpy as np
import torch
from both_loops import both
from meshes import delaunay, grid, jittered, ring

from torchmesh import join
from torchmesh.mesh.triangle import corners
from torchmesh.optimising.laplacian import cotangent_weights, stiffness_blocks


def systems(generator):
    """Triangles, weights and known vertices: sound ones, weights that cancel, triangles on each other, all known."""
    batch = join([ring(), delaunay(70, seed=1), jittered(6, 5, 0.2, 1)])
    sound = cotangent_weights(corners(batch.points, batch.triangles))
    some = torch.rand(len(batch.points), generator=generator) < 0.3
    whole = tuple(torch.randint(-1, 2, sound[0].shape, generator=generator).to(torch.float64) for _ in range(3))
    twice = torch.cat([batch.triangles, batch.triangles[::2].roll(1, 1)])  # a sum of two has one order
    odd = tuple(torch.randn(len(twice), generator=generator, dtype=torch.float64) for _ in range(3))
    right = grid(9, 8)  # the weights of the diagonals are 0
    return [
        (batch.triangles, sound, batch.fixed),
        (batch.triangles, whole, some),
        (batch.triangles, whole, torch.zeros_like(some)),
        (twice, odd, some),
        (right.triangles, cotangent_weights(corners(right.points, right.triangles)), right.fixed),
        (batch.triangles, sound, torch.ones_like(some)),
    ]


def test_blocks_have_the_same_bits(generator):
    for triangles, weights, known in systems(generator):
        expected, got = both(lambda t=triangles, w=weights, k=known: stiffness_blocks(t, w, k))
        for one, other in zip(expected, got, strict=True):
            for name, left, right in zip(("offsets", "columns", "values"), one, other, strict=True):
                np.testing.assert_array_equal(left, right, err_msg=name)
                assert left.dtype == right.dtype, name
