"""The batched recursion against the dense formula, and the promises of `minimise`."""

import dataclasses
import itertools
from dataclasses import dataclass

import numpy as np
import pytest
import torch

from torchmesh import Status
from torchmesh.optimising.blocks import BLOCK
from torchmesh.optimising.lbfgs import minimise
from torchmesh.optimising.lbfgs_options import LbfgsOptions

EXACT = LbfgsOptions(gradient_tolerance=1e-6, energy_tolerance=0.0, max_iterations=2000)


@dataclass(frozen=True)
class Function:
    """A differentiable function of n unknowns, where to start, and its minimum."""

    value: callable
    start: torch.Tensor
    minimum: torch.Tensor | None = None


def quadratic(n, condition, seed):
    """1/2 x.Ax - b.x with eigenvalues from 1 to `condition`."""
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(rng.normal(size=(n, n)))[0]
    a = torch.from_numpy(basis @ np.diag(np.geomspace(1, condition, n)) @ basis.T)
    b = torch.from_numpy(rng.normal(size=n))
    start = torch.from_numpy(rng.normal(size=n))
    return Function(lambda x: 0.5 * x @ (a @ x) - b @ x, start, torch.linalg.solve(a, b))


def rosenbrock(n):
    start = torch.full((n,), -1.0, dtype=torch.float64)
    start[::2] = 1.2
    return Function(
        lambda x: (100 * (x[1:] - x[:-1] ** 2) ** 2 + (1 - x[:-1]) ** 2).sum(),
        start,
        torch.ones(n, dtype=torch.float64),
    )


