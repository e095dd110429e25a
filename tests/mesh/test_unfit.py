"""A mesh with positions that are no numbers to compute with keeps them, says so, and touches no other."""

import functools
from dataclasses import replace

import meshes
import numpy as np
import pytest
import torch

import torchmesh as tm
from torchmesh import Status
from torchmesh.diagnosing.problems import ProblemKind
from torchmesh.mesh.unfit import on_a_line, unfit_meshes

NAN, INF = float("nan"), float("inf")
# A few rounds of remeshing take every step of it.
FEW = tm.RemeshOptions(sizes="keep", max_rounds=2)
TOPOLOGIES = {
    "flip": tm.ImproveOptions(),
    "keep": tm.ImproveOptions(topology="keep"),
    "full": tm.ImproveOptions(topology="full", remesh=FEW),
    "slide": tm.ImproveOptions(boundary="slide"),
    "paper": tm.ImproveOptions.paper(),
}


def good(seed: int) -> tm.MeshBatch:
    return meshes.jittered(6, 5, 0.4, seed)


@functools.cache
def alone(options: str, seed: int) -> tuple[tm.MeshBatch, tm.Report]:
    return tm.improve(good(seed), TOPOLOGIES[options])


def valid() -> tm.MeshBatch:
    return meshes.grid(6, 5)


def spoiled(mesh: tm.MeshBatch, value: float, fixed: bool) -> tm.MeshBatch:
    points = mesh.points.clone()
    points[int((mesh.fixed == fixed).nonzero()[3])] = value
    return mesh.with_points(points)


def same(a: tm.MeshBatch, b: tm.MeshBatch) -> bool:
    points = torch.allclose(a.points, b.points, rtol=0, atol=0, equal_nan=True)
    return points and torch.equal(a.triangles, b.triangles)


@pytest.mark.parametrize("options", TOPOLOGIES)
@pytest.mark.parametrize(("value", "fixed"), [(NAN, True), (NAN, False), (-INF, True), (1e200, False)])
def test_improve_leaves_it_and_the_others_come_out_as_alone(options, value, fixed):
    bad = spoiled(good(1), value, fixed)
    batch = tm.join([good(0), bad, good(2)])
    before = batch.points.clone()
    after, report = tm.improve(batch, TOPOLOGIES[options])
    parts = after.split()
    for i, seed in ((0, 0), (2, 2)):
        mesh, own = alone(options, seed)
        assert same(parts[i], mesh)
        assert report.messages[i] == own.messages[0]
        assert report.status[i] == own.status[0]
    assert same(parts[1], bad)
    assert report.status[1] == Status.NOT_FINITE
    assert not report.valid[1]
    assert not report.certified[1]
    assert report.moved[1] == 0
    row = int((bad.fixed == fixed).nonzero()[3])
    assert f"points row {row} is [{value}, {value}]" in report.messages[1]
    assert torch.equal(batch.points.nan_to_num(7.0), before.nan_to_num(7.0))
    with pytest.raises(tm.ConvergenceError, match=f"mesh 1: .* points row {row} is"):
        report.check()


@pytest.mark.parametrize(("value", "dtype"), [(NAN, torch.float32), (INF, torch.float64), (1e200, torch.float64)])
def test_every_other_function_too(value, dtype):
    tangled = tm.join([good(0).to(dtype), spoiled(good(1).to(dtype), value, True), good(2).to(dtype)])
    upright = tm.join([valid().to(dtype), spoiled(valid().to(dtype), value, False), valid().to(dtype)])
    keep = torch.tensor([True, False, True])
    for run, batch, has_status in (
        (tm.untangle, tangled, True),
        (lambda b: tm.untangle(b, tm.UntangleOptions("regularised")), tangled, True),
        (tm.smooth, upright, True),
        (tm.flip_to_delaunay, tangled, False),
        (lambda b: (tm.relax(b), None), tangled, False),
        (tm.polish, upright, False),
        (lambda b: tm.remesh(b, replace(FEW, sizes="boundary")), upright, False),
    ):
        after, info = run(batch)
        rest, _ = run(batch.select(keep))
        assert same(after.select(keep), rest)
        assert same(after.split()[1], batch.split()[1])
        if has_status:
            assert info.status[1] == Status.NOT_FINITE
    for sizes in ("boundary", "keep", "uniform"):
        size = tm.size_field(upright, sizes)
        rows = unfit_meshes(upright).repeat_interleave(upright.point_offsets.diff())
        assert torch.equal(size[~rows], tm.size_field(upright.select(keep), sizes))
        assert (size[rows] == 1).all()


