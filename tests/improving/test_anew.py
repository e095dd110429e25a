"""Topology "full" makes insides anew: where it may, what it keeps, and whatever else is in the batch."""

import dataclasses

import meshes
import numpy as np
import pytest
import torch
from judges import assert_same_domain

import torchmesh as tm
from experiments.robustness.attack.impossible import torus
from torchmesh import ImproveOptions, RemeshOptions, Status, improve, join

FULL = ImproveOptions(topology="full")


def crossed() -> tm.MeshBatch:
    """A grid with a corner on the other side: its boundary crosses itself."""
    mesh = meshes.grid(4, 4)
    points = mesh.points.clone()
    points[0] = torch.tensor([2.0, 2.0])
    return mesh.with_points(points)


def stages(report: tm.Report, b: int = 0) -> list[str]:
    return [step.stage for step in report.steps[b]]


def test_joined_equals_alone_to_the_bit_whichever_way_a_mesh_goes():
    given = [
        crossed(), meshes.moved_hole(), meshes.equilateral(), meshes.dragged_interface(), meshes.jittered(9, 8, 0.5, 2),
        meshes.grid(5, 4).with_points(meshes.grid(5, 4).points * torch.tensor([4.0, 1.0])),
    ]  # fmt: skip
    batch = join(given)
    together, report = improve(batch, FULL)
    maps = report.vertex_map.split(batch, together)
    ways = set()
    for b, (mesh, after) in enumerate(zip(given, together.split(), strict=True)):
        alone, own = improve(mesh, FULL)
        assert torch.equal(alone.points, after.points)
        assert torch.equal(alone.triangles, after.triangles)
        assert report.status[b] == own.status[0]
        assert report.messages[b] == own.messages[0]
        assert stages(report, b) == stages(own)
        assert bool(report.certified[b]) == bool(own.certified[0]) == bool(own.valid[0])
        for name in ("old_to_new", "new_to_old", "rows", "sources", "weights"):
            assert torch.equal(getattr(maps[b], name), getattr(own.vertex_map, name))
        ways.add("anew" in stages(own) and own.steps[0][1].kept)
    assert ways == {True, False}


@pytest.mark.parametrize("make", [meshes.moved_hole, meshes.dragged_interface, lambda: meshes.jittered(9, 8, 0.5, 2)])
def test_the_frame_and_the_order_of_kept_vertices_stay(make):
    mesh = make()
    after, report = improve(mesh, FULL)
    assert stages(report) == ["initial", "anew"]
    assert report.status.tolist() == [Status.SETTLED]
    assert bool(report.certified)
    assert_same_domain(mesh, after)
    vertex_map = report.vertex_map
    old = vertex_map.new_to_old
    kept = old[old >= 0]
    assert torch.equal(kept, kept.sort().values)
    assert bool((old[: len(kept)] >= 0).all())
    assert 0 < int(report.remeshed.splits) == int((old < 0).sum())
    assert int(report.remeshed.collapses) == int((vertex_map.old_to_new < 0).sum())
    held = mesh.fixed
    assert torch.equal(after.points[vertex_map.old_to_new[held]], mesh.points[held])
    assert len(report.remeshed.size) == len(after.points)
    weights = torch.zeros(len(old), dtype=torch.float64).index_add_(0, vertex_map.rows, vertex_map.weights)
    assert torch.allclose(weights, torch.ones_like(weights))


def test_linear_fields_are_carried_near_to_where_vertices_are():
    mesh = meshes.jittered(14, 13, 0.5, 3)
    after, report = improve(mesh, FULL)
    off = report.vertex_map.carry(mesh.points) - after.points
    # A vertex takes its value along for at most about half a width, and new ones are smoothed a little.
    assert float(off.norm(dim=1).max()) < 1.0 / 13


