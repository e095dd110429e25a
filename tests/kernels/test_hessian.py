"""The compiled solver of systems with Hessians against its twin in torch."""

import pytest
import torch
from meshes import delaunay, disc, jittered, ring

from torchmesh import join
from torchmesh.kernels import hessian, library
from torchmesh.optimising.conjugate_gradients import solve
from torchmesh.optimising.energies import InverseMeanRatio
from torchmesh.optimising.hessian import Hessian
from torchmesh.optimising.jacobian import Target, equilateral
from torchmesh.optimising.objective import pack


def systems(generator, energy, target=None):
    batch = join([jittered(cells=0.05, seed=1), ring(), disc(), delaunay(60, seed=2)])
    packing = pack(batch.points, batch.triangles, ~batch.fixed, batch.point_offsets, batch.triangle_offsets)
    coordinates = torch.cat([packing.unknowns, packing.anchored])
    target = equilateral() if target is None else target(len(packing.triangles))
    made = Hessian.at(coordinates, packing.rows, energy, target, packing.triangle_offsets)
    right = torch.zeros_like(packing.unknowns)
    for rows in (packing.x_rows, packing.y_rows):
        right[rows] = torch.randn(len(rows), generator=generator, dtype=torch.float64)
    return made, right, packing.block_offsets * 128


def of_each(count):
    scale = torch.linspace(0.9, 1.1, count, dtype=torch.float64)
    return Target(*(v * scale for v in equilateral()))


@pytest.mark.parametrize("target", [None, of_each])
def test_both_solve_the_systems(generator, target):
    made, right, offsets = systems(generator, InverseMeanRatio(), target)
    solutions = {}
    for choice in ("torch", "compiled"):
        with library.using(choice):
            solutions[choice] = solve(made, right, offsets, tolerance=1e-11)
    one, two = solutions["torch"], solutions["compiled"]
    # The last mesh has slivers, at which its Hessian is not positive definite.
    assert one.converged.tolist() == two.converged.tolist() == [True, True, True, False]
    rows = slice(0, int(offsets[3]))
    torch.testing.assert_close(two.x[rows], one.x[rows], rtol=0, atol=1e-8 * float(one.x[rows].abs().max()))
    beyond = right.new_zeros(made.size - len(right))
    residual = (made @ torch.cat([two.x, beyond]))[: len(right)] - right
    assert float(residual[rows].abs().max()) < 1e-8 * float(right.abs().max())


def test_each_system_has_its_own_tolerance_and_limit(generator):
    made, right, offsets = systems(generator, InverseMeanRatio())
    tolerance = torch.tensor([1e-1, 1e-9, 1e-3, 1e-6], dtype=torch.float64)
    for most in (3, 1000):
        found = []
        for choice in ("torch", "compiled"):
            with library.using(choice):
                found.append(solve(made, right, offsets, tolerance=tolerance, max_iterations=most))
        # Rounding may shift the step in which a goal is reached by one.
        assert int((found[0].iterations - found[1].iterations).abs().max()) <= 1
        assert torch.equal(found[0].converged, found[1].converged)


def test_a_matrix_that_is_not_positive_stops_unconverged(generator):
    made, right, offsets = systems(generator, InverseMeanRatio())
    negative = Hessian(
        made.rows, made.size, made.edges, made.target, -made.slopes, -made.curvatures, made.triangle_offsets
    )
    for choice in ("torch", "compiled"):
        with library.using(choice):
            assert not bool(solve(negative, right, offsets).converged.any())


def test_threads_pauses_and_company_change_no_bit(generator, monkeypatch):
    made, right, offsets = systems(generator, InverseMeanRatio())
    whole = solve(made, right, offsets)
    monkeypatch.setattr(hessian, "threads", lambda: 3)
    monkeypatch.setattr(hessian, "_TRIANGLES", 1)
    assert torch.equal(solve(made, right, offsets).x, whole.x)
