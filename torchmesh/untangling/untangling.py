"""Step 2: move the free vertices until no triangle is inverted; triangles stay as they are."""

from dataclasses import replace

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch, put, triangle_mesh
from ..mesh.detached import without_autograd
from ..mesh.interfaces import holding, released
from ..mesh.measure import upright
from ..mesh.quads import inverted_quads, quad_mesh, sampled
from ..mesh.ragged import segment_any, segment_count, spread, true_rows
from ..mesh.unfit import unfit_meshes
from ..optimising.jacobian import Target
from ..optimising.moves import Monitor, MoveInfo
from ..optimising.objective import pack
from ..optimising.targets import ideal
from ..status import Status
from .beta import untangle_beta
from .continuation import judged, try_regularised
from .local_size import local_size, own_target, rest_target
from .options import UntangleOptions


@without_autograd
def untangle(
    batch: MeshBatch,
    options: UntangleOptions | None = None,
    *,
    reference: MeshBatch | None = None,
    targets: Tensor | None = None,
    free: Tensor | None = None,
    monitor: Monitor | None = None,
) -> tuple[MeshBatch, MoveInfo]:
    """Move the free vertices until every triangle and quad is upright, where that is possible with these.

    A mesh without inverted triangles comes back unmoved.  `info.status` is `Status.VALID` for every mesh that ends
    valid.  Of each other mesh the try with the fewest inverted triangles comes back.  A mesh with a position that is
    not finite, or beyond 1e150, comes back as it is, with `Status.NOT_FINITE`.

    The result carries no gradient, whatever the points require; `nn`, `losses`, `metrics` and `femwarp` have one.

    reference  the meshes before they were deformed: the same triangles, all upright.  The first try of "regularised"
               then takes each triangle's shape and size there as its target, and minimises the energy further once
               the mesh is valid
    targets    (T, 2, 2) the same of rest shapes that are no plane mesh: target matrices with their sizes, such as
               those of a surface in space (`target_from(points, triangles)`).  Their sum is scaled to the area that
               the mesh encloses.  Not with a reference, nor with quads
    free       (V,) bool: of the vertices that are not fixed, move only these; None: all
    monitor    called with the iteration and the energies of the meshes still running

    Raises InvalidMeshError when the reference has other triangles or an inverted one, and for targets that are none.
    """
    options = options or UntangleOptions()
    if targets is not None and (reference is not None or len(batch.quads)):
        raise InvalidMeshError("targets of untangle go with triangles alone, and not with a reference")
    if reference is not None:
        check_reference(batch, reference)
    # Quads are their corners: what moves is the same, and every gate below is exact for them.
    given, batch = batch, sampled(batch)
    reference = None if reference is None else sampled(reference)
    batch, unfit = holding(batch, options.interfaces), unfit_meshes(batch)
    tangled = segment_any(~upright(batch), batch.triangle_offsets) & ~unfit
    may_move = ~batch.fixed & spread(tangled, batch.point_offsets)
    if free is not None:
        may_move &= free
    if options.method == "beta":
        moved, info = untangle_beta(batch, may_move, options, monitor)
        return _as_given(moved, given), _refused(info, unfit)
    # Where the rest shapes are known, they are the first target.
    rest = None if reference is None else own_target(batch, reference)
    if targets is not None:
        rest = rest_target(batch, targets)
    if options.method == "newton":
        moved, info = _persisted(batch, batch, _untouched(batch), options, tangled, may_move, rest)
        return _as_given(moved, given), _refused(info, unfit)
    packing = pack(batch.points, batch.triangles, may_move, batch.point_offsets, batch.triangle_offsets)
    target, size = rest or _local_target(batch, options.size_sweeps[0])
    moved, info = try_regularised(batch, packing, target, size, options, monitor, settle=rest is not None)
    for sweeps in options.size_sweeps if rest is not None else options.size_sweeps[1:]:
        again = (info.status != Status.VALID) & ~unfit
        if not bool(again.any()):
            break
        part, movable = batch.select(again), may_move[spread(again, batch.point_offsets)]
        packing = pack(part.points, part.triangles, movable, part.point_offsets, part.triangle_offsets)
        tried, its = try_regularised(part, packing, *_local_target(part, sweeps), options, monitor)
        fewer = _inverted(tried) < _inverted(moved)[again]
        now = moved.select(again)
        moved = put(moved, again, put(now, fewer, tried.select(fewer)) if bool(fewer.any()) else now)
        info = _merged(info, again, its, fewer)
    again = (info.status != Status.VALID) & ~unfit
    if options.newton is not None and bool(again.any()):
        moved, info = _persisted(batch, moved, info, options, again, may_move, rest)
    return _as_given(moved, given), _refused(info, unfit)


