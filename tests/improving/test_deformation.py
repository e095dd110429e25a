import dataclasses
import json
import math

import meshes
import numpy as np
import pytest
import torch
from exact import inverted
from layered import first_heights, round_body, turned_body

from torchmesh import (
    Bound,
    ConvergenceError,
    DeformOptions,
    ImproveOptions,
    InvalidMeshError,
    MeshBatch,
    Status,
    deform,
    femwarp,
    improve,
    join,
    quality,
)
from torchmesh.improving.deform_options import StepControl


def channel() -> MeshBatch:
    return MeshBatch.from_arrays(*meshes.holed_arrays())


def hole_moved(mesh: MeshBatch, right: float, up: float = 0.0, degrees: float = 0.0) -> torch.Tensor:
    centre = torch.tensor([4.0, 5.0], dtype=torch.float64)
    on_hole = (mesh.points - centre).norm(dim=1) < 1.1
    there = centre + meshes.turned(mesh.points - centre, degrees) + torch.tensor([right, up], dtype=torch.float64)
    return torch.where(on_hole[:, None], there, mesh.points)


def assert_arrived(mesh, goal, after, report):
    assert report.status.tolist() == [Status.VALID] * len(mesh)
    assert torch.equal(after.points[mesh.fixed], goal.to(mesh.points)[mesh.fixed])
    assert inverted(after) == 0
    assert report.valid.all()
    assert report.report.certified.all()
    assert report.reached.tolist() == [1.0] * len(mesh)
    for b, path in enumerate(report.path):
        assert path == sorted(path)
        assert path[-1] == 1.0
        assert len(path) == report.steps[b]
    report.check()


@pytest.mark.parametrize(
    ("right", "up", "degrees"),
    [(0.5, 0.0, 0.0), (5.0, 2.0, 0.0), (10.0, 0.0, 0.0), (0.0, 0.0, 180.0), (9.0, 3.0, -150)],
)
def test_large_motions_never_tangle(right, up, degrees, monkeypatch):
    from torchmesh.improving import deformation

    mesh = channel()
    goal = hole_moved(mesh, right, up, degrees)
    seen = []
    advance = deformation.advance

    def watched(motion, options):
        after = advance(motion, options)
        if bool((after.steps > motion.steps).any()):
            seen.append(int(inverted(after.mesh)))
        return after

    monkeypatch.setattr(deformation, "advance", watched)
    after, report = deform(mesh, goal)
    assert_arrived(mesh, goal, after, report)
    assert seen == [0] * int(report.steps)
    if (right, degrees) != (0.5, 0.0):
        assert quality(femwarp(mesh, goal)).inverted.item() > 0
        assert int(report.steps) > 1
        assert int(report.flips) > 0
    # The twelve-sided hole among cells of its own size allows no better.
    assert quality(after).mean.item() < 1.12


def test_a_bar_turned_half_round():
    points, triangles = meshes.ring_arrays(20, 5, 0.3, 2.0)
    points = points * [1.0, 1.0]
    squeeze = np.where(np.arange(len(points)) < 20, 0.25, 1.0)
    mesh = MeshBatch.from_arrays(points * np.stack([np.ones(len(points)), squeeze], 1), triangles)
    hole = torch.arange(len(points)) < 20
    goal = torch.where(hole[:, None], -mesh.points, mesh.points)
    after, report = deform(mesh, goal)
    assert_arrived(mesh, goal, after, report)
    # Drawn straight, the hole shrinks to a point half way.
    _, straight = deform(mesh, goal, options=DeformOptions(path="straight", max_steps=60))
    assert straight.status.item() == Status.STALLED
    assert 0.3 < straight.reached.item() <= 0.5
    assert straight.valid.tolist() == [True]
    assert "stuck after" in straight.messages[0]


def test_affine_motions_of_everything_take_one_step():
    mesh = meshes.ring()
    matrix = torch.tensor([[2.0, 0.3], [-0.1, 0.7]], dtype=torch.float64)
    after, report = deform(mesh, mesh.points @ matrix + 3.0)
    assert_arrived(mesh, mesh.points @ matrix + 3.0, after, report)
    assert report.steps.tolist() == [1]
    assert report.refused.tolist() == [0]


def test_no_motion_at_all():
    mesh = meshes.grid()
    after, report = deform(mesh, mesh.points)
    assert_arrived(mesh, mesh.points, after, report)


