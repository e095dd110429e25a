"""Step 2: move the free vertices until no triangle is inverted; triangles stay as they are."""

from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

from .energies import Regularised, Target, UntangleBeta, equilateral, select_rows, target_of
from .errors import InvalidMeshError
from .lbfgs import BLOCK, LbfgsOptions, minimise
from .mesh import Means, MeshBatch, put, surroundings, triangle_mesh
from .packing import MeshObjective, Packing, pack
from .quality import upright
from .segments import counts_from_offsets, segment_any, segment_count, segment_min, segment_sum, spread
from .smoothing import Monitor, MoveInfo, vertex_size
from .status import Status
from .triangle import SQRT3, Corners, corners, signed_area

# Where epsilon ends (Garanzha et al. 2021).
_LEAST_EPS = 1e-9

# No hope: over so many values of epsilon neither the lowest determinant nor the number of inverted triangles
# fell by a tenth, and that determinant is so many epsilons below zero.  Of 129 tries on random domains (holes,
# onto, letter, airfoil, jitter, spiral; up to 400 values of epsilon) none that ended valid was ever there, though
# some need 120 values; of those that did not, nine in ten were, after 50 values on average.
_PATIENCE, _NO_GAIN, _FAR_BELOW = 10, 0.9, 8.0


@dataclass(frozen=True)
class UntangleOptions:
    """How `untangle` works.

    method             "regularised": the foldover-free functional with a local size for each triangle's
                       target (Garanzha et al. 2021); "beta": Knupp's untangle-beta (Kim 2017, equation 2)
    beta               beta of "beta": the area below which a triangle is pushed, as a part of the
                       mesh's mean absolute area
    local              beta is a part of no more than twice the usual area nearby, for graded meshes
    absolute_beta      beta in the mesh's own unit of area instead, as printed in Kim 2017 (0.01 there)
    single             compute displacements of "beta" in single precision, which is faster
    reach              rings of vertices round the triangles that "beta" pushes which move; None: all move
    size_sweeps        how often the target sizes of "regularised" are averaged over neighbours: each in
                       turn until a mesh is valid, from where it was given
    max_iterations     L-BFGS steps tried at most, for "regularised" per value of epsilon
    max_continuations  values of epsilon tried at most; a mesh that no longer gets better ends before
    """

    method: Literal["regularised", "beta"] = "regularised"
    beta: float = 0.01
    local: bool = False
    absolute_beta: float | None = None
    reach: int | None = None
    single: bool = False
    size_sweeps: tuple[int, ...] = (100, 20, 1000)
    max_iterations: int = 500
    max_continuations: int = 200

    def __post_init__(self) -> None:
        if self.method not in ("regularised", "beta"):
            raise ValueError(f"UntangleOptions.method must be 'regularised' or 'beta', not {self.method!r}")
        for name in ("max_iterations", "max_continuations"):
            if getattr(self, name) < 1:
                raise ValueError(f"UntangleOptions.{name} must be at least 1, not {getattr(self, name)}")
        if not self.size_sweeps or min(self.size_sweeps) < 0:
            raise ValueError(f"UntangleOptions.size_sweeps must be numbers, none negative, not {self.size_sweeps!r}")
        if self.reach is not None and self.reach < 1:
            raise ValueError(f"UntangleOptions.reach must be at least 1, not {self.reach}")
        if self.local and self.absolute_beta is not None:
            raise ValueError("UntangleOptions.local and absolute_beta exclude each other")
        for name in ("beta", "absolute_beta"):
            value = getattr(self, name)
            if value is not None and not value >= 0:
                raise ValueError(f"UntangleOptions.{name} must not be negative, but is {value}")


