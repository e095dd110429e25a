"""Submeshes: a small tangle in a large good mesh costs what its neighbourhood costs, and is judged as a whole."""

import dataclasses
from typing import Any

import meshes
import numpy as np
import pytest
import torch
from exact import boundary, directed_edges, edge_counts, inverted, total_area
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

import torchmesh as tm
from torchmesh import ImproveOptions, MeshBatch, improve, join, quality
from torchmesh.improving import forked
from torchmesh.improving.local_repair import Submeshes, damaged_submeshes
from torchmesh.improving.neighbourhood import neighbourhood
from torchmesh.improving.runner import Log
from torchmesh.improving.state import State
from torchmesh.improving.step_options import LocalRepair
from torchmesh.improving.strategies import improve_batch
from torchmesh.mesh import connectivity
from torchmesh.mesh.batch import put

WHOLE = ImproveOptions(local_repair=None)


@pytest.fixture
def low(monkeypatch):
    """Meshes that are small enough for tests count as large."""
    small = dataclasses.asdict(LocalRepair()) | {"large": 2_000, "rings": 3, "rings_by_width": 0.0}
    monkeypatch.setattr(LocalRepair.__init__, "__defaults__", tuple(small.values()))


def cut(batch: MeshBatch) -> Submeshes | None:
    """The submeshes that `improve` would work on by default."""
    return damaged_submeshes(batch, quality(batch), LocalRepair())


def patch(columns: int = 50, rows: int = 40, seed: int = 0, **of_mesh: Any) -> MeshBatch:
    """4,000 triangles, nearly equilateral, edges about 1 long, in a parallelogram."""
    plain = meshes.equilateral(columns, rows)
    mesh = MeshBatch.from_arrays(plain.points, plain.triangles, **of_mesh)
    return meshes.disturbed(mesh, 0.03, seed)


def near(mesh: MeshBatch, place: tuple[float, float], radius: float) -> Tensor:
    return (mesh.points - torch.tensor(place, dtype=mesh.points.dtype)).norm(dim=1) < radius


def tangled(mesh: MeshBatch, *places: tuple[float, float], radius: float = 2.0, size: float = 1.2) -> MeshBatch:
    """The mesh with its free vertices near the `places` thrown about."""
    thrown = meshes.disturbed(mesh, size, 1).points
    for place in places:
        points = torch.where(near(mesh, place, radius)[:, None], thrown, mesh.points)
        mesh = mesh.with_points(points)
    assert int(quality(mesh).inverted) > 0
    return mesh


MIDDLE, LEFT, RIGHT = (15.0, 17.0), (5.0, 17.0), (28.0, 17.0)
RIM = (25.0, 0.5)


def assert_same_but_for_time(one: tm.Report, its: tm.Report) -> None:
    for name in ("status", "valid", "certified", "moved"):
        assert torch.equal(getattr(one, name), getattr(its, name)), name
    for field in dataclasses.fields(tm.Quality):
        assert torch.equal(getattr(one.quality, field.name), getattr(its.quality, field.name)), field.name
    assert one.messages == its.messages
    rows = [[[dataclasses.replace(row, seconds=0.0) for row in steps] for steps in r.steps] for r in (one, its)]
    assert rows[0] == rows[1]


def assert_same_rows(one: MeshBatch, two: MeshBatch) -> None:
    assert torch.equal(one.points, two.points)
    assert torch.equal(one.triangles, two.triangles)


def assert_sound(before: MeshBatch, after: MeshBatch, report: tm.Report) -> None:
    """Valid and of the same frame by independent judges, and the report says what `quality` says."""
    assert report.valid.all()
    assert report.certified.all()
    assert inverted(after) == 0
    assert max(directed_edges(after.triangles).values()) == 1
    assert boundary(after.triangles) == boundary(before.triangles)
    assert total_area(after) == total_area(before)
    assert torch.equal(after.points[before.fixed], before.points[before.fixed])
    edges = edge_counts(after.triangles)
    assert all(edges[frozenset(edge)] == 2 for edge in before.constrained_edges.tolist())
    for name in ("fixed", "constrained_edges", "point_offsets", "triangle_offsets", "frames"):
        assert torch.equal(getattr(after, name), getattr(before, name)), name
    assert_report_is_of(report, before, after)


