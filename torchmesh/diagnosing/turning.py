"""How often a boundary turns round: too few turns are a proof that no valid mesh exists, of whatever triangles.

        +----<----+       In a valid mesh the angles round an inner vertex sum to 360 degrees, those of a triangle to
        |         |       180.  Summed over all triangles (Gauss & Bonnet) the boundary turns left by 360 degrees times
        +---->----+       the Euler number chi: once for a disc, not at all for an annulus, minus once for two holes.

The boundary alone tells the turn at each of its vertices, except for whole turns.  The turn is 180 degrees less the sum
of the angles of the triangles there; that sum is positive, and it may exceed 360 degrees where a mesh lies over itself.
So the turns computed from the boundary are at least chi in every valid mesh.  Fewer are a proof of impossibility; more
prove nothing.
"""

import math

import torch
from torch import Tensor

from ..mesh import connectivity
from ..mesh.batch import MeshBatch
from ..mesh.predicates import orientation
from ..mesh.ragged import true_rows


def turns_too_little(batch: MeshBatch) -> Tensor:
    """(B,) bool: some component of the mesh has a boundary that turns less often than its Euler number.

    No valid mesh of that topology has this boundary.  The signs of turns are exact, their sum is a whole number of
    turns, so that rounding does no harm; a component whose boundary has an edge without length proves nothing.
    """
    triangles, twin = batch.triangles, batch.twin
    label = connectivity.triangle_components(triangles, twin)
    count = int(label.max()) + 1 if len(label) else 0
    here = true_rows(twin < 0)
    turn, clear = _turns(batch, here, _onward(twin, here))
    owner = label[here // 3]
    total = turn.new_zeros(count).index_add_(0, owner, turn) / (2 * math.pi)
    known = torch.ones(count, dtype=torch.bool, device=label.device)
    known[owner[~clear]] = False
    few = (total.round() < _euler_numbers(batch, label, owner, count)) & known
    found = torch.zeros(len(batch), dtype=torch.bool, device=label.device)
    faces = true_rows(few[label])
    found[torch.bucketize(faces, batch.triangle_offsets[1:], right=True)] = True
    return found


def _onward(twin: Tensor, here: Tensor) -> Tensor:
    """(E,) the boundary half-edge that follows each of the boundary half-edges `here` (E,) round the same fan."""
    onward = connectivity.next_in_triangle(here)
    while True:
        inner = true_rows(twin[onward] >= 0)
        if not len(inner):
            return onward
        onward[inner] = connectivity.next_in_triangle(twin[onward[inner]])


def _turns(batch: MeshBatch, here: Tensor, onward: Tensor) -> tuple[Tensor, Tensor]:
    """(E,) the left turn from each boundary half-edge to the next one in radians, and bool: it has a direction.

    A reversal is the turn to the right, since the angle of the triangles between is positive.
    """
    tail, head = connectivity.tails(batch.triangles), connectivity.heads(batch.triangles)
    points = batch.points.to(torch.float64)
    (ax, ay), (bx, by), (cx, cy) = (points[v].unbind(1) for v in (tail[here], head[here], head[onward]))
    side = orientation(ax, ay, bx, by, cx, cy)
    ux, uy, wx, wy = bx - ax, by - ay, cx - bx, cy - by
    # Powers of two near the lengths keep the products in range.
    long_u, long_w = torch.maximum(ux.abs(), uy.abs()), torch.maximum(wx.abs(), wy.abs())
    clear = (long_u > 0) & (long_w > 0) & long_u.isfinite() & long_w.isfinite()
    u, w = (torch.where(clear, v, 1.0) for v in (long_u, long_w))
    ux, uy, wx, wy = ux / u, uy / u, wx / w, wy / w
    angle = torch.atan2((ux * wy - uy * wx).abs(), ux * wx + uy * wy)
    straight = torch.where(ux * wx + uy * wy < 0, -math.pi, 0.0)
    return torch.where(clear, torch.where(side == 0, straight, angle * side), 0.0), clear


def _euler_numbers(batch: MeshBatch, label: Tensor, owner: Tensor, count: int) -> Tensor:
    """(C,) V - E + F of each component, a vertex where fans of the boundary meet counted once for each fan."""
    faces = torch.bincount(label, minlength=count)
    boundary = torch.bincount(owner, minlength=count)
    inner = ~connectivity.boundary_vertices(batch.triangles, batch.twin, len(batch.points))
    component = torch.full((len(batch.points),), -1, dtype=label.dtype, device=label.device)
    component[batch.triangles.reshape(-1)] = label.repeat_interleave(3)
    inside = torch.bincount(component[inner & (component >= 0)], minlength=count)
    return inside + boundary - (3 * faces + boundary) // 2 + faces
