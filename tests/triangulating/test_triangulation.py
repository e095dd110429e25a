import numpy as np
from polygons import SQUARE
from scipy.spatial import Delaunay

from torchmesh.triangulating.arrays import signs
from torchmesh.triangulating.polygon import loop_edges
from torchmesh.triangulating.polygon_triangulation import is_triangulation_of
from torchmesh.triangulating.triangulation import Triangulation


def test_two_angles_of_almost_pi_are_flipped_away():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 1e-14], [0.5, -1e-14]])
    work = Triangulation(points, np.array([[0, 1, 2], [1, 0, 3]]), np.ones(4))
    work.flip_to_delaunay(np.arange(2))
    assert all({2, 3} <= set(t) for t in work.corners.tolist())
    assert (signs(points, *work.corners.T) > 0).all()


def test_insert_refuses_duplicates_and_the_rim_and_splits_edges():
    points = np.concatenate([SQUARE, [[0.5, 0.5], [0.5, 0.5], [0.5, 0.0], [0.25, 0.25], [1.0, 1.0]]])
    work = Triangulation(points, np.array([[0, 1, 2], [0, 2, 3]]), np.ones(len(points)))
    refused = work.insert(np.arange(4, 9), np.zeros(5, np.int64))
    assert len(refused) == 3
    assert {6, 8} < set(refused.tolist()) < {4, 5, 6, 8}
    assert is_triangulation_of(points, work.corners, loop_edges(np.arange(4)))
    assert set(work.corners.ravel().tolist()) == set(range(9)) - set(refused.tolist())


def test_one_edge_alone_is_flipped_as_among_others(rng):
    points = rng.uniform(size=(40, 2))
    corners = Delaunay(points).simplices.astype(np.int64)
    turned = signs(points, *corners.T) < 0
    corners[turned] = corners[turned][:, [0, 2, 1]]
    by_arrays, alone = (Triangulation(points.copy(), corners.copy(), np.ones(40)) for _ in range(2))
    for work in (by_arrays, alone):
        work.locked[::5] = True
    flipped = 0
    for _ in range(200):
        h = int(rng.choice(np.flatnonzero(by_arrays.twin >= 0)))
        (w, u), (z, v) = (
            (by_arrays.corners[e // 3, (e + 2) % 3], by_arrays.corners.flat[e]) for e in (h, by_arrays.twin[h])
        )
        if not (signs(points, *np.array([[w, u, z], [z, v, w]]).T) > 0).all():
            continue
        by_arrays.flip(np.array([h]))
        alone.flip_one(h)
        flipped += 1
        for name in ("corners", "twin", "locked"):
            np.testing.assert_array_equal(getattr(alone, name), getattr(by_arrays, name), err_msg=name)
    assert flipped > 50
