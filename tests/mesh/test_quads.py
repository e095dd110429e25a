"""Inverted quads are those with a corner that is not upright, whichever way round a file lists them."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchmesh.mesh.quads import inverted_quads, oriented_quads

SQUARE = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], dtype=torch.float64)
ROW = torch.tensor([[0, 1, 2, 3]])


@pytest.mark.parametrize(
    ("where", "inverted"),
    [([1.0, 1.0], False), ([0.6, 0.6], False), ([0.5, 0.5], True), ([0.2, 0.2], True), ([-1.0, 0.5], True)],
    ids=["square", "kite", "corner of 180 degrees", "dart", "folded"],
)
def test_one_corner_decides(where, inverted):
    points = SQUARE.clone()
    points[2] = torch.tensor(where)
    for k in range(4):
        assert inverted_quads(points, ROW.roll(k, 1)).tolist() == [inverted]
    assert inverted_quads(points, ROW.flip(1)).tolist() == [True]


@given(st.lists(st.tuples(st.integers(-3, 3), st.integers(-3, 3)), min_size=4, max_size=4))
def test_corners_agree_with_fractions(positions):
    scale = 1 / 3
    points = torch.tensor(positions, dtype=torch.float64) * scale
    exact = [(Fraction(x * scale), Fraction(y * scale)) for x, y in positions]

    def area(a, b, c):
        (ax, ay), (bx, by), (cx, cy) = (exact[i] for i in (a, b, c))
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

    want = any(area((k - 1) % 4, k, (k + 1) % 4) <= 0 for k in range(4))
    assert inverted_quads(points, ROW).tolist() == [want]


@pytest.mark.parametrize("flips", list(itertools.product([False, True], repeat=2)))
def test_quads_are_wound_as_the_triangles_beside_them(flips):
    """A triangle, and two quads beside it, each listed either way round."""
    points = torch.tensor([[0.0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1], [3, 0]], dtype=torch.float64)
    triangles = torch.tensor([[4, 6, 5]])
    upright = torch.tensor([[0, 1, 2, 3], [1, 4, 5, 2]])
    listed = torch.stack([q.flip(0) if flip else q for q, flip in zip(upright, flips, strict=True)])
    found = oriented_quads(points, triangles, listed)
    assert not inverted_quads(points, found).any()
    moved = points.clone()
    moved[2] = torch.tensor([1.9, 0.05], dtype=torch.float64)
    assert inverted_quads(moved, oriented_quads(moved, triangles, listed)).tolist() == [False, True]


def test_quads_that_fit_no_mesh_are_judged_as_they_are():
    points = torch.from_numpy(np.vstack([SQUARE, [[0.5, 2.0]]]))
    twice = torch.cat([ROW, ROW, ROW.flip(1)])
    found = oriented_quads(points, torch.tensor([[3, 2, 4]]), twice)
    assert torch.equal(found, twice)
    assert inverted_quads(points, found).tolist() == [False, False, True]
