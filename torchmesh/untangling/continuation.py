"""The regularised functional with falling epsilon: triangles are kept, vertices move (Garanzha et al. 2021)."""

from dataclasses import replace

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.measure import upright
from ..mesh.ragged import counts_from_offsets, segment_any, segment_count, segment_min, spread
from ..optimising.blocks import BLOCK
from ..optimising.energies import Regularised
from ..optimising.jacobian import Target, select_rows
from ..optimising.lbfgs import minimise
from ..optimising.lbfgs_options import LbfgsResult
from ..optimising.moves import Monitor, MoveInfo
from ..optimising.objective import MeshObjective, Packing
from ..status import Status
from .options import UntangleOptions

# A step of torch's loops on a small mesh takes as long as one on so many triangles more, for what does not depend on
# their number.
_OVERHEAD = 1750

# Epsilon never falls below this number (Garanzha et al. 2021).
_LEAST_EPS = 1e-9


def judged(batch: MeshBatch, moved: MeshBatch, info: MoveInfo) -> tuple[MeshBatch, MoveInfo]:
    """`moved` with the status that its exact signs give it: a mesh is valid as it comes back, or it is not."""
    valid = ~segment_any(~upright(moved), batch.triangle_offsets)
    status = torch.where(valid, Status.VALID, torch.where(info.status == Status.VALID, Status.STALLED, info.status))
    return moved, replace(info, status=status)


def try_regularised(
    batch: MeshBatch,
    packing: Packing,
    target: Target,
    size: Tensor,
    options: UntangleOptions,
    monitor: Monitor | None,
    settle: bool = False,
) -> tuple[MeshBatch, MoveInfo]:
    """Move the vertices of `packing` by the regularised functional.

    target  of the triangles, (T,) in the batch's unit
    size    (V,) of the triangles around each vertex, in the batch's unit
    settle  keep minimising valid meshes at the least epsilon until their energy settles
    """
    # From the batch's unit to the packing's.
    unit = spread(packing.unit, batch.triangle_offsets)
    square = unit * unit
    packed = select_rows(
        Target(target.g11 * square, target.g12 * square, target.g22 * square, target.m * square), packing.triangles
    )
    objective = MeshObjective(
        Regularised(1.0),
        packed,
        packing.rows,
        packing.anchored,
        packing.block_offsets,
        packing.triangle_offsets,
        packing.spread_vertices(size / spread(packing.unit, batch.point_offsets)),
    )
    unknowns = packing.unknowns.clone()
    info = _nothing_done(unknowns, len(batch))
    _lower_epsilon(objective, unknowns, info, options, monitor)
    if settle:
        _settle(objective, unknowns, info, options, monitor)
    return judged(batch, batch.with_points(packing.unpack(unknowns, batch.points)), info)


def _nothing_done(unknowns: Tensor, meshes: int) -> MoveInfo:
    whole = torch.zeros(meshes, dtype=torch.int64, device=unknowns.device)
    return MoveInfo(unknowns.new_zeros(meshes), unknowns.new_zeros(meshes), whole, whole.clone(), whole.clone())


def _lower_epsilon(
    objective: MeshObjective,
    unknowns: Tensor,
    info: MoveInfo,
    options: UntangleOptions,
    monitor: Monitor | None,
) -> None:
    """Minimise with an epsilon for each mesh, lower it, and so on; changes `unknowns` and `info` in place.

    A mesh ends when it is valid, when it stalls, or after `options.max_continuations` values of epsilon.
    """
    meshes, triangles = len(info.status), counts_from_offsets(objective.triangle_offsets)
    compiled = None if monitor is not None else objective.turns(unknowns, options.minimiser())
    turns = compiled or Turns(objective, unknowns, options, monitor)
    eps = unknowns.new_ones(meshes)
    stall = _Stall(meshes, options, eps)
    rows = torch.arange(meshes, device=eps.device)
    lowest = segment_min(objective.det(unknowns), objective.triangle_offsets)
    for turn in range(options.max_continuations):
        info.status[rows[lowest > 0]] = Status.VALID
        rows = rows[info.status[rows] == Status.RUNNING]
        if not len(rows):
            return
        here = eps[rows]
        before, lowest, inverted, (energy, gradient, iterations, evaluations, status) = turns.take(rows, here)
        result = MoveInfo(energy, gradient, iterations, evaluations, status)
        eps[rows] = next_epsilon(here, lowest, before, result.energy)
        _record(info, rows, result)
        # Neither the vertices nor epsilon move any more.
        stuck = (result.iterations == 0) | ((eps[rows] >= 0.999 * here) & (result.status == Status.SETTLED))
        stuck |= stall.reached(turn, rows, here, lowest, inverted)
        info.status[rows[stuck]] = Status.STALLED
        if options.work is not None:
            most = options.work // (triangles[rows] + _OVERHEAD)
            spent = (info.iterations[rows] >= most.clamp_min(options.least_steps)) & (
                info.status[rows] == Status.RUNNING
            )
            info.status[rows[spent & (lowest <= 0)]] = Status.ITERATION_LIMIT
    info.status[rows[lowest > 0]] = Status.VALID
    info.status[info.status == Status.RUNNING] = Status.ITERATION_LIMIT


