"""The blocks of the stiffness matrix, compiled, against their twin of scipy's matrices; its weights against torch."""

import numpy as np
import pytest
import torch
from both_loops import both
from meshes import delaunay, grid, jittered, ring

from torchmesh import join
from torchmesh.mesh.triangle import corners
from torchmesh.optimising.laplacian import cotangent_weights, edge_stiffness, stiffness_blocks
from torchmesh.warping.stiffened import affine_fit


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


@pytest.mark.parametrize("power", [0.0, 1.0, 0.5])
def test_stiffened_weights_are_those_of_torch(power):
    batch = join([ring(), delaunay(70, seed=1), jittered(6, 5, 0.2, 1)])
    given = batch.points, batch.triangles, batch.triangle_offsets
    expected, got = both(lambda: edge_stiffness(*given, power))
    for left, right in zip(expected, got, strict=True):
        # The two round a power in their own ways.
        torch.testing.assert_close(right, left, rtol=0 if power in (0, 1) else 4e-16, atol=0)


def test_affine_fits_are_those_of_torch(generator):
    batch = join([ring(), delaunay(70, seed=1), grid(3, 1)])
    displacement = torch.randn(batch.points.shape, generator=generator, dtype=torch.float64)
    displacement[~batch.fixed] = 0
    for points in (batch.points, torch.zeros_like(batch.points)):
        expected, got = both(lambda p=points: affine_fit(p, batch.fixed, displacement, batch.point_offsets))
        assert torch.equal(expected, got)
