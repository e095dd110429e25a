"""Meshes with quads through the whole job: valid and certified, alone as in a batch, layers with their heights kept."""

import math

import pytest
import torch

import torchmesh as tm
from tests.meshes import disturbed, grid, jittered, mixed, quad_layers
from torchmesh import ImproveOptions, MeshBatch, SmoothOptions, Status, UntangleOptions
from torchmesh.bench.catalogue import chosen
from torchmesh.improving import strategies
from torchmesh.improving.runner import Work
from torchmesh.mesh.quads import halved, whole
from torchmesh.optimising.targets import quad_targets_from


def tangled() -> list[MeshBatch]:
    """Quads beside triangles, quads alone, and triangles alone."""
    return [disturbed(mixed(8, 8, 4), 0.06, 1), disturbed(mixed(7, 7, 7), 0.07, 2), jittered(6, 6, 0.5, 3)]


def one_quad_too_many() -> MeshBatch:
    """A grid in which three vertices of a quad are held where its corner is not upright."""
    mesh = mixed(6, 6, 3)
    quad = mesh.quads[7]
    points = mesh.points.clone()
    points[quad[2]] = points[quad].mean(0) - 0.4 * (points[quad[2]] - points[quad].mean(0))
    return MeshBatch.from_arrays(points, mesh.triangles, mesh.fixed.index_fill(0, quad, True), quads=mesh.quads)


@pytest.mark.parametrize(
    "options",
    [ImproveOptions(), ImproveOptions(topology="keep"), ImproveOptions.paper(), ImproveOptions(boundary="slide")],
    ids=["flip", "keep", "paper", "slide"],
)
def test_tangled_quads_are_mended_alone_as_in_a_batch(options):
    meshes = tangled()
    batch = tm.join(meshes)
    assert (tm.quality(batch).inverted > 0).all()
    after, report = tm.improve(batch, options)
    assert report.valid.all()
    assert report.certified.all()
    assert torch.equal(after.quads, batch.quads)
    assert int(tm.quality(after).inverted.sum()) == 0
    assert float(report.quality.max[:2].max()) < 2.5
    for alone, mesh in zip(meshes, after.split(), strict=True):
        found, _ = tm.improve(alone, options)
        assert torch.equal(found.points, mesh.points)
        assert torch.equal(found.triangles, mesh.triangles)


def test_quads_alone_become_squares():
    after, report = tm.improve(tangled()[1])
    assert float(report.quality.max) < 1.001
    assert (after.points - mixed(7, 7, 7).points).abs().max() < 1e-2


def test_vertices_only_steps_move_quads_and_break_none():
    batch = tm.join(tangled()[:2])
    moved, info = tm.untangle(batch)
    assert (info.status == Status.VALID).all()
    better, _ = tm.smooth(moved)
    assert int(tm.quality(better).inverted.sum()) == 0
    assert (tm.quality(better).mean < tm.quality(moved).mean).all()
    for method in ("beta", "regularised"):
        assert int(tm.quality(tm.untangle(batch, UntangleOptions(method=method))[0]).inverted.sum()) == 0
    assert int(tm.quality(tm.relax(batch)).inverted.sum()) == 0
    assert batch.triangles is not moved.quads
    assert torch.equal(moved.quads, batch.quads)


def test_femwarp_of_quads_is_exact_for_affine_motions_and_prefers_no_diagonal():
    mesh = mixed(5, 4, 5)
    matrix = torch.tensor([[1.2, 0.3], [-0.1, 0.9]], dtype=torch.float64)
    assert (tm.femwarp(mesh, mesh.points @ matrix).points - mesh.points @ matrix).abs().max() < 1e-12
    bent = mesh.points + 0.1 * torch.sin(3 * mesh.points.flip(1))
    other = MeshBatch.from_arrays(mesh.points, [], quads=mesh.quads.roll(1, 1))
    assert (tm.femwarp(mesh, bent).points - tm.femwarp(other, bent).points).abs().max() < 1e-12


def test_a_step_is_bounded_by_the_corners_of_quads_too():
    mesh = mixed(1, 1, 1)
    goal = mesh.points.clone()
    corner = int(mesh.quads[0, 2])
    goal[corner] = torch.tensor([0.0, 0.0])
    assert float(tm.largest_step(mesh, goal)) == pytest.approx(0.5)


