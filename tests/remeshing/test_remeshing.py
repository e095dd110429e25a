"""`remesh`, alone and as a stage of `improve`: the domain it keeps, the sizes and shapes it reaches."""

import dataclasses
import functools

import meshes
import pytest
import together
import torch
from editing import VALID, random_valid
from exact import boundary, inverted, total_area
from judges import assert_same_domain, euler, region_areas

import torchmesh as tm
from torchmesh.mesh.certificate import same_frame
from torchmesh.mesh.connectivity import boundary_vertices
from torchmesh.mesh.interfaces import holding
from torchmesh.remeshing.options import RemeshOptions
from torchmesh.remeshing.remeshing import remesh
from torchmesh.remeshing.sizing import size_field

UNCHANGED = dataclasses.replace(RemeshOptions(), max_rounds=0)


NAMES = [name for name in VALID if name != "bowtie"]


@functools.cache
def remeshed(sizes: str) -> dict[str, tuple[tm.MeshBatch, tm.MeshBatch, tm.RemeshInfo]]:
    """The meshes of VALID before and after: made once for all tests, which change nothing of them."""
    before = [VALID[name]() for name in NAMES]
    results = together.remeshed(before, RemeshOptions(sizes=sizes))
    return {name: (mesh, *result) for name, mesh, result in zip(NAMES, before, results, strict=True)}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("sizes", ["boundary", "keep", "uniform"])
def test_remesh_keeps_the_domain(name, sizes):
    mesh, after, info = remeshed(sizes)[name]
    assert_same_domain(mesh, after)
    assert same_frame(mesh, after, holding(mesh).fixed, info.vertex_map).tolist() == [True]
    assert len(after.points) == len(mesh.points) + int(info.splits) - int(info.collapses)
    assert info.size.shape == (len(after.points),)


def test_what_is_given_stays_as_it_is():
    mesh = meshes.jittered(8, 7, 0.12, 0)
    copy = mesh.points.clone(), mesh.triangles.clone(), mesh.fixed.clone(), mesh.constrained_edges.clone()
    after, _ = remesh(mesh, RemeshOptions(sizes="uniform"))
    assert not torch.equal(after.points, mesh.points)
    given = mesh.points, mesh.triangles, mesh.fixed, mesh.constrained_edges
    assert all(torch.equal(a, b) for a, b in zip(copy, given, strict=True))


@pytest.mark.parametrize("split_boundary", [False, True])
def test_remesh_of_anything_valid_keeps_the_domain(split_boundary, rng):
    given = [random_valid(5 * int(rng.integers(2000)) + kind) for kind in (0, 1, 2, 3, 4, 0)]
    sizes = torch.cat([float(rng.uniform(0.4, 3.0)) * size_field(mesh, "uniform") for mesh in given])
    results = together.remeshed(given, RemeshOptions(sizes=sizes, split_boundary=split_boundary, max_rounds=3))
    for mesh, (after, info) in zip(given, results, strict=True):
        if not split_boundary:
            assert_same_domain(mesh, after)
        assert inverted(after) == 0
        assert euler(after) == euler(mesh)
        assert float(total_area(after)) == pytest.approx(float(total_area(mesh)), rel=1e-12)
        assert same_frame(mesh, after, holding(mesh).fixed, info.vertex_map).tolist() == [True]


@pytest.mark.parametrize("factor", [0.6, 2.0])
def test_edges_get_the_length_that_was_asked_for(factor):
    mesh = meshes.grid(24, 24)
    size = factor / 24
    wanted = lambda p: torch.full((len(p),), size, dtype=p.dtype)  # noqa: E731
    after, info = remesh(mesh, RemeshOptions(sizes=wanted, split_boundary=True))
    assert 0.8 < float(info.conformity.mean) < 1.2
    assert float(info.conformity.high) < 1.5
    assert (len(after.points) > len(mesh.points)) == (factor < 1)
    q = tm.quality(after)
    assert float(q.mean) < 1.12
    assert float(q.max) < 1.9


def test_a_graded_function_is_followed():
    mesh = meshes.grid(20, 20)
    wanted = lambda p: 0.02 + 0.1 * p[:, 0]  # noqa: E731
    after, info = remesh(mesh, RemeshOptions(sizes=wanted, split_boundary=True))
    assert torch.equal(info.size, wanted(after.points))
    assert 0.85 < float(info.conformity.mean) < 1.15
    centre = after.points[after.triangles].mean(1)[:, 0]
    assert int((centre < 0.3).sum()) > 3 * int((centre > 0.7).sum())
    assert float(tm.quality(after).mean) < 1.06


