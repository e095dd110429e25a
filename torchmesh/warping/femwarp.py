"""FEMWARP: carry the interior of a mesh along with its boundary."""

from dataclasses import replace

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch, put
from ..mesh.connectivity import boundary_edges, edge_components
from ..mesh.detached import detached, without_autograd
from ..mesh.interfaces import Interfaces, holding
from ..mesh.measure import refuse_inverted
from ..mesh.quads import sampled
from ..mesh.ragged import owner_of, segment_any
from ..mesh.typed import typed
from ..mesh.unfit import unfit_meshes, what_is_unfit
from ..mesh.validation import fit_positions
from ..optimising.laplacian import ExtensionSystem, edge_stiffness, harmonic_extension
from ..optimising.linear_map import LinearMap


@typed
def femwarp(batch: MeshBatch, new_points: Tensor, *, hold: Tensor | None = None) -> MeshBatch:
    """Move the fixed vertices to `new_points` and let the others follow harmonically.

    new_points  (V, 2) in the batch's unit; the rows of fixed vertices count.  The points of the result are
                differentiable in these rows, by one more solve with the same factors; they are not in the points of
                `batch`
    hold        (V,) bool, further vertices whose rows count, such as those of an interface whose motion is known

    Quads count with the mean of the stiffnesses of their two splittings into triangles (`stiffness`).
    Vertices on interfaces (constrained edges) follow as all interior vertices do, unless they are fixed or held.
    Each interior vertex stays the same weighted mean of its neighbours, with the P1
    stiffness of the undeformed mesh as weights, so affine motions are reproduced (Shontz &
    Vavasis, Analysis of and workarounds for element reversal, BIT 50, 2010).  A large motion may
    invert triangles: `improve` mends that.  Raises InvalidMeshError when a triangle of the
    undeformed mesh is inverted, when no vertex of a piece is fixed, or when positions are not finite or of another
    shape or type; it names mesh and row.
    """
    system, target = _warp_system(batch, new_points, hold)
    batch = detached(batch)
    if isinstance(new_points, Tensor) and new_points.requires_grad and torch.is_grad_enabled():
        fixed = system.known[:, None]
        # The values are those of `target`, and the gradient goes to the rows that count.
        asked = torch.where(fixed, new_points.to(batch.points), target)
        return batch.with_points(LinearMap(system.extended, system.adjoint)(asked))
    with torch.no_grad():
        return batch.with_points(system.extended(target))


@without_autograd
def _warp_system(batch: MeshBatch, new_points: Tensor, hold: Tensor | None) -> tuple[ExtensionSystem, Tensor]:
    """The factorised system of the warp, and (V, 2) the fixed vertices at their goal, the others where they are."""
    fixed = with_held(batch, hold).fixed
    target = boundary_goal(replace(batch, fixed=fixed), new_points, "femwarp")
    refuse_loose(batch, fixed)
    return _system(batch, fixed), target


def refuse_loose(batch: MeshBatch, fixed: Tensor) -> None:
    """Raise InvalidMeshError for a piece of a mesh without a `fixed` (V,) vertex, which would shrink to a point."""
    batch = sampled(batch)
    if bool(fixed[boundary_edges(batch.triangles, batch.twin).reshape(-1)].all()):
        return  # every piece of a plane mesh has a boundary
    edges = torch.cat([batch.triangles[:, :2], batch.triangles[:, 1:]])
    label = edge_components(edges, len(fixed))
    used, held = torch.zeros_like(fixed), torch.zeros_like(fixed)
    used[batch.triangles] = True
    held[label[fixed]] = True
    loose = used & ~held[label]
    if bool(loose.any()):
        row = loose.nonzero()[0]
        b = int(owner_of(row, batch.point_offsets))
        raise InvalidMeshError(
            f"mesh {b}: no vertex of the piece with vertex {int(row - batch.point_offsets[b])} is fixed, so that "
            "nothing says where it goes; fix some of its vertices"
        )


def _system(batch: MeshBatch, fixed: Tensor) -> ExtensionSystem:
    """The factorised stiffness of the vertices that are not `fixed` (V,) bool."""
    triangles, weights = stiffness(batch)
    return ExtensionSystem(triangles, weights, fixed, batch.point_offsets)


def carried(batch: MeshBatch, goal: Tensor) -> MeshBatch:
    """`femwarp` for callers that know that the batch is valid and that `goal` (V, 2) fits it; without a gradient."""
    return batch.with_points(_system(batch, batch.fixed).extended(goal))


def stiffness(batch: MeshBatch, stiffening: float = 0.0) -> tuple[Tensor, tuple[Tensor, Tensor, Tensor]]:
    """The triangles (T, 3) of linear elements and the weights (T,) of their edges, as `harmonic_extension` has them.

    stiffening  as `edge_stiffness` has it

    The stiffness of a quad is the mean of those of its two splittings into triangles: half of each of its four corner
    triangles.  Each splitting reproduces linear functions, and so does their mean; it does not prefer a diagonal.
    """
    mixed = len(batch.quads) > 0
    batch = sampled(batch)
    weights = edge_stiffness(batch.points, batch.triangles, batch.triangle_offsets, stiffening)
    if mixed:
        share = torch.where(batch.of_quads, 0.5, 1.0).to(weights[0])
        weights = share * weights[0], share * weights[1], share * weights[2]
    return batch.triangles, weights


