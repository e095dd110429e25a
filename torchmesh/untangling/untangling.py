"""Step 2: move the free vertices until no triangle is inverted; triangles stay as they are."""

from dataclasses import replace

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch, put, triangle_mesh
from ..mesh.means import Means, vertex_size
from ..mesh.measure import upright
from ..mesh.neighbourhoods import surroundings
from ..mesh.ragged import counts_from_offsets, segment_any, segment_count, segment_sum, spread
from ..mesh.triangle import SQRT3, Corners, corners, signed_area
from ..optimising.energies import UntangleBeta
from ..optimising.jacobian import Target, equilateral, target_of
from ..optimising.lbfgs import LbfgsOptions, minimise
from ..optimising.moves import Monitor, MoveInfo
from ..optimising.objective import MeshObjective, pack
from ..status import Status
from .continuation import _judged, _try_regularised
from .local_size import local_size
from .options import UntangleOptions


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
