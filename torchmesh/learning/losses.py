"""Energies of a mesh as losses: differentiable in `points`, finite and with finite gradients everywhere.

    loss = tm.losses.untangle_beta(network(mesh), mesh).mean()

Each loss takes points (V, 2), float32 or float64, and the batch whose triangles they belong to.  Where a loss needs a
scale, the batch's own points give it, as those of an undeformed mesh or of a network's input; they are constants.
Losses are per mesh (B,) by default, the mean over its triangles, or per triangle (T,); both have no unit.  The formulae
are those of `optimising.energies`.  All losses can be differentiated twice.

    inverse_mean_ratio  shape; 1 for equilateral triangles
    untangle_beta       zero when no triangle is inverted or nearly so
    regularised         shape and size, grows without bound as inverted triangles get worse
    minimum_jacobian    zero when every triangle keeps a part of its area; looks at the worst triangle
"""

from typing import Literal

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch
from ..mesh.quads import refuse_quads
from ..optimising.energies import InverseMeanRatio, Regularised, UntangleBeta, whole_power
from ..optimising.jacobian import Target, equilateral, invariants_of_edges
from .linear import edges_of, mean_of_each, owner
from .scales import local_sides, mean_side, own_targets

__all__ = ["inverse_mean_ratio", "minimum_jacobian", "regularised", "untangle_beta"]

Per = Literal["mesh", "triangle"]

# Added to the stretch of every triangle, so that no ratio is 0/0: the stretch of a triangle a millionth as large as
# the mean.
_NO_SIZE = 1e-12


def __dir__() -> list[str]:
    return __all__


def inverse_mean_ratio(
    points: Tensor, mesh: MeshBatch, *, power: int = 1, limit: float = 10.0, per: Per = "mesh"
) -> Tensor:
    """q^power, q the inverse mean ratio (Kim 2017, equations 3 and 4): 1 for an equilateral triangle.

    limit  above this q, and for inverted triangles, q is replaced by its tangent as a function of the signed mean
           ratio 1/q = 2 det / stretch.  The tangent reaches 2 limit for a flat triangle, and 2 limit + limit^2 for
           the mirror image of an equilateral one

    A triangle of no size counts as flat and has no gradient.  Raises ValueError for limit <= 1, and for a power that is
    no whole number from 1.
    """
    if power < 1 or power != int(power):
        raise ValueError(f"power must be a whole number from 1, not {power}")
    if not limit > 1:
        raise ValueError(f"limit must be above 1, the ideal, not {limit}")
    stretch, det = _invariants(points, mesh, equilateral(mean_side(mesh).to(points)))
    lowest = 1 / limit
    # The stretch is 2 for an equilateral triangle of mean area: only triangles of (nearly) no size are changed by this.
    stretch = stretch + _NO_SIZE
    ratio = 2 * det / stretch
    good = ratio >= lowest
    # A triangle on the tangent is replaced by an equilateral one here, whose value and slopes are not used.
    exact = InverseMeanRatio(power).value(torch.where(good, stretch, 2.0), torch.where(good, det, 1.0))
    tangent = whole_power((2 * lowest - ratio) / lowest**2, power)
    return _reduced(torch.where(good, exact, tangent), mesh, per)


def untangle_beta(points: Tensor, mesh: MeshBatch, *, beta: float = 0.01, per: Per = "mesh") -> Tensor:
    """Knupp's untangle-beta, max(beta - A, 0)^2 (Kim 2017, equations 1 and 2), A in units of the mean area of `mesh`.

    beta  the area, as a part of the mean absolute area of the mesh in `mesh`, below which a triangle counts
    """
    if not beta >= 0:
        raise ValueError(f"beta must not be negative, but is {beta}")
    # An equilateral triangle of the mean area has det = 1: half its determinant is half its area.
    stretch, det = _invariants(points, mesh, equilateral(mean_side(mesh).to(points)))
    return _reduced(UntangleBeta(beta).value(stretch, 2 * det), mesh, per)


def regularised(
    points: Tensor,
    mesh: MeshBatch,
    *,
    eps: float = 0.1,
    theta: float = 1 / 128,
    reference: bool = False,
    per: Per = "mesh",
) -> Tensor:
    """The foldover-free functional (Garanzha et al. 2021), with a target triangle for each triangle.

    eps        its regularisation: the smaller, the harder an inverted triangle is punished
    theta      weight of area against shape
    reference  True: the triangle of `mesh` is the target, and `mesh` must be valid (InvalidMeshError);
               False: equilateral, of the local size in `mesh`
    """
    if not eps > 0:
        raise ValueError(f"eps must be positive, not {eps}: at 0 the loss of a flat triangle is infinite")
    if not 0 <= theta < 1:
        raise ValueError(f"theta must be from 0 to below 1, not {theta}")
    target = _reference(points, mesh) if reference else equilateral(local_sides(mesh).to(points))
    return _reduced(Regularised(eps, theta).value(*_invariants(points, mesh, target)), mesh, per)


def minimum_jacobian(
    points: Tensor, mesh: MeshBatch, *, threshold: float = 0.1, reference: bool = True, per: Per = "mesh"
) -> Tensor:
    """max(threshold - J, 0), J the Jacobian determinant of each triangle, per mesh for its smallest J.

    threshold  the J from which on nothing is punished
    reference  True: J is the area over the area in `mesh`, which must be valid (InvalidMeshError);
               False: over the mean absolute area of the mesh in `mesh`

    Per mesh only the worst triangle has a gradient (equally bad ones share it); per triangle each has its own.
    """
    target = _reference(points, mesh) if reference else equilateral(mean_side(mesh).to(points))
    _, det = _invariants(points, mesh, target)
    if per == "mesh":
        rows = owner(mesh.triangle_offsets, len(det), det)
        det = det.new_full((len(mesh),), torch.inf).scatter_reduce(0, rows, det, "amin")
        return (threshold - det).clamp_min(0)
    return _reduced((threshold - det).clamp_min(0), mesh, per)


def _invariants(points: Tensor, mesh: MeshBatch, target: Target) -> tuple[Tensor, Tensor]:
    refuse_quads(mesh, "a loss over triangles")
    if points.shape != mesh.points.shape:
        raise InvalidMeshError(f"points must be {tuple(mesh.points.shape)} as in the batch, not {tuple(points.shape)}")
    return invariants_of_edges(*edges_of(points, mesh.triangles), target)


def _reference(points: Tensor, mesh: MeshBatch) -> Target:
    """Each triangle of `mesh` as the target of itself."""
    return Target(*own_targets(mesh).to(points))


def _reduced(values: Tensor, mesh: MeshBatch, per: Per) -> Tensor:
    if per == "triangle":
        return values
    if per != "mesh":
        raise ValueError(f"per must be 'mesh' or 'triangle', not {per!r}")
    return mean_of_each(values, mesh.triangle_offsets)
