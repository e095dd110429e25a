"""L-BFGS for many small problems at once, each with its own history, step and stopping test.

The unknowns of all problems stand in one vector, in blocks (see `blocks`).  One pass of the loop tries one step
of every problem; each problem accepts or shortens it for itself:

    start -> State -> ended? -> step -> State -> ended? -> ...

The directions come from the compact representation of the history (see `lbfgs_history`), the step lengths from
backtracking with a sufficient decrease (Nocedal & Wright, Numerical Optimization, 2006, algorithm 3.1).
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from torch import Tensor

from ..mesh.ragged import counts_from_offsets
from ..status import Status
from .blocks import Blocks, block_width
from .lbfgs_history import History
from .lbfgs_options import LbfgsOptions, LbfgsResult


@runtime_checkable
class Compiled(Protocol):
    """An objective for which there may be a compiled minimiser."""

    def minimised(
        self, start: Tensor, options: LbfgsOptions, monitor: Callable[[int, Tensor], None] | None
    ) -> tuple[Tensor, ...] | None:
        """The fields of the result that it comes to from `start` (N,); None where torch is to do its work."""
        ...


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
        """Unknowns (N,) to energy (B,), gradient (N,), and done (B,) bool: the problem may stop; None: none may yet."""
        ...

    def select(self, keep: Tensor) -> "Objective":
        """The problems whose keep (B,) is true."""
        ...


# Finished problems are removed when they hold this part of all blocks: earlier, removing costs more than it saves.
_LEAVING = 1 / 4


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
    if isinstance(objective, Compiled):
        outcome = objective.minimised(start, options, monitor)
        if outcome is not None:
            return LbfgsResult(*outcome)
    problems = len(objective.block_offsets) - 1
    numbers = torch.zeros((2, problems), dtype=torch.float64, device=start.device)
    counts = torch.zeros((3, problems), dtype=torch.int64, device=start.device)
    result = LbfgsResult(start.clone(), *numbers, *counts)
    rows = torch.arange(problems, device=start.device)
    block_rows = torch.arange(len(start), device=start.device)
    block_rows = block_rows.reshape(-1, block_width(len(start), objective.block_offsets))
    state = _start(objective, start, options)
    iteration = 0
    while True:
        state, ended = _terminate(state, options, iteration >= options.max_iterations)
        if ended is not None:
            everyone = bool(ended.all())
            if everyone or int((state.blocks.counts * ended).sum()) > _LEAVING * len(state.per_block.x):
                gone = ended.repeat_interleave(state.blocks.counts)
                _write(result, rows[ended], block_rows[gone], state, ended, gone)
                if everyone:
                    return result
                rows, block_rows, state = rows[~ended], block_rows[~gone], state.select(~ended)
        state = _step(state, options, iteration)
        iteration += 1
        if monitor is not None:
            monitor(iteration, state.per_problem.energy / state.per_problem.unit)


def _write(result: LbfgsResult, rows: Tensor, block_rows: Tensor, state: "State", ended: Tensor, gone: Tensor) -> None:
    """Write the problems `ended` (B,) bool, with their blocks `gone` (K,) bool, to those rows of `result`."""
    each = state.per_problem
    result.energy[rows] = (each.energy / each.unit)[ended]
    result.gradient[rows] = (state.history.slope / each.unit)[ended]
    result.iterations[rows] = each.accepted[ended]
    result.evaluations[rows] = each.evaluations[ended]
    result.status[rows] = each.status[ended]
    result.unknowns[block_rows] = state.per_block.x[gone]


# --- the state and its way: start, terminate, step ---


class PerBlock(NamedTuple):
    """(K, W) in the precision of the start; scale and metric stay, the others change with every step.

    x, direction   unknowns, and direction in units of `scale`
    scale, metric  the objective's scale, and its product with `unit`: the factor of gradients
    """

    x: Tensor
    direction: Tensor
    scale: Tensor
    metric: Tensor


class PerProblem(NamedTuple):
    """(B,) in double precision or int64.

    energy       and descent, its slope along the direction, in units of 1 / unit
    length       of the step to try next, in units of the direction
    recent       (B, patience) energies before the last accepted steps, the oldest first
    status, accepted, evaluations  as in `LbfgsResult`
    unit         a power of two, so that no product of gradients leaves the range of single precision
    small        a problem has converged where g'g is no larger
    """

    energy: Tensor
    descent: Tensor
    length: Tensor
    recent: Tensor
    status: Tensor
    accepted: Tensor
    evaluations: Tensor
    unit: Tensor
    small: Tensor


class State(NamedTuple):
    """The problems that are still in the loop.  A step makes another one, and writes only in the history."""

    objective: Objective
    blocks: Blocks
    per_block: PerBlock
    per_problem: PerProblem
    history: History

    def select(self, keep: Tensor) -> "State":
        """Only the problems `keep` (B,) bool."""
        rows = self.blocks.spread(keep).squeeze(1)
        blocks = Blocks.of(self.blocks.counts[keep])
        return State(
            self.objective.select(keep),
            blocks,
            PerBlock(*(v[rows] for v in self.per_block)),
            PerProblem(*(v[keep] for v in self.per_problem)),
            self.history.select(keep, rows, blocks),
        )


def _start(objective: Objective, start: Tensor, options: LbfgsOptions) -> State:
    """The state at `start` (N,), with the direction of steepest descent."""
    blocks = Blocks.of(counts_from_offsets(objective.block_offsets))
    scale = objective.scale.reshape(-1, block_width(len(start), objective.block_offsets))
    wide = scale.to(torch.float64)
    energy, gradient, done = objective(start)
    finite = energy.isfinite()
    free = blocks.sum((wide > 0).to(wide).sum(1)).clamp_min(1)
    g = torch.where(blocks.spread(finite), gradient.reshape(scale.shape) * wide, 0.0)
    unit = _unit((blocks.sum((g * g).sum(1)) / free).sqrt())
    energy = energy.to(torch.float64) * unit
    status = torch.where(finite, Status.RUNNING, Status.NOT_FINITE)
    if done is not None:
        status = status.masked_fill(finite & done, Status.VALID)
    gradient = (g * blocks.spread(unit)).to(start)
    history = History.start(blocks, free, gradient, options.history, options.first_step)
    direction, descent = history.direction()
    return State(
        objective,
        blocks,
        PerBlock(start.reshape(scale.shape).clone(), direction, scale, (wide * blocks.spread(unit)).to(start)),
        PerProblem(
            energy=energy,
            descent=descent,
            length=_whole_step(direction, blocks, options),
            recent=energy.repeat(options.patience, 1).T,
            status=status,
            accepted=torch.zeros_like(status),
            evaluations=torch.ones_like(status),
            unit=unit,
            small=(options.gradient_tolerance * unit).square() * free,
        ),
        history,
    )


def _terminate(state: State, options: LbfgsOptions, out_of_iterations: bool) -> tuple[State, Tensor | None]:
    """The state with the status of problems that end here, and (B,) bool which have ended; None: none has."""
    each = state.per_problem
    settled = (each.accepted >= options.patience) & (
        each.recent[:, 0] - each.energy <= options.energy_tolerance * each.energy.abs()
    )
    small = state.history.square <= each.small
    stuck = each.length < options.shortest_step
    ended = settled | small | stuck | (each.status != Status.RUNNING)
    if not out_of_iterations and not bool(ended.any()):
        return state, None
    why = torch.full_like(each.status, Status.ITERATION_LIMIT if out_of_iterations else Status.RUNNING)
    for hit, ending in ((stuck, Status.STALLED), (settled, Status.SETTLED), (small, Status.CONVERGED)):
        why = torch.where(hit, ending, why)
    status = torch.where(each.status == Status.RUNNING, why, each.status)
    return state._replace(per_problem=each._replace(status=status)), status != Status.RUNNING


def _step(state: State, options: LbfgsOptions, iteration: int) -> State:
    """Try one step of every problem; accept it or shorten it."""
    slot = iteration % options.history
    trial = _try(state, slot)
    running = state.per_problem.status == Status.RUNNING
    possible = running & (trial.change > -torch.inf)
    good = possible & (trial.change <= options.sufficient_decrease * trial.slope)
    # On another device it takes longer to hear of this than to do without.
    if good.device.type == "cpu" and bool(good.all()):
        state = _all_accept(state, options, slot, trial, good)
    else:
        good |= possible & _flatter(state, trial)
        state = _some_accept(state, options, slot, trial, good, running)
    each = state.per_problem
    status = each.status if trial.done is None else each.status.masked_fill(good & trial.done, Status.VALID)
    each = each._replace(status=status, accepted=each.accepted + good, evaluations=each.evaluations + running)
    return state._replace(per_problem=each)


class _Trial(NamedTuple):
    """What a step of every problem leads to.

    x         (K, W) the unknowns there
    gradient  (K, W) in the metric, and (B,) the energy, both in units of 1 / unit;  done (B,) of the objective
    change    (B,) of the energy;  slope (B,) what the slope at the old point promises
    """

    x: Tensor
    energy: Tensor
    gradient: Tensor
    done: Tensor | None
    change: Tensor
    slope: Tensor


def _try(state: State, slot: int) -> _Trial:
    """Take the step in every problem, and write it to its slot of the history."""
    objective, blocks, at, each, history = state
    move = history.step(slot)
    torch.mul(at.direction, blocks.spread(each.length).to(at.direction), out=move)
    x = torch.addcmul(at.x, move, at.scale)
    energy, gradient, done = objective(x.reshape(-1))
    energy = energy * each.unit
    gradient = gradient.reshape(x.shape) * at.metric
    return _Trial(x, energy, gradient, done, energy - each.energy, each.length * each.descent)


# The part of an energy that is lost to rounding in sums of some thousand terms.
_ROUNDING = 1e-15


def _flatter(state: State, trial: _Trial) -> Tensor:
    """(B,) bool: the energy is the same up to rounding, and the gradient smaller.

    So near to the minimum that rounding hides the descent, a smaller gradient shows it.
    """
    same = trial.change <= _ROUNDING * state.per_problem.energy.abs()
    square = state.blocks.sum((trial.gradient * trial.gradient).sum(1).to(trial.energy))
    return same & (square < state.history.square)


def _all_accept(state: State, options: LbfgsOptions, slot: int, trial: _Trial, good: Tensor) -> State:
    """Every problem goes to its trial point, `good` (B,) being true of all."""
    at, each = state.per_block, state.per_problem
    direction, descent = _advance(state.history, options, slot, trial, good)
    return state._replace(
        per_block=PerBlock(trial.x, direction, at.scale, at.metric),
        per_problem=each._replace(
            energy=trial.energy,
            descent=descent,
            length=_whole_step(direction, state.blocks, options),
            recent=torch.cat([each.recent[:, 1:], each.energy[:, None]], 1),
        ),
    )


def _some_accept(state: State, options: LbfgsOptions, slot: int, trial: _Trial, good: Tensor, running: Tensor) -> State:
    """The problems `good` (B,) bool go to their trial points; of the others those `running` shorten their step.

    A problem whose step was refused stays where it is, with its direction, and its history has a zero in this slot.
    """
    _, blocks, at, each, history = state
    stay = blocks.spread(~good)
    trial = trial._replace(
        x=torch.where(stay, at.x, trial.x), gradient=torch.where(stay, history.gradient, trial.gradient)
    )
    history.step(slot).masked_fill_(stay, 0.0)
    direction, descent = _advance(history, options, slot, trial, good)
    direction = torch.where(stay, at.direction, direction)
    length = torch.where(running, _shortened(each, trial.change, options), each.length)
    return state._replace(
        per_block=PerBlock(trial.x, direction, at.scale, at.metric),
        per_problem=each._replace(
            energy=torch.where(good, trial.energy, each.energy),
            descent=torch.where(good, descent, each.descent),
            length=torch.where(good, _whole_step(direction, blocks, options), length),
            recent=torch.where(good[:, None], torch.cat([each.recent[:, 1:], each.energy[:, None]], 1), each.recent),
        ),
    )


def _advance(history: History, options: LbfgsOptions, slot: int, trial: _Trial, good: Tensor) -> tuple[Tensor, Tensor]:
    """Take the trial's gradient and its pair into the history; the direction (K, W) from there, the slope along it."""
    history.take(slot, trial.gradient, trial.slope, good, options.least_curvature)
    direction, descent = history.direction()
    downhill = descent < 0
    if not bool(downhill.all()) and bool((good & ~downhill).any()):
        history.forget(good & ~downhill)
        direction, descent = history.direction()
    return direction, descent


def _shortened(each: PerProblem, change: Tensor, options: LbfgsOptions) -> Tensor:
    """(B,) the next length after a refused step that changed the energy by `change`: a parabola's minimum, bounded."""
    least, most = options.shortening
    fit = -0.5 * each.descent * each.length / (change / each.length - each.descent)
    within = fit.clamp(least * each.length, most * each.length)
    return torch.where(change.isfinite(), within, options.blind_shortening * each.length)


def _whole_step(direction: Tensor, blocks: Blocks, options: LbfgsOptions) -> Tensor:
    """(B,) the length of a step along the direction (K, W): 1, or less to keep to `largest_step`."""
    longest = blocks.largest(direction.abs().amax(1)).to(torch.float64)
    return options.largest_step / longest.clamp_min(options.largest_step)


def _unit(slope: Tensor) -> Tensor:
    """(B,) the power of two by which the root mean square of a gradient becomes about 2^30, if it can.

    So the products of gradients up to 2^30 times as large are finite, and down to 2^-90 of it not zero.
    """
    exponent = (30 - torch.frexp(slope).exponent).clamp(-90, 90)
    return torch.where(slope > 0, torch.ldexp(torch.ones_like(slope), exponent), 1.0)