def test_a_boundary_that_may_be_split_keeps_its_course():
    mesh = meshes.l_shape(2)
    after, info = remesh(mesh, RemeshOptions(sizes=torch.full((len(mesh.points),), 0.2), split_boundary=True))
    assert len(boundary(after.triangles)) > len(boundary(mesh.triangles))
    assert len(after.constrained_edges) > len(mesh.constrained_edges)
    assert region_areas(after) == region_areas(mesh)
    x, y = after.points[after.constrained_edges.reshape(-1)].unbind(1)
    assert (x == 1).all()
    assert (y <= 1).all()
    # What halves an interface is not fixed, what halves the boundary is.
    rim = boundary_vertices(after.triangles, after.twin, len(after.points))
    assert torch.equal(after.fixed, rim)
    assert not after.fixed[after.constrained_edges.reshape(-1)].all()
    assert same_frame(mesh, after, holding(mesh).fixed, info.vertex_map).tolist() == [True]
    kept, info = remesh(mesh, RemeshOptions(sizes=torch.full((len(mesh.points),), 0.2)))
    assert_same_domain(mesh, kept)


def test_a_mesh_alone_and_the_same_in_a_batch_get_the_same_bits():
    parts = [
        meshes.jittered(9, 8, 0.15, 4),
        meshes.l_shape(4),
        meshes.ring(20, 5),
        meshes.jittered(6, 5, 0.7, 1),
        meshes.disc(),
    ]
    batch = tm.join(parts)
    after, info = remesh(batch)
    for b, (alone, joined) in enumerate(zip(parts, after.split(), strict=True)):
        single, own = remesh(alone)
        for name in ("points", "triangles", "fixed", "constrained_edges"):
            assert torch.equal(getattr(single, name), getattr(joined, name)), (b, name)
        for name in ("splits", "collapses", "flips", "rounds"):
            assert int(getattr(own, name)) == int(getattr(info, name)[b])
        rows = slice(int(after.point_offsets[b]), int(after.point_offsets[b + 1]))
        assert torch.equal(own.size, info.size[rows])
        first, origin = int(batch.point_offsets[b]), info.vertex_map.new_to_old[rows]
        assert torch.equal(own.vertex_map.new_to_old, torch.where(origin >= 0, origin - first, -1))
        for name in ("mean", "low", "high"):
            assert float(getattr(own.conformity, name)) == float(getattr(info.conformity, name)[b])


def test_the_unit_of_length_makes_no_difference():
    mesh = meshes.jittered(9, 8, 0.15, 4)
    once, _ = remesh(mesh)
    for unit in (2.0**40, 2.0**-40):
        again, _ = remesh(mesh.with_points(mesh.points * unit))
        assert torch.equal(again.triangles, once.triangles)
        assert torch.allclose(again.points, once.points * unit, rtol=1e-12, atol=0)


def test_single_precision_stays_and_is_valid():
    mesh = meshes.ring(20, 5).to(torch.float32)
    after, _ = remesh(mesh, RemeshOptions(sizes=torch.full((len(mesh.points),), 0.08)))
    assert after.points.dtype == torch.float32
    assert len(after.points) > len(mesh.points)
    assert_same_domain(mesh, after)


def test_tangled_meshes_come_back_as_they_were():
    tangled, good = meshes.jittered(6, 5, 0.9, 1), meshes.jittered(9, 8, 0.15, 4)
    after, info = remesh(tm.join([tangled, good]), RemeshOptions(sizes="uniform"))
    first = after.split()[0]
    assert torch.equal(first.points, tangled.points)
    assert torch.equal(first.triangles, tangled.triangles)
    assert info.rounds.tolist()[0] == 0
    assert info.rounds.tolist()[1] > 0
    alone, info = remesh(tangled)
    assert torch.equal(alone.points, tangled.points)
    assert info.vertex_map.new_to_old.tolist() == list(range(len(tangled.points)))


def test_no_rounds_no_new_vertices():
    mesh = meshes.jittered(9, 8, 0.15, 4)
    after, info = remesh(mesh, UNCHANGED)
    assert len(after.points) == len(mesh.points)
    assert (int(info.splits), int(info.collapses), int(info.rounds)) == (0, 0, 0)