@pytest.mark.parametrize(
    "options",
    [
        ImproveOptions(topology="full", remesh=RemeshOptions(split_boundary=True, max_rounds=1)),
        ImproveOptions(topology="full", remesh=RemeshOptions(sizes="keep", max_rounds=1)),
        ImproveOptions(topology="full", interfaces="free", remesh=RemeshOptions(max_rounds=1)),
        ImproveOptions(topology="full", scope="damage", remesh=RemeshOptions(max_rounds=1)),
        ImproveOptions(topology="flip"),
    ],
)
def test_what_binds_a_mesh_keeps_it_from_being_made_anew(options):
    _, report = improve(meshes.dragged_interface(), options)
    assert bool(report.valid)
    assert "anew" not in stages(report)


def test_a_good_mesh_is_not_made_anew():
    mesh = meshes.equilateral()
    after, report = improve(mesh, FULL)
    assert "anew" not in stages(report)
    assert torch.equal(after.triangles, mesh.triangles)


def test_what_was_made_anew_is_not_made_anew_again():
    once, _ = improve(meshes.moved_hole(), FULL)
    _, report = improve(once, FULL)
    assert "anew" not in stages(report)


def test_sizes_by_a_function_are_followed():
    mesh = meshes.jittered(12, 12, 0.5, 1)
    sizes = RemeshOptions(sizes=lambda p: 0.05 + 0.1 * p[:, 0])
    _, report = improve(mesh, dataclasses.replace(FULL, remesh=sizes))
    assert stages(report) == ["initial", "anew"]
    assert bool(report.certified)
    assert float(report.sizes.mean) == pytest.approx(1, abs=0.1)


def test_single_precision_stays_single():
    mesh = meshes.moved_hole()
    after, report = improve(dataclasses.replace(mesh, points=mesh.points.float()), FULL)
    assert after.points.dtype == torch.float32
    assert bool(report.certified)
    assert stages(report) == ["initial", "anew"]


def test_where_the_front_leaves_poor_triangles_splits_and_collapses_are_tried_and_the_lower_mean_is_taken():
    batch = tm.join([tm.domains.generate(9, triangles=110, seed=seed).deformed[b] for seed, b in ((540, 1), (528, 0))])
    after, report = tm.improve(batch, FULL)
    assert bool(report.certified.all())
    assert float(report.quality.mean[0]) < 1.08
    assert report.steps[0][-1].stage != "anew"
    assert float(report.quality.mean[1]) < 1.08
    assert report.steps[1][-1].stage == "anew"
    for b in range(2):
        alone, its = tm.improve(batch[b], FULL)
        assert torch.equal(alone.points, after[b].points)
        assert torch.equal(alone.triangles, after[b].triangles)
        assert [row.stage for row in its.steps[0]] == [row.stage for row in report.steps[b]]
        given = report.vertex_map.old_to_new[batch.point_offsets[b] : batch.point_offsets[b + 1]]
        assert int((given >= 0).sum()) == int((its.vertex_map.old_to_new >= 0).sum()) > 20


@pytest.mark.parametrize("seed", range(3))
def test_a_mesh_with_a_handle_is_not_made_anew(seed):
    """Its boundary is that of a mesh of the plane, and it is none."""
    mesh = tm.MeshBatch.from_arrays(*torus(np.random.default_rng(seed), 30)[:2])
    _, report = improve(mesh, FULL)
    assert not bool(report.valid[0])
    assert all(not row.kept for row in report.steps[0] if row.stage == "anew")


def square(shift: float = 0.0, hole: bool = False) -> tuple[torch.Tensor, torch.Tensor]:
    """Points and triangles of a unit square of 16 x 16 cells, perhaps with a hole of 4 x 4 in its middle."""
    mesh = meshes.grid(16, 16)
    points, triangles = mesh.points / mesh.points.max(), mesh.triangles
    if hole:
        away = (points[triangles].mean(1) - 0.5).abs().amax(1) > 2 / 16
        used, rows = triangles[away].unique(return_inverse=True)
        points, triangles = points[used], rows
    return points + torch.tensor([shift, 0.0]), triangles