def untangle(
    batch: MeshBatch,
    options: UntangleOptions | None = None,
    *,
    reference: MeshBatch | None = None,
    free: Tensor | None = None,
    monitor: Monitor | None = None,
) -> tuple[MeshBatch, MoveInfo]:
    """Move the free vertices until every triangle is upright, if that can be had with these triangles.

    A mesh without inverted triangles comes back unmoved.  `info.status` is `Status.VALID` for
    every mesh that ends valid; of the others what comes back is the try with the fewest inverted
    triangles.

    reference  the meshes undeformed, the same triangles, all upright: the first try of "regularised"
               has each triangle's own undeformed shape and size as its target, and goes on from the
               first valid mesh to the least energy
    free       (V,) bool, move only these of the vertices that are not fixed
    monitor    called with the iteration and the energies of the meshes still running

    Raises InvalidMeshError when the reference's triangles are others, or one is not upright.
    """
    options = options or UntangleOptions()
    if reference is not None:
        check_reference(batch, reference)
    tangled = segment_any(~upright(batch), batch.triangle_offsets)
    may_move = ~batch.fixed & spread(tangled, batch.point_offsets)
    if free is not None:
        may_move &= free
    if options.method == "beta":
        return _untangle_beta(batch, may_move, options, monitor)
    packing = pack(batch.points, batch.triangles, may_move, batch.point_offsets, batch.triangle_offsets)
    target, size = _local_target(batch, options.size_sweeps[0]) if reference is None else _own_target(batch, reference)
    moved, info = _try_regularised(batch, packing, target, size, options, monitor, settle=reference is not None)
    rest = options.size_sweeps[1:] if reference is None else options.size_sweeps
    for sweeps in rest:
        again = info.status != Status.VALID
        if not bool(again.any()):
            break
        part, movable = batch.select(again), may_move[spread(again, batch.point_offsets)]
        small = pack(part.points, part.triangles, movable, part.point_offsets, part.triangle_offsets)
        tried, its = _try_regularised(part, small, *_local_target(part, sweeps), options, monitor)
        fewer = _inverted(tried) < _inverted(moved)[again]
        now = moved.select(again)
        moved = put(moved, again, put(now, fewer, tried.select(fewer)) if bool(fewer.any()) else now)
        info = _merged(info, again, its, fewer)
    return moved, info


def check_reference(batch: MeshBatch, reference: MeshBatch) -> None:
    """Raise InvalidMeshError, naming the mesh, unless `reference` has the triangles of `batch`, all upright."""
    if not torch.equal(batch.triangle_offsets, reference.triangle_offsets) or not torch.equal(
        batch.point_offsets, reference.point_offsets
    ):
        raise InvalidMeshError(
            f"the reference has {len(reference)} meshes, {len(reference.points)} points and "
            f"{len(reference.triangles)} triangles, not the batch's {len(batch)}, {len(batch.points)} and "
            f"{len(batch.triangles)}, mesh by mesh"
        )
    for problem, rows in (
        (
            "is another triangle than the batch's: order and corners must be the same",
            reference.triangles != batch.triangles,
        ),
        ("is inverted in the reference, which must be a valid mesh", ~upright(reference)[:, None]),
    ):
        bad = rows.any(1)
        if bool(bad.any()):
            row = int(bad.nonzero()[0, 0])
            b = int(triangle_mesh(batch)[row])
            row -= int(batch.triangle_offsets[b])
            raise InvalidMeshError(f"mesh {b}: triangles row {row} {problem}")


def _judged(batch: MeshBatch, moved: MeshBatch, info: MoveInfo) -> tuple[MeshBatch, MoveInfo]:
    """The status by exact signs of the mesh as it comes back."""
    valid = ~segment_any(~upright(moved), batch.triangle_offsets)
    status = torch.where(valid, Status.VALID, torch.where(info.status == Status.VALID, Status.STALLED, info.status))
    return moved, replace(info, status=status)


def _inverted(batch: MeshBatch) -> Tensor:
    return segment_count(~upright(batch), batch.triangle_offsets)


def _merged(info: MoveInfo, at: Tensor, part: MoveInfo, better: Tensor) -> MoveInfo:
    """`info` after another try of the meshes `at`: work adds up, the rest is that of the try that was `better`."""
    rows = at.nonzero().squeeze(1)
    more = {name: getattr(info, name).clone() for name in ("iterations", "evaluations", "energy", "gradient", "status")}
    for name in ("iterations", "evaluations"):
        more[name][rows] += getattr(part, name)
    for name in ("energy", "gradient", "status"):
        more[name][rows[better]] = getattr(part, name)[better]
    return replace(info, **more)