@pytest.mark.parametrize("layer", [tm.nn.Smooth, tm.nn.Untangle])
@pytest.mark.parametrize("value", [NAN, 1e200])
def test_layers_keep_it_if_they_are_asked_to(layer, value):
    start = valid() if layer is tm.nn.Smooth else good(0)
    batch = tm.join([start, spoiled(start, value, False), start])
    keep = layer(on_failure="keep")
    points = batch.points.clone().requires_grad_()
    out = keep(points, batch)
    parts = batch.with_points(out.detach()).split()
    assert torch.equal(parts[0].points, layer()(start.points, start))
    assert torch.equal(parts[2].points, parts[0].points)
    assert same(parts[1], batch.split()[1])
    assert keep.info.status.tolist() == [Status.CONVERGED, Status.NOT_FINITE, Status.CONVERGED]
    assert keep.info.valid.tolist() == [True, False, True]
    (out[:20].square().sum()).backward()
    assert points.grad.isfinite().all()
    with pytest.raises(tm.InvalidMeshError, match="mesh 1: points row"):
        layer()(batch.points, batch)


def test_diagnose_names_it_and_goes_on():
    folded = meshes.jittered(6, 5, 0.4, 0)
    crossed = folded.points.clone()
    crossed[[0, 3]] = crossed[[3, 0]]
    batch = tm.join([spoiled(good(1), NAN, True), folded.with_points(crossed)])
    problems = tm.diagnose(batch)
    assert problems[0].kind == ProblemKind.NOT_FINITE
    assert problems[0].mesh == 0
    alone = tm.diagnose(batch.select(torch.tensor([False, True])))
    assert [p.message for p in problems[1:]] == [p.message for p in alone]
    assert {p.mesh for p in problems[1:]} == {1}


@pytest.mark.parametrize("options", ["flip", "full"])
def test_a_vertex_without_triangles_may_be_anything(options):
    points, triangles = meshes.grid_arrays(6, 5)
    with pytest.warns(tm.MeshWarning, match="belong to no triangle"):
        mesh = tm.MeshBatch.from_arrays(np.vstack([points, [[0.5, 0.5]]]), triangles)
    odd = mesh.points.clone()
    odd[-1] = NAN
    after, report = tm.improve(mesh.with_points(odd), TOPOLOGIES[options])
    assert report.valid.all()
    row = len(points) if report.vertex_map is None else int(report.vertex_map.old_to_new[len(points)])
    assert after.points.isnan().any(1).nonzero().squeeze(1).tolist() == [row]
    assert report.moved[0] < len(points)


def test_single_precision_knows_infinity():
    with pytest.raises(tm.InvalidMeshError, match="must be finite"):
        tm.MeshBatch.from_arrays(torch.tensor([[0.0, 0.0], [1.0, 0.0], [INF, 1.0]], dtype=torch.float32), [[0, 1, 2]])


def test_on_a_line_no_triangle_is_upright_and_no_two_vertices_coincide():
    batch = tm.join([good(0), spoiled(good(1), NAN, True)])
    line, rows = on_a_line(batch, unfit_meshes(batch))
    assert (line.points[:30] == batch.points[:30]).all()
    part = line.split()[1]
    assert tm.quality(part).inverted == len(part.triangles)
    assert len(part.points.unique(dim=0)) == len(part.points)
    assert rows.tolist() == list(range(len(line.points) - len(part.points), len(line.points)))


@pytest.mark.parametrize(
    ("points", "match"),
    [
        (torch.zeros(3, 2), "as in the batch"),
        (torch.zeros(30, 2, dtype=torch.bool), "real numbers"),
        (torch.zeros(30, 2, dtype=torch.complex128), "real numbers"),
        (np.zeros((30, 2)), "must be a tensor"),
    ],
)
def test_with_points_refuses_other_shapes_and_types(points, match):
    mesh = meshes.grid(6, 5)
    assert len(mesh.points) in (30, 42)
    if match != "as in the batch":
        points = (
            points[:1].repeat(len(mesh.points), 0)
            if isinstance(points, np.ndarray)
            else points[:1].expand(len(mesh.points), 2)
        )
    with pytest.raises(tm.InvalidMeshError, match=match):
        mesh.with_points(points)


def test_rows_of_another_mesh_are_refused_by_name():
    batch = tm.join([valid(), valid()])
    faces = batch.triangles.clone()
    row = int(batch.triangle_offsets[1]) + 2
    faces[row, 1] = 0
    with pytest.raises(tm.InvalidMeshError, match=f"mesh 1: triangles row {row} is"):
        batch.with_triangles(faces)
    with pytest.raises(tm.InvalidMeshError, match="int64"):
        batch.with_triangles(batch.triangles.double())
    wrong = replace(batch, triangles=faces, _twin=None)
    for run in (lambda: tm.improve(wrong), lambda: tm.nn.Smooth()(wrong.points, wrong)):
        with pytest.raises(tm.InvalidMeshError, match=f"mesh 1: triangles row {row} is"):
            run()
    with pytest.raises(tm.InvalidMeshError, match="float32 or float64"):
        tm.nn.Smooth()(valid().points.half(), valid())
