"""The neighbourhood of damage in one mesh: rings of vertices round it, found without a search of the whole mesh."""

from dataclasses import dataclass

import torch
from torch import Tensor

from ..mesh.connectivity import corners_of, touching
from ..mesh.ragged import take, true_rows
from ..mesh.triangle import corners, squared_edge_lengths

# The search for vertices near the damage divides a mesh into at most so many cells along each axis.
_CELLS = 1000


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """A part of one mesh round its damage.  All rows are rows of the mesh.

    vertices   (v,) int64, ascending
    shared     (v,) bool, the vertices that triangles outside may have, too
    triangles  (t,) int64, ascending; all the triangles at vertices that are not shared
    across     (n, 2) int64, the edges of other triangles whose ends are both among the vertices
    """

    vertices: Tensor
    shared: Tensor
    triangles: Tensor
    across: Tensor


# How many rings are taken before it is seen whether they are too many already.
_RINGS_AT_ONCE = 8


def neighbourhood(
    points: Tensor, triangles: Tensor, damage: Tensor, rings: int, most: int | None = None
) -> Neighbourhood | None:
    """The neighbourhood that consists of damaged triangles and `rings` rings of vertices round them.

    It is None if it has more than `most` triangles.

    points     (V, 2), with which vertices that cannot be near are left out of the search; the result does not depend
               on them
    triangles  (T, 3) int64
    damage     (D,) int64, rows of the damaged triangles
    """
    x, y = points[:, 0].contiguous(), points[:, 1].contiguous()
    low, high = zip(*([float(v) for v in c.aminmax()] for c in (x, y)), strict=True)
    extent = max(high[0] - low[0], high[1] - low[1])
    longest = torch.stack(squared_edge_lengths(corners(points, triangles[damage])), 1).amax(1).sqrt()
    # The length is zero if all the damage is in one point.
    reach = max(rings * float(longest.median()), extent / _CELLS)
    while True:
        near = _nearby(x - low[0], y - low[1], extent, triangles[damage], reach)
        found = _grown(triangles, damage, rings, near, len(triangles) if most is None else most)
        if isinstance(found, Neighbourhood):
            return found
        if found:
            return None
        reach *= 2


def _grown(triangles: Tensor, damage: Tensor, rings: int, near: Tensor, most: int) -> Neighbourhood | bool:
    """The neighbourhood if all its vertices are `near` (V,) bool, so that no triangle at them is missed.

    If not, whether it has more than `most` triangles for certain.
    """
    # The work is done on the near triangles and vertices, with rows of their own; the result has rows of the mesh.
    faces = true_rows(touching(triangles, near))
    here = take(triangles, faces)
    rows = true_rows(torch.zeros_like(near).index_fill_(0, here.reshape(-1), True))
    number = torch.empty(len(near), dtype=torch.int64, device=near.device)
    number[rows] = torch.arange(len(rows), device=near.device)
    here = number[here]
    free = torch.zeros_like(rows, dtype=torch.bool).index_fill_(0, number[triangles[damage]].reshape(-1), True)
    for ring in range(1, rings):
        taken = touching(here, free)
        if ring % _RINGS_AT_ONCE == 0 and int(taken.sum()) > most:
            return True
        free = corners_of(here, taken, len(rows))
    taken = touching(here, free)
    if int(taken.sum()) > most:
        return True
    mine = corners_of(here, taken, len(rows))
    if not bool(near[rows[mine]].all()):
        return False
    outside = here[~taken]
    edges = torch.cat([outside[:, [0, 1]], outside[:, [1, 2]], outside[:, [2, 0]]])
    across = edges[mine[edges].all(1)]
    return Neighbourhood(rows[mine], ~free[mine], faces[taken], rows[across])


def _nearby(x: Tensor, y: Tensor, extent: float, damaged: Tensor, reach: float) -> Tensor:
    """(V,) bool: all the vertices within `reach` of a corner of the `damaged` triangles (D, 3), and not many others.

    These are the vertices in the cell of such a corner in a square grid, or in one of the eight cells round it.
    x and y (V,) are between 0 and `extent`.
    """
    if not reach < extent:
        return torch.ones_like(x, dtype=torch.bool)
    # The grid has one more cell on every side, so that eight cells lie round each vertex.
    cells = int(extent / reach) + 4
    cell = (y / reach + 1).to(torch.int32) * cells + (x / reach + 1).to(torch.int32)
    marked = torch.zeros(cells * cells, dtype=torch.bool, device=x.device)
    marked[cell[damaged.reshape(-1)].long()] = True
    marked = marked.reshape(cells, cells)
    wide = marked | marked.roll(1, 0) | marked.roll(-1, 0)
    wide = wide | wide.roll(1, 1) | wide.roll(-1, 1)
    return take(wide.reshape(-1), cell)
