"""The limits that a boundary sets hold for every mesh and are reached by some."""

import math

import meshes
import numpy as np
import pytest
import torch

import torchmesh as tm
from experiments.quality.limits import boundary_limits, least_mean_without_interior


def test_limits_of_known_boundaries():
    square = boundary_limits(meshes.grid(4, 4))
    # Two triangles in each corner, of 45 degrees between equal sides.
    assert square.angle == pytest.approx(45, abs=1e-9)
    t = math.pi / 4
    assert square.ratio == pytest.approx((2 - math.cos(t)) / (math.sqrt(3) * math.sin(t)), rel=1e-12)
    hexagon = boundary_limits(meshes.disc(6, 1))
    assert hexagon.angle == pytest.approx(60, abs=1e-6)
    assert hexagon.ratio == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_no_mesh_passes_the_limit_of_its_boundary(seed):
    mesh = meshes.delaunay(40, seed) if seed % 2 else meshes.disturbed(meshes.l_shape(4), 0.02, seed)
    limits = boundary_limits(mesh)
    assert float(tm.quality(mesh).max) >= limits.ratio * (1 - 1e-12)
    assert float(tm.minimum_angle(mesh)) <= limits.angle + 1e-9


def test_a_fan_of_equal_triangles_reaches_the_limit():
    # Three triangles of one shape in a corner between sides of lengths 1 and 6.
    turn, length = math.pi / 2 * torch.arange(4) / 3, 6 ** (torch.arange(4) / 3)
    ends = torch.stack([length * turn.cos(), length * turn.sin()], 1)
    fan = tm.MeshBatch.from_arrays(torch.cat([torch.zeros(1, 2), ends]).double(), [[0, 1, 2], [0, 2, 3], [0, 3, 4]])
    angle = math.degrees(math.atan2(math.sin(math.pi / 6), 6 ** (1 / 3) - math.cos(math.pi / 6)))
    # The corners were made in single precision.
    assert float(tm.minimum_angle(fan)) == pytest.approx(angle, rel=1e-5)
    assert boundary_limits(fan).angle <= angle + 1e-4


def test_the_least_mean_is_that_of_the_best_triangulation():
    # A rhombus of two equilateral triangles; cut the other way, both have a worse shape.
    rhombus = np.array([[0.0, 0.0], [1.0, 0.0], [1.5, math.sqrt(3) / 2], [0.5, math.sqrt(3) / 2]])
    assert least_mean_without_interior(rhombus) == pytest.approx(1, rel=1e-12)
    # A dart can be cut in one way only.
    dart = np.array([[0.0, 0.0], [2.0, -1.0], [1.0, 0.0], [2.0, 1.0]])
    mesh = tm.MeshBatch.from_arrays(dart, [[0, 1, 2], [0, 2, 3]])
    assert least_mean_without_interior(dart) == pytest.approx(float(tm.quality(mesh).mean), rel=1e-12)