def assert_report_is_of(report: tm.Report, before: MeshBatch, after: MeshBatch) -> None:
    first, last = quality(before), quality(after)
    for field in dataclasses.fields(tm.Quality):
        assert torch.equal(getattr(report.quality, field.name), getattr(last, field.name)), field.name
    assert int(report.moved.sum()) == int((before.points != after.points).any(1).sum())
    for b, steps in enumerate(report.steps):
        row = steps[0]
        assert (row.mean, row.max, row.inverted) == (float(first.mean[b]), float(first.max[b]), int(first.inverted[b]))
        row = steps[-1]
        assert row.inverted == int(last.inverted[b])
        assert row.max == float(last.max[b])
        # The mean is put together from inside and outside: rounding.
        assert row.mean == pytest.approx(float(last.mean[b]), rel=1e-12)


def untouched(before: MeshBatch, after: MeshBatch) -> Tensor:
    """(T,) bool: the triangle has the same corners in the same places."""
    still = (before.points == after.points).all(1)[before.triangles].all(1)
    return still & (before.triangles == after.triangles).all(1)


def stages(report: tm.Report, b: int = 0) -> list[str]:
    return [step.stage for step in report.steps[b]]


# --- which triangles ---


def slow_neighbourhood(triangles: Tensor, damage: list[int], rings: int) -> tuple[set, set, list, set]:
    """Vertices, rim, triangles and edges across, by sets."""
    rows = triangles.tolist()
    free = {v for t in damage for v in rows[t]}
    for _ in range(rings - 1):
        free |= {v for row in rows if free & set(row) for v in row}
    taken = [t for t, row in enumerate(rows) if free & set(row)]
    vertices = {v for t in taken for v in rows[t]}
    pairs = {frozenset(p) for t, (a, b, c) in enumerate(rows) if t not in set(taken) for p in ((a, b), (b, c), (c, a))}
    return vertices, vertices - free, taken, {pair for pair in pairs if pair <= vertices}


@settings(max_examples=25)
@given(
    st.sampled_from(["patch", "ring", "delaunay", "graded"]),
    st.lists(st.integers(0, 10_000), min_size=1, max_size=6),
    st.integers(1, 5),
    st.sampled_from([0.0, 0.5, 100.0]),
)
def test_the_neighbourhood_is_what_a_walk_by_sets_finds(kind, picks, rings, throw):
    mesh = {
        "patch": lambda: meshes.equilateral(16, 12),
        "ring": lambda: meshes.ring(40, 8),
        "delaunay": lambda: meshes.delaunay(250),
        "graded": lambda: meshes.ring(12, 20, 1e-3, 1.0),
    }[kind]()
    damage = torch.tensor(picks).remainder(len(mesh.triangles)).unique()
    corners = mesh.triangles[damage]
    points = mesh.points.clone()
    points[corners[:, 0]] += throw
    place = neighbourhood(points, mesh.triangles, damage, rings)
    assert neighbourhood(points, mesh.triangles, damage, rings, len(place.triangles)) is not None
    assert neighbourhood(points, mesh.triangles, damage, rings, len(place.triangles) - 1) is None
    vertices, rim, taken, across = slow_neighbourhood(mesh.triangles, damage.tolist(), rings)
    assert place.vertices.tolist() == sorted(vertices)
    assert place.vertices[place.shared].tolist() == sorted(rim)
    assert place.triangles.tolist() == taken
    assert {frozenset(edge) for edge in place.across.tolist()} == across


@pytest.mark.parametrize("where", [0.0, 1e9])
def test_damage_in_one_point_is_found(where):
    mesh = meshes.equilateral(30, 30)
    core = near(mesh, (8.0, 13.0), 5.0)
    points = mesh.points.clone()
    points[core] = where
    damage = core[mesh.triangles].all(1).nonzero().squeeze(1)
    place = neighbourhood(points, mesh.triangles, damage, 8)
    assert set(damage.tolist()) < set(place.triangles.tolist())
    points[:] = 1.0
    assert torch.equal(neighbourhood(points, mesh.triangles, damage, 8).triangles, place.triangles)


