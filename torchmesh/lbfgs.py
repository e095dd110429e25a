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

    block_offsets: Tensor  # (B+1,) the blocks of each problem
    scale: Tensor  # (N,) the length in which each unknown is measured: the diagonal metric

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
    history: int = 6
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
        run.close(iteration >= options.max_iterations)
        finished = run.status != Status.RUNNING
        count = int(finished.sum())
        everyone = count == len(finished)
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
    """The state of the problems that are still in the loop; (K, BLOCK) vectors, (B,) numbers."""

    def __init__(self, objective: Objective, start: Tensor, options: LbfgsOptions) -> None:
        self.objective, self.options = objective, options
        m = options.history
        self.blocks = counts_from_offsets(objective.block_offsets)
        self.scale = objective.scale.reshape(-1, BLOCK)
        self.x = start.reshape(-1, BLOCK).clone()
        self.energy, gradient, done = objective(start)
        self.g = gradient.reshape(-1, BLOCK) * self.scale
        b, new = len(self.blocks), start.new_zeros
        self.past = new((len(self.x), 2 * m, BLOCK))  # the steps s, then the gradient changes y
        self.sy, self.yy = new((b, m, m)), new((b, m, m))
        self.valid = torch.zeros((b, m), dtype=torch.bool, device=start.device)
        self.free = self._sum((self.scale > 0).to(start.dtype).sum(1)).clamp_min(1)
        self.slope = (self._sum((self.g * self.g).sum(1)) / self.free).sqrt()
        self.status = torch.where(done, Status.VALID, Status.RUNNING)
        self.status = torch.where(self.energy.isfinite(), self.status, Status.NOT_FINITE)
        self.g = torch.where(self._to_blocks(self.energy.isfinite()), self.g, 0.0)
        self.accepted = torch.zeros_like(self.status)
        self.evaluations = torch.ones_like(self.status)
        self.recent = self.energy.repeat(options.patience, 1)
        self._steepest()

    def select(self, keep: Tensor) -> None:
        """Go on with some of the problems only."""
        of_blocks = keep.repeat_interleave(self.blocks)
        self.objective = self.objective.select(keep)
        for name in ("x", "g", "d", "scale", "past"):
            setattr(self, name, getattr(self, name)[of_blocks])
        for name in ("blocks", "energy", "sy", "yy", "valid", "free", "slope", "status", "accepted",
                     "evaluations", "t", "descent"):  # fmt: skip
            setattr(self, name, getattr(self, name)[keep])
        self.recent = self.recent[:, keep]

    def close(self, out_of_iterations: bool) -> None:
        """Set the status of every problem that has reached the end of its run."""
        running = self.status == Status.RUNNING
        settled = (self.accepted >= self.options.patience) & (
            self.recent[0] - self.energy <= self.options.energy_tolerance * self.energy.abs()
        )
        tests = [
            (self.slope <= self.options.gradient_tolerance, Status.CONVERGED),
            (settled, Status.SETTLED),
            (self.t < 1e-12, Status.STALLED),
        ]
        for hit, status in tests:
            self.status = torch.where(running & hit, status, self.status)
            running = running & ~hit
        if out_of_iterations:
            self.status = torch.where(running, Status.ITERATION_LIMIT, self.status)

    def step(self, iteration: int) -> None:
        """Try one step of every problem; accept it or shorten it."""
        running = self.status == Status.RUNNING
        move = self._to_blocks(self.t) * self.d
        x = torch.addcmul(self.x, move, self.scale)
        energy, gradient, done = self.objective(x.reshape(-1))
        gradient = gradient.reshape(-1, BLOCK) * self.scale
        change = energy - self.energy
        good = running & energy.isfinite() & (change <= _SUFFICIENT_DECREASE * self.t * self.descent)
        self.evaluations += running
        slot = iteration % self.options.history
        m = self.options.history
        all_good = bool(good.all())
        if not all_good:
            of_blocks = self._to_blocks(good)
            move = torch.where(of_blocks, move, 0.0)
            gradient = torch.where(of_blocks, gradient, self.g)
            x = torch.where(of_blocks, x, self.x)
        self.past[:, slot] = move
        torch.sub(gradient, self.g, out=self.past[:, m + slot])
        self.x, self.g = x, gradient
        along = self._direction(slot, good)
        energy = torch.where(good, energy, self.energy)
        self.recent = torch.where(good, torch.cat([self.recent[1:], self.energy[None]]), self.recent)
        self.accepted += good
        self.status = torch.where(good & done, Status.VALID, self.status)
        # Quadratic interpolation of the shortened step, where the trial had a value.
        fit = -0.5 * self.descent * self.t / (change / self.t - self.descent)
        shorter = torch.where(change.isfinite(), fit.clamp(0.1 * self.t, 0.5 * self.t), 0.3 * self.t)
        self.energy = energy
        self.t = torch.where(good, 1.0, torch.where(running, shorter, self.t))
        if along is not None:
            self._limit(good)

    def _direction(self, slot: int, good: Tensor) -> bool:
        """The new direction d of the problems that moved; the others keep theirs."""
        m = self.options.history
        new = torch.stack([self.past[:, slot], self.past[:, m + slot], self.g], 2)
        dots = self._sum_rows(torch.bmm(self.past, new).reshape(len(self.past), -1)).reshape(-1, 2 * m, 3)
        square = self._sum((self.g * self.g).sum(1))
        self.sy[:, :, slot], self.sy[:, slot, :] = dots[:, :m, 1], dots[:, m:, 0]
        self.yy[:, :, slot] = self.yy[:, slot, :] = dots[:, m:, 1]
        curvature, length = self.sy[:, slot, slot], self.yy[:, slot, slot]
        ok = good & (curvature > _CURVATURE * length) & (length > 0)
        self.valid[:, slot] = ok
        self.slope = torch.where(good, (square / self.free).sqrt(), self.slope)
        order = [(slot + 1 + i) % m for i in range(m)]
        valid = self.valid[:, order]
        mask = (valid[:, :, None] & valid[:, None, :]).to(dots.dtype)
        sy = self.sy[:, order][:, :, order] * mask
        yy = self.yy[:, order][:, :, order] * mask
        # The scale of the newest pair that counts.
        newest = torch.where(valid, torch.arange(m, device=valid.device), -1).amax(1).clamp_min(0)
        pick = newest[:, None]
        y2 = yy.diagonal(dim1=1, dim2=2).gather(1, pick).squeeze(1)
        s_y = sy.diagonal(dim1=1, dim2=2).gather(1, pick).squeeze(1)
        gamma = torch.where(y2 > 0, s_y / torch.where(y2 > 0, y2, 1.0), 1.0)[:, None]
        diagonal = sy.diagonal(dim1=1, dim2=2)
        upper = sy.triu() + torch.diag_embed((~valid).to(sy.dtype))
        weight = valid.to(dots.dtype)
        sg, yg = dots[:, :m, 2][:, order] * weight, dots[:, m:, 2][:, order] * weight
        w = torch.linalg.solve_triangular(upper, sg[:, :, None], upper=True)
        middle = diagonal[:, :, None] * w + gamma[:, :, None] * ((yy @ w) - yg[:, :, None])
        a = torch.linalg.solve_triangular(upper.mT, middle, upper=False).squeeze(2) * weight
        b = -gamma * w.squeeze(2) * weight
        back = [order.index(i) for i in range(m)]
        coefficients = torch.cat([a[:, back], b[:, back]], 1)
        descent = -(gamma[:, 0] * square + (a * sg).sum(1) + (b * yg).sum(1))
        steepest = ~valid.any(1) | ~(descent < 0)
        coefficients = torch.where(steepest[:, None], 0.0, coefficients)
        first = self.options.first_step / self.slope.clamp_min(1e-300)
        gamma = torch.where(steepest, first, gamma[:, 0])
        self.valid &= ~(steepest & good)[:, None]
        descent = torch.where(steepest, -first * square, descent)
        spread = coefficients.repeat_interleave(self.blocks, 0)
        d = torch.bmm(spread[:, None], self.past).squeeze(1)
        d = d.addcmul_(self._to_blocks(gamma), self.g).neg_()
        if bool(good.all()):
            self.d, self.descent = d, descent
        else:
            self.d = torch.where(self._to_blocks(good), d, self.d)
            self.descent = torch.where(good, descent, self.descent)
        return True

    def _steepest(self) -> None:
        gamma = self.options.first_step / self.slope.clamp_min(1e-300)
        self.d = -self._to_blocks(gamma) * self.g
        self.descent = -gamma * self.slope * self.slope * self.free
        self.t = torch.ones_like(self.energy)
        self._limit(torch.ones_like(self.status, dtype=torch.bool))

    def _limit(self, fresh: Tensor) -> None:
        """Shorten the first trial along a fresh direction to the largest step allowed."""
        longest = self.d.abs().amax(1)
        offsets = offsets_from_counts(self.blocks)
        longest = torch.segment_reduce(longest, "max", offsets=offsets, initial=0.0)
        limit = self.options.largest_step / longest.clamp_min(1e-300)
        self.t = torch.where(fresh, torch.minimum(self.t, limit), self.t)

    def _to_blocks(self, per_problem: Tensor) -> Tensor:
        return per_problem.repeat_interleave(self.blocks)[:, None]

    def _sum(self, per_block: Tensor) -> Tensor:
        return torch.segment_reduce(per_block, "sum", offsets=offsets_from_counts(self.blocks), initial=0.0)

    def _sum_rows(self, per_block: Tensor) -> Tensor:
        return torch.segment_reduce(per_block, "sum", offsets=offsets_from_counts(self.blocks), axis=0, initial=0.0)
