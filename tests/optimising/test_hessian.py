"""Products with the Hessian against autograd's dense matrix; the solver against a dense solve."""

import pytest
import torch
from meshes import disc, disturbed, grid
from torch import Tensor

from torchmesh.mesh.triangle import Corners
from torchmesh.optimising.conjugate_gradients import solve
from torchmesh.optimising.energies import (
    Energy,
    InverseMeanRatio,
    Regularised,
    TotalLiftedContent,
    UntangleBeta,
    equilateral,
)
from torchmesh.optimising.energies import invariants as energy_invariants
from torchmesh.optimising.hessian import Hessian

ENERGIES = {
    "inverse mean ratio": InverseMeanRatio(),
    "cubed, with a ceiling": InverseMeanRatio(3, 1.5),
    "first power": InverseMeanRatio(1),
    "untangle-beta": UntangleBeta(2.0),
    "regularised": Regularised(0.1),
    "lifted content": TotalLiftedContent(0.1),
}
TARGET = equilateral(0.2)


def place(mesh) -> tuple[Tensor, Tensor]:
    """All coordinates, x before y, and where the corners' stand in them."""
    count = len(mesh.points)
    rows = torch.stack([mesh.triangles[:, i // 2] + (i % 2) * count for i in range(6)])
    return mesh.points.T.reshape(-1).clone(), rows


def dense(energy: Energy, x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
    def total(x: Tensor) -> Tensor:
        return energy.value(*energy_invariants(Corners(*x[rows]), TARGET)).sum()

    return torch.autograd.functional.jacobian(total, x), torch.autograd.functional.hessian(total, x)


@pytest.mark.parametrize("name", ENERGIES)
def test_products_gradient_and_diagonal_are_autograds(name, generator):
    energy = ENERGIES[name]
    x, rows = place(disturbed(grid(4, 3), 0.01, 1))
    gradient, matrix = dense(energy, x, rows)
    assert float(matrix.abs().max()) > 0.1
    hessian = Hessian.at(x, rows, energy, TARGET)
    u = torch.randn(len(x), generator=generator, dtype=x.dtype)
    # Sums of some ten terms, in another order.
    size = float(matrix.abs().max())
    torch.testing.assert_close(hessian @ u, matrix @ u, rtol=0, atol=1e-13 * size * float(u.norm()))
    torch.testing.assert_close(hessian.gradient(), gradient, rtol=0, atol=1e-12 * size)
    torch.testing.assert_close(hessian.diagonal(), matrix.diagonal(), rtol=0, atol=1e-12 * size)


def fixed_grid(energy: Energy, mesh):
    """The Hessian over the free coordinates, first in the vector, and the dense one."""
    x, rows = place(mesh)
    free = (~mesh.fixed).repeat(2)
    order = torch.cat([free.nonzero().squeeze(1), (~free).nonzero().squeeze(1)])
    name = torch.empty_like(order)
    name[order] = torch.arange(len(order))
    x, rows = x[order], name[rows]
    count = int(free.sum())
    return Hessian.at(x, rows, energy, TARGET), dense(energy, x, rows)[1][:count, :count], count


def test_the_solution_is_the_dense_ones(generator):
    hessian, matrix, count = fixed_grid(InverseMeanRatio(), disturbed(grid(), 0.01, 2))
    assert float(torch.linalg.eigvalsh(matrix).min()) > 0
    right = torch.randn(count, generator=generator, dtype=torch.float64)
    solution = solve(hessian, right, torch.tensor([0, count]), tolerance=1e-13)
    assert bool(solution.converged.all())
    assert 0 < int(solution.iterations) <= 2 * count
    torch.testing.assert_close(solution.x, torch.linalg.solve(matrix, right), rtol=1e-9, atol=1e-11)


def test_each_problem_is_solved_as_if_alone(generator):
    meshes = [disturbed(grid(), 0.01, 2), disc(), disturbed(grid(9, 8), 0.003, 3)]
    alone, parts, right = [], [], []
    for mesh in meshes:
        hessian, _, count = fixed_grid(InverseMeanRatio(), mesh)
        r = torch.randn(count, generator=generator, dtype=torch.float64)
        alone.append(solve(hessian, r, torch.tensor([0, count])))
        parts.append((hessian, count))
        right.append(r)
    # The free coordinates of all, then the others.
    counts = [count for _, count in parts]
    total, rest, rows, starts = sum(counts), sum(counts), [], torch.tensor([0, *counts]).cumsum(0)
    for (hessian, count), start in zip(parts, starts, strict=False):
        rows.append(torch.where(hessian.rows < count, hessian.rows + start, hessian.rows - count + rest))
        rest += hessian.size - count
    together = Hessian(
        torch.cat(rows, 1),
        rest,
        tuple(torch.cat([h.e[i] for h, _ in parts]) for i in range(4)),
        TARGET,
        torch.cat([h.slopes for h, _ in parts], 1),
        torch.cat([h.curvatures for h, _ in parts], 1),
    )
    solution = solve(together, torch.cat(right), starts)
    assert len(solution.x) == total
    assert torch.equal(solution.x, torch.cat([s.x for s in alone]))
    assert torch.equal(solution.iterations, torch.cat([s.iterations for s in alone]))
    assert len(set(solution.iterations.tolist())) > 1


def test_an_indefinite_problem_stops_and_says_so():
    # With its signs turned round, a positive definite Hessian is negative definite.
    hessian, _, count = fixed_grid(InverseMeanRatio(), disturbed(grid(), 0.01, 2))
    turned = Hessian(hessian.rows, hessian.size, hessian.e, TARGET, -hessian.slopes, -hessian.curvatures)
    solution = solve(turned, torch.ones(count, dtype=torch.float64), torch.tensor([0, count]))
    assert not bool(solution.converged)
    assert bool((solution.x == 0).all())


def test_nothing_to_solve_is_solved():
    hessian, _, count = fixed_grid(InverseMeanRatio(), grid())
    solution = solve(hessian, torch.zeros(count, dtype=torch.float64), torch.tensor([0, count]))
    assert bool(solution.converged)
    assert int(solution.iterations) == 0


def test_too_few_iterations_do_not_converge(generator):
    hessian, _, count = fixed_grid(InverseMeanRatio(), disturbed(grid(), 0.01, 2))
    right = torch.randn(count, generator=generator, dtype=torch.float64)
    solution = solve(hessian, right, torch.tensor([0, count]), max_iterations=2)
    assert not bool(solution.converged)
    assert int(solution.iterations) == 2
