"""The packing of a batch, compiled, against its twin in torch: the same bits in every field."""

import dataclasses

import pytest
import torch
from both_loops import both
from meshes import delaunay, disc, grid, jittered, ring

from torchmesh import join
from torchmesh.mesh.detached import without_autograd
from torchmesh.mesh.means import vertex_size
from torchmesh.mesh.units import centre_and_unit
from torchmesh.optimising.objective import pack


def batches():
    many = join([jittered(cells=0.4, seed=1), ring(), disc(), delaunay(60, seed=2), grid(3, 2), grid(1, 1)])
    return [many, many.to(torch.float32), grid(2, 2), many.with_points(1e120 * many.points), delaunay(300, seed=3)]


@pytest.mark.parametrize("displacements", [False, True])
@pytest.mark.parametrize("block", [128, 8])
def test_every_field_has_the_same_bits(generator, displacements, block):
    for batch in batches():
        some = torch.rand(len(batch.points), generator=generator) < 0.5
        nothing = torch.zeros_like(batch.fixed)
        for free in (~batch.fixed, some & ~batch.fixed, nothing):
            offsets = batch.point_offsets, batch.triangle_offsets
            given = batch.points, batch.triangles, free, *offsets, displacements, block
            expected, got = both(lambda arguments=given: pack(*arguments))
            for field in dataclasses.fields(expected):
                one, two = getattr(expected, field.name), getattr(got, field.name)
                assert (one is None) == (two is None), field.name
                assert one is None or (one.dtype == two.dtype and torch.equal(one, two)), field.name


def test_sizes_centres_and_units_have_the_same_bits():
    for batch in batches():
        for expected, got in zip(*both(lambda b=batch: centre_and_unit(b.points, b.point_offsets)), strict=True):
            assert torch.equal(expected, got)
        expected, got = both(lambda b=batch: vertex_size(b))
        torch.testing.assert_close(got, expected, rtol=1e-15, atol=0)  # torch does not always round square roots


@pytest.mark.parametrize("displacements", [False, True])
def test_positions_and_sizes_are_packed_and_unpacked_with_the_same_bits(generator, displacements):
    for batch in batches():
        packing = pack(batch.points, batch.triangles, ~batch.fixed, batch.point_offsets, batch.triangle_offsets,
                       displacements)  # fmt: skip
        unknowns = packing.unknowns + 1e-3 * torch.rand(packing.unknowns.shape, generator=generator).to(
            packing.unknowns
        )
        unknowns[::3] = packing.unknowns[::3]
        size = torch.rand(len(batch.points), generator=generator, dtype=torch.float64)

        def run(packing=packing, unknowns=unknowns, batch=batch, size=size):
            return packing.unpack(unknowns, batch.points), packing.spread_vertices(size)

        for expected, got in zip(*both(without_autograd(run)), strict=True):
            assert expected.dtype == got.dtype
            assert torch.equal(expected, got)
