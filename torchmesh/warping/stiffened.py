"""Carry the interior of a mesh along with its boundary so that small triangles keep their shapes.

    step of the boundary = affine motion + rest        the interior of each connected part of a mesh takes the
                                                       affine motion of the part as it is, and the rest as a
                                                       harmonic function whose stiffness is higher in smaller
                                                       triangles

Near a moving body triangles are usually small.  FEMWARP lets all triangles share the deformation alike, so that the
small ones are the first ones to be flat.  Where small triangles are stiffer, they move along with the body, and large
ones take the deformation.
"""

import torch
from torch import Tensor

from ..kernels import stiffness as compiled
from ..kernels.library import library_for
from ..mesh.batch import MeshBatch
from ..mesh.connectivity import vertex_components
from ..mesh.quads import halved
from ..mesh.ragged import counts_from_offsets, offsets_from_counts, put_rows, segment_sum, spread, take, true_rows
from ..optimising.laplacian import ExtensionSystem
from .femwarp import carried, stiffness

# Where the determinant of the second moments, divided by their trace, is below this, vertices lie on a line.
_ON_A_LINE = 1e-12


def carried_stiffly(batch: MeshBatch, goal: Tensor, stiffening: float) -> MeshBatch:
    """The batch with its fixed vertices at `goal` (V, 2), the interior following; without a gradient.

    stiffening  the stiffness of a triangle is proportional to this power of one over its area; 0 is FEMWARP, and 1 is
                the rule of Stein, Tezduyar & Benney, Mesh moving techniques for fluid-structure interactions with
                large displacements, Journal of Applied Mechanics 70, 2003, section 3.  They leave the Jacobian, which
                is proportional to the area, out of the integral that gives the stiffness of an element, and so divide
                that stiffness by the area

    The displacement of the interior is the sum of two.  The first is the affine motion that fits the motion of the
    fixed vertices best, by least squares; each connected part of a mesh has one of its own, for which only vertices of
    triangles count.  The second is the harmonic extension, with these stiffnesses, of what the fit leaves at the fixed
    vertices.  So affine motions of each part are reproduced, as by FEMWARP.  Callers know that the batch is valid and
    that `goal` fits it.
    """
    if stiffening == 0:
        return carried(batch, goal)
    points, fixed = batch.points.to(torch.float64), batch.fixed[:, None]
    asked = torch.where(fixed, goal.to(points) - points, 0.0)
    affine = _affine_fit_of_parts(batch, points, asked)
    triangles, weights = stiffness(batch, stiffening)
    system = ExtensionSystem(triangles, weights, batch.fixed, batch.point_offsets)
    rest = system.extended(torch.where(fixed, asked - affine, 0.0))
    return batch.with_points(torch.where(fixed, goal, (points + (affine + rest)).to(batch.points)))


def _affine_fit_of_parts(batch: MeshBatch, points: Tensor, displacement: Tensor) -> Tensor:
    """(V, 2) `affine_fit` over each connected part of each mesh of the batch; 0 at vertices in no triangle."""
    mesh = halved(batch)
    part, count = vertex_components(mesh.triangles, mesh.twin, len(points))
    rows = true_rows(part >= 0)
    meshes = int((counts_from_offsets(batch.point_offsets) > 0).sum())
    if count == meshes and len(rows) == len(points):  # every vertex is in a triangle, and no mesh has two parts
        return affine_fit(points, batch.fixed, displacement, batch.point_offsets)
    # The vertices of a part stand one after the other, as those of a mesh do.
    rows = rows[part[rows].argsort(stable=True)]
    offsets = offsets_from_counts(torch.bincount(part[rows], minlength=count))
    fit = affine_fit(take(points, rows), batch.fixed[rows], take(displacement, rows), offsets)
    return put_rows(torch.zeros_like(points), rows, fit)


def affine_fit(points: Tensor, fixed: Tensor, displacement: Tensor, offsets: Tensor) -> Tensor:
    """(V, 2) the affine displacement of each part that fits that of its `fixed` (V,) vertices best, at all vertices.

    points, displacement  (V, 2) float64; the displacement is 0 where a vertex is not fixed
    offsets               (P+1,) the rows of each part, which may be a whole mesh

    Where the fixed vertices lie on a line, it is their mean displacement alone.
    """
    if library_for(points) is not None:
        return compiled.affine_fit(points, fixed, displacement, offsets, _ON_A_LINE)
    one = fixed.to(points)[:, None]
    count = segment_sum(one, offsets).clamp_min(1)
    means = segment_sum(torch.cat([points * one, displacement], 1), offsets) / count
    centred, moved = points - spread(means[:, :2], offsets), (displacement - spread(means[:, 2:], offsets)) * one
    held = centred * one
    columns = [held[:, i : i + 1] * v for i in (0, 1) for v in (held, moved)]
    moments = segment_sum(torch.cat(columns, 1), offsets)
    # Divided by the trace, they neither overflow nor underflow in any unit of length.
    trace = moments[:, 0] + moments[:, 5]
    xx, xy, xu, xv, _, yy, yu, yv = (moments / torch.where(trace > 0, trace, 1.0)[:, None]).unbind(1)
    determinant = xx * yy - xy * xy
    flat = ~(determinant > _ON_A_LINE)
    inverse = torch.where(flat, 0.0, 1.0 / torch.where(flat, 1.0, determinant))[:, None]
    x_to = torch.stack([yy * xu - xy * yu, yy * xv - xy * yv], 1) * inverse
    y_to = torch.stack([xx * yu - xy * xu, xx * yv - xy * xv], 1) * inverse
    return (
        spread(means[:, 2:], offsets) + centred[:, :1] * spread(x_to, offsets) + centred[:, 1:] * spread(y_to, offsets)
    )
