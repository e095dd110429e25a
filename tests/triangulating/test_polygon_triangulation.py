import itertools

import numpy as np
import pytest
from polygons import CROSSED, CROSSED_LOOPS, edges_of, star_with_holes, star_with_vertices

from torchmesh.triangulating.arrays import Obstacle
from torchmesh.triangulating.polygon import why_not_simple
from torchmesh.triangulating.polygon_triangulation import (
    _cut_out,
    _proposed,
    is_triangulation_of,
    locate,
    triangulate_polygon,
    triangulate_with,
)
from torchmesh.triangulating.recovery import recover


@pytest.mark.parametrize("seed", range(20))
def test_proposal_and_exact_construction_triangulate_polygons_with_holes(seed):
    points, loops = star_with_holes(np.random.default_rng(seed))
    assert why_not_simple(points, loops) is None
    for corners in (_proposed(points, loops), _cut_out(points, loops, np.ones(len(points)))):
        assert is_triangulation_of(points, corners, edges_of(loops))
        assert len(corners) == len(points) - 2 + 2 * (len(loops) - 1)


def turned(corners):
    """The triangles as a set, each from its lowest vertex on."""
    first = corners.argmin(1)[:, None]
    return set(map(tuple, np.take_along_axis(corners, (first + np.arange(3)) % 3, 1).tolist()))


@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (1.0, 1e6), (2.0**-100, 0.0), (2.0**100, 0.0)])
@pytest.mark.parametrize("seed", range(8))
def test_all_at_once_is_what_step_by_step_comes_to(seed, scale, offset):
    points, loops, inner, inside, segment = star_with_vertices(seed, scale, offset)
    spacing = np.where(np.arange(len(points)) < inner[0], scale, 0.0)
    made = triangulate_with(points.copy(), loops, spacing.copy(), inner, segment)
    assert is_triangulation_of(made.points, made.corners, edges_of(loops))
    assert np.array_equal(np.unique(made.corners), np.sort(np.concatenate([*loops, inside])))
    assert np.array_equal(made.spacing[inside], np.full(len(inside), scale))
    locked = made.corners.ravel()[made.locked]
    assert np.array_equal(np.sort(locked), np.sort(segment[0]))
    slow = triangulate_polygon(points.copy(), loops, spacing)
    slow.insert(inside, locate(points, inside, slow.corners))
    assert recover(slow, segment) is None
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
    assert is_triangulation_of(points, corners, edges_of(loops))


def test_collinear_vertices_are_all_used():
    side = np.linspace(0, 1, 11)[:-1]
    corners = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2], [0, 0]], float)
    points = np.concatenate([a + side[:, None] * (b - a) for a, b in itertools.pairwise(corners)])
    loops = [np.arange(len(points))]
    for made in (_proposed(points, loops), _cut_out(points, loops, np.ones(len(points)))):
        assert is_triangulation_of(points, made, edges_of(loops))
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
    assert is_triangulation_of(points, made.corners, edges_of(loops))


def test_exact_construction_where_the_proposal_is_refused(monkeypatch):
    points, loops = star_with_holes(np.random.default_rng(0))
    monkeypatch.setattr("torchmesh.triangulating.polygon_triangulation._proposed", lambda *_: None)
    made = triangulate_polygon(points, loops, np.ones(len(points)))
    assert is_triangulation_of(points, made.corners, edges_of(loops))


def test_hole_that_touches_the_outer_loop_in_a_common_vertex():
    points = np.array([[0, 0], [2, 0], [4, 0], [4, 3], [0, 3], [3, 1], [1, 1]], float)
    loops = [np.arange(5), np.array([1, 6, 5])]
    assert why_not_simple(points, loops) is None
    for corners in (_proposed(points, loops), _cut_out(points, loops, np.ones(len(points)))):
        assert corners is None or is_triangulation_of(points, corners, edges_of(loops))
    assert not isinstance(triangulate_polygon(points, loops, np.ones(7)), Obstacle)


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
    monkeypatch.setattr("torchmesh.triangulating.polygon_triangulation._TABLE", 0)
    assert locate(points, vertices, corners).tolist() == home.tolist()


def test_loops_that_bound_no_domain_are_refused_with_the_reason():
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    obstacle = triangulate_polygon(square[[0, 2, 1, 3]], [np.arange(4)], np.ones(4))
    assert isinstance(obstacle, Obstacle)
    assert "meet" in str(obstacle)


def test_loops_that_cross_in_common_vertices_are_not_triangulated():
    loops, none = [np.array(loop) for loop in CROSSED_LOOPS], np.zeros(0, np.int64)
    assert triangulate_with(CROSSED.copy(), loops, np.ones(10), none, none.reshape(0, 2)) is None
    assert isinstance(_cut_out(CROSSED, loops, np.ones(10)), Obstacle)
    assert isinstance(triangulate_polygon(CROSSED.copy(), loops, np.ones(10)), Obstacle)


def test_what_a_closed_walk_of_segments_encloses_is_triangulated():
    points = np.array([[0, 0], [4, 0], [4, 4], [0, 4], [1, 1], [3, 1], [3, 3], [1, 3], [2, 2.125]])
    segments = np.array([[4, 5], [5, 6], [6, 7], [7, 4]])
    made = triangulate_with(points, [np.arange(4)], np.ones(9), np.arange(4, 9), segments)
    assert is_triangulation_of(points, made.corners, edges_of([np.arange(4)]))
    assert len(made.corners) == 12
    assert made.locked.sum() == 8
