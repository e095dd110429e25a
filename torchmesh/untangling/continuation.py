"""The regularised functional with falling epsilon: triangles kept, vertices moved."""

from dataclasses import replace

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.measure import upright
from ..mesh.ragged import counts_from_offsets, segment_any, segment_count, segment_min, spread
from ..optimising.blocks import BLOCK
from ..optimising.energies import Regularised
from ..optimising.jacobian import Target, select_rows
from ..optimising.lbfgs import LbfgsOptions, minimise
from ..optimising.moves import Monitor, MoveInfo
from ..optimising.objective import MeshObjective, Packing
from ..status import Status
from .options import UntangleOptions

# Where epsilon ends (Garanzha et al. 2021).
_LEAST_EPS = 1e-9


# No hope: over so many values of epsilon neither the lowest determinant nor the number of inverted triangles
# fell by a tenth, and that determinant is so many epsilons below zero.  Of 129 tries on random domains (holes,
# onto, letter, airfoil, jitter, spiral; up to 400 values of epsilon) none that ended valid was ever there, though
# some need 120 values; of those that did not, nine in ten were, after 50 values on average.
_PATIENCE, _NO_GAIN, _FAR_BELOW = 10, 0.9, 8.0


def _judged(batch: MeshBatch, moved: MeshBatch, info: MoveInfo) -> tuple[MeshBatch, MoveInfo]:
    """The status by exact signs of the mesh as it comes back."""
    valid = ~segment_any(~upright(moved), batch.triangle_offsets)
    status = torch.where(valid, Status.VALID, torch.where(info.status == Status.VALID, Status.STALLED, info.status))
    return moved, replace(info, status=status)


def _try_regularised(
    batch: MeshBatch,
    packing: Packing,
    target: Target,
    size: Tensor,
    options: UntangleOptions,
    monitor: Monitor | None,
    settle: bool = False,
) -> tuple[MeshBatch, MoveInfo]:
    # From the batch's unit to the packing's.
    unit = spread(packing.unit, batch.triangle_offsets)
    square = unit * unit
    packed = select_rows(
        Target(target.g11 * square, target.g12 * square, target.g22 * square, target.m * square), packing.triangles
    )
    size = size / spread(packing.unit, batch.point_offsets)
    unknowns, info = _regularised(packing, packed, size, options, monitor, settle)
    return _judged(batch, batch.with_points(packing.unpack(unknowns, batch.points)), info)


def _regularised(
    packing: Packing,
    target: Target,
    size: Tensor,
    options: UntangleOptions,
    monitor: Monitor | None,
    settle: bool,
) -> tuple[Tensor, MoveInfo]:
    """Continuation in epsilon (Garanzha et al. 2021), each mesh with its own; `target` and `size` in packed units.

    settle  go on with the valid meshes at the least epsilon until their energy settles
    """
    whole_batch = objective = MeshObjective(
        Regularised(1.0),
        target,
        packing.rows,
        packing.anchored,
        packing.block_offsets,
        packing.triangle_offsets,
        packing.spread_vertices(size),
    )
    settings = LbfgsOptions(
        max_iterations=options.max_iterations, gradient_tolerance=1e-6, energy_tolerance=1e-3, first_step=0.1
    )
    unknowns = packing.unknowns.clone()
    meshes = len(packing.unit)
    whole = torch.zeros(meshes, dtype=torch.int64, device=unknowns.device)
    info = MoveInfo(unknowns.new_zeros(meshes), unknowns.new_zeros(meshes), whole, whole.clone(), whole.clone())
    eps = unknowns.new_ones(meshes)
    hope = _Hope(eps)
    rows, place = torch.arange(meshes, device=eps.device), torch.arange(len(unknowns), device=eps.device)
    lowest = segment_min(objective.det(unknowns), objective.triangle_offsets)
    for turn in range(options.max_continuations):
        info.status[rows[lowest > 0]] = Status.VALID
        going = info.status[rows] == Status.RUNNING
        if not bool(going.any()):
            break
        if not bool(going.all()):
            blocks = counts_from_offsets(objective.block_offsets)
            place = place[going.repeat_interleave(blocks).repeat_interleave(BLOCK)]
            rows, objective = rows[going], objective.select(going)
        here = eps[rows]
        objective = replace(objective, energy=Regularised(spread(here, objective.triangle_offsets)))
        before = objective(unknowns[place])[0]
        result = minimise(objective, unknowns[place], settings, monitor)
        unknowns[place] = result.unknowns
        det = objective.det(result.unknowns)
        lowest = segment_min(det, objective.triangle_offsets)
        eps[rows] = _next_eps(here, lowest, before, result.energy)
        info.energy[rows], info.gradient[rows] = result.energy, result.gradient
        info.iterations[rows] += result.iterations
        info.evaluations[rows] += result.evaluations
        # Neither the vertices nor epsilon move any more.
        stuck = (result.iterations == 0) | ((eps[rows] >= 0.999 * here) & (result.status == Status.SETTLED))
        stuck |= hope.lost(turn, rows, here, lowest, segment_count(det <= 0, objective.triangle_offsets))
        info.status[rows[stuck]] = Status.STALLED
    info.status[rows[lowest > 0]] = Status.VALID
    info.status[info.status == Status.RUNNING] = Status.ITERATION_LIMIT
    valid = info.status == Status.VALID
    if settle and bool(valid.any()):
        blocks = counts_from_offsets(whole_batch.block_offsets)
        place = valid.repeat_interleave(blocks).repeat_interleave(BLOCK)
        objective = replace(whole_batch.select(valid), energy=Regularised(_LEAST_EPS))
        settings = replace(settings, energy_tolerance=1e-5)
        result = minimise(objective, unknowns[place], settings, monitor)
        unknowns[place] = result.unknowns
        info.energy[valid], info.gradient[valid] = result.energy, result.gradient
        info.iterations[valid] += result.iterations
        info.evaluations[valid] += result.evaluations
    return unknowns, info


class _Hope:
    """What each mesh came to at the last values of epsilon: is there any gain left?

    lowest, inverted  (_PATIENCE, B) the lowest determinant and the number of inverted triangles
    """

    def __init__(self, eps: Tensor) -> None:
        self.lowest = eps.new_full((_PATIENCE, len(eps)), -torch.inf)
        self.inverted = torch.zeros_like(self.lowest)

    def lost(self, turn: int, rows: Tensor, eps: Tensor, lowest: Tensor, inverted: Tensor) -> Tensor:
        """(B',) bool: the meshes `rows` (B',) that are no better than `_PATIENCE` values of epsilon ago."""
        slot = turn % _PATIENCE
        before, some = self.lowest[slot, rows], self.inverted[slot, rows]
        self.lowest[slot, rows], self.inverted[slot, rows] = lowest, inverted.to(lowest.dtype)
        return (lowest < _NO_GAIN * before) & (inverted >= _NO_GAIN * some) & (lowest < -_FAR_BELOW * eps)


def _next_eps(eps: Tensor, lowest: Tensor, before: Tensor, after: Tensor) -> Tensor:
    """(B,) the next epsilon from the smallest determinant and the energies at this one (Garanzha et al. 2021)."""
    sigma = (1 - after / before).clamp_min(0.1)
    root = torch.sqrt(eps * eps + lowest * lowest)
    chi = torch.where(lowest > 0, 0.5 * (lowest + root), 0.5 * eps * eps / (root - lowest))
    mu = (1 - sigma) * chi
    lower = 2 * torch.sqrt((mu * (mu - lowest)).clamp_min(0))
    return torch.where(lowest < mu, lower, 0.0).clamp_min(_LEAST_EPS)
