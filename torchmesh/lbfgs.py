"""L-BFGS for many small problems at once, each with its own history, step and stopping test.

The unknowns of all problems stand in one vector; each problem owns a whole number of blocks of
BLOCK numbers (padded with zeros whose gradient is zero), so that the products with the history
are batched matrix products.  The recursion is the compact representation of Byrd, Nocedal &
Schnabel (Mathematical Programming 63, 1994): the history is read twice an iteration, and all that
is small happens in (problems, m, m) tensors, as in the vector-free form of Chen, Wang & Zhou 2014.
One pass of the loop tries one step of every problem; problems accept or shorten it each for itself.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from .segments import counts_from_offsets, offsets_from_counts
from .status import Status

BLOCK = 128


class Objective(Protocol):
    """B problems over one vector of unknowns."""

    @property
    def block_offsets(self) -> Tensor:
        """(B+1,) the blocks of each problem."""
        ...

    @property
    def scale(self) -> Tensor:
        """(N,) the length in which each unknown is measured: the diagonal metric."""
        ...

    def __call__(self, unknowns: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(N,) to energy (B,), gradient (N,), done (B,) bool: the problem needs no further step."""
        ...

    def select(self, keep: Tensor) -> "Objective":
        """The problems whose keep (B,) is true."""
        ...


@dataclass(frozen=True)
class LbfgsOptions:
    """How `minimise` runs.

    max_iterations      steps tried at most
    gradient_tolerance  stop when the root mean square of the scaled gradient is below it
    energy_tolerance    stop when `patience` steps together lower the energy by less than this part
    patience            see above
    history             pairs kept (m)
    first_step          root mean square length of the first step, in units of `scale`
    largest_step        largest move of one unknown in a step, in units of `scale`
    """

    max_iterations: int = 300
    gradient_tolerance: float = 1e-6
    energy_tolerance: float = 1e-5
    patience: int = 5
    history: int = 4
    first_step: float = 0.1
    largest_step: float = 2.0


@dataclass(frozen=True, eq=False)
class LbfgsResult:
    """Where `minimise` ended: unknowns (N,), and per problem (B,) energy, root mean square
    scaled gradient, steps accepted, energies evaluated and the `Status` as int64."""

    unknowns: Tensor
    energy: Tensor
    gradient: Tensor
    iterations: Tensor
    evaluations: Tensor
    status: Tensor


_SUFFICIENT_DECREASE = 1e-4
_CURVATURE = 1e-10


def minimise(
    objective: Objective,
    start: Tensor,
    options: LbfgsOptions | None = None,
    monitor: Callable[[int, Tensor], None] | None = None,
) -> LbfgsResult:
    """Minimise every problem of `objective` from `start` (N,).

    monitor is called with the iteration and the energies (B',) of the problems still running.
    """
    options = options or LbfgsOptions()
    problems = len(objective.block_offsets) - 1
    rows = torch.arange(problems, device=start.device)
    final = start.clone()
    final_rows = torch.arange(len(start), device=start.device).reshape(-1, BLOCK)
    report = {
        name: torch.zeros(problems, dtype=dtype, device=start.device)
        for name, dtype in [("energy", start.dtype), ("gradient", start.dtype), ("iterations", torch.int64),
                            ("evaluations", torch.int64), ("status", torch.int64)]
    }  # fmt: skip
    run = _Run(objective, start, options)
    iteration = 0
    while True:
        finished = run.close(iteration >= options.max_iterations)
        everyone = bool(finished.all())
        # Finished problems leave together, when carrying them costs more than moving the rest.
        if everyone or 4 * int(run.blocks[finished].sum()) > int(run.blocks.sum()):
            leaving = rows[finished]
            report["energy"][leaving] = run.energy[finished]
            report["gradient"][leaving] = run.slope[finished]
            report["iterations"][leaving] = run.accepted[finished]
            report["evaluations"][leaving] = run.evaluations[finished]
            report["status"][leaving] = run.status[finished]
            gone = finished.repeat_interleave(run.blocks)
            final[final_rows[gone]] = run.x[gone]
            if everyone:
                break
            rows, final_rows = rows[~finished], final_rows[~gone]
            run.select(~finished)
        run.step(iteration)
        iteration += 1
        if monitor is not None:
            monitor(iteration, run.energy)
    return LbfgsResult(final, **report)