def _untangle_beta(
    batch: MeshBatch, may_move: Tensor, options: UntangleOptions, monitor: Monitor | None
) -> tuple[MeshBatch, MoveInfo]:
    # Areas in units of what is usual, so that the tolerances mean the same on every mesh.
    usual = usual_area(batch, options)
    beta = options.beta if options.absolute_beta is None else 1.0
    if options.reach is not None:
        area = signed_area(corners(batch.points.to(torch.float64), batch.triangles))
        may_move = may_move & surroundings(batch, area < beta * usual, options.reach)
    packing = pack(batch.points, batch.triangles, may_move, batch.point_offsets, batch.triangle_offsets, options.single)
    unit = spread(packing.unit, packing.triangle_offsets)
    inverse = unit / usual.index_select(0, packing.triangles) * unit
    objective = MeshObjective(
        UntangleBeta(beta),
        Target(1.0, 0.0, 1.0, inverse.to(packing.unknowns)),
        packing.rows,
        packing.anchored,
        packing.block_offsets,
        packing.triangle_offsets,
        # The Hessian of (area)^2 at a vertex is the square of the edge opposite: large triangles are
        # stiff, so lengths are measured in usual area over local size.
        packing.spread_vertices(
            Means(batch).round_vertices(usual)
            / spread(packing.unit, batch.point_offsets)
            / vertex_size(batch).clamp_min(1e-150)
        ),
        edges=packing.edges,
    )
    settings = LbfgsOptions(
        max_iterations=options.max_iterations, gradient_tolerance=1e-12, energy_tolerance=1e-6, first_step=0.1
    )
    result = minimise(objective, packing.unknowns, settings, monitor)
    info = MoveInfo(result.energy, result.gradient, result.iterations, result.evaluations, result.status)
    return _judged(batch, batch.with_points(packing.unpack(result.unknowns, batch.points)), info)


def usual_area(batch: MeshBatch, options: UntangleOptions) -> Tensor:
    """(T,) the area, in the batch's unit, of which beta is a part."""
    if options.absolute_beta is not None:
        return torch.full(
            (len(batch.triangles),), options.absolute_beta, dtype=torch.float64, device=batch.points.device
        )
    area = signed_area(corners(batch.points.to(torch.float64), batch.triangles)).abs()
    mean = segment_sum(area, batch.triangle_offsets) / counts_from_offsets(batch.triangle_offsets)
    usual = spread(mean, batch.triangle_offsets)
    if options.local:
        local = Means(batch).of_corners(local_size(batch, _LOCAL_SWEEPS)).square() * (SQRT3 / 4)
        usual = torch.minimum(usual, 2 * local)
    return torch.where(usual > 0, usual, 1.0)


# How far "local" looks round a vertex, in edges.
_LOCAL_SWEEPS = 20


def _local_target(batch: MeshBatch, sweeps: int) -> tuple[Target, Tensor]:
    """Equilateral targets (T,) of local size, and that size (V,), in the batch's unit."""
    size = local_size(batch, sweeps)
    return equilateral(size[batch.triangles].mean(1)), size


def _own_target(batch: MeshBatch, reference: MeshBatch) -> tuple[Target, Tensor]:
    """Each triangle of the reference as the target of the same one here, all scaled to the area enclosed now."""
    before = corners(reference.points.to(torch.float64), reference.triangles)
    now = corners(batch.points.to(torch.float64), batch.triangles)
    areas = [segment_sum(signed_area(t), batch.triangle_offsets) for t in (now, before)]
    factor = (areas[0].abs() / areas[1]).sqrt()
    scaled = Corners(*(v * spread(factor, batch.triangle_offsets) for v in before))
    return target_of(scaled), vertex_size(reference) * spread(factor, batch.point_offsets)


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


def local_size(batch: MeshBatch, sweeps: int = 100) -> Tensor:
    """(V,) side of the equilateral triangle a vertex's triangles should have, in the batch's unit.

    From the mean |area| round each vertex, its root averaged over neighbours `sweeps` times, then
    scaled per mesh so that the triangles' target areas sum to the enclosed area.
    """
    t = corners(batch.points.to(torch.float64), batch.triangles)
    area = signed_area(t)
    offsets = batch.triangle_offsets
    enclosed = segment_sum(area, offsets)
    mean = spread(segment_sum(area.abs(), offsets) / counts_from_offsets(offsets), offsets)
    share = area.abs() / torch.where(mean > 0, mean, 1.0)
    means = Means(batch)
    size = means.round_vertices(share).sqrt().clamp_min(1e-3)
    for _ in range(sweeps):
        size = means.round_vertices(means.of_corners(size))
    target = means.of_corners(size).square() * (SQRT3 / 4)
    factor = (enclosed.abs() / segment_sum(target, offsets)).sqrt()
    return size * spread(factor, batch.point_offsets)