@pytest.mark.usefixtures("low")
def test_only_large_good_meshes_with_small_tangles_are_cut():
    one = tangled(patch(), MIDDLE)
    assert cut(one) is not None
    assert cut(patch()) is None, "nothing is tangled"
    assert cut(tangled(patch(20, 20), (5.0, 8.0))) is None, "small"
    assert cut(tangled(patch(), MIDDLE, radius=15)) is None, "tangled all over"
    assert cut(tangled(patch(), LEFT, MIDDLE, RIGHT, (10.0, 30.0), radius=3)) is None, "at many places"
    assert cut(tangled(meshes.disturbed(patch(), 0.1, 3), MIDDLE)) is None, "poor elsewhere"


def test_the_bound_of_large_is_as_documented():
    assert cut(tangled(patch(100, 100), (20.0, 40.0), radius=1.5)) is None
    batch = tangled(patch(101, 101), (20.0, 40.0), radius=1.5)
    found = cut(batch)
    assert found is not None
    assert len(found.taken.mesh.triangles) < 0.05 * len(batch.triangles)


@pytest.mark.parametrize(
    "options",
    [
        ImproveOptions(local_repair=None),
        ImproveOptions.paper(),
        ImproveOptions(topology="full"),
        ImproveOptions(boundary="slide"),
        ImproveOptions(smooth=tm.SmoothOptions(boundary="slide")),
        ImproveOptions(remesh=tm.RemeshOptions(sizes="uniform")),
        ImproveOptions(remesh=tm.RemeshOptions(sizes=torch.ones(3))),
        ImproveOptions(reference=meshes.grid()),
        ImproveOptions(topology="keep", smooth=tm.SmoothOptions(targets=torch.eye(2).expand(3, 2, 2))),
    ],
    ids=["off", "paper", "full", "slide", "smooth-slide", "sizes", "size-field", "reference", "targets"],
)
def test_what_is_about_the_whole_mesh_is_not_done_on_submeshes(options):
    assert not options.local


@pytest.mark.parametrize("topology", ["keep", "flip"])
def test_the_default_is_done_on_submeshes(topology):
    assert ImproveOptions(topology=topology).local


# --- what is done with them ---


@pytest.mark.usefixtures("low")
@pytest.mark.parametrize("topology", ["keep", "flip"])
def test_it_is_the_submesh_alone_put_back(topology):
    options = ImproveOptions(topology=topology)
    mesh = tangled(patch(), MIDDLE)
    found = cut(mesh)
    # By hand: `from_arrays` finds the rim by itself, as the boundary of the part.
    used, local = np.unique(mesh.triangles[found.taken.triangles].numpy(), return_inverse=True)
    alone = MeshBatch.from_arrays(mesh.points[used], local.reshape(-1, 3), mesh.fixed[used])
    # It would wind mirrored pieces otherwise; this one is not.
    assert torch.equal(alone.triangles, torch.from_numpy(local.reshape(-1, 3)))
    assert torch.equal(alone.fixed, found.taken.mesh.fixed)
    its, its_report = improve(alone, options)
    after, report = improve(mesh, options)
    rows = torch.from_numpy(used)
    assert torch.equal(after.points[rows], its.points)
    assert torch.equal(after.triangles[found.taken.triangles], rows[its.triangles])
    outside = torch.ones(len(mesh.points), dtype=torch.bool).index_fill_(0, rows, False)
    assert torch.equal(after.points[outside], mesh.points[outside])
    assert [s for s in stages(report) if s != "submesh"] == stages(its_report)
    assert stages(report)[:2] == ["initial", "submesh"]
    assert f"only a submesh, {len(local.reshape(-1, 3)):,} of 4,000 triangles" in report.messages[0]
    assert report.status.tolist() == its_report.status.tolist()
    assert report.flipped.tolist() == its_report.flipped.tolist()
    assert report.to_dict()[0]["tried"][0] == "submesh"
    assert_sound(mesh, after, report)


@pytest.mark.usefixtures("low")
def test_the_rest_keeps_its_bits_and_the_caller_his_mesh():
    mesh = tangled(patch(), MIDDLE)
    points, triangles = mesh.points.clone(), mesh.triangles.clone()
    after, report = improve(mesh)
    assert torch.equal(mesh.points, points)
    assert torch.equal(mesh.triangles, triangles)
    assert int(untouched(mesh, after).sum()) > 0.9 * len(triangles)
    assert after.triangles is not mesh.triangles
    assert after.points is not mesh.points
    assert_sound(mesh, after, report)