@pytest.mark.parametrize("name", ["circle", "bar", "gate"])
def test_full_is_never_worse_than_flip(name):
    _, tangled = tm.domains.moving(name)
    _, plain = tm.improve(tangled)
    after, report = tm.improve(tangled, tm.ImproveOptions(topology="full"))
    assert report.certified.tolist() == [True]
    assert_same_domain(tangled, after)
    assert float(report.quality.mean) <= float(plain.quality.mean)
    assert float(report.quality.max) <= max(float(plain.quality.max), 1.5)
    # The target; other processors round the minimisation otherwise.
    assert float(report.quality.mean) < 1.04
    assert [step.stage for step in report.steps[0]] == ["initial", "anew"]
    assert report.vertex_map is report.remeshed.vertex_map
    assert plain.vertex_map is None


def test_rows_of_right_angled_triangles_are_not_left_as_they_are():
    mesh = meshes.grid(12, 12)
    _, report = tm.improve(mesh, tm.ImproveOptions(topology="full"))
    assert float(tm.quality(mesh).mean) > 1.15
    assert float(report.quality.mean) < 1.08


def test_full_in_a_batch_is_full_alone():
    parts = [meshes.jittered(8, 7, 0.3, 2), meshes.dragged_interface(), meshes.grid(4, 4)]
    options = tm.ImproveOptions(topology="full")
    after, report = tm.improve(tm.join(parts), options)
    for b, (part, joined) in enumerate(zip(parts, after.split(), strict=True)):
        alone, own = tm.improve(part, options)
        assert torch.equal(alone.points, joined.points)
        assert torch.equal(alone.triangles, joined.triangles)
        assert bool(own.certified) == bool(report.certified[b])
        assert own.messages[0] == report.messages[b]


def test_an_impossible_mesh_does_not_hold_up_the_others():
    crossed = meshes.grid(4, 4)
    points = crossed.points.clone()
    points[0] = torch.tensor([2.0, 2.0])
    batch = tm.join([crossed.with_points(points), meshes.dragged_interface()])
    after, report = tm.improve(batch, tm.ImproveOptions(topology="full"))
    assert report.valid.tolist() == [False, True]
    assert report.certified.tolist() == [False, True]
    assert torch.equal(after.split()[0].points, batch.split()[0].points)
    assert report.vertex_map.old_to_new[: len(points)].tolist() == list(range(len(points)))


def test_sizes_that_were_asked_for_come_before_the_last_bit_of_quality():
    mesh = meshes.grid(16, 16)
    options = tm.ImproveOptions(topology="full", remesh=RemeshOptions(sizes=lambda p: 0.02 + 0.1 * p[:, 0]))
    after, report = tm.improve(mesh, options)
    assert len(after.points) != len(mesh.points)
    assert bool(report.certified)
    assert float(report.remeshed.conformity.mean) == pytest.approx(1, abs=0.2)


@pytest.mark.parametrize("topology", ["flip", "full"])
def test_the_report_says_how_edges_follow_the_sizes_asked_for(topology):
    batch = tm.join([meshes.grid(8, 8), meshes.moved_hole(5.0)])
    after, report = tm.improve(batch, tm.ImproveOptions(topology=topology, remesh=RemeshOptions(sizes="uniform")))
    expected = tm.size_conformity(after, "uniform")
    record = report.to_dict()[1]["edge_length_over_size"]
    if topology == "flip":
        for name in ("mean", "low", "high"):
            torch.testing.assert_close(getattr(report.sizes, name), getattr(expected, name), rtol=1e-12, atol=0)
    assert record == {
        "mean": float(report.sizes.mean[1]), "p5": float(report.sizes.low[1]), "p95": float(report.sizes.high[1]),
    }  # fmt: skip
    assert 0.5 < record["p5"] < record["mean"] < record["p95"] < 2
    plain = tm.improve(batch, tm.ImproveOptions(topology=topology))[1]
    assert (plain.sizes is None) == (topology == "flip")
    assert ("edge_length_over_size" in plain.to_dict()[0]) == (topology == "full")


def test_the_paper_knows_no_full():
    with pytest.raises(ValueError, match="topology='full' needs method 'default'"):
        tm.ImproveOptions.paper(topology="full")