def test_a_good_mesh_that_stands_still_comes_back_to_the_bit_with_a_trail_that_lasts_the_whole_step():
    channels = [channel(), meshes.disturbed(meshes.grid(), 0.02, 1)]
    batch = join(channels)
    goal = batch.points.clone()
    goal[batch.point_offsets[1] :] *= 1.1  # the second one moves
    options = DeformOptions(when=Bound(angle=5.0))
    after, report = deform(batch, goal, options=options, trail=True)
    assert_arrived(batch, goal, after, report)
    assert torch.equal(after[0].points, channels[0].points)
    assert [(piece.start, piece.end) for piece in report.trail[0]] == [(0.0, 1.0)]
    assert torch.equal(report.trail[0][0].before.points, report.trail[0][0].after.points)
    alone, its = deform(channels[1], goal[batch.point_offsets[1] :], options=options)
    assert torch.equal(after[1].points, alone.points)
    assert report.path[1] == its.path[0]


@pytest.mark.parametrize("steps", [1, 3, 8])
def test_at_least_so_many_steps(steps):
    mesh = channel()
    after, report = deform(mesh, hole_moved(mesh, 0.3), steps)
    assert_arrived(mesh, hole_moved(mesh, 0.3), after, report)
    assert report.steps.tolist() == [steps]
    assert report.path[0] == pytest.approx([(k + 1) / steps for k in range(steps)])


def test_keep_keeps_the_triangles():
    mesh = channel()
    options = DeformOptions(topology="keep", improve=ImproveOptions(topology="keep"))
    after, report = deform(mesh, hole_moved(mesh, 1.0), options=options)
    assert torch.equal(after.triangles, mesh.triangles)
    assert inverted(after) == 0
    assert report.flips.tolist() == [0]


def test_single_precision_and_a_far_origin():
    mesh = channel()
    goal = hole_moved(mesh, 4.0)
    single = mesh.to(torch.float32)
    after, report = deform(single, goal.float())
    assert after.points.dtype == torch.float32
    assert_arrived(single, goal.float(), after, report)
    away = mesh.with_points(mesh.points + 1e7)
    after, report = deform(away, goal + 1e7)
    assert_arrived(away, goal + 1e7, after, report)


@pytest.mark.parametrize("exponent", [-300, 300])
def test_the_unit_of_length_does_not_matter_to_the_bit(exponent):
    mesh = channel()
    goal = hole_moved(mesh, 3.0, degrees=40)
    plain, report = deform(mesh, goal)
    scaled, its = deform(mesh.with_points(mesh.points * 2.0**exponent), goal * 2.0**exponent)
    assert torch.equal(scaled.points, plain.points * 2.0**exponent)
    assert torch.equal(scaled.triangles, plain.triangles)
    assert its.path == report.path


# --- what cannot be done ---


def test_a_hole_that_runs_into_the_wall_stops_before_it():
    mesh = channel()
    after, report = deform(mesh, hole_moved(mesh, 16.0))
    assert report.status.tolist() == [Status.INFEASIBLE]
    # The rim, cos(7.5 degrees) from its centre at 4, meets the wall at 18 after 13.009 of 16.
    assert 0.75 < report.reached.item() < 13.009 / 16
    assert inverted(after) == 0
    assert report.valid.tolist() == [True]
    assert "stuck after" in report.messages[0]
    assert "outside the outer loop" in report.messages[0]
    place = report.messages[0].split("near (")[1].split(",")[0]
    assert 16.5 < float(place) < 18.5
    assert torch.equal(after.points[:, 0] == 18, mesh.points[:, 0] == 18)
    with pytest.raises(ConvergenceError, match="1 of 1 meshes did not arrive: mesh 0: stuck"):
        report.check()


def test_a_straight_way_through_another_hole_can_be_finished_by_improve():
    mesh = two_holes()
    goal = mesh.points.clone()
    first = (mesh.points - torch.tensor([3.0, 5.0])).norm(dim=1) < 1.1
    goal[first] += torch.tensor([10.0, 0.0], dtype=torch.float64)
    stopped, report = deform(mesh, goal)
    assert report.status.tolist() == [Status.STALLED]
    assert 0.2 < report.reached.item() < 0.4
    assert inverted(stopped) == 0
    after, report = deform(mesh, goal, options=DeformOptions(finish="improve"))
    assert report.status.tolist() == [Status.VALID]
    assert report.reached.item() < 0.4
    assert torch.equal(after.points[mesh.fixed], goal[mesh.fixed])
    assert inverted(after) == 0
    assert report.messages[0].endswith("untangled at the goal")


