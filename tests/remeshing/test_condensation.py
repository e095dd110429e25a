"""Condensation: where a boundary is too coarse for the vertices inside, they go to a few points."""

import meshes
import pytest
import torch
from coarse import strip
from judges import assert_every_row_stays

import torchmesh as tm
from torchmesh.remeshing.condensation import condense
from torchmesh.remeshing.options import RemeshOptions
from torchmesh.remeshing.relocation import relocate, relocated


@pytest.fixture(scope="module")
def stretched() -> tm.MeshBatch:
    return relocated(strip(), RemeshOptions()).batch


def test_shapes_gain_what_even_sizes_cost(stretched):
    before = tm.quality(stretched)
    after, flips = condense(stretched, RemeshOptions())
    assert_every_row_stays(stretched, after)
    assert int(flips) > 0
    # Of what the mean is above the ideal, at least a fifth.
    assert float(tm.quality(after).mean) - 1 < 0.8 * (float(before.mean) - 1)


def test_good_meshes_and_those_with_sizes_asked_for_keep_their_bits(stretched):
    good = meshes.equilateral()
    after, flips = condense(tm.join([good, good]), RemeshOptions())
    assert torch.equal(after.points, tm.join([good, good]).points)
    assert flips.tolist() == [0, 0]
    asked, _ = condense(stretched, RemeshOptions(sizes="uniform"))
    assert torch.equal(asked.points, stretched.points)


def test_condensed_in_a_batch_is_condensed_alone(stretched):
    parts = [meshes.grid(5, 4), stretched]
    together, flips = condense(tm.join(parts), RemeshOptions())
    for part, joined, count in zip(parts, together.split(), flips, strict=True):
        alone, own = condense(part, RemeshOptions())
        assert torch.equal(alone.points, joined.points)
        assert torch.equal(alone.triangles, joined.triangles)
        assert int(own) == int(count)


@pytest.mark.parametrize("scale", [1e-140])
def test_the_unit_of_length_does_not_matter(stretched, scale):
    after, _ = condense(stretched.with_points(stretched.points * scale), RemeshOptions())
    assert float(tm.quality(after).mean) < float(tm.quality(stretched).mean) - 0.05


def test_relocation_ends_with_it():
    mesh = strip()
    state = relocated(mesh, RemeshOptions())
    expected, flips = condense(state.batch, RemeshOptions())
    after, info = relocate(mesh, RemeshOptions())
    assert torch.equal(after.points, expected.points)
    assert torch.equal(after.triangles, expected.triangles)
    assert int(flips) > 0
    assert torch.equal(info.flips, state.flips + flips)
    assert torch.equal(info.size, state.size)
