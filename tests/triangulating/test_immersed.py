"""Discs laid over themselves: triangulated where some triangulation exists, by brute force, and nowhere else."""

import numpy as np
import pytest
from exact import double_area

from torchmesh.triangulating.immersed import MOST, triangulate_immersed
from torchmesh.triangulating.polygon import loop_edges
from torchmesh.triangulating.polygon_triangulation import is_triangulation_of


def upright(points, corners):
    return all(double_area(*points[list(row)]) > 0 for row in corners)


def triangulations(loop):
    """Every way to cut a polygon into triangles, as lists of corners."""
    if len(loop) < 3:
        yield []
        return
    for k in range(1, len(loop) - 1):
        for one in triangulations(loop[: k + 1]):
            for two in triangulations(loop[k:]):
                yield [(loop[0], loop[k], loop[-1]), *one, *two]


def test_a_loop_is_triangulated_exactly_where_brute_force_finds_a_way(rng):
    found = {True: 0, False: 0}
    for _ in range(400):
        n = int(rng.integers(3, 8))
        points = rng.integers(-4, 5, (n, 2)).astype(float)
        loop = np.arange(n)
        possible = any(upright(points, way) for way in triangulations(list(range(n))))
        corners = triangulate_immersed(points, loop)
        assert (corners is not None) == possible
        found[possible] += 1
        if possible:
            assert len(corners) == n - 2
            assert upright(points, corners)
            assert is_triangulation_of(points, corners, loop_edges(loop))
    assert min(found.values()) > 30


@pytest.mark.parametrize("turns", [0.4, 1.0, 1.6, 2.3])
def test_strips_of_more_than_one_turn(turns):
    count = int(20 * turns) + 4
    angle = np.linspace(0, 2 * np.pi * turns, count)
    inner, outer = (r * np.stack([np.cos(angle), np.sin(angle)], 1) for r in (1.0, 1.4))
    points = np.concatenate([inner[::-1], outer])
    corners = triangulate_immersed(points, np.arange(len(points)))
    assert corners is not None
    assert is_triangulation_of(points, corners, loop_edges(np.arange(len(points))))
    assert triangulate_immersed(points, np.arange(len(points))[::-1]) is None


def test_long_loops_are_not_tried():
    angle = np.linspace(0, 2 * np.pi, MOST + 2)[:-1]
    points = np.stack([np.cos(angle), np.sin(angle)], 1)
    assert triangulate_immersed(points, np.arange(MOST + 1)) is None
    assert triangulate_immersed(points, np.arange(2)) is None