class Problems:
    """Functions side by side in blocks; remembers every point it was asked for."""

    def __init__(self, functions, scale=1.0, done=None):
        self.functions, self.done = functions, done
        self.counts = [-(-len(f.start) // BLOCK) for f in functions]
        self.block_offsets = torch.tensor([0, *np.cumsum(self.counts)])
        self.each_scale = scale
        self.scale = self.lay([torch.full_like(f.start, scale) for f in functions])
        self.asked = []

    def lay(self, pieces):
        out = torch.zeros(int(self.block_offsets[-1]) * BLOCK, dtype=torch.float64)
        for first, piece in zip((self.block_offsets[:-1] * BLOCK).tolist(), pieces, strict=True):
            out[first : first + len(piece)] = piece
        return out

    def lift(self, unknowns):
        firsts = (self.block_offsets[:-1] * BLOCK).tolist()
        return [unknowns[i : i + len(f.start)] for i, f in zip(firsts, self.functions, strict=True)]

    @property
    def start(self):
        return self.lay([f.start for f in self.functions])

    def __call__(self, unknowns):
        self.asked.append(unknowns.clone())
        values, slopes = [], []
        for f, piece in zip(self.functions, self.lift(unknowns), strict=True):
            x = piece.clone().requires_grad_()
            value = f.value(x)
            slopes.append(torch.autograd.grad(value, x)[0])
            values.append(value.detach())
        energy = torch.stack(values)
        done = torch.zeros(len(energy), dtype=torch.bool) if self.done is None else energy < self.done
        return energy, self.lay(slopes), done

    def select(self, keep):
        part = Problems(
            [f for f, k in zip(self.functions, keep.tolist(), strict=True) if k], self.each_scale, self.done
        )
        part.asked = self.asked
        return part


def unlike():
    """Problems of unlike size and difficulty; some fill their blocks, some do not, some end early."""
    return [
        quadratic(3, 10, 0),
        rosenbrock(2),
        quadratic(BLOCK, 100, 1),
        quadratic(200, 1000, 2),
        rosenbrock(10),
        quadratic(1, 1, 3),
        Function(lambda x: (x**4).sum(), torch.ones(5, dtype=torch.float64)),
    ]


def dense_inverse_hessian(steps, changes):
    """The BFGS matrix of the pairs, oldest first, from gamma times the identity (Nocedal & Wright 7.20 and 6.17)."""
    n = len(steps[0])
    h = (steps[-1] @ changes[-1]) / (changes[-1] @ changes[-1]) * torch.eye(n, dtype=torch.float64)
    for s, y in zip(steps, changes, strict=True):
        rho = 1 / (s @ y)
        v = torch.eye(n, dtype=torch.float64) - rho * torch.outer(y, s)
        h = v.T @ h @ v + rho * torch.outer(s, s)
    return h


# --- the direction ---


@pytest.mark.parametrize("history", [1, 2, 3, 6])
@pytest.mark.parametrize("scale", [1.0, 0.3])
def test_each_direction_is_that_of_the_dense_bfgs_matrix(history, scale):
    # A mild quadratic: the points asked for are the iterates until the first trial is refused, if one is.
    problem = quadratic(12, 4, 4)
    objective = Problems([problem], scale)
    options = LbfgsOptions(
        history=history, max_iterations=10, gradient_tolerance=0.0, energy_tolerance=-1.0, largest_step=1e9
    )
    minimise(objective, objective.start, options)
    points = [objective.lift(x)[0] for x in objective.asked]
    values = [problem.value(x) for x in points]
    falling = [bool(after < before) for before, after in itertools.pairwise(values)]
    iterates = falling.index(False) + 1 if False in falling else len(points)
    assert iterates > history + 3
    gradients = [torch.autograd.functional.jacobian(problem.value, x) for x in points]
    # In units of `scale`.
    z, g = [x / scale for x in points], [v * scale for v in gradients]
    torch.testing.assert_close(z[1] - z[0], -0.1 * g[0] / g[0].square().mean().sqrt(), rtol=1e-12, atol=0)
    for k in range(1, iterates - 1):
        pairs = range(max(0, k - history), k)
        h = dense_inverse_hessian([z[i + 1] - z[i] for i in pairs], [g[i + 1] - g[i] for i in pairs])
        # Pairs are differences of points that close in on each other: 1e-16 over steps of 1e-5 and more.
        torch.testing.assert_close(z[k + 1] - z[k], -h @ g[k], rtol=1e-7, atol=1e-10)


def test_a_refused_trial_is_shortened_along_the_same_direction():
    objective = Problems([rosenbrock(2)])
    minimise(objective, objective.start, LbfgsOptions(max_iterations=60))
    points = [objective.lift(x)[0] for x in objective.asked]
    here, refused = points[0], 0
    values = [float(rosenbrock(2).value(p)) for p in points]
    current = values[0]
    for k in range(1, len(points) - 1):
        if values[k] < current:
            here, current = points[k], values[k]
        elif values[k] > current:
            refused += 1
            first, second = points[k] - here, points[k + 1] - here
            assert float(second @ first / (second.norm() * first.norm())) == pytest.approx(1, abs=1e-9)
            assert 0.09 < float(second.norm() / first.norm()) < 0.51
    assert refused > 3


def test_in_one_dimension_the_second_direction_is_newtons():
    objective = Problems([Function(lambda x: 3.5 * (x - 2).square().sum(), torch.zeros(1, dtype=torch.float64))])
    minimise(objective, objective.start, LbfgsOptions(max_iterations=2, energy_tolerance=0, largest_step=1e9))
    assert objective.asked[2][0].item() == pytest.approx(2, rel=1e-14)


# --- where it ends ---


def test_converges_to_the_minimum_of_every_problem():
    functions = unlike()[:6]
    objective = Problems(functions)
    result = minimise(objective, objective.start, EXACT)
    assert result.status.tolist() == [Status.CONVERGED] * 6
    assert bool((result.gradient <= 1e-6).all())
    for f, x, energy in zip(functions, objective.lift(result.unknowns), result.energy, strict=True):
        # The root mean square gradient, times the root of at most 200, over the smallest curvature: 1 for the
        # quadratics, 0.4 for the valley.  The energy is off by that squared.
        torch.testing.assert_close(x, f.minimum, rtol=0, atol=4e-5)
        assert energy.item() == pytest.approx(float(f.value(f.minimum)), abs=1e-9)


def test_takes_about_as_many_steps_as_a_textbook_implementation():
    from scipy.optimize import minimize

    for f in (quadratic(100, 100, 5), quadratic(30, 1000, 6), rosenbrock(10)):
        objective = Problems([f])
        result = minimise(
            objective, objective.start, LbfgsOptions(gradient_tolerance=1e-6, energy_tolerance=0, history=6)
        )

        def value_and_slope(x, f=f):
            t = torch.from_numpy(x.copy()).requires_grad_()
            value = f.value(t)
            return value.item(), torch.autograd.grad(value, t)[0].numpy()

        settings = {"maxcor": 6, "gtol": 1e-6, "ftol": 0}
        book = minimize(value_and_slope, f.start.numpy(), jac=True, method="L-BFGS-B", options=settings)
        assert result.status.item() == Status.CONVERGED
        # Line searches differ; a wrong direction costs several times as much.
        assert result.evaluations.item() < 2 * book.nfev


def test_energies_never_rise():
    objective = Problems(unlike())
    seen = []
    minimise(objective, objective.start, LbfgsOptions(max_iterations=200), lambda k, e: seen.append((k, e.clone())))
    assert [k for k, _ in seen] == list(range(1, len(seen) + 1))
    for (_, before), (_, after) in itertools.pairwise(seen):
        if len(before) == len(after):
            assert bool((after <= before).all())


def test_the_energy_and_gradient_reported_are_those_of_the_unknowns_returned():
    objective = Problems(unlike())
    for limit in (0, 1, 7, 300):
        result = minimise(objective, objective.start, LbfgsOptions(max_iterations=limit))
        energy, gradient, _ = objective(result.unknowns)
        assert torch.equal(energy, result.energy)
        slopes = torch.stack([g.square().mean().sqrt() for g in objective.lift(gradient)])
        # A sum of a few hundred squares in two orders.
        torch.testing.assert_close(result.gradient, slopes, rtol=1e-13, atol=0)


@pytest.mark.parametrize("limit", [0, 1, 5])
def test_iteration_limit(limit):
    objective = Problems([rosenbrock(10), quadratic(200, 1000, 2)])
    result = minimise(objective, objective.start, LbfgsOptions(max_iterations=limit))
    assert result.status.tolist() == [Status.ITERATION_LIMIT] * 2
    assert bool((result.iterations <= limit).all())
    assert result.evaluations.tolist() == [limit + 1] * 2
    assert torch.equal(result.unknowns, objective.start) == (limit == 0)


def test_done_ends_a_problem_at_once():
    functions = [quadratic(5, 10, 0), quadratic(6, 10, 1), rosenbrock(4)]
    objective = Problems(functions, done=1.0)
    result = minimise(objective, objective.start, EXACT)
    assert result.status.tolist() == [Status.VALID] * 3
    assert bool((result.energy < 1).all())
    again = Problems(functions, done=1.0)
    still = minimise(again, result.unknowns, EXACT)
    assert still.status.tolist() == [Status.VALID] * 3
    assert still.iterations.tolist() == [0, 0, 0]
    assert torch.equal(still.unknowns, result.unknowns)


def test_settled_when_the_energy_no_longer_changes():
    objective = Problems([rosenbrock(10)])
    result = minimise(objective, objective.start, LbfgsOptions(energy_tolerance=0.5, patience=3))
    assert result.status.item() == Status.SETTLED
    assert 3 <= result.iterations.item() < 30


def test_a_gradient_that_lies_stalls_and_moves_nothing():
    class Uphill(Problems):
        def __call__(self, unknowns):
            energy, gradient, done = super().__call__(unknowns)
            return energy, -gradient, done

        def select(self, keep):
            raise AssertionError("one problem: nothing to select")

    objective = Uphill([quadratic(5, 10, 0)])
    result = minimise(objective, objective.start, LbfgsOptions())
    assert result.status.item() == Status.STALLED
    assert result.iterations.item() == 0
    assert torch.equal(result.unknowns, objective.start)


def test_a_start_at_the_minimum_stays_there():
    f = quadratic(5, 10, 0)
    objective = Problems([Function(lambda x: (x - 1).square().sum(), torch.ones(5, dtype=torch.float64)), f])
    result = minimise(objective, objective.start, EXACT)
    assert result.status.tolist() == [Status.CONVERGED] * 2
    assert result.iterations[0] == 0
    assert objective.lift(result.unknowns)[0].tolist() == [1] * 5


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), float("-inf")])
def test_a_start_without_finite_energy_is_refused_and_touches_no_other(bad):
    broken = Function(lambda x: (x * bad).sum(), torch.ones(4, dtype=torch.float64))
    good = [quadratic(5, 10, 0), rosenbrock(3)]
    objective = Problems([good[0], broken, good[1]])
    result = minimise(objective, objective.start, EXACT)
    assert result.status.tolist() == [Status.CONVERGED, Status.NOT_FINITE, Status.CONVERGED]
    assert result.iterations[1] == 0
    pieces = objective.lift(result.unknowns)
    assert pieces[1].tolist() == [1] * 4
    for f, x in zip(good, pieces[::2], strict=True):
        alone = Problems([f])
        assert torch.equal(alone.lift(minimise(alone, alone.start, EXACT).unknowns)[0], x)