@pytest.mark.usefixtures("low")
def test_what_is_fixed_or_constrained_stays_in_the_submesh_and_elsewhere():
    plain = meshes.equilateral(50, 40)
    index = torch.arange(51 * 41).reshape(51, 41)
    # A line of edges right through the mesh, and so through the tangle and across the rim.
    line = index[:, 20]
    lone = index[26, 18]
    fixed = torch.zeros(len(plain.points), dtype=torch.bool)
    fixed[lone] = True
    mesh = patch(fixed=fixed, constrained_edges=torch.stack([line[:-1], line[1:]], 1))
    assert len(mesh.constrained_edges) == 50
    place = tuple(float(v) for v in mesh.points[index[25, 18]])
    mesh = tangled(mesh, place, radius=2.5)
    found = cut(mesh)
    part = found.taken.mesh
    mine = {tuple(sorted(edge)) for edge in found.taken.vertices[part.constrained_edges].tolist()}
    inner = {pair for pair, count in edge_counts(mesh.triangles[found.taken.triangles]).items() if count == 2}
    assert mine == {tuple(sorted(e)) for e in mesh.constrained_edges.tolist() if frozenset(e) in inner}
    assert 0 < len(mine) < 50
    assert bool(part.fixed[(found.taken.vertices == lone).nonzero()])
    after, report = improve(mesh)
    assert "submesh" in stages(report)
    assert "whole" not in stages(report)
    assert_sound(mesh, after, report)


@pytest.mark.usefixtures("low")
def test_constrained_edges_on_the_boundary_are_no_business_of_the_submesh():
    mesh = tangled(patch(), MIDDLE)
    found = cut(mesh)
    once = [sorted(pair) for pair, count in edge_counts(found.taken.mesh.triangles).items() if count == 1]
    rim = found.taken.vertices[torch.tensor(once)]
    held = MeshBatch.from_arrays(patch().points, mesh.triangles, constrained_edges=rim).with_points(mesh.points)
    again = cut(held)
    assert torch.equal(again.taken.triangles, found.taken.triangles)
    assert len(held.constrained_edges) == len(rim)
    assert len(again.taken.mesh.constrained_edges) == 0
    after, report = improve(held)
    assert_sound(held, after, report)


@pytest.mark.usefixtures("low")
def test_a_tangle_at_the_boundary():
    mesh = tangled(patch(), RIM, radius=3.0)
    after, report = improve(mesh)
    found = cut(mesh)
    own = {frozenset(edge) for edge in found.taken.vertices[found.taken.mesh.triangles[:, [0, 1]]].tolist()}
    assert own & {frozenset(edge) for edge in boundary(mesh.triangles)}
    assert "submesh" in stages(report)
    assert "whole" not in stages(report)
    assert_sound(mesh, after, report)


@pytest.mark.usefixtures("low")
def test_two_tangles_far_apart_are_one_submesh_of_two_components():
    mesh = tangled(patch(), LEFT, RIGHT, radius=1.2)
    part = cut(mesh).taken.mesh
    twin = connectivity.twins(part.triangles)
    assert len(connectivity.triangle_components(part.triangles, twin).unique()) == 2
    after, report = improve(mesh)
    assert "whole" not in stages(report)
    assert_sound(mesh, after, report)


@pytest.mark.usefixtures("low")
def test_a_vertex_thrown_out_of_the_mesh_comes_back():
    mesh = patch()
    points = mesh.points.clone()
    points[near(mesh, MIDDLE, 0.8)] = torch.tensor([1e4, -3e4], dtype=points.dtype)
    mesh = mesh.with_points(points)
    after, report = improve(mesh)
    assert "whole" not in stages(report)
    assert_sound(mesh, after, report)


@pytest.mark.usefixtures("low")
def test_single_precision():
    mesh = tangled(patch(), MIDDLE).to(torch.float32)
    after, report = improve(mesh)
    assert after.points.dtype == torch.float32
    assert "whole" not in stages(report)
    assert_sound(mesh, after, report)


# --- batches ---


def assorted() -> list[MeshBatch]:
    return [
        meshes.moved_hole(),
        tangled(patch(), MIDDLE),
        patch(seed=4),
        meshes.jittered(),
        tangled(patch(52, 44, seed=5), LEFT, RIGHT, radius=1.2),
        tangled(patch(), RIM, radius=3.0),
    ]


