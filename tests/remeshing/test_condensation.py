"""Condensation: where a boundary is too coarse for the vertices inside, they go to a few points."""

import functools

import meshes
import pytest
import torch
from coarse import strip
from judges import assert_every_row_stays

import torchmesh as tm
from torchmesh.remeshing.condensation import PACE, CondenseOptions, condense
from torchmesh.remeshing.options import RemeshOptions
from torchmesh.remeshing.point_sources import share_with_room
from torchmesh.remeshing.relocation import Relocated, relocate, relocated


@functools.cache
def strip_relocated() -> tuple[tm.MeshBatch, Relocated]:
    return relocate(strip(), RemeshOptions())


@pytest.fixture(scope="module")
def stretched() -> tm.MeshBatch:
    return relocated(strip(), RemeshOptions()).batch


def test_shapes_gain_what_even_sizes_cost(stretched):
    before = tm.quality(stretched)
    after, info = condense(stretched, RemeshOptions())
    assert info.done.tolist() == [True]
    assert_every_row_stays(stretched, after)
    assert int(info.flips) > 0
    # Of what the mean is above the ideal, at least a fifth.
    assert float(tm.quality(after).mean) - 1 < 0.8 * (float(before.mean) - 1)


def test_good_meshes_and_those_with_sizes_asked_for_keep_their_bits(stretched):
    good = meshes.equilateral()
    after, info = condense(tm.join([good, good]), RemeshOptions())
    assert torch.equal(after.points, tm.join([good, good]).points)
    assert info.flips.tolist() == info.rounds.tolist() == [0, 0]
    assert info.done.tolist() == [False, False]
    asked, _ = condense(stretched, RemeshOptions(sizes="uniform"))
    assert torch.equal(asked.points, stretched.points)


def test_condensed_in_a_batch_is_condensed_alone(stretched):
    parts = [meshes.grid(5, 4), stretched]
    together, info = condense(tm.join(parts), RemeshOptions())
    assert info.done.tolist() == [False, True]
    for part, joined, count in zip(parts, together.split(), info.flips, strict=True):
        alone, own = condense(part, RemeshOptions())
        assert torch.equal(alone.points, joined.points)
        assert torch.equal(alone.triangles, joined.triangles)
        assert int(own.flips) == int(count)


@pytest.mark.parametrize("scale", [1e-140])
def test_the_unit_of_length_does_not_matter(stretched, scale):
    after, _ = condense(stretched.with_points(stretched.points * scale), RemeshOptions())
    assert float(tm.quality(after).mean) < float(tm.quality(stretched).mean) - 0.05


def test_relocation_condenses_in_its_place():
    mesh = strip()
    expected, condensed = condense(mesh, RemeshOptions())
    assert condensed.done.tolist() == [True]
    after, info = strip_relocated()
    assert torch.equal(after.points, expected.points)
    assert torch.equal(after.triangles, expected.triangles)
    assert int(condensed.flips) > 0
    assert torch.equal(info.flips, condensed.flips)
    assert info.size.isnan().all()


def test_a_boundary_with_room_for_its_triangles_is_no_reason_to_condense():
    mesh = meshes.scrambled(meshes.grid(9, 9), 1)
    assert float(tm.quality(mesh).mean) > CondenseOptions().mean
    assert float(share_with_room(mesh)) > CondenseOptions().room
    after, info = condense(mesh, RemeshOptions())
    assert info.done.tolist() == [False]
    assert torch.equal(after.points, mesh.points)
    both, info = relocate(tm.join([mesh, strip()]), RemeshOptions())
    for (alone, _), joined in zip((relocate(mesh, RemeshOptions()), strip_relocated()), both.split(), strict=True):
        assert torch.equal(alone.points, joined.points)
        assert torch.equal(alone.triangles, joined.triangles)
    assert info.size.isfinite().tolist() == [True] * len(mesh.points) + [False] * len(strip().points)


def test_equilateral_triangles_have_just_the_room_that_they_take():
    assert float(share_with_room(meshes.equilateral())) == pytest.approx(1)


def test_a_mesh_has_no_more_rounds_than_its_work_allows():
    limit = PACE.work // (len(strip().triangles) + PACE.overhead)
    _, info = condense(strip(), RemeshOptions())
    assert 0 < int(info.rounds) <= max(limit, PACE.least_rounds)
