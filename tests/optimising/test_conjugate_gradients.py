"""The solver against dense solves: alone and side by side, and how it ends where it cannot go on."""

import pytest
import torch
from meshes import disc, disturbed, grid
from torch import Tensor

from torchmesh.optimising.conjugate_gradients import Systems, solve
from torchmesh.optimising.energies import InverseMeanRatio
from torchmesh.optimising.hessian import Hessian
from torchmesh.optimising.jacobian import equilateral

TARGET = equilateral(0.2)


def hessian_of(mesh) -> tuple[Hessian, int]:
    """The Hessian of the mean ratio with the free coordinates first in the vector, and how many they are."""
    count = len(mesh.points)
    rows = torch.stack([mesh.triangles[:, i // 2] + (i % 2) * count for i in range(6)])
    free = (~mesh.fixed).repeat(2)
    order = torch.cat([free.nonzero().squeeze(1), (~free).nonzero().squeeze(1)])
    x = mesh.points.T.reshape(-1)[order]
    return Hessian.at(x, order.argsort()[rows], InverseMeanRatio(), TARGET), int(free.sum())


def leading_block(hessian: Hessian, count: int) -> Tensor:
    """(count, count) the dense matrix over the free coordinates."""
    unit = torch.eye(hessian.size, dtype=torch.float64)
    return torch.stack([hessian @ row for row in unit[:count]])[:, :count]


def test_the_solution_is_the_dense_ones(generator):
    hessian, count = hessian_of(disturbed(grid(), 0.01, 2))
    matrix = leading_block(hessian, count)
    assert count < hessian.size
    assert float(torch.linalg.eigvalsh(matrix).min()) > 0
    right = torch.randn(count, generator=generator, dtype=torch.float64)
    solution = solve(hessian, right, torch.tensor([0, count]), tolerance=1e-13)
    assert bool(solution.converged.all())
    assert 0 < int(solution.iterations) <= 2 * count
    torch.testing.assert_close(solution.x, torch.linalg.solve(matrix, right), rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("start", ["zero", "elsewhere"])
def test_steps_lead_to_the_solution_from_any_start(start, generator):
    hessian, count = hessian_of(disturbed(grid(4, 4), 0.01, 2))
    matrix = leading_block(hessian, count)
    right, x = torch.randn(2, count, generator=generator, dtype=torch.float64)
    x = torch.zeros_like(x) if start == "zero" else x
    systems = Systems(matrix, matrix.diagonal(), torch.tensor([0, count]))
    now = systems.start(x, right - matrix @ x)
    for _ in range(2 * count):
        now = systems.step(now)
    torch.testing.assert_close(now.x, torch.linalg.solve(matrix, right), rtol=1e-10, atol=1e-12)
    # The residual that is carried along is the true one.
    torch.testing.assert_close(now.residual, right - matrix @ now.x, rtol=0, atol=1e-11)


def side_by_side(generator):
    """Three unlike Hessians with right-hand sides, alone and as one, and the offsets of the latter."""
    parts = [hessian_of(mesh) for mesh in (disturbed(grid(), 0.01, 2), disc(), disturbed(grid(9, 8), 0.003, 3))]
    right = [torch.randn(count, generator=generator, dtype=torch.float64) for _, count in parts]
    # The free coordinates of all, then the others.
    counts = [count for _, count in parts]
    rest, rows, offsets = sum(counts), [], torch.tensor([0, *counts]).cumsum(0)
    for (hessian, count), start in zip(parts, offsets, strict=False):
        rows.append(torch.where(hessian.rows < count, hessian.rows + start, hessian.rows - count + rest))
        rest += hessian.size - count
    together = Hessian(
        torch.cat(rows, 1),
        rest,
        torch.cat([h.edges for h, _ in parts], 2),
        TARGET,
        torch.cat([h.slopes for h, _ in parts], 1),
        torch.cat([h.curvatures for h, _ in parts], 1),
    )
    return parts, right, together, offsets


def test_each_system_is_solved_as_if_alone(generator):
    parts, right, together, offsets = side_by_side(generator)
    alone = [solve(h, r, torch.tensor([0, count])) for (h, count), r in zip(parts, right, strict=True)]
    solution = solve(together, torch.cat(right), offsets)
    assert len(solution.x) == int(offsets[-1])
    assert torch.equal(solution.x, torch.cat([s.x for s in alone]))
    assert torch.equal(solution.iterations, torch.cat([s.iterations for s in alone]))
    assert len(set(solution.iterations.tolist())) > 1


def test_each_system_has_its_own_tolerance(generator):
    _, right, together, offsets = side_by_side(generator)
    exact = solve(together, torch.cat(right), offsets, tolerance=1e-13)
    rough = solve(together, torch.cat(right), offsets, tolerance=torch.tensor([1e-13, 0.1, 1e-13]).double())
    same = (exact.x == rough.x).split((offsets[1:] - offsets[:-1]).tolist())
    assert [bool(part.all()) for part in same] == [True, False, True]
    assert bool(rough.converged.all())
    assert rough.iterations[1] < exact.iterations[1]


def test_selected_systems_go_on_as_if_alone(generator):
    parts, right, together, offsets = side_by_side(generator)
    keep = torch.tensor([True, False, True])
    count = int(offsets[-1])
    whole = Systems(leading_block(together, count), together.diagonal()[:count], offsets)
    now = whole.step(whole.start(torch.zeros(count, dtype=torch.float64), torch.cat(right)))
    part = whole.select(now, keep)
    rows = torch.cat([torch.arange(int(offsets[b]), int(offsets[b + 1])) for b in (0, 2)])
    inner = leading_block(together, count)[rows][:, rows]
    sizes = torch.tensor([0, parts[0][1], parts[2][1]])
    some = Systems(inner, together.diagonal()[:count][rows], sizes.cumsum(0)).step(part)
    torch.testing.assert_close(some.x, whole.step(now).x[rows], rtol=1e-12, atol=1e-14)
    assert bool((some.length > 0).all())


def test_an_indefinite_system_stops_and_says_so():
    # With its signs turned round, a positive definite Hessian is negative definite.
    hessian, count = hessian_of(disturbed(grid(), 0.01, 2))
    turned = Hessian(hessian.rows, hessian.size, hessian.edges, TARGET, -hessian.slopes, -hessian.curvatures)
    solution = solve(turned, torch.ones(count, dtype=torch.float64), torch.tensor([0, count]))
    assert not bool(solution.converged)
    assert bool((solution.x == 0).all())


def test_nothing_to_solve_is_solved():
    hessian, count = hessian_of(grid())
    solution = solve(hessian, torch.zeros(count, dtype=torch.float64), torch.tensor([0, count]))
    assert bool(solution.converged)
    assert int(solution.iterations) == 0


def test_too_few_iterations_do_not_converge(generator):
    hessian, count = hessian_of(disturbed(grid(), 0.01, 2))
    right = torch.randn(count, generator=generator, dtype=torch.float64)
    solution = solve(hessian, right, torch.tensor([0, count]), max_iterations=2)
    assert not bool(solution.converged)
    assert int(solution.iterations) == 2