def _persisted(
    batch: MeshBatch,
    moved: MeshBatch,
    info: MoveInfo,
    options: UntangleOptions,
    at: Tensor,
    may_move: Tensor,
    rest: tuple[Target, Tensor] | None,
) -> tuple[MeshBatch, MoveInfo]:
    """`moved` and `info` after the second-order ways from `batch`, on the meshes `at` (B,) bool.

    rest  the targets (T,) and sizes (V,) that the rest shapes come to, where they are known

    Meshes with an inverted triangle that cannot move are left out: they cannot be untangled.
    """
    from .persisting import persist

    assert options.newton is not None
    held = ~may_move[batch.triangles].any(1)
    at = at & ~segment_any(~upright(batch) & held, batch.triangle_offsets)
    if not bool(at.any()):
        return moved, info
    tried, steps = persist(batch, may_move, options.newton, at, None if rest is None else rest[0])
    fewer = at & (_inverted(tried) < _inverted(moved))
    if bool(fewer.any()):
        moved = put(moved, fewer, tried.select(fewer))
    info = replace(info, iterations=info.iterations + steps)
    # The energies of the ways differ, so that none is told.
    energy, gradient = (torch.where(fewer, torch.nan, column) for column in (info.energy, info.gradient))
    return judged(moved, moved, replace(info, energy=energy, gradient=gradient))


def _untouched(batch: MeshBatch) -> MoveInfo:
    nothing = torch.zeros(len(batch), dtype=torch.int64, device=batch.points.device)
    energy = torch.full((len(batch),), torch.nan, dtype=torch.float64, device=nothing.device)
    return MoveInfo(energy, energy.clone(), nothing, nothing.clone(), nothing + int(Status.STALLED))


def _as_given(moved: MeshBatch, given: MeshBatch) -> MeshBatch:
    """`moved` with quads, and what is fixed, as in the batch `given`."""
    return released(moved if moved.triangles is given.triangles else given.with_points(moved.points), given)


def _refused(info: MoveInfo, unfit: Tensor) -> MoveInfo:
    """`info` where it is known that the meshes `unfit` (B,) bool were not looked at."""
    return replace(info, status=torch.where(unfit, int(Status.NOT_FINITE), info.status))


def check_reference(batch: MeshBatch, reference: MeshBatch) -> None:
    """Raise InvalidMeshError, naming mesh and row, unless `reference` has the triangles of `batch`, all upright."""
    if not torch.equal(batch.triangle_offsets, reference.triangle_offsets) or not torch.equal(
        batch.point_offsets, reference.point_offsets
    ):
        raise InvalidMeshError(
            f"the reference has {len(reference)} meshes, {len(reference.points)} points and "
            f"{len(reference.triangles)} triangles, not the batch's {len(batch)}, {len(batch.points)} and "
            f"{len(batch.triangles)}, mesh by mesh"
        )
    _check_quads(batch, reference)
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


def _check_quads(batch: MeshBatch, reference: MeshBatch) -> None:
    """Raise InvalidMeshError, naming mesh and row, unless `reference` has the quads of `batch`, all upright."""
    if batch.quads.shape != reference.quads.shape or not torch.equal(batch.quad_offsets, reference.quad_offsets):
        raise InvalidMeshError(f"the reference has {len(reference.quads)} quads, the batch {len(batch.quads)}")
    if not len(batch.quads):
        return
    for problem, bad in (
        (
            "is another quad than the batch's: order and corners must be the same",
            (reference.quads != batch.quads).any(1),
        ),
        ("is inverted in the reference, which must be a valid mesh", inverted_quads(reference.points, reference.quads)),
    ):
        if bool(bad.any()):
            row = int(bad.nonzero()[0])
            b = int(quad_mesh(batch)[row])
            raise InvalidMeshError(f"mesh {b}: quads row {row - int(batch.quad_offsets[b])} {problem}")


def _inverted(batch: MeshBatch) -> Tensor:
    return segment_count(~upright(batch), batch.triangle_offsets)


def _merged(info: MoveInfo, at: Tensor, part: MoveInfo, better: Tensor) -> MoveInfo:
    """`info` after another try of the meshes `at`: work adds up, and where the try was `better` it gives the rest."""
    rows = true_rows(at)
    more = {name: getattr(info, name).clone() for name in ("iterations", "evaluations", "energy", "gradient", "status")}
    for name in ("iterations", "evaluations"):
        more[name][rows] += getattr(part, name)
    for name in ("energy", "gradient", "status"):
        more[name][rows[better]] = getattr(part, name)[better]
    return replace(info, **more)


def _local_target(batch: MeshBatch, sweeps: int) -> tuple[Target, Tensor]:
    """Equilateral targets (T,) of local size, and that size (V,), in the batch's unit."""
    size = local_size(batch, sweeps)
    return ideal(batch, size[batch.triangles].mean(1)), size