def test_a_problem_that_turns_infinite_on_the_way_is_held_back_from_there():
    # A barrier at zero: the quadratic pulls every unknown through it.
    wall = Function(
        lambda x: torch.where(x > 0, (x + 1).square() - 1e-3 * x.clamp_min(1e-300).log(), torch.inf).sum(),
        torch.full((5,), 3.0, dtype=torch.float64),
    )
    objective = Problems([wall])
    result = minimise(objective, objective.start, LbfgsOptions(energy_tolerance=0.0, largest_step=1e9))
    assert any(bool((x[:5] <= 0).any()) for x in objective.asked)
    # 2 (x + 1) = 1e-3 / x.
    root = (-1 + np.sqrt(1 + 2e-3)) / 2
    torch.testing.assert_close(result.unknowns[:5], torch.full((5,), root, dtype=torch.float64), rtol=1e-3, atol=0)


def test_a_trial_of_energy_minus_infinity_is_not_taken():
    cliff = Function(
        lambda x: torch.where(x > 0, (x + 1).square(), -torch.inf).sum(), torch.full((5,), 3.0, dtype=torch.float64)
    )
    objective = Problems([cliff])
    result = minimise(objective, objective.start, LbfgsOptions(largest_step=1e9))
    assert any(bool((x[:5] <= 0).any()) for x in objective.asked)
    assert bool((result.unknowns[:5] > 0).all())
    assert bool(result.energy.isfinite().all())