class _Run:
    """The state of the problems that are still in the loop: (K, BLOCK) vectors and (B,) numbers.

    x, g       unknowns and scaled gradient; d, t, descent: direction, step, slope of the energy along d
    past       (K, 2m, BLOCK) the last m steps s, then the last m gradient changes y
    gram       (B, 2, m, m) their products S'Y and Y'Y; against (B, 2, m) S'g and Y'g
    valid      (B, m) the pairs that count: steps accepted, with positive curvature
    gamma      (B,) s'y / y'y of the newest pair that counts: the scale of the first Hessian
    """

    def __init__(self, objective: Objective, start: Tensor, options: LbfgsOptions) -> None:
        self.objective, self.options = objective, options
        m = options.history
        self._index(counts_from_offsets(objective.block_offsets))
        self.scale = objective.scale.reshape(-1, BLOCK)
        self.x = start.reshape(-1, BLOCK).clone()
        self.energy, gradient, done = objective(start)
        finite = self.energy.isfinite()
        self.g = gradient.reshape(-1, BLOCK) * self.scale
        self.g = torch.where(self._to_blocks(finite), self.g, 0.0)
        b, new = len(self.blocks), start.new_zeros
        self.past = new((len(self.x), 2 * m, BLOCK))
        self.gram, self.against = new((b, 2, m, m)), new((b, 2, m))
        self.valid = torch.zeros((b, m), dtype=torch.bool, device=start.device)
        self.free = self._sum((self.scale > 0).to(start.dtype).sum(1)).clamp_min(1)
        self.gg = self._sum((self.g * self.g).sum(1))
        self.status = torch.where(done, Status.VALID, Status.RUNNING)
        self.status = torch.where(finite, self.status, Status.NOT_FINITE)
        self.accepted = torch.zeros_like(self.status)
        self.evaluations = torch.ones_like(self.status)
        self.recent = self.energy.repeat(options.patience, 1)
        self.gamma = first = self._first_step()
        self.d = -self._to_blocks(first) * self.g
        self.descent = -first * self.gg
        self.t = self._limit(torch.ones_like(self.energy))

    @property
    def slope(self) -> Tensor:
        """(B,) root mean square of the scaled gradient."""
        return (self.gg / self.free).sqrt()

    def select(self, keep: Tensor) -> None:
        """Go on with some of the problems only."""
        of_blocks = self._to_blocks(keep).squeeze(1)
        self.objective = self.objective.select(keep)
        for name in ("x", "g", "d", "scale", "past"):
            setattr(self, name, getattr(self, name)[of_blocks])
        for name in ("energy", "gram", "against", "gamma", "valid", "free", "gg", "status", "accepted",
                     "evaluations", "t", "descent"):  # fmt: skip
            setattr(self, name, getattr(self, name)[keep])
        self.recent = self.recent[:, keep]
        self._index(self.blocks[keep])

    def close(self, out_of_iterations: bool) -> Tensor:
        """(B,) bool: the problems at the end of their run, whose status is set."""
        settled = (self.accepted >= self.options.patience) & (
            self.recent[0] - self.energy <= self.options.energy_tolerance * self.energy.abs()
        )
        tests = [
            (self.t < 1e-12, Status.STALLED),
            (settled, Status.SETTLED),
            (self.gg <= self.options.gradient_tolerance**2 * self.free, Status.CONVERGED),
        ]
        status = torch.full_like(self.status, Status.ITERATION_LIMIT if out_of_iterations else Status.RUNNING)
        for hit, ending in tests:
            status = torch.where(hit, ending, status)
        self.status = torch.where(self.status == Status.RUNNING, status, self.status)
        return self.status != Status.RUNNING

    def step(self, iteration: int) -> None:
        """Try one step of every problem; accept it or shorten it."""
        running = self.status == Status.RUNNING
        slot = iteration % self.options.history
        move = self.d * self._to_blocks(self.t)
        x = torch.addcmul(self.x, move, self.scale)
        energy, gradient, done = self.objective(x.reshape(-1))
        gradient = gradient.reshape(-1, BLOCK) * self.scale
        change = energy - self.energy
        good = running & (change <= _SUFFICIENT_DECREASE * self.t * self.descent) & energy.isfinite()
        if bool(good.all()):
            self._advance(slot, x, move, gradient, good)
            self.t = self._limit(torch.ones_like(self.t))
        else:
            # A problem whose step was refused stays where it is; its pair of this slot is void.
            stay = (~good).index_select(0, self.owner).nonzero().squeeze(1)
            direction, descent = self.d[stay], self.descent
            x[stay], move[stay], gradient[stay] = self.x[stay], 0.0, self.g[stay]
            self._advance(slot, x, move, gradient, good)
            self.d[stay] = direction
            self.descent = torch.where(good, self.descent, descent)
            # The minimum of the parabola through the refused step, within bounds.
            fit = -0.5 * self.descent * self.t / (change / self.t - self.descent)
            shorter = torch.where(change.isfinite(), fit.clamp(0.1 * self.t, 0.5 * self.t), 0.3 * self.t)
            self.t = torch.where(good, self._limit(torch.ones_like(self.t)), torch.where(running, shorter, self.t))
        self.recent = torch.where(good, torch.cat([self.recent[1:], self.energy[None]]), self.recent)
        self.energy = torch.where(good, energy, self.energy)
        self.accepted += good
        self.evaluations += running
        self.status = torch.where(good & done, Status.VALID, self.status)

    def _advance(self, slot: int, x: Tensor, move: Tensor, gradient: Tensor, good: Tensor) -> None:
        """Take the new point, with its pair in `slot`, and find the direction from there.

        S'g and Y'g are read off the history once; the products with the new pair follow from
        them and from those at the old point, since y = g_new - g_old.
        """
        m = self.options.history
        self.past[:, slot] = move
        torch.sub(gradient, self.g, out=self.past[:, m + slot])
        self.x, self.g = x, gradient
        gg = self._sum((gradient * gradient).sum(1))
        against = self._sum(_batched(gradient[:, None], self.past.mT).squeeze(1)).reshape(-1, 2, m)
        change = against - self.against
        self.gram[..., slot] = change
        self.gram[:, 1, slot] = change[:, 1]
        sy = against[:, 0, slot] - self.t * self.descent
        yy = 2 * against[:, 1, slot] - gg + self.gg
        self.gram[:, 0, slot, slot], self.gram[:, 1, slot, slot] = sy, yy
        curved = good & (sy > _CURVATURE * yy) & (yy > 0)
        self.valid[:, slot] = curved
        self.against, self.gg = against, gg
        self.gamma = torch.where(curved, sy / torch.where(curved, yy, 1.0), self.gamma)
        self.gamma = torch.where(self.valid.any(1), self.gamma, self._first_step())
        weights = self._recursion(slot)
        self.descent = -(self.gamma * gg + (weights * against.reshape(-1, 2 * m)).sum(1))
        lost = good & ~(self.descent < 0)
        if bool(lost.any()):
            self.gamma = torch.where(lost, self._first_step(), self.gamma)
            weights = torch.where(lost[:, None], 0.0, weights)
            self.valid &= ~lost[:, None]
            self.descent = torch.where(lost, -self.gamma * gg, self.descent)
        self.d = _batched(weights.index_select(0, self.owner)[:, None], self.past).squeeze(1)
        self.d.addcmul_(self._to_blocks(self.gamma), gradient).neg_()

    def _recursion(self, slot: int) -> Tensor:
        """(B, 2m) the weights of H g = gamma g + S a + Y b; Byrd, Nocedal & Schnabel 1994, equation 3.1.

        slot  that of the newest pair
        """
        order = self._slots.roll(-1 - slot)  # from the oldest pair to the newest
        count = self.valid.index_select(1, order).to(self.gg.dtype)
        gram = self.gram.index_select(2, order).index_select(3, order)
        gram = gram * (count[:, None, :, None] * count[:, None, None, :])
        against = self.against.index_select(2, order) * count[:, None]
        (sy, yy), gamma = gram.unbind(1), self.gamma[:, None, None]
        upper = sy.triu() + torch.diag_embed(1 - count)
        w = torch.linalg.solve_triangular(upper, against[:, 0, :, None], upper=True)
        middle = sy.diagonal(dim1=1, dim2=2)[:, :, None] * w + gamma * (yy @ w - against[:, 1, :, None])
        a = torch.linalg.solve_triangular(upper.mT, middle, upper=False)
        both = torch.cat([a, -gamma * w], 2).mT * count[:, None]
        return both.index_select(2, self._slots.roll(1 + slot)).flatten(1)

    def _first_step(self) -> Tensor:
        """(B,) factor of the gradient for a step without history."""
        return self.options.first_step / self.slope.clamp_min(1e-300)

    def _limit(self, t: Tensor) -> Tensor:
        """Steps (B,), shortened so that no unknown moves further along d than allowed."""
        longest = torch.segment_reduce(self.d.abs().amax(1), "max", offsets=self.offsets, initial=0.0)
        return torch.minimum(t, self.options.largest_step / longest.clamp_min(1e-300))

    def _index(self, blocks: Tensor) -> None:
        self.blocks = blocks
        self.offsets = offsets_from_counts(blocks)
        self.owner = torch.arange(len(blocks), device=blocks.device).repeat_interleave(blocks)
        self._slots = torch.arange(self.options.history, device=blocks.device)

    def _to_blocks(self, per_problem: Tensor) -> Tensor:
        return per_problem.index_select(0, self.owner)[:, None]

    def _sum(self, per_block: Tensor) -> Tensor:
        return torch.segment_reduce(per_block, "sum", offsets=self.offsets, axis=0, initial=0.0)


def _batched(left: Tensor, right: Tensor) -> Tensor:
    """`torch.bmm` with the same bits for a matrix alone as among others: a batch of one goes another way in torch.

    A row times matrices, never matrices times a column: that way is four times slower.
    """
    if len(left) > 1:
        return torch.bmm(left, right)
    return torch.bmm(left.expand(2, -1, -1), right.expand(2, -1, -1))[:1]
