"""The compiled minimiser against its twin in torch, and against itself: in threads, in pauses, alone and joined."""

import pytest
import torch
from energy_cases import ENERGIES, UPRIGHT_ONLY
from meshes import delaunay, disc, grid, jittered, ring

from torchmesh import SmoothOptions, UntangleOptions, join, smooth, target_from, untangle
from torchmesh.kernels import library, minimiser
from torchmesh.mesh.means import vertex_size
from torchmesh.mesh.ragged import spread
from torchmesh.mesh.triangle import Corners, corners
from torchmesh.optimising.energies import InverseMeanRatio
from torchmesh.optimising.jacobian import EdgeMap, Target, equilateral, target_of
from torchmesh.optimising.lbfgs import minimise
from torchmesh.optimising.lbfgs_options import LbfgsOptions
from torchmesh.optimising.objective import MeshObjective, pack


def valid_batch():
    return join([jittered(cells=0.05, seed=1), ring(), disc(), delaunay(60, seed=2), grid(3, 2)])


def tangled_batch():
    return join([jittered(cells=1.5, seed=1), jittered(6, 5, cells=3.0, seed=2), delaunay(50, seed=4)])


def objective(batch, energy, *, displacements=False, own_target=False, edge_map=None, enough=None):
    packing = pack(
        batch.points, batch.triangles, ~batch.fixed, batch.point_offsets, batch.triangle_offsets, displacements
    )
    size = vertex_size(batch) / spread(packing.unit, batch.point_offsets)
    target = equilateral()
    if own_target:
        unit = spread(packing.unit, batch.triangle_offsets)
        own = target_of(Corners(*(v / unit for v in corners(batch.points, batch.triangles))))
        target = Target(*(v[packing.triangles] for v in own))
    maps = None if edge_map is None else EdgeMap(*(v[packing.triangles] for v in edge_map))
    made = MeshObjective(
        energy, target, packing.rows, packing.anchored, packing.block_offsets, packing.triangle_offsets,
        packing.spread_vertices(size), enough=enough, edges=packing.edges, edge_map=maps,
    )  # fmt: skip
    return made, packing.unknowns


def both(make, start, options, monitor=None):
    results = []
    for choice in ("torch", "compiled"):
        with library.using(choice):
            results.append(minimise(make, start, options, monitor))
    return results


@pytest.mark.parametrize("name", ENERGIES)
def test_each_energy_and_its_gradient_are_those_of_torch(name):
    batch = valid_batch() if name in UPRIGHT_ONLY else tangled_batch()
    made, start = objective(batch, ENERGIES[name], enough=0.1)
    with library.using("torch"):
        energy, gradient, done = made(start)
    with library.using("compiled"):
        energy_2, gradient_2, done_2 = made(start)
    torch.testing.assert_close(energy_2, energy, rtol=1e-13, atol=0)
    torch.testing.assert_close(gradient_2, gradient, rtol=1e-11, atol=1e-12 * float(gradient.abs().max()))
    assert torch.equal(done, done_2)


@pytest.mark.parametrize("name", ENERGIES)
def test_a_few_steps_lead_to_the_same_positions(name):
    batch = valid_batch() if name in UPRIGHT_ONLY else tangled_batch()
    made, start = objective(batch, ENERGIES[name])
    result, result_2 = both(made, start, LbfgsOptions(max_iterations=6))
    # Rounding grows by about one digit a step where energies are stiff.
    torch.testing.assert_close(result_2.unknowns, result.unknowns, rtol=0, atol=1e-7)
    assert torch.equal(result.evaluations, result_2.evaluations)
    assert torch.equal(result.status, result_2.status)


def test_targets_and_metrics_of_each_triangle_are_used(generator):
    batch = valid_batch()
    rows = len(batch.triangles)
    maps = EdgeMap(*(torch.rand(rows, generator=generator, dtype=torch.float64) + shift for shift in (1.0, -0.5, 1.0)))
    for more in ({"own_target": True}, {"edge_map": maps}, {"own_target": True, "edge_map": maps}):
        made, start = objective(batch, InverseMeanRatio(), **more)
        result, result_2 = both(made, start, LbfgsOptions(max_iterations=15))
        torch.testing.assert_close(result_2.unknowns, result.unknowns, rtol=0, atol=1e-9)
        torch.testing.assert_close(result_2.energy, result.energy, rtol=1e-12, atol=0)
    plain, start = objective(batch, InverseMeanRatio())
    assert not torch.equal(minimise(plain, start, LbfgsOptions(max_iterations=15)).unknowns, result_2.unknowns)


