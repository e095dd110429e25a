"""How long a step may be for a solver that moves along with the mesh: |w| dt / h."""

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.detached import without_autograd
from ..mesh.quads import quads_as_halves
from ..mesh.ragged import segment_max
from ..mesh.triangle import corners, edge_lengths, signed_area
from .femwarp import femwarp


@without_autograd
@quads_as_halves
def courant_step(batch: MeshBatch, new_points: Tensor, courant: float = 1.0, *, hold: Tensor | None = None) -> Tensor:
    """(B,) the part of the motion in which no vertex goes further than `courant` heights of the triangles at it.

    This is the part of the time in which |w| dt / h stays below `courant`, as explicit steps in moving coordinates ask
    for; w is the velocity of a vertex, and h the least height of a triangle at it.  The interior goes by FEMWARP, so
    that nothing need be warped before.  More than 1 means that the whole motion is within the bound, and a huge number
    that nothing moves.  `largest_step` says when a triangle would invert.

    new_points  (V, 2) in the unit of the batch; only the rows of fixed and held vertices are read
    courant     the greatest |w| dt / h, such as 0.5
    hold        (V,) bool, further vertices whose rows are read

    Raises ValueError for a `courant` that is not positive, and InvalidMeshError as `femwarp` does.
    """
    if not courant > 0:
        raise ValueError(f"courant must be positive, not {courant}")
    way = (femwarp(batch, new_points, hold=hold).points - batch.points).to(torch.float64).norm(dim=1)
    t = corners(batch.points.to(torch.float64), batch.triangles)
    longest = torch.stack(edge_lengths(t)).amax(0)
    number = way[batch.triangles].amax(1) * longest / (2 * signed_area(t))
    return courant / segment_max(number, batch.triangle_offsets)
