"""The trail of a deformation, and which triangles have changed."""

import meshes
import pytest
import torch

from torchmesh import (
    Bound,
    DeformOptions,
    ImproveOptions,
    InvalidMeshError,
    MeshBatch,
    deform,
    join,
    largest_step,
    rewired,
)


def channel() -> MeshBatch:
    return MeshBatch.from_arrays(*meshes.holed_arrays())


def moved(mesh: MeshBatch, right: float) -> torch.Tensor:
    on_hole = (mesh.points - torch.tensor([4.0, 5.0])).norm(dim=1) < 1.1
    return torch.where(on_hole[:, None], mesh.points + torch.tensor([right, 0.3]), mesh.points)


def same(a: MeshBatch, b: MeshBatch) -> bool:
    return torch.equal(a.points, b.points) and torch.equal(a.triangles, b.triangles)


@pytest.mark.parametrize(
    "options",
    [DeformOptions(), DeformOptions(topology="keep"), DeformOptions(when=Bound(angle=15.0))],
    ids=["flip", "keep", "when"],
)
def test_the_pieces_lead_from_the_mesh_given_to_the_one_that_comes_back(options):
    batch = join([channel(), meshes.ring(), channel()])
    goal = torch.cat([moved(channel(), 5.0), meshes.ring().points * 1.1, moved(channel(), 0.1)])
    plain, _ = deform(batch, goal, options=options)
    after, report = deform(batch, goal, options=options, trail=True)
    assert same(plain, after)
    assert report.trail is not None
    assert len(report.trail) == 3
    assert len(report.trail[0]) > 1
    for given, end, trail in zip(batch.split(), after.split(), report.trail, strict=True):
        last, time = given, 0.0
        for piece in trail:
            assert torch.equal(piece.before.triangles, piece.after.triangles)
            assert torch.equal(piece.before.fixed, given.fixed)
            assert piece.start == time
            if piece.previous is None:
                assert same(piece.before, last)
                assert not piece.rewired.any()
            else:
                assert same(piece.previous, last)
                assert torch.equal(piece.rewired, rewired(last, piece.before))
            if piece.end > piece.start:
                # No triangle inverts on the straight way, so that a solver can be anywhere on it.
                assert float(largest_step(piece.before, piece.after.points)[0]) > 1
                way = piece.velocity(2.0) * 2.0 * (piece.end - piece.start)
                assert torch.allclose(piece.before.points + way, piece.after.points, atol=1e-12)
            else:
                assert same(piece.before, piece.after)
                assert (piece.velocity(2.0) == 0).all()
            last, time = piece.after, piece.end
        assert same(last, end)
        assert time == 1.0


def test_where_triangles_stay_nothing_need_be_transferred():
    mesh = channel()
    for options in (DeformOptions(topology="keep"), DeformOptions(when=Bound(angle=5.0))):
        _, report = deform(mesh, moved(mesh, 0.2), options=options, trail=True)
        assert [piece.previous for piece in report.trail[0]] == [None]


def test_without_asking_no_trail_is_kept():
    mesh = channel()
    assert deform(mesh, moved(mesh, 0.2))[1].trail is None


def test_rewired_compares_corners_up_to_where_they_begin():
    mesh = channel()
    rolled = mesh.with_triangles(mesh.triangles.roll(1, 1))
    assert not rewired(mesh, rolled).any()
    after, report = deform(mesh, moved(mesh, 5.0))
    changed = rewired(mesh, after)
    kept = [
        tuple(sorted(a)) == tuple(sorted(b))
        for a, b in zip(mesh.triangles.tolist(), after.triangles.tolist(), strict=True)
    ]
    assert changed.tolist() == [not k for k in kept]
    assert report.rewired.tolist() == [True]
    assert bool(changed.any())
    assert int(report.flips[0]) >= int(report.report.flips[0])
    turned = mesh.with_triangles(mesh.triangles.flip(1))
    assert rewired(mesh, turned).all()
    with pytest.raises(InvalidMeshError, match="rewired"):
        rewired(mesh, meshes.ring())


def test_keep_governs_the_arrival_too():
    mesh = channel()
    for options in (DeformOptions(topology="keep"), DeformOptions(improve=ImproveOptions(topology="keep"))):
        after, report = deform(mesh, moved(mesh, 1.0), options=options)
        assert torch.equal(after.triangles, mesh.triangles)
        assert report.flips.tolist() == [0]
        assert report.rewired.tolist() == [False]
    with pytest.raises(ValueError, match="exclude"):
        DeformOptions(topology="keep", improve=ImproveOptions(topology="full"))


def test_deform_refuses_a_gradient_by_name():
    mesh = channel()
    with pytest.raises(ValueError, match="femwarp"):
        deform(mesh, moved(mesh, 0.1).requires_grad_())
    with torch.no_grad():
        deform(mesh, moved(mesh, 0.1).requires_grad_())


def test_a_trail_may_keep_smoothing_apart_from_the_motion():
    """Then only the boundary moves a vertex within a piece; otherwise smoothing may be a part of it."""
    mesh = channel()
    goal = torch.where(mesh.fixed[:, None], mesh.points + 1.0, mesh.points)
    after, report = deform(mesh, goal, trail="apart")
    assert report.trail is not None
    *steps, end = report.trail[0]
    for piece in steps:
        # The whole boundary shifts, and all that it carries with it.
        shift = piece.after.points - piece.before.points
        assert torch.allclose(shift, shift[:1].expand_as(shift), rtol=0, atol=1e-12)
    assert end.start == end.end == 1
    assert end.previous is not None
    assert torch.allclose(end.previous.points, mesh.points + 1.0, rtol=0, atol=1e-12)
    assert same(end.before, after)
    assert not same(end.previous, after), "it was smoothed on arrival"
    assert same(deform(mesh, goal, trail=True)[0], after)
    with pytest.raises(ValueError, match="trail must be"):
        deform(mesh, goal, trail="a part")
