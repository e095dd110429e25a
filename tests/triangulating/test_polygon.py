import numpy as np
import pytest
import shapely
from polygons import CROSSED, CROSSED_LOOPS, SQUARE, edges_of, star_with_holes

from torchmesh.triangulating.polygon import nested_holes, turns_left, why_not_simple, winding, windings


@pytest.mark.parametrize(
    ("points", "loops", "text"),
    [
        (SQUARE[[0, 2, 1, 3]], [[0, 1, 2, 3]], "meet"),
        (SQUARE, [[3, 2, 1, 0]], "0 outer loops"),
        (np.concatenate([SQUARE, 0.2 * SQUARE + 2]), [[0, 1, 2, 3], [7, 6, 5, 4]], "outside the outer loop"),
        (np.concatenate([SQUARE, 0.2 * SQUARE + 0.2]), [[0, 1, 2, 3], [4, 5, 6, 7]], "2 outer loops"),
        (np.concatenate([SQUARE, 0.2 * SQUARE]), [[0, 1, 2, 3], [7, 6, 5, 4]], "meet"),
        (
            np.concatenate([SQUARE, 0.5 * SQUARE + 0.2, 0.1 * SQUARE + 0.3]),
            [[0, 1, 2, 3], [7, 6, 5, 4], [11, 10, 9, 8]],
            "inside the one",
        ),
        (CROSSED, CROSSED_LOOPS, "crosses itself at vertex 2"),
    ],
)
def test_loops_that_bound_no_domain_are_named(points, loops, text):
    obstacle = why_not_simple(points, [np.array(loop) for loop in loops])
    assert text in str(obstacle)


def test_loops_that_touch_in_common_vertices_bound_a_domain():
    # A hole that touches the outer loop, and one that touches that hole.
    points = np.array([[0, 0], [4, 0], [8, 0], [8, 8], [0, 8], [6, 3], [4, 4], [2, 3], [6, 6], [2, 6]], float)
    loops = [np.arange(5), np.array([1, 7, 6, 5]), np.array([6, 9, 8])]
    assert why_not_simple(points, loops) is None


@pytest.mark.parametrize("seed", range(5))
def test_winding_against_shapely(seed):
    rng = np.random.default_rng(seed)
    rim, loops = star_with_holes(rng)
    points = np.concatenate([rim, rng.uniform(-1, 1, (500, 2))])
    inside = winding(points, np.arange(len(rim), len(points)), edges_of(loops))
    polygon = shapely.Polygon(rim[loops[0]], [rim[loop] for loop in loops[1:]])
    np.testing.assert_array_equal(inside, shapely.contains_xy(polygon, points[len(rim) :]).astype(int))
    assert turns_left(points, loops).tolist() == [1, -1, -1]
    # The same, edge by edge, for a vertex beside each edge.
    edges, vertices = edges_of(loops), np.arange(len(rim), len(points))
    beside = windings(points, vertices.repeat(len(edges)), np.tile(edges, (len(vertices), 1)))
    np.testing.assert_array_equal(beside.reshape(len(vertices), -1).sum(1), inside)


def test_nested_holes_are_found_by_sweep_and_by_tree(monkeypatch):
    squares = [((0, 0), 8), ((1, 1), 2), ((20, 0), 3), ((4, 1), 2)]
    points = np.concatenate([np.add(at, side * np.array([(0, 0), (0, 1), (1, 1), (1, 0)])) for at, side in squares])
    holes = [np.arange(4 * k, 4 * k + 4) for k in range(4)]
    for _ in range(2):
        assert nested_holes(points.astype(float), holes[1:]) is None
        inner, outer = nested_holes(points.astype(float), holes)
        assert outer.tolist() == [0, 1, 2, 3]
        assert inner.tolist() in ([4, 5, 6, 7], [12, 13, 14, 15])
        monkeypatch.setattr("torchmesh.triangulating.polygon.overlapping_boxes", lambda low, high: None)


@pytest.mark.parametrize("seed", range(6))
def test_winding_is_that_of_a_table_of_all_rays_and_edges(seed):
    # On a coarse lattice, where rays go through vertices and along edges.
    rng = np.random.default_rng(seed)
    points = rng.integers(0, 6, (60, 2)).astype(float)
    walk = rng.permutation(60)[:30]
    edges, every = np.stack([walk, np.roll(walk, -1)], 1), np.arange(60)
    x, y = points.T
    (a, b), q = edges.T, every[:, None]
    left = (x[b] - x[a]) * (y[q] - y[a]) - (y[b] - y[a]) * (x[q] - x[a])
    up, down = (y[a] <= y[q]) & (y[q] < y[b]), (y[b] <= y[q]) & (y[q] < y[a])
    expected = (up & (left > 0)).sum(1) - (down & (left < 0)).sum(1)
    assert np.array_equal(winding(points, every, edges), expected)
    assert expected.any()
