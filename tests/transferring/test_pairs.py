"""The candidates: every pair of boxes that touch, and no other."""

import meshes
import numpy as np

from torchmesh import join
from torchmesh.transferring.pairs import both_sides, touching_boxes


def test_every_pair_of_boxes_that_touch_is_found_once_and_in_order():
    """Against all pairs held against each other."""
    before = join([meshes.grid(4, 3), meshes.delaunay(30, 1)])
    after = join([meshes.jittered(3, 3, 0.4), meshes.delaunay(25, 2)])
    old, new = both_sides(before, after)
    here, there = (*new.triangle_boxes(), new.triangle), (*old.triangle_boxes(), old.triangle)
    i, j = touching_boxes(old, here, there)
    meet = (here[0][:, None] <= there[1][None] + 1e-14) & (there[0][None] <= here[1][:, None] + 1e-14)
    table = meet.all(2) & (here[2][:, None] == there[2][None])
    assert table.any(0).all()
    np.testing.assert_array_equal(np.argwhere(table), np.stack([i, j], 1))


def test_coordinates_lose_no_bit():
    mesh = meshes.jittered(5, 5, 0.2)
    far = mesh.with_points(mesh.points * 3e9)
    side = both_sides(far, far)[0]
    there = side.x != 0
    (unit,) = np.unique(far.points[:, 0].numpy()[there] / side.x[there])
    assert np.log2(unit) % 1 == 0
