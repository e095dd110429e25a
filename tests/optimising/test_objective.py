import dataclasses

import meshes
import pytest
import torch

from torchmesh import join
from torchmesh.mesh.ragged import segment_sum
from torchmesh.mesh.triangle import corners, signed_area
from torchmesh.mesh.units import centre_and_unit
from torchmesh.optimising.blocks import BLOCK
from torchmesh.optimising.energies import Regularised
from torchmesh.optimising.jacobian import equilateral, invariants
from torchmesh.optimising.objective import MeshObjective, pack


def unlike():
    return [meshes.jittered(), meshes.grid(1, 1), meshes.grid(14, 13), meshes.disc(), meshes.dragged_interface()]


def packed(batch, free=None):
    free = ~batch.fixed if free is None else free
    return pack(batch.points, batch.triangles, free, batch.point_offsets, batch.triangle_offsets)


def objective_of(batch, packing):
    return MeshObjective(
        Regularised(torch.linspace(0.5, 1.5, len(packing.triangles), dtype=torch.float64)),
        equilateral(),
        packing.rows,
        packing.anchored,
        packing.block_offsets,
        packing.triangle_offsets,
        packing.spread_vertices(torch.ones(len(batch.points))),
    )


def test_the_unit_is_a_power_of_two_and_the_centre_that_of_the_box():
    batch = join([m.with_points(m.points * s + 3 * s) for m, s in zip(unlike(), (1, 1e-9, 7, 1e12, 0.3), strict=True)])
    centre, unit = centre_and_unit(batch.points, batch.point_offsets)
    for b, mesh in enumerate(batch.split()):
        low, high = mesh.points.amin(0), mesh.points.amax(0)
        torch.testing.assert_close(centre[b], (low + high) / 2, rtol=1e-15, atol=0)
        half = float((high - low).max() / 2)
        assert torch.frexp(unit[b]).mantissa == 0.5
        assert half / 2 <= float(unit[b]) <= half * (1 + 1e-15)


def test_the_centre_and_unit_of_the_largest_numbers_are_finite():
    points = torch.tensor([[-1.7e308, 0.0], [1.7e308, 1.0]], dtype=torch.float64)
    centre, unit = centre_and_unit(points, torch.tensor([0, 2]))
    assert centre.tolist() == [[0, 0.5]]
    assert bool(unit.isfinite().all())


def test_a_mesh_in_one_point_has_a_unit():
    assert centre_and_unit(torch.ones(3, 2), torch.tensor([0, 3]))[1].tolist() == [1]


def test_unknowns_stand_in_whole_blocks_with_zeros_between():
    batch = join(unlike())
    packing = packed(batch)
    assert len(packing.unknowns) == BLOCK * int(packing.block_offsets[-1])
    # The grid of 14 by 13 has 156 interior vertices: two blocks for x and two for y; one square has none.
    assert packing.block_offsets.diff().tolist() == [2, 0, 4, 2, 2]
    used = torch.cat([packing.x_rows, packing.y_rows])
    assert len(used.unique()) == len(used) == 2 * int((~batch.fixed).sum())
    rest = torch.ones(len(packing.unknowns), dtype=torch.bool)
    rest[used] = False
    assert bool((packing.unknowns[rest] == 0).all())
    owner = (packing.block_offsets[1:] * BLOCK)[:, None] > torch.stack([packing.x_rows, packing.y_rows]).reshape(1, -1)
    assert torch.equal(owner.to(torch.int64).argmax(0), packing.point_mesh.repeat(2))


def test_rows_give_the_corners_of_every_triangle_that_a_free_vertex_touches():
    batch = join(unlike())
    packing = packed(batch)
    assert packing.triangles.tolist() == (~batch.fixed)[batch.triangles].any(1).nonzero().squeeze(1).tolist()
    unit, centre = packing.unit, packing.centre
    mesh_of = torch.bucketize(packing.triangles, batch.triangle_offsets[1:], right=True)
    assert torch.equal(torch.bincount(mesh_of, minlength=len(batch)), packing.triangle_offsets.diff())
    expected = (batch.points[batch.triangles[packing.triangles]] - centre[mesh_of, None]) / unit[mesh_of, None, None]
    got = torch.cat([packing.unknowns, packing.anchored])[packing.rows.long()]
    assert torch.equal(got, expected.reshape(-1, 6).T)


