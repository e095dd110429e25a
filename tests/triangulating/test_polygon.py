import itertools

import numpy as np
import pytest
import shapely

from torchmesh.triangulating.arrays import Obstacle, among, distinct, signs
from torchmesh.triangulating.polygon import (
    _cut_out,
    _proposed,
    crossing_pairs,
    is_triangulation_of,
    locate,
    loop_edges,
    nested_holes,
    triangulate_polygon,
    triangulate_with,
    turns_left,
    why_not_simple,
    winding,
)
from torchmesh.triangulating.triangulation import Triangulation


def star(count, rng, low=0.5, high=1.0):
    angle = 2 * np.pi * np.arange(count) / count
    radius = rng.uniform(low, high, count)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1)


def star_with_holes(rng):
    """A star-shaped outer loop and two star-shaped holes: points and loops."""
    parts = [star(int(rng.integers(8, 60)), rng)]
    parts += [0.15 * star(int(rng.integers(3, 20)), rng) + centre for centre in ([-0.22, 0.0], [0.22, 0.0])]
    starts = np.cumsum([0, *map(len, parts)])
    loops = [np.arange(a, b) for a, b in itertools.pairwise(starts)]
    return np.concatenate(parts), [loops[0], loops[1][::-1].copy(), loops[2][::-1].copy()]


def rim_of(loops):
    return np.concatenate([loop_edges(loop) for loop in loops])


@pytest.mark.parametrize("seed", range(20))
def test_proposal_and_exact_construction_triangulate_polygons_with_holes(seed):
    points, loops = star_with_holes(np.random.default_rng(seed))
    assert why_not_simple(points, loops) is None
    for corners in (_proposed(points, loops), _cut_out(points, loops, np.ones(len(points)))):
        assert is_triangulation_of(points, corners, rim_of(loops))
        assert len(corners) == len(points) - 2 + 2 * (len(loops) - 1)


@pytest.mark.parametrize("size", [0, 1, 7, 300])
def test_distinct_and_among_are_what_numpy_has(size):
    rng = np.random.default_rng(size)
    values, others = rng.integers(-20, 20, size), rng.integers(-20, 20, (5, 2))
    assert np.array_equal(distinct(values), np.unique(values))
    assert np.array_equal(among(values, others), np.isin(values, others))
    assert np.array_equal(among(others, values), np.isin(others, values))


def turned(corners):
    """The triangles as a set, each from its lowest vertex on."""
    first = corners.argmin(1)[:, None]
    return set(map(tuple, np.take_along_axis(corners, (first + np.arange(3)) % 3, 1).tolist()))


def star_with_vertices(seed, scale=1.0, offset=0.0):
    """A star with holes, vertices in and round it, a segment between two of those inside; which are inside."""
    rng = np.random.default_rng(seed)
    points, loops = star_with_holes(rng)
    inner = len(points) + np.arange(60)
    points = np.concatenate([points, rng.uniform(-1, 1, (60, 2))]) * scale + offset
    inside = inner[winding(points, inner, rim_of(loops)) == 1]
    rim = rim_of(loops)
    pairs = (np.array([[u, v]]) for u, v in itertools.combinations(inside.tolist(), 2))
    segment = next(pair for pair in pairs if not len(crossing_pairs(points, np.concatenate([rim, pair]))))
    return points, loops, inner, inside, segment


@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (1.0, 1e6), (2.0**-100, 0.0), (2.0**100, 0.0)])
@pytest.mark.parametrize("seed", range(8))
def test_all_at_once_is_what_step_by_step_comes_to(seed, scale, offset):
    points, loops, inner, inside, segment = star_with_vertices(seed, scale, offset)
    spacing = np.where(np.arange(len(points)) < inner[0], scale, 0.0)
    made = triangulate_with(points.copy(), loops, spacing.copy(), inner, segment)
    assert is_triangulation_of(made.points, made.corners, rim_of(loops))
    assert np.array_equal(np.unique(made.corners), np.sort(np.concatenate([*loops, inside])))
    assert np.array_equal(made.spacing[inside], np.full(len(inside), scale))
    locked = made.corners.ravel()[made.locked]
    assert np.array_equal(np.sort(locked), np.sort(segment[0]))
    slow = triangulate_polygon(points.copy(), loops, spacing)
    slow.insert(inside, locate(points, inside, slow.corners))
    assert slow.recover(segment) is None
    slow.flip_to_delaunay(np.arange(len(slow.corners)))
    assert turned(made.corners) == turned(slow.corners)