def test_flips_leave_the_edges_of_quads():
    mesh = disturbed(mixed(6, 6, 3), 0.03, 5)
    after, info = tm.flip_to_delaunay(mesh)
    assert int(info.flips) > 0
    assert torch.equal(after.quads, mesh.quads)
    rows = halved(after)
    assert torch.equal(whole(rows).triangles, after.triangles)
    boundary = tm.diagnose(after)
    assert boundary == []


@pytest.mark.parametrize("topology", ["flip", "keep"])
def test_layers_of_quads_follow_their_wall_with_their_heights(topology):
    mesh = quad_layers()
    body = mesh.fixed & (mesh.points.norm(dim=1) < 1)
    goal = mesh.points.clone()
    turn = math.radians(40)
    matrix = goal.new_tensor([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    goal[body] = goal[body] @ matrix.T + goal.new_tensor([0.5, 0.1])
    after, report = tm.improve(tm.femwarp(mesh, goal), ImproveOptions(reference=mesh, topology=topology))
    assert report.valid.all()

    def heights(m: MeshBatch) -> torch.Tensor:
        return (m.points[m.quads] - m.points[m.quads].roll(-1, 1)).norm(dim=2).amin(1)

    ratio = heights(after) / heights(mesh)
    assert float(ratio.min()) > 0.5
    assert float(ratio.max()) < 2
    moved, motion = tm.deform(mesh, goal)
    assert motion.status.tolist() == [Status.VALID]
    assert int(tm.quality(moved).inverted) == 0
    assert float((heights(moved) / heights(mesh) - 1).abs().max()) < 1


def test_corners_aim_at_what_they_are_told():
    mesh = mixed(6, 3, 6)
    wide = mesh.with_points(mesh.points * torch.tensor([1.0, 0.4]))
    inner = disturbed(wide, 0.02, 7)
    squares, _ = tm.smooth(inner)
    own, _ = tm.smooth(inner, SmoothOptions(quad_targets=quad_targets_from(wide), energy_tolerance=1e-9))
    assert (own.points - wide.points).abs().max() < 1e-3
    assert (squares.points - wide.points).abs().max() > 1e-4 or float(tm.quality(squares).max) < 1.5


def test_a_quad_that_cannot_be_mended_is_named_and_splits_where_that_is_asked():
    mesh = tm.join([one_quad_too_many(), mixed(4, 4, 2)])
    after, report = tm.improve(mesh)
    assert report.valid.tolist() == [False, True]
    assert not report.certified[0]
    assert tm.quality(after).quad_upright.tolist().count(False) == 1
    assert "quads row 7" in report.messages[0]
    assert "1 quad (row 7) is inverted still: with quads='split'" in report.messages[0]
    assert report.messages[1].startswith("settled") or report.messages[1].startswith("valid")
    split, done = tm.improve(mesh, ImproveOptions(quads="split"))
    assert done.valid.all()
    assert done.split_quads.nonzero().squeeze(1).tolist() == [7]
    assert len(split.quads) == len(mesh.quads) - 1
    assert len(split.triangles) == len(mesh.triangles) + 2
    assert int(tm.quality(split).inverted.sum()) == 0
    assert "became two triangles each" in done.messages[0]


def test_full_leaves_quads_and_remeshes_the_triangles():
    mesh = disturbed(mixed(8, 8, 3), 0.05, 4)
    after, report = tm.improve(mesh, ImproveOptions(topology="full"))
    assert report.valid.all()
    assert report.certified.all()
    assert len(after.quads) == len(mesh.quads)
    row = report.vertex_map.old_to_new
    assert torch.equal(row[mesh.quads], after.quads)
    assert after.fixed[row[mesh.fixed]].all()
    with pytest.raises(tm.InvalidMeshError, match="quads alone"):
        tm.improve(mixed(3, 3, 3), ImproveOptions(topology="full"))


def test_the_observer_sees_whole_meshes():
    seen = []
    tm.improve(tangled()[0], observe=lambda stage, mesh: seen.append((stage, mesh.rows_per_quad, len(mesh.quads))))
    assert {rows for _, rows, _ in seen} == {0}
    assert {count for *_, count in seen} == {32}


def test_what_takes_triangles_alone_says_so():
    mesh = mixed(3, 3, 1)
    for call in (lambda: tm.nn.Smooth()(mesh.points, mesh), lambda: tm.losses.inverse_mean_ratio(mesh.points, mesh),
                 lambda: tm.remesh(mesh)):  # fmt: skip
        with pytest.raises(tm.InvalidMeshError, match="3 quads"):
            call()


def test_values_are_transferred_in_quads():
    before, (after, _) = mixed(6, 6, 3), tm.improve(disturbed(mixed(6, 6, 3), 0.05, 3))
    f = before.points @ before.points.new_tensor([2.0, -1.0])
    assert (tm.transfer(before, after, f) - after.points @ after.points.new_tensor([2.0, -1.0])).abs().max() < 1e-12
    values = torch.arange(len(before.triangles) + len(before.quads), dtype=torch.float64)
    found = tm.transfer(before, after, values, where="triangles")
    sums = [torch.cat([q.area, q.quad_area]) @ v for q, v in ((tm.quality(before), values), (tm.quality(after), found))]
    assert float(sums[0]) == pytest.approx(float(sums[1]))
    assert torch.equal(tm.transfer(before, before, values, where="triangles"), values)


def test_a_mesh_without_quads_takes_the_way_it_took():
    mesh = grid(5, 5)
    assert tm.improve(mesh)[1].split_quads is None


def test_a_quad_goes_where_it_leaves_only_triangles_inverted():
    """A quad that turns inwards, and the triangle in its notch: with one of them upright, the other is inverted."""
    points = [[0.0, 0], [3, 0], [1, 1], [0, 3]]
    mesh = MeshBatch.from_arrays(points, [[1, 3, 2]], quads=[[0, 1, 2, 3]])
    assert not tm.improve(mesh)[1].valid.any()
    after, report = tm.improve(mesh, ImproveOptions(quads="split"))
    assert report.valid.all()
    assert (len(after.triangles), len(after.quads)) == (3, 0)


@pytest.mark.parametrize("number", [3, 4])
def test_hard_tangles_with_quads_are_mended_where_edges_may_flip_too(number):
    """Re-triangulation does nothing for quads, so that the last untangling must not be cut short for its sake."""
    mesh = next(iter(chosen(["quads"]))).case(number).mesh
    better, report = tm.improve(mesh)
    assert report.valid.all()
    assert torch.equal(better.quads, mesh.quads)


def test_a_motion_splits_no_quad_and_says_how_vertices_may_come_on_arrival():
    mesh = mixed(4, 4, 2)
    goal = mesh.points + mesh.points.new_tensor([0.1, 0.0]) * (mesh.points[:, 1:] > 0.9)
    kept, _ = tm.deform(mesh, goal)
    split, report = tm.deform(mesh, goal, options=tm.DeformOptions(improve=ImproveOptions(quads="split")))
    assert torch.equal(kept.points, split.points)
    assert torch.equal(split.quads, mesh.quads)
    report.check()
    with pytest.raises(ValueError, match="take topology 'flip', and improve"):
        tm.deform(mesh, goal, options=tm.DeformOptions(improve=ImproveOptions(topology="full")))


def test_newton_mends_quads_that_nothing_else_does_where_edges_may_flip_too(monkeypatch):
    """On a ring whose inner circle has turned, as the zones of a public mesh, whose quads L-BFGS left tangled."""
    turn, radii = torch.arange(16) * (2 * math.pi / 16), torch.logspace(-0.3, 0.6, 5)
    angle = torch.where(radii == radii[0], math.radians(150), 0.0)[:, None] + turn
    points = torch.stack([radii[:, None] * angle.cos(), radii[:, None] * angle.sin()], 2).reshape(-1, 2).double()
    low = torch.arange(64)
    beside = low - low % 16 + (low + 1) % 16
    ring = MeshBatch.from_arrays(points, [], quads=torch.stack([low, low + 16, beside + 16, beside], 1))
    assert int(tm.quality(ring).inverted[0]) == 16
    monkeypatch.setattr(strategies, "regularised", lambda _: lambda state, _: (state, Work.done(state)))
    after, report = tm.improve(ring)
    assert "newton" in [step.stage for step in report.steps[0]]
    report.check()
    assert torch.equal(after.quads, ring.quads)