def test_unpack_puts_free_vertices_where_the_unknowns_are_and_leaves_the_others():
    batch = join(unlike())
    packing = packed(batch)
    moved = packing.unpack(packing.unknowns + 0.5, batch.points)
    assert torch.equal(moved[batch.fixed], batch.points[batch.fixed])
    unit = packing.unit[packing.point_mesh]
    expected = batch.points[packing.vertices] + 0.5 * unit[:, None]
    # One rounding in and one out, of numbers of size one.
    torch.testing.assert_close(moved[packing.vertices], expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("offset", [0.0, 1 / 3, 1e5])
def test_unknowns_that_did_not_move_leave_the_points_to_the_bit(offset):
    batch = join([m.with_points(m.points + offset) for m in unlike()])
    packing = packed(batch)
    assert torch.equal(packing.unpack(packing.unknowns, batch.points), batch.points)


def test_float32_points_come_back_as_float32():
    batch = meshes.jittered().to(torch.float32)
    packing = packed(batch)
    assert packing.unknowns.dtype == torch.float64
    assert torch.equal(packing.unpack(packing.unknowns, batch.points), batch.points)


def test_spread_vertices_gives_both_coordinates_the_value():
    batch = join(unlike())
    packing = packed(batch)
    values = torch.arange(1.0, len(batch.points) + 1, dtype=torch.float64)
    spread = packing.spread_vertices(values)
    assert torch.equal(spread[packing.x_rows], values[packing.vertices])
    assert torch.equal(spread[packing.y_rows], values[packing.vertices])
    assert float(spread.sum()) == 2 * float(values[packing.vertices].sum())


def test_the_objective_is_the_sum_over_each_mesh_and_its_gradient():
    batch = join(unlike())
    packing = packed(batch)
    objective = objective_of(batch, packing)
    energy, gradient, done = objective(packing.unknowns)
    assert done is None
    unknowns = packing.unknowns.clone().requires_grad_()
    t = torch.cat([unknowns, packing.anchored])[packing.rows.long()]
    stretch, det = invariants(
        corners(t.T.reshape(-1, 2), torch.arange(3 * t.shape[1]).reshape(-1, 3)), objective.target
    )
    value = segment_sum(objective.energy.value(stretch, det), packing.triangle_offsets)
    expected = torch.autograd.grad(value.sum(), unknowns)[0]
    # Sums of some hundred terms in two orders.
    torch.testing.assert_close(energy, value.detach(), rtol=1e-12, atol=0)
    torch.testing.assert_close(gradient, expected, rtol=1e-9, atol=1e-9 * float(expected.abs().max()))
    torch.testing.assert_close(objective.det(packing.unknowns), det.detach(), rtol=1e-13, atol=1e-15)


def test_done_when_every_packed_triangle_is_large_enough():
    batch = join([meshes.grid(4, 4), meshes.jittered(cells=0.9)])
    packing = packed(batch)
    objective = objective_of(batch, packing)
    done = dataclasses.replace(objective, enough=0.0)(packing.unknowns)[2]
    assert done.tolist() == [True, False]
    area = signed_area(corners(batch.points, batch.triangles))
    assert bool((area[:32] > 0).all())
    assert bool((area[32:] < 0).any())


@pytest.mark.parametrize("keep", [[True, False, True, True, False], [False, False, False, True, False], [True] * 5])
def test_select_is_the_objective_of_the_meshes_kept_to_the_bit(keep):
    batch = join(unlike())
    packing = packed(batch)
    objective = objective_of(batch, packing)
    keep = torch.tensor(keep)
    of_blocks = keep.repeat_interleave(packing.block_offsets.diff()).repeat_interleave(BLOCK)
    energy, gradient, _ = objective(packing.unknowns)
    part = objective.select(keep)
    some_energy, some_gradient, _ = part(packing.unknowns[of_blocks])
    assert torch.equal(some_energy, energy[keep])
    assert torch.equal(some_gradient, gradient[of_blocks])
    assert torch.equal(part.scale, objective.scale[of_blocks])
    again = part.select(torch.ones(int(keep.sum()), dtype=torch.bool))
    assert torch.equal(again(packing.unknowns[of_blocks])[1], some_gradient)


def test_a_large_batch_gives_every_mesh_the_bits_it_has_alone():
    # More triangles than any chunk that stays in a cache; the meshes stand at all positions relative to its ends.
    mesh = meshes.jittered(9, 7, 0.4, 3)
    count = 400
    alone, many = packed(mesh), packed(join([mesh] * count))
    assert len(many.triangles) > 40_000

    def values(packing, copies):
        objective = MeshObjective(
            Regularised(0.7),
            equilateral(0.1),
            packing.rows,
            packing.anchored,
            packing.block_offsets,
            packing.triangle_offsets,
            packing.spread_vertices(torch.ones(copies * len(mesh.points))),
        )
        energy, gradient, _ = objective(packing.unknowns)
        return energy, gradient.reshape(copies, -1)

    energy, gradient = values(alone, 1)
    energies_, gradients = values(many, count)
    assert bool((energies_ == energy).all())
    assert bool((gradients == gradient).all())


@pytest.mark.parametrize("offset", [0.0, 1e4])
def test_displacements_in_single_precision_have_the_energy_and_forces_of_coordinates_in_double(offset):
    batch = join([m.with_points(m.points + offset) for m in unlike()])
    free = ~batch.fixed
    whole = packed(batch)
    shifts = pack(batch.points, batch.triangles, free, batch.point_offsets, batch.triangle_offsets, displacements=True)
    assert shifts.unknowns.dtype == shifts.edges.dtype == torch.float32
    assert torch.equal(shifts.unpack(shifts.unknowns, batch.points), batch.points)
    move = 0.01 * torch.randn(len(whole.unknowns), generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    move = move * whole.spread_vertices(torch.ones(len(batch.points)))
    energy, gradient, _ = objective_of(batch, whole)(whole.unknowns + move)
    single = dataclasses.replace(
        objective_of(batch, shifts),
        energy=Regularised(torch.linspace(0.5, 1.5, len(shifts.triangles))),
        edges=shifts.edges,
    )
    small, forces, _ = single(move.to(torch.float32))
    assert small.dtype == torch.float64
    assert forces.dtype == torch.float32
    torch.testing.assert_close(small, energy, rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(forces.to(torch.float64), gradient, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(
        shifts.unpack(move.to(torch.float32), batch.points), whole.unpack(whole.unknowns + move, batch.points),
        rtol=0, atol=1e-8,
    )  # fmt: skip
    keep = torch.arange(len(batch)) % 2 == 0
    part = single.select(keep)
    blocks = (whole.block_offsets[1:] - whole.block_offsets[:-1]).tolist()
    kept = torch.cat([p for p, k in zip(move.split([b * BLOCK for b in blocks]), keep.tolist(), strict=True) if k])
    assert torch.equal(part(kept.to(torch.float32))[0], small[keep])