def test_all_at_once_leaves_to_others_what_is_hard():
    square, none = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]), np.zeros((0, 2), np.int64)
    loops, spacing = [np.arange(4)], np.ones(6)

    def made(*places):
        points = np.concatenate([square, places])
        return triangulate_with(points, loops, spacing[: len(points)].copy(), np.arange(4, len(points)), none)

    assert len(made([0.5, 0.25], [0.25, 0.5]).corners) == 6
    # Of two in one place the first is in; outside none is.
    twice = made([0.5, 0.25], [0.5, 0.25])
    assert np.array_equal(np.unique(twice.corners), np.arange(5))
    assert np.array_equal(np.unique(made([2.0, 0.5], [0.5, -1e-300]).corners), np.arange(4))
    # On the rim, or in the place of one of its vertices.
    assert made([0.0, 0.5]) is None
    corner = made([0.0, 0.0])
    assert corner is None or np.array_equal(np.unique(corner.corners), np.arange(4))
    points = np.concatenate([square, [[0.5, 0.25], [0.5, 0.75]]])
    # Where fourth powers leave the range of numbers.
    assert triangulate_with(points * 2.0**600, loops, spacing.copy(), np.array([4, 5]), none) is None
    crossed = np.array([[0, 5], [3, 4]])
    assert triangulate_with(points, loops, spacing.copy(), np.array([4, 5]), crossed) is None


@pytest.mark.parametrize(
    ("scale", "offset"), [(1.0, 0.0), (1.0, 1e8), (2.0**-20, 1e8), (2.0**-300, 0.0), (2.0**300, 0.0)]
)
@pytest.mark.parametrize("seed", range(3))
def test_exact_construction_at_any_scale(seed, scale, offset):
    points, loops = star_with_holes(np.random.default_rng(seed))
    points = points * scale + offset
    corners = _cut_out(points, loops, np.ones(len(points)))
    assert is_triangulation_of(points, corners, rim_of(loops))


def test_collinear_vertices_are_all_used():
    side = np.linspace(0, 1, 11)[:-1]
    corners = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2], [0, 0]], float)
    points = np.concatenate([a + side[:, None] * (b - a) for a, b in itertools.pairwise(corners)])
    loops = [np.arange(len(points))]
    for made in (_proposed(points, loops), _cut_out(points, loops, np.ones(len(points)))):
        assert is_triangulation_of(points, made, rim_of(loops))
        assert len(made) == len(points) - 2


@pytest.mark.parametrize("width", [1e-6, 1e-12, 5e-324])
def test_thin_slot(width):
    """A slot cut into a square, so narrow that its areas round to nothing."""
    across = np.linspace(0.1, 1.0, 7)
    upper = np.stack([across, np.full(7, width)], 1)
    lower = np.stack([across[::-1], np.zeros(7)], 1)
    points = np.concatenate([[[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]], lower, upper])
    loops = [np.arange(len(points))]
    made = triangulate_polygon(points, loops, np.ones(len(points)))
    assert is_triangulation_of(points, made.corners, rim_of(loops))


def test_exact_construction_where_the_proposal_is_refused(monkeypatch):
    points, loops = star_with_holes(np.random.default_rng(0))
    monkeypatch.setattr("torchmesh.triangulating.polygon._proposed", lambda *_: None)
    made = triangulate_polygon(points, loops, np.ones(len(points)))
    assert is_triangulation_of(points, made.corners, rim_of(loops))