def with_held(batch: MeshBatch, hold: Tensor | None) -> MeshBatch:
    """The batch with the vertices `hold` (V,) bool fixed, too; InvalidMeshError for another shape or type."""
    return batch if hold is None else replace(batch, fixed=batch.fixed | checked_hold(batch, hold))


def checked_hold(batch: MeshBatch, hold: Tensor, name: str = "hold") -> Tensor:
    """The mask `hold` as (V,) bool on the device of the batch; InvalidMeshError, with its name, for anything else."""
    hold = torch.as_tensor(hold, device=batch.fixed.device)
    if hold.dtype != torch.bool or hold.shape != batch.fixed.shape:
        raise InvalidMeshError(f"{name} must be ({len(batch.fixed)},) bool, not {tuple(hold.shape)} {hold.dtype}")
    return hold


def checked_new_points(batch: MeshBatch, new_points: Tensor) -> Tensor:
    """`new_points` as (V, 2) in the dtype and on the device of the batch; InvalidMeshError for anything else."""
    try:
        target = torch.as_tensor(new_points)
    except (TypeError, ValueError, RuntimeError) as error:
        raise InvalidMeshError(f"new_points is not a rectangular array of numbers: {error}") from None
    if target.shape != batch.points.shape:
        raise InvalidMeshError(f"new_points must be {tuple(batch.points.shape)}, not {tuple(target.shape)}")
    if target.dtype == torch.bool or target.is_complex():
        raise InvalidMeshError(f"new_points must be real numbers, not {target.dtype}")
    return target.to(batch.points)


def boundary_goal(batch: MeshBatch, new_points: Tensor, what: str) -> Tensor:
    """(V, 2) the fixed vertices at `new_points`, the others where they are; InvalidMeshError as `what` says."""
    target = checked_new_points(batch, new_points)
    unfit = unfit_goals(batch, target)
    if bool(unfit.any()):
        b = int(unfit.nonzero()[0])
        raise InvalidMeshError(f"mesh {b}: {what_is_unfit_goal(batch, target, b)}")
    refuse_tangled(batch, what)
    return torch.where(batch.fixed[:, None], target, batch.points)


def refuse_tangled(batch: MeshBatch, what: str) -> None:
    """Raise InvalidMeshError, as `what` says, if a triangle is inverted."""
    refuse_inverted(batch, f"; {what} starts from a valid mesh, so improve it first")


def unfit_goals(batch: MeshBatch, target: Tensor) -> Tensor:
    """(B,) bool: a position of the mesh, or the goal of one of its fixed vertices, is not finite or beyond 1e150."""
    return unfit_meshes(batch) | segment_any(batch.fixed & ~fit_positions(target), batch.point_offsets)


def what_is_unfit_goal(batch: MeshBatch, target: Tensor, b: int) -> str:
    """What is to be said of the mesh `b`, which is one of `unfit_goals`; rows are those of the batch."""
    start, end = batch.point_offsets[b : b + 2].tolist()
    if bool(unfit_meshes(batch)[b]):
        return what_is_unfit(batch, b)[0]
    row = start + int((batch.fixed & ~fit_positions(target))[start:end].nonzero()[0, 0])
    return f"new_points row {row} is {target[row].tolist()}: a fixed vertex needs a finite position, below 1e150"


@without_autograd
def relax(batch: MeshBatch, *, interfaces: Interfaces | None = None) -> MeshBatch:
    """Move every free vertex to the mean of its neighbours, wherever it was.

    The neighbours are those along edges of triangles and quads, not across quads.

    interfaces  "free": the ends of constrained edges move, too; otherwise they stay

    With a convex boundary and a 3-connected mesh the result is valid (Tutte, How to draw a graph,
    Proceedings of the London Mathematical Society s3-13, 1963); it restores scrambled interiors.  A mesh with a
    position that is not finite, or beyond 1e150, comes back as it is.  Raises InvalidMeshError when no vertex of a
    piece is fixed.

    The result carries no gradient, whatever the points require; `nn`, `losses`, `metrics` and `femwarp` have one.
    """
    unfit = unfit_meshes(batch)
    if bool(unfit.any()):
        return batch if bool(unfit.all()) else put(batch, ~unfit, relax(batch.select(~unfit), interfaces=interfaces))
    given, batch = batch, sampled(batch)
    one = torch.ones(len(batch.triangles), dtype=torch.float64, device=batch.points.device)
    weights = (one, one, one)
    if len(batch.quads):
        # Each edge of a quad is in two of its corners, and its diagonals make no neighbours.
        side = torch.where(batch.of_quads, 0.5, 1.0).to(one)
        weights = torch.where(batch.of_quads, 0.0, 1.0).to(one), side, side
    fixed = holding(batch, interfaces).fixed
    refuse_loose(batch, fixed)
    points = harmonic_extension(batch.triangles, weights, fixed, batch.points, batch.point_offsets)
    return given.with_points(points)