@pytest.mark.usefixtures("low")
def test_joined_equals_alone_to_the_bit():
    parts = assorted()
    batch, report = improve(join(parts))
    for b, (mesh, together) in enumerate(zip(parts, batch.split(), strict=True)):
        alone, its = improve(mesh)
        assert torch.equal(alone.points, together.points), b
        assert torch.equal(alone.triangles, together.triangles), b
        keep = torch.arange(len(parts)) == b
        rows = keep.repeat_interleave(torch.tensor([len(m.triangles) for m in parts]))
        q = report.quality
        own = tm.Quality(
            *(getattr(q, n)[rows] for n in ("area", "inverse_mean_ratio", "upright")),
            *(getattr(q, n)[keep] for n in ("mean", "max", "inverted")),
        )
        columns = {n: getattr(report, n)[keep] for n in ("status", "valid", "certified", "moved")}
        assert_same_but_for_time(
            dataclasses.replace(report, quality=own, steps=[report.steps[b]], messages=[report.messages[b]], **columns),
            its,
        )
    assert [s[1] == "submesh" for s in (stages(report, b) for b in range(6))] == [False, True, False, False, True, True]
    assert_report_is_of(report, join(parts), batch)


@pytest.mark.usefixtures("low")
def test_runs_repeat_to_the_bit():
    mesh = join([tangled(patch(), MIDDLE), meshes.moved_hole()])
    (one, report), (two, again) = improve(mesh), improve(mesh)
    assert_same_rows(one, two)
    assert_same_but_for_time(report, again)


@pytest.mark.usefixtures("low")
def test_shards_do_the_same(monkeypatch):
    monkeypatch.setattr(forked, "_LEAST", 1_000)
    batch = join(assorted())
    one, report = improve(batch, ImproveOptions(workers=1))
    two, again = improve(batch, ImproveOptions(workers=2))
    assert_same_rows(one, two)
    assert_same_but_for_time(report, again)


# --- where a submesh does not do ---


def keep() -> ImproveOptions:
    """Made anew each time, with the bounds that the fixture has lowered."""
    return ImproveOptions(topology="keep")


def poor() -> list[MeshBatch]:
    """The first has a fixed vertex far from where its triangles, if they stay, would have it."""
    fixed = torch.zeros(51 * 41, dtype=torch.bool)
    place = 25 * 41 + 20
    fixed[place] = True
    mesh = patch(fixed=fixed)
    points = mesh.points.clone()
    points[place] += torch.tensor([2.5, 0.3], dtype=points.dtype)
    return [mesh.with_points(points), tangled(patch(seed=2), LEFT), meshes.jittered(cells=0.2)]


@pytest.mark.usefixtures("low")
def test_a_submesh_of_poor_shape_is_left_for_the_whole_mesh():
    mesh = poor()[0]
    seen: list[tuple[str, MeshBatch]] = []
    after, report = improve(mesh, keep(), observe=lambda stage, batch: seen.append((stage, batch)))
    usual, its = improve(mesh, dataclasses.replace(keep(), local_repair=None))
    assert_same_rows(after, usual)
    assert stages(report)[:2] == ["initial", "submesh"]
    back = stages(report).index("whole")
    assert not report.steps[0][back].kept
    assert stages(report)[back + 1 :] == stages(its)[1:]
    assert report.messages[0] == its.messages[0] + "; a submesh round the damage was tried in vain"
    assert [stage for stage, _ in seen] == stages(report)
    assert_same_rows(seen[back][1], mesh)
    assert_same_rows(seen[-1][1], after)
    assert_report_is_of(report, mesh, after)


@pytest.mark.usefixtures("low")
def test_in_a_batch_only_that_mesh_goes_on_as_a_whole():
    parts = poor()
    seen: list[tuple[str, MeshBatch]] = []
    batch, report = improve(join(parts), keep(), observe=lambda stage, batch: seen.append((stage, batch)))
    assert ["submesh" in stages(report, b) for b in range(3)] == [True, True, False]
    assert ["whole" in stages(report, b) for b in range(3)] == [True, False, False]
    for mesh, together in zip(parts, batch.split(), strict=True):
        alone, _ = improve(mesh, keep())
        assert_same_rows(alone, together)
    assert_report_is_of(report, join(parts), batch)
    assert_same_rows(seen[-1][1], batch)


