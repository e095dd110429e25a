"""The compiled search for boxes, and the compiled clipping of triangles, against those in numpy."""

import numpy as np
import pytest
import torch
from both_loops import both
from meshes import delaunay, disc, grid, jittered, ring
from scipy.spatial import Delaunay

from torchmesh import MeshBatch, join, transfer
from torchmesh.transferring import overlaps as clipping
from torchmesh.transferring.overlaps import _upright_corners, overlaps
from torchmesh.transferring.pairs import both_sides, touching_boxes


def graded(seed: int) -> MeshBatch:
    """Points whose distances from one corner run over nine powers of ten."""
    rng = np.random.default_rng(seed)
    radius, angle = 10.0 ** rng.uniform(-9, 0, 300), rng.uniform(0, np.pi / 2, 300)
    points = np.concatenate([[[0, 0], [1, 0], [0, 1]], radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)])
    used, triangles = np.unique(Delaunay(points).simplices, return_inverse=True)
    return MeshBatch.from_arrays(points[used], triangles.reshape(-1, 3))


def pairs_of_meshes() -> dict[str, tuple[MeshBatch, MeshBatch]]:
    far = jittered(6, 5, 0.2, seed=1)
    return {
        "moved": (jittered(9, 8, 0.1), jittered(9, 8, 0.2, seed=5)),
        "tangled": (jittered(9, 8, 2.5), jittered(9, 8, 0.2, seed=5)),
        "the same": (grid(7, 5), grid(7, 5)),
        "graded": (graded(1), graded(2)),
        "far": (far.with_points(far.points * 1e9 + 1e12), far.with_points(far.points * 1e9 + 1e12 + 1e7)),
        "several": (join([disc(), ring(), delaunay(60, 2)]), join([disc(), jittered(5, 5, 0.2), delaunay(90, 3)])),
        "nothing in common": (grid(4, 4), grid(4, 4).with_points(grid(4, 4).points + 10)),
    }


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
