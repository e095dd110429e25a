"""Boundaries that touch themselves as plane graphs, judged by exact rationals and by areas that are known."""

import numpy as np
import pytest
from exact import double_area

from experiments.robustness.attack import cracks
from torchmesh.triangulating.arrays import Obstacle
from torchmesh.triangulating.polygon import loops_of
from torchmesh.triangulating.polygon_triangulation import triangulate_with
from torchmesh.triangulating.touching import of_own_sides, plane_boundary, wrong_turns

SQUARE = [[0, 0], [4, 0], [4, 4], [0, 4]]


def walk_of(*corners):
    """Points (n, 2), and the closed walk through all of them in order."""
    points = np.array(corners, float)
    rows = np.arange(len(points))
    return points, np.stack([rows, np.roll(rows, -1)], 1)


# A square with a crack from (2, 0) to (2, 2): the right lip has a vertex at 1, the left one at 1/2 and 3/2.
CRACKED = walk_of([0, 0], [2, 0], [2, 0.5], [2, 1.5], [2, 2], [2, 1], [2, 0], [4, 0], [4, 4], [0, 4])


def triangulated(points, boundary):
    plane = plane_boundary(points, boundary)
    assert plane.sound
    inner = np.setdiff1d(plane.lines, plane.open_ends)
    loops = loops_of(plane.open_ends)
    work = triangulate_with(points, loops, np.ones(len(points)), inner, plane.lines)
    return of_own_sides(work, plane, np.zeros((0, 2), np.int64))


def test_a_simple_boundary_is_its_own_plane_graph():
    points, boundary = walk_of(*SQUARE)
    plane = plane_boundary(points, boundary)
    assert plane.sound
    assert (plane.ends == boundary).all()
    assert (plane.names == boundary).all()
    assert len(plane.stops) == len(plane.touched) == plane.paired.sum() == 0
    assert wrong_turns(points, plane) == []


def test_edges_are_parted_where_vertices_of_the_other_side_lie_in_them():
    points, boundary = CRACKED
    plane = plane_boundary(points, boundary)
    assert sorted(points[plane.stops, 1].tolist()) == [0.5, 1.0, 1.5]
    assert len(plane.ends) == len(boundary) + 3
    # Four parts of a line of length two, each in both directions, and all else with the outside on the right.
    assert len(plane.lines) == 4
    assert np.abs(np.diff(points[plane.lines][:, :, 1])).sum() == 2.0
    assert wrong_turns(points, plane) == []


def test_each_side_of_a_crack_keeps_its_own_vertices():
    points, boundary = CRACKED
    work = triangulated(points, boundary)
    corners = work.corners
    assert len(corners) == len(points) - 2, "a polygon of n vertices has n - 2 triangles"
    areas = [double_area(*points[row]) for row in corners.tolist()]
    assert min(areas) > 0
    assert sum(areas) == 32
    sides = {(u, v) for t in corners.tolist() for u, v in zip(t, t[1:] + t[:1], strict=True)}
    assert {(u, v) for u, v in sides if (v, u) not in sides} == set(map(tuple, boundary.tolist()))


def test_a_domain_closed_in_a_point_by_two_vertices():
    # A ring of width one, open at the corner (2, 2) but for a point: two vertices are there.
    ring = [[2, 3], [2, 2], [2, 1], [1, 1], [1, 2], [2, 2], [1, 3]]
    points, boundary = walk_of([0, 0], [3, 0], [3, 3], *ring, [0, 3])
    plane = plane_boundary(points, boundary)
    assert plane.sound
    assert plane.first[8] == 4
    assert wrong_turns(points, plane) == []
    work = triangulated(points, boundary)
    assert sum(double_area(*points[row]) for row in work.corners.tolist()) == 2 * (9 - 1 - 0.5)


@pytest.mark.parametrize(
    ("corners", "what"),
    [
        ([[0, 0], [4, 0], [0, 4], [4, 4]], "crossing"),
        ([[0, 0], [4, 0], [4, 0], [4, 4], [0, 4]], "no length"),
        ([[0, 0], [4, 0], [4, 4], [0, 4], [0, 0], [4, 0], [4, 4], [0, 4]], "twice"),
    ],
)
def test_what_does_more_than_touch_is_not_sound(corners, what):
    plane = plane_boundary(*walk_of(*corners))
    assert not plane.sound
    assert {"crossing": len(plane.crossing), "no length": 1, "twice": len(plane.twice)}[what] > 0


def test_a_boundary_that_crosses_itself_in_a_vertex_turns_wrong():
    # A figure of eight through (2, 2), where it has two vertices: by its vertices, it goes straight on there.
    points, boundary = walk_of([0, 0], [4, 0], [2, 2], [0, 4], [4, 4], [2, 2])
    plane = plane_boundary(points, boundary)
    assert plane.sound
    assert [points[p].tolist() for p in wrong_turns(points, plane)] == [[2, 2]]
    # A tooth that reaches the opposite side from inside leaves that side's triangle no room.
    points, boundary = walk_of([0, 0], [4, 0], [4, 4], [3, 4], [2, 0], [1, 4], [0, 4])
    plane = plane_boundary(points, boundary)
    assert [points[p].tolist() for p in wrong_turns(points, plane)] == [[2, 0]]


@pytest.mark.parametrize("scale", [1e-100, 1.0, 1e100])
def test_groups_do_not_meet_and_scale_does_not_matter(scale):
    points, boundary = CRACKED
    both = np.concatenate([points, points + np.array([1, 0])]) * scale
    edges = np.concatenate([boundary, boundary + len(points)])
    assert not plane_boundary(both, edges).sound
    plane = plane_boundary(both, edges, np.repeat([0, 1], len(points)))
    assert plane.sound
    assert len(plane.lines) == 8
    assert plane.first.tolist() == [0, 1, 2, 3, 4, 5, 1, 7, 8, 9, 10, 11, 12, 13, 14, 15, 11, 17, 18, 19]


@pytest.mark.parametrize("seed", range(6))
def test_random_cracks_are_plane_graphs(seed):
    rng = np.random.default_rng(seed)
    points, triangles = cracks.crack(rng, kinked=seed % 2 == 1, flips=0)
    sides = {(u, v) for t in triangles.tolist() for u, v in zip(t, t[1:] + t[:1], strict=True)}
    boundary = np.array(sorted((u, v) for u, v in sides if (v, u) not in sides))
    plane = plane_boundary(points, boundary)
    assert plane.sound
    assert wrong_turns(points, plane) == []
    length = np.linalg.norm(np.diff(points[plane.lines], axis=1), axis=2).sum()
    assert length == pytest.approx(2 + (np.sqrt(2) if seed % 2 else 0), rel=1e-12)
    assert not isinstance(triangulated(points, boundary), Obstacle)
