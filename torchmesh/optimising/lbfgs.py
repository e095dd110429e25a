"""L-BFGS for many small problems at once, each with its own history, step and stopping test.

The unknowns of all problems stand in one vector; each problem owns a whole number of blocks, of
BLOCK numbers or another width (padded with zeros whose gradient is zero), so that the products with
the history are batched matrix products.  The recursion is the compact representation of Byrd, Nocedal &
Schnabel (Mathematical Programming 63, 1994): the history is read twice an iteration, and all that
is small happens in (problems, m, m) tensors, as in the vector-free form of Chen, Wang & Zhou 2014.
One pass of the loop tries one step of every problem; problems accept or shorten it each for itself.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from ..mesh.ragged import counts_from_offsets, offsets_from_counts
from ..status import Status

BLOCK = 128


def block_width(numbers: int, block_offsets: Tensor) -> int:
    """The numbers in each block, where blocks (B+1,) are filled with so many in all."""
    return numbers // max(1, int(block_offsets[-1])) or BLOCK


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

    def __call__(self, unknowns: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
        """(N,) to energy (B,), gradient (N,), done (B,) bool: the problem needs no further step; None: all do."""
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


# The part of an energy that sums of some thousand terms round off.
_ROUNDING = 1e-15


# Below this part of the slope along a step, the change of slope may be rounding.
_CURVATURE = 1e-6


def minimise(
    objective: Objective,
    start: Tensor,
    options: LbfgsOptions | None = None,
    monitor: Callable[[int, Tensor], None] | None = None,
) -> LbfgsResult:
    """Minimise every problem of `objective` from `start` (N,), float32 or float64.

    monitor is called with the iteration and the energies (B',) of the problems still running.
    """
    options = options or LbfgsOptions()
    problems = len(objective.block_offsets) - 1
    rows = torch.arange(problems, device=start.device)
    final = start.clone()
    width = block_width(len(start), objective.block_offsets)
    final_rows = torch.arange(len(start), device=start.device).reshape(-1, width)
    report = {
        name: torch.zeros(problems, dtype=dtype, device=start.device)
        for name, dtype in [("energy", torch.float64), ("gradient", torch.float64), ("iterations", torch.int64),
                            ("evaluations", torch.int64), ("status", torch.int64)]
    }  # fmt: skip
    run = _Run(objective, start, options)
    iteration = 0
    while True:
        finished = run.close(iteration >= options.max_iterations)
        many = 0 if finished is None else int((run.blocks * finished).sum())
        # Finished problems leave together, when carrying them costs more than moving the rest.
        if finished is not None and ((everyone := bool(finished.all())) or 4 * many > len(run.x)):
            leaving = rows[finished]
            report["energy"][leaving] = (run.energy / run.unit)[finished]
            report["gradient"][leaving] = (run.slope / run.unit)[finished]
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
            monitor(iteration, run.energy / run.unit)
    return LbfgsResult(final, **report)


class _Run:
    """The state of the problems that are still in the loop: (K, W) vectors and (B,) numbers.

    Vectors are in the precision of the start, numbers in double precision; so that no product of single
    precision leaves its range, each problem's energy is counted in a unit of its own.

    x, d, t      unknowns, direction in units of `scale`, step
    past         (K, 2m+1, W) the last m steps s, their m gradient changes y, the gradient g
    energy       and descent, its slope along d, in units of 1 / unit
    against      (B, 2m+1) the products of `past` with g: S'g and Y'g by slots, in which pairs replace one another, g'g
    sy           (B, m) s_i'y_i
    inverse      (B, m, m) of the triangle of s_i'y_j, i no newer than j, which has `sy` on its diagonal; without the
                 row and column of the oldest pair it is that of the others
    yy           (B, m, m) y_i'y_j
    gamma        (B,) s'y / y'y of the newest pair that counts: the scale of the first Hessian

    A pair that does not count, because the step was refused or has no positive curvature, is zero, with a one in `sy`.
    """

    def __init__(self, objective: Objective, start: Tensor, options: LbfgsOptions) -> None:
        self.objective, self.options = objective, options
        m = options.history
        width = block_width(len(start), objective.block_offsets)
        self.scale = objective.scale.reshape(-1, width)
        self.x = start.reshape(-1, width).clone()
        energy, gradient, done = objective(start)
        finite = energy.isfinite()
        wide = self.scale.to(torch.float64)
        self._index(counts_from_offsets(objective.block_offsets))
        self.free = self._sum((wide > 0).to(wide).sum(1)).clamp_min(1)
        g = torch.where(self._to_blocks(finite), gradient.reshape(-1, width) * wide, 0.0)
        self.unit = _unit((self._sum((g * g).sum(1)) / self.free).sqrt())
        self.tiny = (options.gradient_tolerance * self.unit).square() * self.free
        self.metric = (wide * self._to_blocks(self.unit)).to(start)
        self.energy = energy.to(torch.float64) * self.unit
        self.past = start.new_zeros((len(self.x), 2 * m + 1, width))
        self.past[:, 2 * m] = g * self._to_blocks(self.unit)
        self.against = self._products()
        self.sy = torch.ones_like(self.against[:, :m])
        self.inverse = torch.diag_embed(self.sy)
        self.yy = torch.zeros_like(self.inverse)
        self.status = torch.where(finite, Status.RUNNING, Status.NOT_FINITE)
        if done is not None:
            self.status = self.status.masked_fill(finite & done, Status.VALID)
        self.accepted = torch.zeros_like(self.status)
        self.evaluations = torch.ones_like(self.status)
        self.recent = self.energy.repeat(options.patience, 1)
        self.gamma = self._first_step()
        self.d, self.descent = self._direction(torch.zeros_like(self.against[:, : 2 * m]))
        self.t = self._whole_step()

    @property
    def slope(self) -> Tensor:
        """(B,) root mean square of the scaled gradient, in units of 1 / unit."""
        return (self.gg / self.free).sqrt()

    @property
    def gg(self) -> Tensor:
        """(B,) g'g."""
        return self.against[:, -1]

    def select(self, keep: Tensor) -> None:
        """Go on with some of the problems only."""
        of_blocks = self._to_blocks(keep).squeeze(1)
        self.objective = self.objective.select(keep)
        for name in ("x", "d", "scale", "metric", "past"):
            setattr(self, name, getattr(self, name)[of_blocks])
        for name in ("energy", "unit", "sy", "inverse", "yy", "against", "gamma", "free", "tiny", "status",
                     "accepted", "evaluations", "t", "descent"):  # fmt: skip
            setattr(self, name, getattr(self, name)[keep])
        self.recent = self.recent[:, keep]
        self._index(self.blocks[keep])

    def close(self, out_of_iterations: bool) -> Tensor | None:
        """(B,) bool: the problems at the end of their run, whose status is set; None: there are none."""
        settled = (self.accepted >= self.options.patience) & (
            self.recent[0] - self.energy <= self.options.energy_tolerance * self.energy.abs()
        )
        small = self.gg <= self.tiny
        stuck = self.t < 1e-12
        ended = settled | small | stuck | (self.status != Status.RUNNING)
        if not out_of_iterations and not bool(ended.any()):
            return None
        status = torch.full_like(self.status, Status.ITERATION_LIMIT if out_of_iterations else Status.RUNNING)
        for hit, ending in ((stuck, Status.STALLED), (settled, Status.SETTLED), (small, Status.CONVERGED)):
            status = torch.where(hit, ending, status)
        self.status = torch.where(self.status == Status.RUNNING, status, self.status)
        return self.status != Status.RUNNING

    def step(self, iteration: int) -> None:
        """Try one step of every problem; accept it or shorten it."""
        running = self.status == Status.RUNNING
        m = self.options.history
        slot = iteration % m
        move = self.past[:, slot]
        torch.mul(self.d, self._to_blocks(self.t).to(self.d), out=move)
        x = torch.addcmul(self.x, move, self.scale)
        energy, gradient, done = self.objective(x.reshape(-1))
        energy = energy * self.unit
        gradient = gradient.reshape(self.x.shape) * self.metric
        change = energy - self.energy
        slope = self.t * self.descent
        possible = running & (change > -torch.inf)
        good = possible & (change <= _SUFFICIENT_DECREASE * slope)
        everyone = bool(good.all())
        if not everyone:
            # So near the minimum that rounding hides the descent, a smaller gradient tells of it.
            flatter = self._sum((gradient * gradient).sum(1).to(energy)) < self.gg
            good |= possible & (change <= _ROUNDING * self.energy.abs()) & flatter
        if everyone:
            self.x = x
            self._advance(slot, gradient, slope, good)
            self.t = self._whole_step()
            self.recent = torch.cat([self.recent[1:], self.energy[None]])
            self.energy = energy
        else:
            # A problem whose step was refused stays where it is; its pair of this slot is void.
            stay = (~good).index_select(0, self.owner).nonzero().squeeze(1)
            direction, descent = self.d[stay], self.descent
            x[stay], gradient[stay] = self.x[stay], self.past[stay, 2 * m]
            move.index_fill_(0, stay, 0.0)
            self.x = x
            self._advance(slot, gradient, slope, good)
            self.d[stay] = direction
            self.descent = torch.where(good, self.descent, descent)
            # The minimum of the parabola through the refused step, within bounds.
            fit = -0.5 * self.descent * self.t / (change / self.t - self.descent)
            shorter = torch.where(change.isfinite(), fit.clamp(0.1 * self.t, 0.5 * self.t), 0.3 * self.t)
            self.t = torch.where(good, self._whole_step(), torch.where(running, shorter, self.t))
            self.recent = torch.where(good, torch.cat([self.recent[1:], self.energy[None]]), self.recent)
            self.energy = torch.where(good, energy, self.energy)
        self.accepted += good
        self.evaluations += running
        if done is not None:
            self.status = self.status.masked_fill(good & done, Status.VALID)

    def _advance(self, slot: int, gradient: Tensor, slope: Tensor, good: Tensor) -> None:
        """Take the gradient at the new point, with its pair in `slot`, and find the direction from there.

        The products with g are read off the history once; the products with the new pair follow from
        them and from those at the old point, since y = g_new - g_old; slope (B,) is s'g_old.
        """
        m = self.options.history
        torch.sub(gradient, self.past[:, 2 * m], out=self.past[:, m + slot])
        self.past[:, 2 * m] = gradient
        before, self.against = self.against, self._products()
        change = self.against - before
        # As |g|^2 - |g - y|^2 is 2 y'g - y'y.
        sy, yy = self.against[:, slot] - slope, 2 * self.against[:, m + slot] - change[:, -1]
        curved = good & (sy > -_CURVATURE * slope) & (yy > 0)
        if bool(curved.all()):
            self.gamma = sy / yy
        else:
            sy, yy = torch.where(curved, sy, 1.0), torch.where(curved, yy, 0.0)
            self._drop(curved, [slot, m + slot])
            change = torch.where(curved[:, None], change, 0.0)
            self.yy[:, slot, slot] = 0.0
            old = (self.yy.diagonal(dim1=1, dim2=2) > 0).any(1)
            self.gamma = torch.where(curved, sy / yy, torch.where(old, self.gamma, self._first_step()))
        self._pair(slot, change[:, : 2 * m].view(-1, 2, m), sy, yy)
        self.d, self.descent = self._direction(self._recursion())
        downhill = self.descent < 0
        if not bool(downhill.all()) and bool((good & ~downhill).any()):
            self._forget(good & ~downhill)
            self.d, self.descent = self._direction(self._recursion())

    def _pair(self, slot: int, new: Tensor, sy: Tensor, yy: Tensor) -> None:
        """The oldest pair goes, the newest comes in its `slot`.

        new  (B, 2, m) the products of its y with all s and y;  sy, yy (B,) with its own
        """
        new[:, 0, slot], new[:, 1, slot] = 0.0, yy
        self.inverse[:, slot] = 0.0
        self.inverse[:, :, slot] = _batched(new[:, :1], self.inverse.mT).squeeze(1) / -sy[:, None]
        self.inverse[:, slot, slot] = sy.reciprocal()
        self.yy[:, slot] = self.yy[:, :, slot] = new[:, 1]
        self.sy[:, slot] = sy

    def _drop(self, keep: Tensor, slots: list[int]) -> None:
        """Make the vectors in `slots` zero where `keep` (B,) is false."""
        gone = (~keep).index_select(0, self.owner).nonzero().squeeze(1)
        for i in slots:
            self.past[:, i].index_fill_(0, gone, 0.0)
            self.against[:, i].masked_fill_(~keep, 0.0)

    def _forget(self, lost: Tensor) -> None:
        """Drop the pairs of the problems `lost` (B,) bool."""
        self._drop(~lost, list(range(2 * self.options.history)))
        self.gamma = torch.where(lost, self._first_step(), self.gamma)
        self.sy = torch.where(lost[:, None], 1.0, self.sy)
        self.inverse = torch.where(lost[:, None, None], torch.diag_embed(torch.ones_like(self.sy)), self.inverse)
        self.yy = torch.where(lost[:, None, None], 0.0, self.yy)

    def _recursion(self) -> Tensor:
        """(B, 2m) the weights of H g = gamma g + S a + Y b; Byrd, Nocedal & Schnabel 1994, equation 3.1."""
        m = self.options.history
        sg, yg = self.against[:, None, :m], self.against[:, None, m : 2 * m]
        gamma = self.gamma[:, None, None]
        w = _batched(sg, self.inverse.mT)
        a = _batched(self.sy[:, None] * w + gamma * (_batched(w, self.yy) - yg), self.inverse)
        return torch.cat([a, -gamma * w], 2).squeeze(1)

    def _direction(self, weights: Tensor) -> tuple[Tensor, Tensor]:
        """(K, BLOCK) minus H g, of the `weights` (B, 2m) of the pairs; and (B,) the slope along it."""
        weights = -torch.cat([weights, self.gamma[:, None]], 1)
        row = weights.to(self.past).index_select(0, self.owner)
        return _batched(row[:, None], self.past).squeeze(1), (weights * self.against).sum(1)

    def _products(self) -> Tensor:
        """(B, 2m+1) of all that is in `past` with g."""
        return self._sum(_batched(self.past[:, -1:], self.past.mT).squeeze(1).to(self.unit))

    def _first_step(self) -> Tensor:
        """(B,) factor of the gradient for a step without history."""
        return self.options.first_step / self.slope.clamp_min(1e-300)

    def _whole_step(self) -> Tensor:
        """(B,) one, shortened so that no unknown moves further along d than allowed."""
        longest = torch.segment_reduce(self.d.abs().amax(1), "max", offsets=self.offsets, initial=0.0)
        largest = self.options.largest_step
        return largest / longest.to(self.unit).clamp_min(largest)

    def _index(self, blocks: Tensor) -> None:
        self.blocks = blocks
        self.offsets = offsets_from_counts(blocks)
        self.owner = torch.arange(len(blocks), device=blocks.device).repeat_interleave(blocks)

    def _to_blocks(self, per_problem: Tensor) -> Tensor:
        return per_problem.index_select(0, self.owner)[:, None]

    def _sum(self, per_block: Tensor) -> Tensor:
        return torch.segment_reduce(per_block, "sum", offsets=self.offsets, axis=0, initial=0.0)


def _unit(slope: Tensor) -> Tensor:
    """(B,) the power of two that makes a gradient's root mean square one of the upper numbers of single precision.

    So the products of gradients up to 2^30 times as large are finite, and down to 2^-90 of it not zero.
    """
    exponent = (30 - torch.frexp(slope).exponent).clamp(-90, 90)
    return torch.where(slope > 0, torch.ldexp(torch.ones_like(slope), exponent), 1.0)


def _batched(left: Tensor, right: Tensor) -> Tensor:
    """`torch.bmm` with the same bits for a matrix alone as among others: a batch of one goes another way in torch.

    A row times matrices, never matrices times a column: that way is four times slower.
    """
    if len(left) != 1:
        return torch.bmm(left, right)
    return torch.bmm(left.expand(2, -1, -1), right.expand(2, -1, -1))[:1]
