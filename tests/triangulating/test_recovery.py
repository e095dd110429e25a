import copy

import numpy as np
import pytest
import shapely
from polygons import SQUARE

from torchmesh.triangulating.polygon import loop_edges
from torchmesh.triangulating.polygon_triangulation import is_triangulation_of, locate, triangulate_polygon
from torchmesh.triangulating.recovery import recover


def locked_edges(work):
    flat, ahead = work.corners.ravel(), np.roll(work.corners, -1, 1).ravel()
    return np.stack([flat, ahead], 1)[work.locked].tolist()


@pytest.mark.parametrize("seed", range(10))
def test_recover_makes_any_edge_that_nothing_stands_in(seed):
    rng = np.random.default_rng(seed)
    points = np.concatenate([4 * SQUARE - 2, rng.uniform(-1, 1, (60, 2))])
    work = triangulate_polygon(points, [np.arange(4)], np.ones(64))
    vertices = np.arange(4, 64)
    assert len(work.insert(vertices, locate(points, vertices, work.corners))) == 0
    for u, v in [rng.permutation(vertices)[:2] for _ in range(30)]:
        before = {tuple(sorted(e)) for e in locked_edges(work)}
        lines = shapely.linestrings(points[np.array(sorted(before), int).reshape(-1, 2)])
        crosses = shapely.crosses(lines, shapely.linestrings(points[[u, v]])).any()
        obstacle = recover(work, np.array([[u, v]]))
        assert (obstacle is not None) == crosses
        after = {tuple(sorted(e)) for e in locked_edges(work)}
        assert after == before | (set() if crosses else {tuple(sorted((int(u), int(v))))})
        assert is_triangulation_of(points, work.corners, loop_edges(np.arange(4)))
        h = np.arange(len(work.twin))[work.twin >= 0]
        np.testing.assert_array_equal(work.twin[work.twin[h]], h)


def test_recover_ends_across_a_long_strip_of_collinear_vertices():
    """Vertices in two straight rows: every choice of the farthest one is a tie."""
    x = np.arange(12.0)
    rows = np.concatenate([np.stack([x, np.full(12, y)], 1) for y in (1.0, -1.0)])
    points = np.concatenate([[[-3.0, -3.0], [15.0, -3.0], [15.0, 3.0], [-3.0, 3.0], [-1.0, 0.0], [12.0, 0.0]], rows])
    work = triangulate_polygon(points, [np.arange(4)], np.ones(len(points)))
    vertices = np.arange(4, len(points))
    assert len(work.insert(vertices, locate(points, vertices, work.corners))) == 0
    assert recover(work, np.array([[4, 5]])) is None
    assert is_triangulation_of(points, work.corners, loop_edges(np.arange(4)))
    assert "passes through vertex" in str(recover(work, np.array([[6, 17]])))


@pytest.mark.parametrize("seed", range(10))
def test_recover_on_a_lattice(seed):
    """Many vertices are equally far from the line: strict convexity hangs on how ties are broken."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(9.0), np.arange(9.0))
    points = np.concatenate([20 * SQUARE - 6, np.stack([x.ravel(), y.ravel()], 1)])
    for trial in range(20):
        if trial % 5 == 0:
            made = triangulate_polygon(points, [np.arange(4)], np.ones(len(points)))
            vertices = rng.permutation(np.arange(4, len(points)))
            assert len(made.insert(vertices, locate(points, vertices, made.corners), seed)) == 0
        work = copy.deepcopy(made)
        u, v = rng.permutation(vertices)[:2]
        primitive = np.gcd(*np.abs(points[u] - points[v]).astype(int)) == 1
        obstacle = recover(work, np.array([[u, v]]))
        assert (obstacle is None) == primitive
        assert primitive or "passes through vertex" in str(obstacle)
        assert is_triangulation_of(points, work.corners, loop_edges(np.arange(4)))