def test_a_problem_without_unknowns_is_converged():
    empty = Function(lambda x: x.sum() + 7.0, torch.zeros(0, dtype=torch.float64))
    good = quadratic(5, 10, 0)
    objective = Problems([empty, good, empty])
    assert objective.block_offsets.tolist() == [0, 0, 1, 1]
    result = minimise(objective, objective.start, EXACT)
    assert result.status.tolist() == [Status.CONVERGED] * 3
    assert result.energy[[0, 2]].tolist() == [7, 7]


# --- steps ---


@pytest.mark.parametrize("largest", [0.01, 0.1])
def test_no_unknown_moves_further_than_the_largest_step(largest):
    scale = 0.5
    objective = Problems([rosenbrock(6)], scale)
    options = LbfgsOptions(largest_step=largest, first_step=10.0, max_iterations=40)
    minimise(objective, objective.start, options)
    accepted = [objective.start]
    for x in objective.asked[1:]:
        # Ten last bits of numbers of size one.
        assert float((x - accepted[-1]).abs().max()) <= largest * scale + 1e-15
        if objective.functions[0].value(x[:6]) < objective.functions[0].value(accepted[-1][:6]):
            accepted.append(x)
    assert len(accepted) > 10


def test_scale_is_the_unit_of_each_unknown_to_the_bit():
    f = rosenbrock(7)
    plain = Problems([f])
    stretched = Problems([Function(lambda x: f.value(x / 8), 8 * f.start)], scale=8.0)
    first, second = (minimise(p, p.start, LbfgsOptions()) for p in (plain, stretched))
    assert torch.equal(8 * first.unknowns, second.unknowns)
    assert torch.equal(first.energy, second.energy)
    assert torch.equal(first.status, second.status)