def test_displacements_in_single_precision():
    made, start = objective(valid_batch(), InverseMeanRatio(), displacements=True)
    result, result_2 = both(made, start, LbfgsOptions(max_iterations=10))
    assert result_2.unknowns.dtype == torch.float32
    torch.testing.assert_close(result_2.unknowns, result.unknowns, rtol=0, atol=1e-4)
    torch.testing.assert_close(result_2.energy, result.energy, rtol=1e-5, atol=0)


def test_every_way_to_end_is_that_of_torch():
    seen = set()
    for options in (
        LbfgsOptions(max_iterations=3),
        LbfgsOptions(energy_tolerance=1e-2),
        LbfgsOptions(gradient_tolerance=1e-2, energy_tolerance=0),
        LbfgsOptions(energy_tolerance=0, shortest_step=0.9),
        LbfgsOptions(history=1, patience=1),
        LbfgsOptions(history=9, max_iterations=40),
    ):
        made, start = objective(valid_batch(), InverseMeanRatio())
        result, result_2 = both(made, start, options)
        assert torch.equal(result.status, result_2.status), options
        seen |= set(result.status.tolist())
    made, start = objective(tangled_batch(), ENERGIES["regularised"], enough=0.0)
    result, result_2 = both(made, start, LbfgsOptions())
    assert torch.equal(result.status, result_2.status)
    start = start.clone()
    start[0] = torch.nan
    result, result_2 = both(made, start, LbfgsOptions(max_iterations=3))
    assert torch.equal(result.status, result_2.status)
    seen |= set(result.status.tolist())
    assert len(seen) >= 5, "the options must lead to different ends"


def test_neither_threads_nor_pauses_nor_company_nor_a_watcher_change_a_bit(monkeypatch):
    batch = valid_batch()
    made, start = objective(batch, InverseMeanRatio(ceiling=1.5))
    whole = minimise(made, start)
    monkeypatch.setattr(minimiser, "WORK", 1)
    monkeypatch.setattr(minimiser, "threads", lambda: 3)
    paused = minimise(made, start)
    watched = minimise(made, start, None, lambda step, energies: None)
    for other in (paused, watched):
        for name in ("unknowns", "energy", "gradient", "iterations", "evaluations", "status"):
            assert torch.equal(getattr(whole, name), getattr(other, name)), name
    for alone, joined in zip(batch.split(), smooth(batch)[0].split(), strict=True):
        assert torch.equal(smooth(alone)[0].points, joined.points)


def test_the_monitor_hears_what_that_of_torch_hears():
    made, start = objective(valid_batch(), InverseMeanRatio())
    heard = {"torch": [], "compiled": []}
    for choice, list_ in heard.items():
        with library.using(choice):
            minimise(made, start, LbfgsOptions(max_iterations=30), lambda i, e, to=list_: to.append((i, e.clone())))
    assert [i for i, _ in heard["compiled"]] == [i for i, _ in heard["torch"]]
    # In torch, problems that have ended may stay among the others for a while.
    for (_, few), (_, many) in zip(heard["compiled"], heard["torch"], strict=True):
        assert len(few) <= len(many)
        assert all(bool(((many - e).abs() <= 1e-9 * e.abs()).any()) for e in few)


def test_an_energy_that_the_library_does_not_know_is_left_to_torch():
    class Doubled(InverseMeanRatio):
        def value_and_slopes(self, stretch, det):
            return tuple(2 * v for v in super().value_and_slopes(stretch, det))

    made, start = objective(valid_batch(), InverseMeanRatio())
    own, _ = objective(valid_batch(), Doubled())
    torch.testing.assert_close(own(start)[0], 2 * made(start)[0], rtol=1e-13, atol=0)
    assert own.minimised(start, LbfgsOptions(), None) is None


def test_smoothing_and_untangling_come_to_the_same_meshes():
    valid, tangled = valid_batch(), tangled_batch()
    for options in (SmoothOptions(), SmoothOptions(ceiling=1.4), SmoothOptions(targets=target_from(valid))):
        with library.using("torch"):
            expected = smooth(valid, options)[1]
        with library.using("compiled"):
            # Where there are slivers the way is long, and it ends where five steps gain less than 1e-5.
            torch.testing.assert_close(smooth(valid, options)[1].energy, expected.energy, rtol=1e-2, atol=0)
    for options in (UntangleOptions(), UntangleOptions(method="beta")):
        with library.using("torch"):
            expected = untangle(tangled, options)[1]
        with library.using("compiled"):
            assert torch.equal(untangle(tangled, options)[1].status, expected.status)