def test_hole_that_touches_the_outer_loop_in_a_common_vertex():
    points = np.array([[0, 0], [2, 0], [4, 0], [4, 3], [0, 3], [3, 1], [1, 1]], float)
    loops = [np.arange(5), np.array([1, 6, 5])]
    assert why_not_simple(points, loops) is None
    for corners in (_proposed(points, loops), _cut_out(points, loops, np.ones(len(points)))):
        assert corners is None or is_triangulation_of(points, corners, rim_of(loops))
    assert not isinstance(triangulate_polygon(points, loops, np.ones(7)), Obstacle)


SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)


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
    ],
)
def test_loops_that_bound_no_domain_are_named(points, loops, text):
    obstacle = triangulate_polygon(points, [np.array(loop) for loop in loops], np.ones(len(points)))
    assert isinstance(obstacle, Obstacle)
    assert text in str(obstacle)


@pytest.mark.parametrize("seed", range(10))
def test_crossing_pairs_against_all_pairs(seed):
    """On a coarse lattice, so that touching, overlapping and shared ends abound."""
    rng = np.random.default_rng(seed)
    lattice = rng.permutation(25)[:14]
    points = np.stack([lattice % 5, lattice // 5], 1).astype(float)
    segments = np.unique(np.sort(np.stack([rng.permutation(14)[:2] for _ in range(20)]), 1), axis=0)
    found = {tuple(sorted(pair)) for pair in crossing_pairs(points, segments).tolist()}
    lines = shapely.linestrings(points[segments])
    for i in range(len(segments)):
        for j in range(i + 1, len(segments)):
            common = lines[i].intersection(lines[j])
            shared = set(segments[i]) & set(segments[j])
            allowed = common.is_empty or (common.geom_type == "Point" and len(shared) == 1)
            assert ((i, j) in found) == (not allowed), (segments[i], segments[j])


@pytest.mark.parametrize("seed", range(5))
def test_winding_against_shapely(seed):
    rng = np.random.default_rng(seed)
    rim, loops = star_with_holes(rng)
    points = np.concatenate([rim, rng.uniform(-1, 1, (500, 2))])
    inside = winding(points, np.arange(len(rim), len(points)), rim_of(loops))
    polygon = shapely.Polygon(rim[loops[0]], [rim[loop] for loop in loops[1:]])
    np.testing.assert_array_equal(inside, shapely.contains_xy(polygon, points[len(rim) :]).astype(int))
    assert turns_left(points, loops).tolist() == [1, -1, -1]


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
        obstacle = work.recover(np.array([[u, v]]))
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
    assert work.recover(np.array([[4, 5]])) is None
    assert is_triangulation_of(points, work.corners, loop_edges(np.arange(4)))
    assert "passes through vertex" in str(work.recover(np.array([[6, 17]])))


@pytest.mark.parametrize("seed", range(10))
def test_recover_on_a_lattice(seed):
    """Many vertices are equally far from the line: strict convexity hangs on how ties are broken."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(9.0), np.arange(9.0))
    points = np.concatenate([20 * SQUARE - 6, np.stack([x.ravel(), y.ravel()], 1)])
    for _ in range(20):
        work = triangulate_polygon(points, [np.arange(4)], np.ones(len(points)))
        vertices = rng.permutation(np.arange(4, len(points)))
        assert len(work.insert(vertices, locate(points, vertices, work.corners), seed)) == 0
        u, v = rng.permutation(vertices)[:2]
        primitive = np.gcd(*np.abs(points[u] - points[v]).astype(int)) == 1
        obstacle = work.recover(np.array([[u, v]]))
        assert (obstacle is None) == primitive
        assert primitive or "passes through vertex" in str(obstacle)
        assert is_triangulation_of(points, work.corners, loop_edges(np.arange(4)))


def test_two_angles_of_almost_pi_are_flipped_away():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 1e-14], [0.5, -1e-14]])
    work = Triangulation(points, np.array([[0, 1, 2], [1, 0, 3]]), np.ones(4))
    work.flip_to_delaunay(np.arange(2))
    assert all({2, 3} <= set(t) for t in work.corners.tolist())
    assert (signs(points, *work.corners.T) > 0).all()


def locked_edges(work):
    flat, ahead = work.corners.ravel(), np.roll(work.corners, -1, 1).ravel()
    return np.stack([flat, ahead], 1)[work.locked].tolist()


def test_insert_refuses_duplicates_and_the_rim_and_splits_edges():
    points = np.concatenate([SQUARE, [[0.5, 0.5], [0.5, 0.5], [0.5, 0.0], [0.25, 0.25], [1.0, 1.0]]])
    work = Triangulation(points, np.array([[0, 1, 2], [0, 2, 3]]), np.ones(len(points)))
    refused = work.insert(np.arange(4, 9), np.zeros(5, np.int64))
    assert len(refused) == 3
    assert {6, 8} < set(refused.tolist()) < {4, 5, 6, 8}
    assert is_triangulation_of(points, work.corners, loop_edges(np.arange(4)))
    assert set(work.corners.ravel().tolist()) == set(range(9)) - set(refused.tolist())


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_spread_stays_inside_and_stops_where_floating_point_ends(dtype):
    rim = np.array([[1.0, 1.0], [1.0 + 8 * np.finfo(dtype).eps, 1.0], [1.0, 1.0 + 8 * np.finfo(dtype).eps]])
    points = np.concatenate([rim, np.zeros((100, 2))])
    work = Triangulation(points, np.array([[0, 1, 2]]), np.ones(len(points)))
    left = work.spread(np.arange(3, 103), np.dtype(dtype))
    assert 0 < len(left) < 100
    assert (signs(points, *work.corners.T) > 0).all()
    np.testing.assert_array_equal(points[3:103].astype(dtype), points[3:103])


@pytest.mark.parametrize("seed", range(6))
def test_pairs_are_the_same_by_sweep_and_by_tree(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    # Places on a small lattice, so that segments also touch, overlap and share ends.
    points = rng.integers(0, 12, (60, 2)).astype(float)
    segments = rng.integers(0, 60, (80, 2))
    segments = segments[segments[:, 0] != segments[:, 1]]
    group = rng.integers(0, 3, 60)[segments[:, 0]] if seed % 2 else None
    swept = crossing_pairs(points, segments, group)
    assert len(swept) > 20
    assert (np.diff(swept[:, 0] * len(segments) + swept[:, 1]) > 0).all()
    monkeypatch.setattr("torchmesh.triangulating.polygon._swept", lambda low, high: None)
    assert sorted(map(tuple, crossing_pairs(points, segments, group).tolist())) == list(map(tuple, swept.tolist()))


def test_nested_holes_are_found_by_sweep_and_by_tree(monkeypatch):
    squares = [((0, 0), 8), ((1, 1), 2), ((20, 0), 3), ((4, 1), 2)]
    points = np.concatenate([np.add(at, side * np.array([(0, 0), (0, 1), (1, 1), (1, 0)])) for at, side in squares])
    holes = [np.arange(4 * k, 4 * k + 4) for k in range(4)]
    for _ in range(2):
        assert nested_holes(points.astype(float), holes[1:]) is None
        inner, outer = nested_holes(points.astype(float), holes)
        assert outer.tolist() == [0, 1, 2, 3]
        assert inner.tolist() in ([4, 5, 6, 7], [12, 13, 14, 15])
        monkeypatch.setattr("torchmesh.triangulating.polygon._swept", lambda low, high: None)


@pytest.mark.parametrize("seed", range(4))
def test_vertices_are_located_alike_by_table_and_by_tree(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    rim, loops = star_with_holes(rng)
    corners = _cut_out(rim, loops, np.ones(len(rim)))
    middles = (rim[corners[:, 0]] + rim[corners[:, 1]]) / 2
    points = np.concatenate([rim, rng.uniform(-1, 1, (50, 2)), middles])
    vertices = np.arange(len(points))
    home = locate(points, vertices, corners)
    assert (home[: len(rim)] >= 0).all()
    assert -1 in home
    monkeypatch.setattr("torchmesh.triangulating.polygon._TABLE", 0)
    assert locate(points, vertices, corners).tolist() == home.tolist()
