"""Meshes, and under scope "damage" places, that are within the bound come back to the bit."""

import math

import meshes
import pytest
import torch

from torchmesh import (
    Bound,
    DeformOptions,
    ImproveOptions,
    MeshBatch,
    Status,
    deform,
    improve,
    join,
    minimum_angle,
    quality,
)
from torchmesh.improving.needed import beyond, meshes_beyond
from torchmesh.mesh.ragged import segment_any
from torchmesh.mesh.triangle import corners
from torchmesh.mesh.triangle import minimum_angle as smallest_angles


def one_poor(degrees: float = 3.0) -> MeshBatch:
    """A good grid in which one vertex stands close to the edge opposite it."""
    mesh = meshes.grid(12, 12)
    points = mesh.points.clone()
    inner = (~mesh.fixed).nonzero().squeeze(1)
    row = int(inner[len(inner) // 2])
    width = float((points[1] - points[0]).norm())
    points[row, 0] += width * (1 - math.tan(math.radians(degrees)))
    return mesh.with_points(points)


def same(a: MeshBatch, b: MeshBatch) -> bool:
    return torch.equal(a.points, b.points) and torch.equal(a.triangles, b.triangles)


def test_what_is_within_the_bound_comes_back_and_the_rest_is_improved():
    good, poor = meshes.ring(), one_poor()
    batch = join([good, poor])
    bound = Bound(angle=20.0, ratio=2.5)
    assert float(minimum_angle(good)[0]) > 20
    after, report = improve(batch, ImproveOptions(when=bound))
    first, second = after.split()
    assert same(first, good)
    assert not same(second, poor)
    assert float(minimum_angle(second)[0]) > 20
    assert report.status[0] == Status.VALID
    assert "within the bound" in report.messages[0]
    assert report.certified.tolist() == report.valid.tolist() == [True, True]
    assert report.moved[0] == report.flips[0] == 0
    assert report.travel.max[0] == 0
    assert [row.stage for row in report.steps[0]] == ["initial"]
    alone, _ = improve(poor, ImproveOptions(when=bound))
    assert same(alone, second)


@pytest.mark.parametrize("topology", ["keep", "flip", "full"])
def test_every_topology_leaves_a_good_mesh_alone(topology):
    mesh = meshes.ring()
    after, report = improve(mesh, ImproveOptions(topology=topology, when=Bound(angle=10.0)))
    assert same(after, mesh)
    assert report.valid.all()
    if topology == "full":
        assert report.vertex_map.old_to_new.tolist() == list(range(len(mesh.points)))


def test_under_damage_only_the_place_beyond_the_bound_changes():
    poor = one_poor()
    after, _ = improve(poor, ImproveOptions(scope="damage", when=Bound(angle=15.0)))
    assert float(minimum_angle(after)[0]) > 15
    moved = (after.points != poor.points).any(1)
    assert 0 < int(moved.sum()) < 30
    again, _ = improve(after, ImproveOptions(scope="damage", when=Bound(angle=15.0)))
    assert same(again, after)


def test_beyond_is_what_the_plain_formulas_say():
    mesh = meshes.jittered(8, 7, 0.4, 5)
    q = quality(mesh)
    angle = torch.rad2deg(smallest_angles(corners(mesh.points, mesh.triangles)))
    for bound in (Bound(angle=25.0), Bound(ratio=1.5), Bound(angle=20.0, ratio=1.4), Bound()):
        expected = ~q.upright | (angle < bound.angle) | (q.inverse_mean_ratio > bound.ratio)
        # At the corners of the square, a right angle, the limits of the boundary are above these bounds.
        assert torch.equal(beyond(mesh, q, bound), expected)


def test_a_corner_that_allows_no_better_does_not_count():
    angle = math.radians(12.0)
    points = torch.tensor([[0.0, 0.0], [1.0, 0.0], [math.cos(angle), math.sin(angle)], [1.2, 0.4]], dtype=torch.float64)
    mesh = MeshBatch.from_arrays(points, [[0, 1, 2], [1, 3, 2]])
    q = quality(mesh)
    assert float(minimum_angle(mesh)[0]) < 15
    assert not beyond(mesh, q, Bound(angle=15.0))[0]
    # The corner of a triangle that could be better counts.
    assert beyond(one_poor(), quality(one_poor()), Bound(angle=15.0)).any()


def test_deform_has_the_same_bound_on_the_way_and_on_arrival():
    mesh = MeshBatch.from_arrays(*meshes.holed_arrays())
    on_hole = (mesh.points - torch.tensor([4.0, 5.0])).norm(dim=1) < 1.1
    goal = torch.where(on_hole[:, None], mesh.points + torch.tensor([0.05, 0.0]), mesh.points)
    for options in (
        DeformOptions(when=Bound(angle=5.0), stiffening=0.0),
        DeformOptions(improve=ImproveOptions(when=Bound(angle=5.0)), stiffening=0.0),
    ):
        after, report = deform(mesh, goal, 3, options)
        assert report.steps.tolist() == [3]
        assert report.flips.tolist() == [0]
        assert not report.rewired.any()
        # The interior has just followed: nothing was smoothed.
        from torchmesh import femwarp

        now = mesh
        for part in (1 / 3, 2 / 3, 1.0):
            now = femwarp(now, torch.lerp(mesh.points, goal, part))
        assert torch.allclose(after.points, now.points, atol=1e-12)
    still, _ = deform(mesh, mesh.points, options=DeformOptions(when=Bound(angle=5.0)))
    assert torch.allclose(still.points, mesh.points, atol=1e-13)


def test_a_bound_of_other_types_is_refused():
    with pytest.raises(TypeError, match="ImproveOptions expects Bound as when=, not a float"):
        ImproveOptions(when=15.0)
    with pytest.raises(TypeError, match="DeformOptions expects Bound as when=, not a float"):
        DeformOptions(when=15.0)
    for wrong in ({"angle": 60.0}, {"ratio": 1.0}, {"limit_share": 0.0}):
        with pytest.raises(ValueError, match=f"Bound.{next(iter(wrong))}"):
            Bound(**wrong)


@pytest.mark.parametrize("widths", [0.05, 0.3])
def test_max_motion_bounds_the_motion_of_valid_meshes(widths):
    batch = join([one_poor(), meshes.jittered(8, 7, 0.2, 4)])
    assert quality(batch).inverted.tolist() == [0, 0]
    after, report = improve(batch, ImproveOptions(max_motion=widths, least_gain=None))
    assert report.travel.max.max() <= widths
    assert report.travel.max.max() > 0.9 * widths
    free, _ = improve(batch, ImproveOptions(least_gain=None))
    assert not same(after, free)
    with pytest.raises(ValueError, match="max_motion"):
        ImproveOptions(max_motion=1.0, topology="full")
    with pytest.raises(ValueError, match="max_motion"):
        ImproveOptions(max_motion=0.0)


def test_where_max_motion_cannot_be_had_the_message_says_so():
    tangled = meshes.moved_hole()
    _, report = improve(tangled, ImproveOptions(max_motion=0.01))
    assert report.valid.all()
    assert float(report.travel.max[0]) > 0.01
    assert f"a vertex is {float(report.travel.max[0]):.3g} local widths from where it was given" in report.messages[0]


def test_the_meshes_beyond_a_bound_are_those_of_the_triangles_beyond_it():
    """Poor triangles inside, at the boundary, at corners that force them, and inverted ones; and a good mesh."""
    sharp = MeshBatch.from_arrays([[0, 0], [1, 0], [1, 0.05]], [[0, 1, 2]])
    batch = join(
        [
            meshes.equilateral(),
            meshes.jittered(8, 7, 0.3),
            sharp,
            meshes.moved_hole(),
            meshes.scrambled(meshes.delaunay(40), 1),
        ]
    )
    for bound in (Bound(angle=1.0), Bound(angle=20.0), Bound(ratio=1.3), Bound(angle=5.0, ratio=3.0)):
        q = quality(batch)
        for held in (None, batch.fixed[batch.triangles].any(1) & q.upright):
            expected = segment_any(beyond(batch, q, bound, held), batch.triangle_offsets)
            assert torch.equal(meshes_beyond(batch, q, bound, held), expected)
    assert bool(expected.any())
    assert not bool(expected.all())
