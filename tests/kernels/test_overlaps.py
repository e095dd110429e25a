"""The compiled search for boxes, and the compiled clipping of triangles, against those in numpy."""

import numpy as np
import pytest
import torch
from both_loops import both
from pairs_of_meshes import pairs_of_meshes

from torchmesh import transfer
from torchmesh.transferring import overlaps as clipping
from torchmesh.transferring.overlaps import _upright_corners, overlaps
from torchmesh.transferring.pairs import both_sides, touching_boxes


@pytest.mark.parametrize("name", pairs_of_meshes())
def test_the_same_boxes_touch(name):
    old, new = both_sides(*pairs_of_meshes()[name])
    boxes = [(*side.triangle_boxes(), side.triangle) for side in (new, old)]
    for here in (boxes[0], tuple(v[::-1] for v in boxes[0]), tuple(v[:0] for v in boxes[0])):
        expected, got = both(lambda here=here: touching_boxes(old, here, boxes[1]))
        np.testing.assert_array_equal(expected[0], got[0])
        np.testing.assert_array_equal(expected[1], got[1])


@pytest.mark.parametrize("name", pairs_of_meshes())
@pytest.mark.parametrize("moments", [False, True])
def test_triangles_share_the_same_areas_to_the_bit(name, moments):
    old, new = both_sides(*pairs_of_meshes()[name])
    expected, got = both(lambda: overlaps(old, new, moments=moments))
    for one, other in zip(expected, got, strict=True):
        np.testing.assert_array_equal(one, other)
    assert len(expected.area) > 50 or name == "nothing in common"


def test_every_cut_has_the_bits_of_numpy():
    """Pairs of every kind: apart, one inside the other, stars, common corners and edges, and without area."""
    rng = np.random.default_rng(0)
    corners = rng.integers(0, 4, (2, 6, 4000)) + rng.choice([0.0, 0.25, 1e-9], (2, 6, 4000))
    order = np.arange(4000)
    area, moments = clipping._clipped(corners[0], order, corners[1], order, True)
    compiled, integrals = clipping.shared_areas(corners[0], order, corners[1], order, True)
    np.testing.assert_array_equal(area, compiled)
    np.testing.assert_array_equal(moments, integrals)
    assert 500 < (area > 0).sum() < 3500


def test_upright_corners_are_what_the_loops_expect():
    old, _ = both_sides(*pairs_of_meshes()["tangled"])
    x, y = _upright_corners(old).reshape(2, 3, -1)
    assert bool(((x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0]) >= 0).all())


@pytest.mark.parametrize("where", ["points", "triangles"])
@pytest.mark.parametrize("name", ["moved", "tangled", "graded", "several"])
def test_transferred_values_are_the_same_to_the_bit(name, where, generator):
    before, after = pairs_of_meshes()[name]
    rows = len(before.points) if where == "points" else len(before.triangles)
    values = torch.rand(rows, generator=generator, dtype=torch.float64)
    expected, got = both(lambda: transfer(before, after, values, where))
    assert torch.equal(expected, got)