class Turns:
    """Meshes that are minimised with an epsilon of each, again and again; `kernels.continuation` has its twin.

    unknowns  (N,) of all meshes, which change
    """

    def __init__(
        self, objective: MeshObjective, unknowns: Tensor, options: UntangleOptions, monitor: Monitor | None
    ) -> None:
        self.objective, self.unknowns = objective, unknowns
        self.options, self.monitor = options.minimiser(), monitor
        self.going = torch.arange(len(objective.block_offsets) - 1, device=unknowns.device)
        self.slots = torch.arange(len(unknowns), device=unknowns.device)

    def take(self, rows: Tensor, eps: Tensor) -> tuple[Tensor, Tensor, Tensor, tuple[Tensor, ...]]:
        """Minimise the meshes `rows` (K,) with `eps` (K,); of the other meshes none is taken again.

        Returns (K,) each: their energies before, their lowest determinants and numbers of inverted triangles after, and
        the fields of `MoveInfo`.
        """
        if len(rows) < len(self.going):
            stays = torch.isin(self.going, rows)
            self.slots = self.slots[_in_slots(self.objective, stays)]
            self.going, self.objective = rows, self.objective.select(stays)
        offsets = self.objective.triangle_offsets
        objective = replace(self.objective, energy=Regularised(spread(eps, offsets)))
        before = objective(self.unknowns[self.slots])[0]
        result = minimise(objective, self.unknowns[self.slots], self.options, self.monitor)
        self.unknowns[self.slots] = result.unknowns
        det = objective.det(result.unknowns)
        outcome = result.energy, result.gradient, result.iterations, result.evaluations, result.status
        return before, segment_min(det, offsets), segment_count(det <= 0, offsets), outcome


def _settle(
    objective: MeshObjective, unknowns: Tensor, info: MoveInfo, options: UntangleOptions, monitor: Monitor | None
) -> None:
    """Minimise the valid meshes at the least epsilon until their energy settles; in place as above."""
    valid = info.status == Status.VALID
    if not bool(valid.any()):
        return
    slots = _in_slots(objective, valid)
    objective = replace(objective.select(valid), energy=Regularised(_LEAST_EPS))
    settings = replace(options.minimiser(), energy_tolerance=options.settled_tolerance)
    result = minimise(objective, unknowns[slots], settings, monitor)
    unknowns[slots] = result.unknowns
    _record(info, valid, result)


def _in_slots(objective: MeshObjective, meshes: Tensor) -> Tensor:
    """(N,) bool: the unknowns of the `meshes` (B,) bool."""
    blocks = counts_from_offsets(objective.block_offsets)
    return meshes.repeat_interleave(blocks).repeat_interleave(BLOCK)


def _record(info: MoveInfo, at: Tensor, result: LbfgsResult | MoveInfo) -> None:
    """Write what `minimise` came to for the meshes `at`, rows or mask, into `info`; work adds up."""
    info.energy[at], info.gradient[at] = result.energy, result.gradient
    info.iterations[at] += result.iterations
    info.evaluations[at] += result.evaluations


class _Stall:
    """What each mesh came to at the last values of epsilon: does it still gain?

    lowest, inverted  (patience, B) the lowest determinant and the number of inverted triangles
    """

    def __init__(self, meshes: int, options: UntangleOptions, like: Tensor) -> None:
        self.options = options
        self.lowest = like.new_full((options.stall_patience, meshes), -torch.inf)
        self.inverted = torch.zeros_like(self.lowest)

    def reached(self, turn: int, rows: Tensor, eps: Tensor, lowest: Tensor, inverted: Tensor) -> Tensor:
        """(B',) bool: the meshes `rows` (B',) that are no better than `stall_patience` values of epsilon ago."""
        options = self.options
        slot = turn % options.stall_patience
        before, some = self.lowest[slot, rows], self.inverted[slot, rows]
        self.lowest[slot, rows], self.inverted[slot, rows] = lowest, inverted.to(lowest.dtype)
        no_gain = (lowest < options.stall_ratio * before) & (inverted >= options.stall_ratio * some)
        return no_gain & (lowest < -options.stall_depth * eps)


def next_epsilon(eps: Tensor, lowest: Tensor, before: Tensor, after: Tensor) -> Tensor:
    """(B,) the next epsilon from the smallest determinant and the energies at this one (Garanzha et al. 2021)."""
    sigma = (1 - after / before).clamp_min(0.1)
    root = torch.sqrt(eps * eps + lowest * lowest)
    chi = torch.where(lowest > 0, 0.5 * (lowest + root), 0.5 * eps * eps / (root - lowest))
    mu = (1 - sigma) * chi
    lower = 2 * torch.sqrt((mu * (mu - lowest)).clamp_min(0))
    return torch.where(lowest < mu, lower, 0.0).clamp_min(_LEAST_EPS)
