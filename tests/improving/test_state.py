"""A state is a value: its rows go with their meshes, and nothing that a stage does changes the one before."""

import dataclasses

import meshes
import pytest
import torch

from torchmesh import ImproveOptions, RemeshOptions, SmoothOptions, Status, join, quality, target_from
from torchmesh.improving.state import State
from torchmesh.optimising.metric_field import MetricField


@pytest.fixture
def batch():
    return join([meshes.jittered(), meshes.ring(), meshes.l_shape(), meshes.disc()])


KEEP = torch.tensor([True, False, True, False])


def test_select_takes_the_rows_of_its_meshes(batch):
    sizes = torch.arange(len(batch.points), dtype=torch.float64) + 1
    options = ImproveOptions(boundary="slide", remesh=RemeshOptions(sizes=sizes), reference=batch)
    state = dataclasses.replace(
        State.of(batch, options),
        averaged=batch.points + 1,
        lively=torch.arange(len(batch.points)) % 2 == 0,
        sizes=sizes,
        reasons=("a", "b", "c", "d"),
    )
    part, alone = state.select(KEEP), batch.select(KEEP)
    rows = KEEP.repeat_interleave(batch.point_offsets.diff())
    assert torch.equal(part.mesh.points, alone.points)
    assert torch.equal(part.given.triangles, alone.triangles)
    assert torch.equal(part.reference.points, alone.points)
    assert torch.equal(part.of_given_vertices(part.origin.sizes), sizes[rows])
    assert torch.equal(part.averaged, (batch.points + 1)[rows])
    assert torch.equal(part.lively, state.lively[rows])
    assert torch.equal(part.sizes, sizes[rows])
    assert part.reasons == ("a", "c")
    assert torch.equal(part.curves.may_slide(alone.point_offsets), state.curves.may_slide(batch.point_offsets)[rows])
    expected = quality(alone)
    for field in dataclasses.fields(expected):
        assert torch.equal(getattr(part.quality, field.name), getattr(expected, field.name)), field.name
    again = part.select(torch.tensor([False, True]))
    assert torch.equal(again.given.points, batch.split()[2].points)
    assert again.reasons == ("c",)


def test_targets_go_with_their_rows(batch):
    matrices = target_from(join([meshes.grid(8, 7), *batch.split()[1:]]))
    state = State.of(batch, ImproveOptions(topology="keep", smooth=SmoothOptions(targets=matrices)))
    triangles = KEEP.repeat_interleave(batch.triangle_offsets.diff())
    assert torch.equal(state.select(KEEP).targets, matrices[triangles])
    metric = torch.rand(len(batch.points), 3, dtype=torch.float64) + torch.tensor([2.0, 0.0, 2.0])
    state = State.of(batch, ImproveOptions(smooth=SmoothOptions(targets=MetricField(metric))))
    rows = KEEP.repeat_interleave(batch.point_offsets.diff())
    assert torch.equal(state.select(KEEP).targets.values, metric[rows])


def test_put_is_the_inverse_of_select(batch):
    state = State.of(batch, ImproveOptions())
    part = state.select(KEEP)
    moved = part.at(part.mesh.with_points(part.mesh.points + 0.25)).ended(torch.tensor([True, False]), Status.STALLED)
    whole = state.put(KEEP, dataclasses.replace(moved, reasons=("why", "")))
    rows = KEEP.repeat_interleave(batch.point_offsets.diff())
    assert torch.equal(whole.mesh.points, torch.where(rows[:, None], batch.points + 0.25, batch.points))
    assert whole.status.tolist() == [Status.STALLED, Status.RUNNING, Status.RUNNING, Status.RUNNING]
    assert whole.reasons == ("why", "", "", "")
    measured = quality(whole.mesh)
    for field in dataclasses.fields(measured):
        assert torch.equal(getattr(whole.quality, field.name), getattr(measured, field.name)), field.name
    # The state before is what it was.
    assert torch.equal(state.mesh.points, batch.points)
    assert state.status.tolist() == [Status.RUNNING] * 4
    assert state.reasons == ("",) * 4


def test_put_of_other_numbers_of_vertices_keeps_their_names(batch):
    from torchmesh import remesh

    state = State.of(batch, ImproveOptions(topology="full"))
    part = state.select(KEEP)
    finer, info = remesh(part.mesh.with_points(part.mesh.points), RemeshOptions(sizes=lambda p: 0 * p[:, 0] + 0.07))
    assert len(finer.points) != len(part.mesh.points)
    local = info.vertex_map
    of = torch.where(local.new_to_old >= 0, part.vertex_names.of[local.new_to_old.clamp_min(0)], -1)
    fresh = int((of < 0).sum())
    names = part.vertex_names
    of[of < 0] = names.fresh + torch.arange(fresh)
    changed = dataclasses.replace(part.at(finer), names=_with_fresh(names, of, fresh))
    whole = state.put(KEEP, changed)
    assert whole.mesh.point_offsets.diff().tolist()[1] == batch.point_offsets.diff().tolist()[1]
    kept = whole.names.of < len(batch.points)
    old = whole.names.of[kept]
    # Fixed vertices stay where they were, under whatever row.
    fixed = batch.fixed[old]
    assert torch.equal(whole.mesh.points[kept][fixed], batch.points[old][fixed])
    assert int(fixed.sum()) == int(batch.fixed.sum())


def _with_fresh(names, of, fresh):
    renamed = names.renamed(of)
    return dataclasses.replace(renamed, fresh=renamed.fresh + fresh) if dataclasses.is_dataclass(renamed) else renamed


def test_tangled_are_those_with_hope(batch):
    state = State.of(batch, ImproveOptions())
    assert state.tangled.tolist() == [True, False, False, False]
    assert (state.valid == ~state.tangled).all()
    assert not state.ended(state.tangled, Status.INFEASIBLE).tangled.any()
