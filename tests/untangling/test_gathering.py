"""Vertices far outside their mesh are brought to it; everything else keeps its bits."""

import torch
from meshes import grid, jittered, ring

from torchmesh import ImproveOptions, Status, improve, join
from torchmesh.untangling.gathering import gathered


def strayed(mesh, distance, row):
    """The mesh with one free vertex so many extents away."""
    points = mesh.points.clone()
    free = (~mesh.fixed).nonzero().squeeze(1)[row]
    points[free] = distance * (points.max() - points.min())
    return mesh.with_points(points), int(free)


def test_only_what_is_far_outside_moves_and_only_onto_the_box():
    near, far = grid(), grid(7, 6)
    near, _ = strayed(near, 1.5, 2)
    far, row = strayed(far, 1e9, 3)
    both = gathered(join([near, far]))
    moved_near, moved_far = both.split()
    assert torch.equal(moved_near.points, near.points)
    others = torch.arange(len(far.points)) != row
    assert torch.equal(moved_far.points[others], far.points[others])
    assert torch.equal(moved_far.points[row], far.points[far.fixed].amax(0))
    assert gathered(near) is near


def test_meshes_that_have_no_box_stay():
    point = grid().with_points(torch.zeros_like(grid().points))
    assert gathered(strayed(point, 0.0, 1)[0]) is not None
    wild = jittered().points.clone()
    wild[~jittered().fixed] = torch.nan
    assert torch.equal(gathered(jittered().with_points(wild)).points.isnan(), wild.isnan())


def test_a_strip_over_itself_is_mended_from_far_away():
    """No cavity of it can be re-triangulated, so the vertices themselves must come back."""
    turns, width = 1.2, 5
    flat = grid(64, width)
    x, y = flat.points.unbind(1)
    angle, radius = 2 * torch.pi * turns * (x - x.min()) / (x.max() - x.min()), 4 + (y - y.min()) / (y.max() - y.min())
    strip = flat.with_points(torch.stack([-radius * angle.cos(), radius * angle.sin()], 1))
    away = torch.where(strip.fixed[:, None], strip.points, 1e8 * strip.points.flip(1))
    for topology in ("flip", "keep"):
        _, report = improve(strip.with_points(away), ImproveOptions(topology=topology))
        assert report.valid.all()
        assert [s.stage for s in report.steps[0]][1] == "gather"
    assert Status(int(report.status)) == Status.SETTLED


def test_an_ordinary_mesh_has_no_such_stage():
    _, report = improve(join([jittered(cells=2.0), ring()]))
    assert all(step.stage != "gather" for steps in report.steps for step in steps)
