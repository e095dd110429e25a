"""The compiled Newton method against its twin in torch, and against itself: in threads, in pauses, alone and joined."""

import pytest
import torch
from meshes import delaunay, disc, disturbed, grid, jittered, ring

from torchmesh import join
from torchmesh.kernels import library
from torchmesh.kernels import newton as kernel
from torchmesh.mesh.means import vertex_size
from torchmesh.mesh.measure import upright
from torchmesh.mesh.ragged import segment_any, spread
from torchmesh.optimising.energies import InverseMeanRatio, Regularised
from torchmesh.optimising.jacobian import Target, equilateral
from torchmesh.optimising.newton import NewtonOptions, NewtonProblem, newton
from torchmesh.optimising.objective import pack

ENERGIES = {
    "plain": InverseMeanRatio(1),
    "squared": InverseMeanRatio(2),
    "cubed": InverseMeanRatio(3),
    "with a ceiling": InverseMeanRatio(2, 1.3),
    "regularised": Regularised(0.0, 0.5),
    "regularised with an epsilon of each": Regularised(torch.empty(0), 0.1),
}


def problem(batch, energy, *, targets=False):
    packing = pack(batch.points, batch.triangles, ~batch.fixed, batch.point_offsets, batch.triangle_offsets)
    count = len(packing.triangles)
    scale = torch.linspace(0.9, 1.1, count, dtype=torch.float64)
    target = Target(*(v * scale for v in equilateral())) if targets else equilateral()
    if isinstance(energy, Regularised) and isinstance(energy.eps, torch.Tensor):
        energy = Regularised(0.1 * scale, energy.theta)
    size = packing.spread_vertices(vertex_size(batch) / spread(packing.unit, batch.point_offsets))
    return NewtonProblem(packing, energy, target, torch.where(size > 0, size, 1.0), packing.block_offsets * 128)


def valid_batch():
    batch = join([jittered(cells=0.05, seed=1), ring(), disturbed(grid(), 0.02, 1), disc(), delaunay(60, 3)])
    assert bool(upright(batch).all())
    return batch


def taken(made, options, choice, valid=None):
    start = made.packing.unknowns
    valid = torch.ones(len(made.rows) - 1, dtype=torch.bool) if valid is None else valid
    with library.using(choice):
        return newton(made, start, valid, options)


@pytest.mark.parametrize("targets", [False, True], ids=["one target", "targets"])
@pytest.mark.parametrize("name", ENERGIES)
def test_one_step_is_that_of_torch(name, targets):
    """A step is made of slopes and curvatures, which the compiled loops have by hand and torch by autograd."""
    made = problem(valid_batch(), ENERGIES[name], targets=targets)
    options = NewtonOptions(newton_steps=1, first_cg_tolerance=1e-13)
    (one, left), (two, also) = (taken(made, options, choice) for choice in ("torch", "compiled"))
    assert not torch.equal(one, made.packing.unknowns)
    torch.testing.assert_close(two, one, rtol=0, atol=1e-11)
    torch.testing.assert_close(also, left, rtol=1e-6, atol=1e-11)


@pytest.mark.parametrize("name", ENERGIES)
def test_both_end_at_the_same_minimum(name):
    made = problem(valid_batch(), ENERGIES[name])
    # The last mesh has slivers, from which the way is long.
    options = NewtonOptions(newton_steps=100)
    (one, left), (two, also) = (taken(made, options, choice) for choice in ("torch", "compiled"))
    assert bool((left < 1e-9).all())
    assert bool((also < 1e-9).all())
    torch.testing.assert_close(two, one, rtol=0, atol=1e-9)
    assert float(made.hessian(two).gradient()[: len(two)].abs().max()) < 1e-7


def test_meshes_that_are_not_valid_stay():
    batch = join([jittered(cells=1.5, seed=1), disturbed(grid(), 0.02, 1)])
    valid = ~segment_any(~upright(batch), batch.triangle_offsets)
    assert valid.tolist() == [False, True]
    made = problem(batch, InverseMeanRatio())
    rows = slice(0, int(made.rows[1]))
    for choice in ("torch", "compiled"):
        x, left = taken(made, NewtonOptions(), choice, valid)
        assert torch.equal(x[rows], made.packing.unknowns[rows])
        assert left[0] == torch.inf
        assert left[1] < 1e-9


def test_a_linear_system_that_is_not_solved_is_told():
    made = problem(valid_batch(), InverseMeanRatio())
    options = NewtonOptions(cg_iterations=1, first_cg_tolerance=1e-12, newton_steps=2)
    for choice in ("torch", "compiled"):
        assert bool(taken(made, options, choice)[1].isinf().all())


def test_threads_pauses_and_company_change_no_bit(monkeypatch):
    batch = valid_batch()
    whole = taken(problem(batch, InverseMeanRatio()), NewtonOptions(), "compiled")
    monkeypatch.setattr(kernel, "threads", lambda: 3)
    monkeypatch.setattr(kernel, "_TRIANGLES", 1)
    made = problem(batch, InverseMeanRatio())
    paused = taken(made, NewtonOptions(), "compiled")
    assert all(torch.equal(a, b) for a, b in zip(paused, whole, strict=True))
    for b, part in enumerate(batch.split()):
        alone = taken(problem(part, InverseMeanRatio()), NewtonOptions(), "compiled")
        assert torch.equal(alone[0], whole[0][made.rows[b] : made.rows[b + 1]])
        assert torch.equal(alone[1], whole[1][b : b + 1])