def within(points: torch.Tensor, x: float, cells: int) -> torch.Tensor:
    """(V,) bool: at most so many cells from (x, 0.5), along both axes."""
    return ((points - torch.tensor([x, 0.5])).abs() <= cells / 16 + 1e-9).all(1)


def rim_of(mesh: tm.MeshBatch, inside: torch.Tensor) -> torch.Tensor:
    """(K, 2) the edges round the triangles all of whose corners are `inside`."""
    part = mesh.triangles[inside[mesh.triangles].all(1)]
    half = torch.cat([part[:, [0, 1]], part[:, [1, 2]], part[:, [2, 0]]]).tolist()
    return torch.tensor([[u, v] for u, v in half if [v, u] not in half])


def hole_over_a_fixed_vertex() -> tm.MeshBatch:
    points, triangles = square(hole=True)
    fixed = within(points, 0.75, 0)
    mesh, to = tm.MeshBatch.from_arrays(points, triangles, fixed=fixed), points.clone()
    to[within(points, 0.5, 2)] += torch.tensor([0.25, 0.0])
    return tm.femwarp(mesh, to)


def inclusion(to: float, hole: bool) -> tm.MeshBatch:
    """An inclusion whose interface has gone to x = `to`, half as large."""
    points, triangles = square(hole=hole)
    inside = within(points, 0.8125, 2)
    mesh = tm.MeshBatch.from_arrays(points, triangles)
    mesh = dataclasses.replace(mesh, constrained_edges=rim_of(mesh, inside))
    moved = (points - torch.tensor([0.8125, 0.5])) / 2 + torch.tensor([to, 0.5])
    return mesh.with_points(torch.where(inside[:, None], moved, points))


def hole_in_another_part() -> tm.MeshBatch:
    (points, triangles), (others, more) = square(hole=True), square(shift=2.0)
    to = torch.where(within(points, 0.5, 2)[:, None], points + torch.tensor([2.0, 0.0]), points)
    return tm.MeshBatch.from_arrays(torch.cat([to, others]), torch.cat([triangles, more + len(points)]))


@pytest.mark.parametrize(
    "mesh",
    [hole_over_a_fixed_vertex(), inclusion(2.0, hole=False), inclusion(0.5, hole=True), hole_in_another_part()],
    ids=["hole over a fixed vertex", "inclusion outside", "inclusion in a hole", "hole in another part"],
)
def test_what_has_gone_out_of_its_region_is_told_as_under_flip(mesh):
    """The boundary alone is that of a domain, in which vertices, interfaces or regions would be lost."""
    after, report = improve(mesh, FULL)
    _, other = improve(mesh)
    assert not bool(report.valid[0])
    assert report.status[0] == other.status[0]
    assert report.messages[0] == other.messages[0]
    assert len(after.triangles) == len(mesh.triangles)


@pytest.mark.parametrize("factor", [0.6, 0.7])
def test_no_vertex_is_put_on_a_boundary_edge_that_is_longer_than_the_size_asked_for(factor):
    points, triangles = square()
    points[8 * 17 + 8] += 0.3
    sizes = RemeshOptions(sizes=lambda p: torch.full((len(p),), factor / 16, dtype=p.dtype))
    _, report = improve(tm.MeshBatch.from_arrays(points, triangles), dataclasses.replace(FULL, remesh=sizes))
    assert bool(report.certified)
    assert float(report.quality.max[0]) < 1.5


def test_where_the_boundary_cannot_follow_a_size_the_better_shapes_are_taken():
    points, triangles = square()
    points[8 * 17 + 8] += 0.3
    sizes = RemeshOptions(sizes=lambda p: torch.full((len(p),), 10 / 16, dtype=p.dtype))
    _, report = improve(tm.MeshBatch.from_arrays(points, triangles), dataclasses.replace(FULL, remesh=sizes))
    assert bool(report.certified)
    assert float(report.quality.mean[0]) < 2