def two_holes() -> MeshBatch:
    x, y = np.meshgrid(np.linspace(0, 18, 19), np.linspace(0, 10, 11), indexing="ij")
    lattice = np.stack([x.ravel(), y.ravel()], 1)
    angle = 2 * np.pi * (np.arange(12) + 0.25) / 12
    circle = np.stack([np.cos(angle), np.sin(angle)], 1)
    centres = np.array([[3.0, 5.0], [8.0, 5.0]])
    for centre in centres:
        lattice = lattice[np.linalg.norm(lattice - centre, axis=1) > 1.4]
    from scipy.spatial import Delaunay

    points = np.concatenate([lattice, *(centre + circle for centre in centres)])
    triangles = Delaunay(points).simplices.astype(np.int64)
    a, b, c = points[triangles].transpose(1, 0, 2)
    twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    triangles[twice < 0] = triangles[twice < 0, ::-1]
    group = np.where(triangles < len(lattice), -1, (triangles - len(lattice)) // 12)
    inside = (group[:, 0] >= 0) & (group == group[:, :1]).all(1)
    return MeshBatch.from_arrays(points, triangles[~inside & (np.abs(twice) > 1e-9)])


def test_steps_run_out():
    mesh = channel()
    after, report = deform(mesh, hole_moved(mesh, 8.0), options=DeformOptions(max_steps=2))
    assert report.status.tolist() == [Status.ITERATION_LIMIT]
    assert report.steps.tolist() == [2]
    assert inverted(after) == 0
    assert "stopped after 2 steps" in report.messages[0]


# --- batches, the report, bad input ---


def test_joined_equals_alone_to_the_bit():
    parts = [channel(), meshes.ring(), channel(), meshes.grid(), channel()]
    goals = [
        hole_moved(parts[0], 7.0),
        torch.where((torch.arange(80) < 16)[:, None], -parts[1].points, parts[1].points),
        hole_moved(parts[2], 16.0),
        parts[3].points * 2,
        hole_moved(parts[4], 3.0, 1.0, 70.0),
    ]
    batch, report = deform(join(parts), torch.cat(goals))
    assert len(set(report.steps.tolist())) > 2
    for b, (mesh, goal, together) in enumerate(zip(parts, goals, batch.split(), strict=True)):
        alone, its = deform(mesh, goal)
        assert torch.equal(alone.triangles, together.triangles)
        assert torch.equal(alone.points, together.points)
        assert its.path == [report.path[b]]
        assert its.messages == [report.messages[b]]
        assert its.status.tolist() == [report.status[b].item()]


def test_a_batch_of_none():
    none = channel().select(torch.tensor([False]))
    after, report = deform(none, none.points)
    assert len(after) == 0
    assert report.path == report.messages == report.to_dict() == []


def test_the_report_is_plain_data_for_json():
    mesh = channel()
    _, report = deform(join([mesh, mesh]), torch.cat([hole_moved(mesh, 3.0), hole_moved(mesh, 16.0)]))
    records = report.to_dict()
    assert json.loads(json.dumps(records, allow_nan=False)) == records
    assert [r["status"] for r in records] == ["valid", "infeasible"]
    assert records[0]["steps"] == len(records[0]["path"])
    assert records[1]["improve"]["valid"] is True


def test_progress_is_told():
    mesh = channel()
    seen = []
    deform(mesh, hole_moved(mesh, 3.0), progress=seen.append)
    assert [p.iteration for p in seen if p.stage == "deform"] == list(range(1, len(seen) + 1))[
        : sum(p.stage == "deform" for p in seen)
    ]
    assert {p.stage for p in seen} > {"deform", "smooth"}


def test_the_input_is_not_changed():
    mesh = channel()
    points, triangles = mesh.points.clone(), mesh.triangles.clone()
    deform(mesh, hole_moved(mesh, 5.0))
    assert torch.equal(mesh.points, points)
    assert torch.equal(mesh.triangles, triangles)


@pytest.mark.parametrize(
    ("match", "arguments"),
    [
        (r"DeformOptions.topology must be one of \('keep', 'flip'\), not 'full'", {"topology": "full"}),
        ("DeformOptions.path must be .*'curved'", {"path": "curved"}),
        ("DeformOptions.finish must be .*'hope'", {"finish": "hope"}),
        ("DeformOptions.part must be between 0 and 1, not 1.0", {"part": 1.0}),
        ("DeformOptions.smallest_step must be between 0 and 1, not 0", {"smallest_step": 0}),
        ("DeformOptions.max_steps must be at least 1, not 0", {"max_steps": 0}),
    ],
)
def test_bad_options_are_named(match, arguments):
    with pytest.raises(ValueError, match=match):
        DeformOptions(**arguments)
    with pytest.raises(dataclasses.FrozenInstanceError):
        DeformOptions().part = 0.5


def test_bad_input_is_named():
    mesh = channel()
    with pytest.raises(ValueError, match="steps must be 'auto' or a number of steps, at least 1, not 0"):
        deform(mesh, mesh.points, 0)
    with pytest.raises(ValueError, match="not 'many'"):
        deform(mesh, mesh.points, "many")
    with pytest.raises(InvalidMeshError, match="new_points must be"):
        deform(mesh, mesh.points[1:])
    bad = mesh.points.clone()
    row = int(mesh.fixed.nonzero()[3])
    bad[row, 0] = math.nan
    after, report = deform(mesh, bad)
    assert report.status.tolist() == [Status.NOT_FINITE]
    assert report.messages[0].startswith(f"new_points row {row} is [nan")
    assert torch.equal(after.points, mesh.points)
    with pytest.raises(ConvergenceError, match=f"mesh 0: new_points row {row}"):
        report.check()
    with pytest.raises(InvalidMeshError, match="new_points must be real"):
        deform(mesh, mesh.points > 0)
    with pytest.raises(InvalidMeshError, match="new_points is not a rectangular"):
        deform(mesh, [[0.0], [1.0, 2.0]])
    tangled = meshes.TANGLED["jittered"]()
    with pytest.raises(InvalidMeshError, match=r"mesh 1: triangles row .* deform starts from a valid mesh"):
        deform(join([mesh, tangled]), torch.cat([mesh.points, tangled.points]))


def test_slivers_that_smoothing_alone_leaves_are_mended():
    """A valid mesh pressed almost flat in front of its hole, as far as FEMWARP goes in one step."""
    mesh = channel()
    goal = hole_moved(mesh, 6.0)
    from torchmesh import largest_step

    warped = femwarp(mesh, goal).points
    step = (1 - 1e-5) * largest_step(mesh, warped)
    pressed = mesh.with_points(mesh.points + step * (warped - mesh.points))
    assert quality(pressed).inverted.item() == 0
    assert quality(pressed).max.item() > 1e3
    after, _ = improve(pressed)
    assert quality(after).max.item() < 3


@pytest.mark.parametrize(
    ("name", "value"), [("shrink", 0.0), ("grow", 0.5), ("after_refusal", 1.0), ("negligible", 1.0)]
)
def test_step_lengths_that_cannot_work_are_refused(name, value):
    with pytest.raises(ValueError, match=f"StepControl.{name} must be"):
        StepControl(**{name: value})


def test_layers_go_with_their_walls():
    body, other = round_body(), meshes.grid()
    moved = turned_body(body, 24, 50.0, (0.5, 0.2))
    goal = torch.cat([moved.points, other.points])
    after, report = deform(join([body, other]), goal)
    report.check()
    turned, _ = after.split()
    assert torch.allclose(first_heights(turned, 24), first_heights(body, 24), rtol=1e-6)
    assert torch.equal(turned.fixed, body.fixed)
    assert len(turned.constrained_edges) == 0
    alone, _ = deform(body, moved.points)
    assert torch.equal(alone.points, turned.points)
    assert torch.equal(alone.triangles, turned.triangles)


def test_a_layer_that_leaves_no_way_is_let_go():
    body = round_body(sides=24, rows=8, first=0.01, growth=1.5, around=4, far=2.5)
    goal = turned_body(body, 24, 0.0, (1.3, 0.0)).points
    with_layers, report = deform(body, goal)
    report.check()
    # The layer is about 0.48 high, and 0.2 are left for it.
    assert report.messages == [f"arrived in {int(report.steps[0])} steps; its layers left no way, and were not kept"]
    assert not torch.allclose(first_heights(with_layers, 24), first_heights(body, 24), rtol=0.1)
    without = DeformOptions(improve=ImproveOptions(shapes="equilateral"))
    assert report.steps.tolist() == deform(body, goal, options=without)[1].steps.tolist()


@pytest.mark.parametrize("where", ["own", "goal"])
@pytest.mark.parametrize("value", [math.nan, math.inf, 1e200])
def test_positions_that_are_not_finite_stop_their_mesh_alone(where, value):
    mesh = channel()
    parts, goals = [mesh, mesh, mesh], [mesh.points * 1.1, mesh.points, mesh.points * torch.tensor([1.2, 1.0])]
    alone = [deform(parts[b], goals[b]) for b in (0, 2)]
    spoilt = mesh.points.clone()
    spoilt[int(mesh.fixed.nonzero()[3]), 1] = value
    if where == "own":
        parts[1] = mesh.with_points(spoilt)
    else:
        goals[1] = spoilt
    after, report = deform(join(parts), torch.cat(goals))
    assert report.status[1] == report.report.status[1] == Status.NOT_FINITE
    assert not report.valid[1]
    assert report.path[1] == []
    assert report.messages[1].startswith("points row" if where == "own" else "new_points row")
    done = after.split()
    assert torch.equal(done[1].points.nan_to_num(7), parts[1].points.nan_to_num(7))
    for b, (own, own_report) in zip((0, 2), alone, strict=True):
        assert torch.equal(done[b].points, own.points)
        assert torch.equal(done[b].triangles, own.triangles)
        assert report.status[b] == own_report.status[0]
        assert report.messages[b] == own_report.messages[0]
        assert report.path[b] == own_report.path[0]


def test_one_step_is_no_steps():
    mesh = meshes.equilateral()
    assert deform(mesh, mesh.points + 1)[1].messages == ["arrived in 1 step"]
