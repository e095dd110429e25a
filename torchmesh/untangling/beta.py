"""Knupp's untangle-beta (Kim 2017, equation 2): triangles below a small area are pushed up to it."""

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.means import Means, vertex_size
from ..mesh.neighbourhoods import surroundings
from ..mesh.ragged import counts_from_offsets, segment_sum, spread, take
from ..mesh.triangle import SQRT3, corners, signed_area
from ..optimising.energies import UntangleBeta
from ..optimising.jacobian import Target
from ..optimising.lbfgs import minimise
from ..optimising.moves import Monitor, MoveInfo
from ..optimising.objective import MeshObjective, Packing, pack
from .continuation import judged
from .local_size import local_size
from .options import UntangleOptions

# With `local`, areas are averaged over so many rings of vertices.
_LOCAL_SWEEPS = 20


def untangle_beta(
    batch: MeshBatch, may_move: Tensor, options: UntangleOptions, monitor: Monitor | None
) -> tuple[MeshBatch, MoveInfo]:
    """Move the vertices `may_move` (V,) bool until all triangles have the area beta, or the energy settles."""
    usual = usual_area(batch, options)
    beta = options.beta if options.absolute_beta is None else 1.0
    if options.reach is not None:
        area = signed_area(corners(batch.points.to(torch.float64), batch.triangles))
        may_move = may_move & surroundings(batch, area < beta * usual, options.reach)
    packing = pack(batch.points, batch.triangles, may_move, batch.point_offsets, batch.triangle_offsets, options.single)
    result = minimise(_objective(batch, packing, usual, beta), packing.unknowns, options.minimiser(), monitor)
    info = MoveInfo(result.energy, result.gradient, result.iterations, result.evaluations, result.status)
    return judged(batch, batch.with_points(packing.unpack(result.unknowns, batch.points)), info)


def _objective(batch: MeshBatch, packing: Packing, usual: Tensor, beta: float) -> MeshObjective:
    """The energy with areas in units of the `usual` ones (T,), so that the tolerances mean the same on every mesh."""
    unit = spread(packing.unit, packing.triangle_offsets)
    inverse = unit / take(usual, packing.triangles) * unit
    return MeshObjective(
        UntangleBeta(beta),
        Target(1.0, 0.0, 1.0, inverse.to(packing.unknowns)),
        packing.rows,
        packing.anchored,
        packing.block_offsets,
        packing.triangle_offsets,
        # The Hessian of (area)^2 at a vertex is the square of the opposite edge.  Large triangles are therefore
        # stiff, and lengths are measured in usual area over local size.
        packing.spread_vertices(
            Means(batch).round_vertices(usual)
            / spread(packing.unit, batch.point_offsets)
            / vertex_size(batch).clamp_min(1e-150)
        ),
        edges=packing.edges,
    )


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
