"""Relocation: vertices travel, rows stay."""

import meshes
import pytest
import torch
from exact import inverted
from hypothesis import given, settings
from hypothesis import strategies as st
from judges import assert_every_row_stays

import torchmesh as tm
from torchmesh.remeshing.criteria import crowded
from torchmesh.remeshing.options import RemeshOptions
from torchmesh.remeshing.relocation import Relocation


def relocated(batch, **options):
    work = Relocation(batch, RemeshOptions(**options))
    work.run(tm.quality(batch).inverted == 0)
    return work


def crowded_square(cells: int = 14) -> tm.MeshBatch:
    """A square whose inner columns are pressed to the left: crowded there, empty on the right."""
    mesh = meshes.grid(cells, cells)
    pressed = torch.stack([mesh.points[:, 0] ** 2.5, mesh.points[:, 1]], 1)
    return mesh.with_points(torch.where(mesh.fixed[:, None], mesh.points, pressed))


def test_vertices_go_where_they_are_needed():
    mesh = crowded_square()
    assert inverted(mesh) == 0
    work = relocated(mesh, sizes="uniform")
    assert int(work.splits) == int(work.collapses) > 0
    assert_every_row_stays(mesh, work.batch)
    before, after = (tm.size_conformity(m, "uniform") for m in (mesh, work.batch))
    assert float(after.high - after.low) < float(before.high - before.low)
    assert float(tm.quality(work.batch).mean) < float(tm.quality(mesh).mean)


@settings(max_examples=10)
@given(st.integers(0, 10_000), st.sampled_from(["boundary", "uniform"]))
def test_whatever_the_sizes_every_row_stays(seed, sizes):
    makers = [
        lambda: meshes.scrambled(meshes.delaunay(40, seed), seed, 40),
        lambda: meshes.jittered(7, 6, 0.15, seed),
        lambda: meshes.l_shape(3 + seed % 3),
        lambda: meshes.ring(11 + seed % 9, 4),
    ]
    mesh = makers[seed % 4]()
    wanted = (0.05 + mesh.points[:, 0].square()) if seed % 3 == 0 else sizes
    assert_every_row_stays(mesh, relocated(mesh, sizes=wanted, max_rounds=4).batch)


def test_a_mesh_alone_and_the_same_in_a_batch_get_the_same_bits():
    parts = [crowded_square(9), meshes.l_shape(4), meshes.jittered(6, 5, 0.8, 1), crowded_square(11)]
    together = relocated(tm.join(parts), sizes="uniform")
    for b, (part, joined) in enumerate(zip(parts, together.batch.split(), strict=True)):
        alone = relocated(part, sizes="uniform")
        assert torch.equal(alone.batch.points, joined.points)
        assert torch.equal(alone.batch.triangles, joined.triangles)
        assert int(alone.splits) == int(together.splits[b])
    assert torch.equal(together.batch.split()[2].points, parts[2].points)
    assert int(together.splits[0]) > 0


def test_it_is_tried_where_shapes_are_poor_or_sizes_were_asked_for():
    batch = tm.join([meshes.equilateral(), crowded_square(), meshes.jittered(8, 7, 1.0, 0)])
    assert crowded(tm.quality(batch), RemeshOptions()).tolist() == [False, True, False]
    assert crowded(tm.quality(batch), RemeshOptions(sizes="uniform")).tolist() == [True, True, False]


def test_one_poor_triangle_of_a_large_mesh_is_not_worth_work_on_all_of_it():
    ratio = torch.full((20_000,), 1.02, dtype=torch.float64)
    ratio[7] = 2.5
    for count, expected in ((20_000, False), (5_000, True)):
        some = ratio[:count]
        q = tm.Quality(some, some, some > 0, some.mean()[None], some.amax()[None], torch.zeros(1, dtype=torch.int64))
        assert crowded(q, RemeshOptions(), torch.tensor([0, count])).tolist() == [expected]
        assert crowded(q, RemeshOptions()).tolist() == [True]


def test_a_huge_mesh_must_be_poorer_on_the_whole_to_be_worth_it():
    for count, mean, expected in ((200_000, 1.07, True), (200_001, 1.07, False), (200_001, 1.09, True)):
        some = torch.full((count,), mean, dtype=torch.float64)
        q = tm.Quality(some, some, some > 0, some.mean()[None], some.amax()[None], torch.zeros(1, dtype=torch.int64))
        assert crowded(q, RemeshOptions(), torch.tensor([0, count])).tolist() == [expected]


def test_improve_pulls_vertices_along_and_keeps_their_number():
    mesh = meshes.moved_hole(9.0)
    after, report = tm.improve(mesh)
    assert report.certified.tolist() == [True]
    assert_every_row_stays(mesh, after)
    stages = [step.stage for step in report.steps[0]]
    if "relocate" in stages:
        place = stages.index("relocate")
        assert report.steps[0][place].mean <= report.steps[0][place - 1].mean
    asked, report = tm.improve(mesh, tm.ImproveOptions(remesh=RemeshOptions(sizes="uniform")))
    assert "relocate" in [step.stage for step in report.steps[0]]
    assert_every_row_stays(mesh, asked)
    assert report.vertex_map is None


@pytest.mark.parametrize("topology", ["keep", "flip", "full"])
def test_sizes_of_the_undeformed_mesh_are_kept(topology):
    undeformed = meshes.grid(10, 10)
    graded = undeformed.with_points(torch.where(undeformed.fixed[:, None], undeformed.points, undeformed.points**1.2))
    tangled = meshes.disturbed(graded, 0.05, 3)
    options = tm.ImproveOptions(topology=topology, reference=graded, remesh=RemeshOptions(sizes="keep"))
    after, report = tm.improve(tangled, options)
    assert report.certified.tolist() == [True]
    assert (len(after.points) == len(graded.points)) or topology == "full"
