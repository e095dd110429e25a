"""Factors of Hessians as preconditioners: systems have the solutions that they have without, in fewer steps."""

import pytest
import torch
from meshes import delaunay, disc, disturbed, grid, jittered, ring

from torchmesh import join
from torchmesh.kernels import block_factors, library
from torchmesh.kernels import newton as kernel
from torchmesh.mesh.means import vertex_size
from torchmesh.mesh.ragged import spread
from torchmesh.optimising.conjugate_gradients import solve
from torchmesh.optimising.energies import InverseMeanRatio
from torchmesh.optimising.jacobian import equilateral
from torchmesh.optimising.newton import NewtonOptions, NewtonProblem, newton
from torchmesh.optimising.objective import pack

# The last but one has slivers, at which its Hessian is not positive definite.
MESHES = [jittered(cells=0.05, seed=1), ring(), disc(), delaunay(60, seed=2), disturbed(grid(), 0.02, 1)]


def problem(batch):
    packing = pack(batch.points, batch.triangles, ~batch.fixed, batch.point_offsets, batch.triangle_offsets)
    size = packing.spread_vertices(vertex_size(batch) / spread(packing.unit, batch.point_offsets))
    size = torch.where(size > 0, size, 1.0)
    return NewtonProblem(packing, InverseMeanRatio(2), equilateral(), size, packing.block_offsets * 128)


def factors(made):
    with library.using("compiled"):
        which = torch.ones(len(made.rows) - 1, dtype=torch.bool)
        return made.factors(made.packing.unknowns, which, made.orders())


def solved(made, right, own=None):
    with library.using("compiled"):
        return solve(made.hessian(made.packing.unknowns, own), right, made.rows, tolerance=1e-11)


def right_side(made, generator):
    right = torch.zeros_like(made.packing.unknowns)
    for rows in (made.packing.x_rows, made.packing.y_rows):
        right[rows] = torch.randn(len(rows), generator=generator, dtype=torch.float64)
    return right


def test_factors_solve_what_the_diagonal_solves_in_a_few_steps(generator):
    made = problem(join(MESHES))
    right = right_side(made, generator)
    expected, got = solved(made, right), solved(made, right, factors(made))
    assert got.converged.tolist() == expected.converged.tolist() == [True, True, True, False, True]
    assert got.iterations[got.converged].max() <= 4  # factors are in single precision
    assert expected.iterations[expected.converged].min() > 8
    # Without factors the system that is not positive definite is left as it would be.
    scale = float(expected.x.abs().max())
    torch.testing.assert_close(got.x, expected.x, rtol=0, atol=1e-8 * scale)


def test_both_orders_of_elimination_lead_to_the_solution(generator):
    """Meshes of more than 1,500 free vertices are dissected, smaller ones are ordered by minimum degree."""
    made = problem(join([disturbed(grid(60, 30), 0.001, 1), disturbed(grid(12, 9), 0.005, 2)]))
    right = right_side(made, generator)
    got = solved(made, right, factors(made))
    assert int(got.iterations.max()) <= 4
    beyond = right.new_zeros(len(made.packing.anchored))
    residual = (made.hessian(made.packing.unknowns) @ torch.cat([got.x, beyond]))[: len(right)] - right
    assert float(residual.abs().max()) < 1e-8


@pytest.mark.parametrize("cells", [0.01, 0.3])
def test_newton_with_factors_of_a_point_nearby_or_not_ends_at_the_same_minimum(cells):
    """Near by, chord steps lead there; from farther away they do not, and Newton's method must."""
    batch = join([MESHES[0], MESHES[4], ring()])
    made, other = problem(batch), problem(join([jittered(cells=cells, seed=4), disturbed(grid(), 0.03, 3), ring()]))
    start, valid = made.packing.unknowns, torch.ones(3, dtype=torch.bool)
    with library.using("compiled"):
        assert len(other.packing.unknowns) == len(start)
        expected, _ = newton(made, start, valid, NewtonOptions(newton_steps=60))
        for near in (factors(made), factors(other)):
            x, left = newton(made, start, valid, NewtonOptions(newton_steps=60), near)
            assert bool((left < 1e-9).all())
            torch.testing.assert_close(x, expected, rtol=0, atol=1e-9)


def test_a_start_at_the_minimum_stays_there():
    made = problem(join([MESHES[0], ring()]))
    valid = torch.ones(2, dtype=torch.bool)
    with library.using("compiled"):
        x, _ = newton(made, made.packing.unknowns, valid, NewtonOptions())
        again, left = newton(made, x, valid, NewtonOptions(), factors(made))
    assert bool((left < 1e-9).all())
    torch.testing.assert_close(again, x, rtol=0, atol=1e-11)


def test_threads_pauses_and_company_change_no_bit(monkeypatch):
    batch = join(MESHES)
    valid = torch.ones(len(MESHES), dtype=torch.bool)

    def taken(made, which):
        with library.using("compiled"):
            return newton(made, made.packing.unknowns, which, NewtonOptions(), factors(made))

    made = problem(batch)
    whole = taken(made, valid)
    monkeypatch.setattr(kernel, "threads", lambda: 3)
    monkeypatch.setattr(block_factors, "threads", lambda: 3)
    monkeypatch.setattr(kernel, "_TRIANGLES", 1)
    monkeypatch.setattr(block_factors, "TRIANGLES", 1)
    assert all(torch.equal(a, b) for a, b in zip(taken(made, valid), whole, strict=True))
    for b, part in enumerate(batch.split()):
        alone = taken(problem(part), valid[:1])
        assert torch.equal(alone[0], whole[0][made.rows[b] : made.rows[b + 1]])
        assert torch.equal(alone[1], whole[1][b : b + 1])


def test_torch_has_no_factors_and_needs_none():
    made = problem(join([ring()]))
    with library.using("torch"):
        assert made.orders() is None
        assert made.factors(made.packing.unknowns, torch.ones(1, dtype=torch.bool), None) is None
