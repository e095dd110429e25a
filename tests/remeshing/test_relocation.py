"""Relocation: vertices travel, rows stay."""

import meshes
import pytest
import torch
from coarse import strip
from exact import inverted
from judges import assert_every_row_stays
from meshes import crowded_square

import torchmesh as tm
from torchmesh.mesh.interfaces import holding
from torchmesh.remeshing.options import RemeshOptions
from torchmesh.remeshing.relocation import QUICK, relocated


def travelled(batch, **options):
    """The state of the batch after relocation, without condensation."""
    return relocated(batch, RemeshOptions(**options))


def test_vertices_go_where_they_are_needed():
    mesh = crowded_square()
    assert inverted(mesh) == 0
    state = travelled(mesh, sizes="uniform")
    assert int(state.splits) == int(state.collapses) > 0
    assert_every_row_stays(mesh, state.batch)
    before, after = (tm.size_conformity(m, "uniform") for m in (mesh, state.batch))
    assert float(after.high - after.low) < float(before.high - before.low)
    assert float(tm.quality(state.batch).mean) < float(tm.quality(mesh).mean)


@pytest.mark.parametrize("sizes", ["boundary", "uniform", None])
def test_whatever_the_sizes_every_row_stays(sizes, rng):
    seeds = rng.integers(10_000, size=4).tolist()
    parts = [
        meshes.scrambled(meshes.delaunay(40, seeds[0]), seeds[0], 40),
        meshes.jittered(7, 6, 0.15, seeds[1]),
        meshes.l_shape(3 + seeds[2] % 3),
        meshes.ring(11 + seeds[3] % 9, 4),
    ]
    batch = holding(tm.join(parts))
    wanted = 0.05 + batch.points[:, 0].square() if sizes is None else sizes
    state = travelled(batch, sizes=wanted, max_rounds=4)
    assert int(state.rounds.max()) > 0
    assert_every_row_stays(batch, state.batch)


def test_a_mesh_alone_and_the_same_in_a_batch_get_the_same_bits():
    parts = [crowded_square(9), meshes.l_shape(4), meshes.disc(), crowded_square(11)]
    together = travelled(tm.join(parts), sizes="uniform")
    for b, (part, joined) in enumerate(zip(parts, together.batch.split(), strict=True)):
        alone = travelled(part, sizes="uniform")
        assert torch.equal(alone.batch.points, joined.points)
        assert torch.equal(alone.batch.triangles, joined.triangles)
        assert int(alone.splits) == int(together.splits[b])
    assert int(together.splits[0]) > 0


def test_improve_relocates_where_shapes_are_poor_and_keeps_the_number_of_vertices():
    mesh = strip()
    after, report = tm.improve(mesh, tm.ImproveOptions(relocate=True))
    assert report.certified.tolist() == [True]
    assert_every_row_stays(mesh, after)
    stages = [step.stage for step in report.steps[0]]
    at = stages.index("relocate")
    assert report.steps[0][at].mean < report.steps[0][at - 1].mean


def test_improve_relocates_where_sizes_were_asked_for():
    mesh = meshes.moved_hole(9.0)
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


def test_rounds_are_bounded_by_the_work_on_a_mesh_and_those_it_has_had_count():
    mesh = strip()
    most = max(QUICK.work // (len(mesh.triangles) + QUICK.overhead), QUICK.least_rounds)
    state = travelled(mesh)
    assert 0 < int(state.rounds) <= most
    spent = relocated(mesh, RemeshOptions(), torch.tensor([most]))
    assert spent.rounds.tolist() == [most]
    assert spent.splits.tolist() == [0]