@pytest.mark.usefixtures("low")
def test_a_mesh_that_cannot_be_valid_is_told_the_reason_for_the_whole():
    mesh = patch()
    points = mesh.points.clone()
    corner = int(near(mesh, RIM, 0.8).nonzero()[0])
    boundary_vertex = int((mesh.fixed & near(mesh, RIM, 3.0)).nonzero()[0])
    points[boundary_vertex] = mesh.points[corner] + torch.tensor([0.0, 1.5], dtype=points.dtype)
    other = int((mesh.fixed & near(mesh, RIM, 3.0)).nonzero()[1])
    points[other] = points[boundary_vertex]
    mesh = mesh.with_points(points)
    after, report = improve(mesh)
    usual, its = improve(mesh, WHOLE)
    assert not bool(report.valid)
    assert report.status.tolist() == its.status.tolist() == [int(tm.Status.PARTLY)]
    assert "are both at" in its.messages[0]
    assert report.messages[0].startswith(its.messages[0])
    assert_same_rows(after, usual)
    assert_report_is_of(report, mesh, after)


@pytest.mark.usefixtures("low")
def test_an_edge_that_the_outside_has_already_is_no_edge_inside():
    mesh = tangled(patch(), MIDDLE)
    found = cut(mesh)
    done = improve_batch(State.of(found.taken.mesh, WHOLE), Log(1), WHOLE)
    part = done.mesh
    assert found.well_done(done).tolist() == [True]
    inner = connectivity.edges(part.triangles, connectivity.twins(part.triangles))
    inner = found.taken.vertices[inner[~part.fixed[inner].any(1)][:1]]
    taken = connectivity.edge_keys(inner[:, 0], inner[:, 1], len(mesh.points))
    clashing = dataclasses.replace(found, across=torch.cat([found.across, taken]))
    assert clashing.well_done(done).tolist() == [False]
    uncertified = dataclasses.replace(done, certified=~done.certified)
    assert found.well_done(uncertified).tolist() == [False]


# --- what is said about it ---


@pytest.mark.usefixtures("low")
def test_every_stage_is_shown_as_a_whole():
    batch = join([meshes.moved_hole(), tangled(patch(), LEFT, RIGHT, radius=1.2)])
    seen: list[tuple[str, MeshBatch]] = []
    after, report = improve(batch, observe=lambda stage, now: seen.append((stage, now)))
    unseen, _ = improve(batch)
    assert torch.equal(unseen.points, after.points)
    assert [stage for stage, _ in seen][:2] == ["initial", "submesh"]
    assert_same_rows(seen[0][1], batch)
    assert_same_rows(seen[-1][1], after)

    seen = []
    mesh = tangled(patch(), MIDDLE)
    _, report = improve(mesh, observe=lambda stage, now: seen.append((stage, now)))
    assert [stage for stage, _ in seen] == stages(report)
    for (_, now), step in zip(seen, report.steps[0], strict=True):
        q = quality(now)
        assert (float(q.max), int(q.inverted)) == (step.max, step.inverted)
        assert step.mean == pytest.approx(float(q.mean), rel=1e-12)


@pytest.mark.usefixtures("low")
def test_flat_triangles_have_no_finite_mean_and_get_one():
    mesh = patch()
    points = mesh.points.clone()
    points[near(mesh, MIDDLE, 2.0)] = torch.tensor(MIDDLE, dtype=points.dtype)
    mesh = mesh.with_points(points)
    after, report = improve(mesh)
    assert report.steps[0][0].mean == report.steps[0][0].max == torch.inf
    assert "whole" not in stages(report)
    assert report.steps[0][-1].mean < 1.03
    assert_sound(mesh, after, report)


@pytest.mark.usefixtures("low")
def test_pasting_what_was_cut_changes_nothing():
    batch = join(assorted())
    found = cut(batch)
    assert found.cut.tolist() == [False, True, False, False, True, True]
    again = found.paste(found.taken.mesh)
    assert_same_rows(again, batch)
    others = ~found.cut
    kept, given = found.taken.mesh.select(others), batch.select(others)
    for name in ("points", "triangles", "fixed", "constrained_edges", "point_offsets", "triangle_offsets"):
        assert torch.equal(getattr(kept, name), getattr(given, name)), name
    # As one moves part of a batch by hand.
    moved = found.taken.mesh.with_points(found.taken.mesh.points + 1.0)
    assert torch.equal(
        put(batch, others, moved.select(others)).select(others).points, found.paste(moved).select(others).points
    )