def test_unknowns_of_scale_zero_stay():
    objective = Problems([quadratic(10, 10, 0)])
    objective.scale[3:6] = 0
    result = minimise(objective, objective.start, EXACT)
    assert torch.equal(result.unknowns[3:6], objective.start[3:6])
    _, gradient, _ = objective(result.unknowns)
    free = [0, 1, 2, 6, 7, 8, 9]
    assert float(gradient[free].square().mean().sqrt()) < 1e-6
    assert result.status.item() == Status.CONVERGED


def test_padding_stays_zero_and_the_start_is_not_changed():
    objective = Problems(unlike())
    start = objective.start
    copy = start.clone()
    result = minimise(objective, start, LbfgsOptions(max_iterations=50))
    assert torch.equal(start, copy)
    assert torch.equal(result.unknowns[objective.scale == 0], torch.zeros(int((objective.scale == 0).sum())).double())


# --- joined equals alone ---


@pytest.mark.parametrize("options", [LbfgsOptions(), EXACT, LbfgsOptions(history=2, patience=2, energy_tolerance=1e-2)])
def test_every_problem_of_a_batch_ends_as_alone_to_the_bit(options):
    functions = unlike()
    alone = []
    for f in functions:
        single = Problems([f])
        alone.append((single, minimise(single, single.start, options)))
    for order in ([6, 2, 4, 0, 1, 5, 3], [3, 3, 0]):
        batch = Problems([functions[k] for k in order])
        together = minimise(batch, batch.start, options)
        for row, k in enumerate(order):
            single, result = alone[k]
            for name in ("energy", "gradient", "iterations", "evaluations", "status"):
                assert torch.equal(getattr(together, name)[row : row + 1], getattr(result, name)), (k, name)
            assert torch.equal(batch.lift(together.unknowns)[row], single.lift(result.unknowns)[0])
    assert len({int(result.iterations) for _, result in alone}) > 4


def test_runs_repeat_to_the_bit():
    objective = Problems(unlike())
    first, second = (minimise(objective, objective.start, LbfgsOptions()) for _ in range(2))
    assert torch.equal(first.unknowns, second.unknowns)
    assert torch.equal(first.energy, second.energy)


@pytest.mark.parametrize(
    ("name", "value"),
    [("patience", 0), ("history", 0), ("first_step", 0.0), ("largest_step", -1.0), ("sufficient_decrease", 1.0),
     ("blind_shortening", 0.0), ("shortening", (0.5, 0.1))],
)  # fmt: skip
def test_options_that_cannot_work_are_refused_by_name(name, value):
    with pytest.raises(ValueError, match=rf"LbfgsOptions\.{name} must"):
        LbfgsOptions(**{name: value})


class Single:
    """An objective over unknowns in single precision."""

    def __init__(self, objective):
        self.objective, self.block_offsets = objective, objective.block_offsets
        self.scale = objective.scale.to(torch.float32)

    def __call__(self, unknowns):
        energy, gradient, done = self.objective(unknowns.to(torch.float64))
        return energy, gradient.to(torch.float32), done

    def select(self, keep):
        return Single(self.objective.select(keep))


def test_single_precision_finds_the_minima_and_tells_numbers_in_double():
    objective = Problems(unlike()[:6])
    options = dataclasses.replace(EXACT, gradient_tolerance=1e-3)
    result = minimise(Single(objective), objective.start.to(torch.float32), options)
    assert result.unknowns.dtype == torch.float32
    assert result.energy.dtype == result.gradient.dtype == torch.float64
    exact = minimise(objective, objective.start, EXACT)
    torch.testing.assert_close(result.energy, exact.energy, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("size", [1e-25, 1e-12, 1e12, 1e25])
def test_the_size_of_the_energy_does_not_matter_in_single_precision(size):
    """Products of such gradients would leave the range of the numbers."""

    def run(factor):
        problem = quadratic(12, 40, 7)
        objective = Problems([Function(lambda x: factor * problem.value(x), problem.start)])
        options = LbfgsOptions(max_iterations=30, gradient_tolerance=0.0)
        return minimise(Single(objective), objective.start.to(torch.float32), options)

    plain, scaled = run(1.0), run(size)
    torch.testing.assert_close(scaled.unknowns, plain.unknowns, rtol=1e-3, atol=1e-4)
