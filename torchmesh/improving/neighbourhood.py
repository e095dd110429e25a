"""The neighbourhood of some damage in one mesh: the rings of vertices round it, found without looking at the rest."""

from dataclasses import dataclass

import torch
from torch import Tensor

from ..mesh.connectivity import corners_of, touching
from ..mesh.triangle import corners, squared_edge_lengths

# The search for what is near the damage divides a mesh into at most so many cells along each axis.
_CELLS = 1000


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """A part of one mesh round its damage; rows are those of the mesh.

    vertices   (v,) int64, ascending
    shared     (v,) bool: those that triangles outside may have, too
    triangles  (t,) int64, ascending: all the triangles at vertices that are not shared
    across     (n, 2) int64: the edges between its vertices that other triangles have
    """

    vertices: Tensor
    shared: Tensor
    triangles: Tensor
    across: Tensor


def neighbourhood(points: Tensor, triangles: Tensor, damage: Tensor, rings: int) -> Neighbourhood:
    """The `damage` (D,) int64, rows of `triangles` (T, 3), and so many rings of vertices round it.

    points  (V, 2), by which what cannot be near is left out of the search; the result does not depend on them
    """
    x, y = points[:, 0].contiguous(), points[:, 1].contiguous()
    low, high = zip(*([float(v) for v in c.aminmax()] for c in (x, y)), strict=True)
    extent = max(high[0] - low[0], high[1] - low[1])
    longest = torch.stack(squared_edge_lengths(corners(points, triangles[damage])), 1).amax(1).sqrt()
    # All the damage may be in one point.
    reach = max(rings * float(longest.median()), extent / _CELLS)
    while True:
        near = _nearby(x - low[0], y - low[1], extent, triangles[damage], reach)
        if (found := _grown(triangles, damage, rings, near)) is not None:
            return found
        reach *= 2


def _grown(triangles: Tensor, damage: Tensor, rings: int, near: Tensor) -> Neighbourhood | None:
    """The neighbourhood, if all of its vertices are `near` (V,) bool, so that no triangle at them is missed."""
    # Rows of the mesh become rows of the triangles and vertices looked at, and in the end are turned back.
    faces = touching(triangles, near).nonzero().squeeze(1)
    here = triangles.index_select(0, faces)
    rows = torch.zeros_like(near).index_fill_(0, here.reshape(-1), True).nonzero().squeeze(1)
    number = torch.empty(len(near), dtype=torch.int64, device=near.device)
    number[rows] = torch.arange(len(rows), device=near.device)
    here = number[here]
    free = torch.zeros_like(rows, dtype=torch.bool).index_fill_(0, number[triangles[damage]].reshape(-1), True)
    for _ in range(rings - 1):
        free = corners_of(here, touching(here, free), len(rows))
    taken = touching(here, free)
    mine = corners_of(here, taken, len(rows))
    if not bool(near[rows[mine]].all()):
        return None
    outside = here[~taken]
    edges = torch.cat([outside[:, [0, 1]], outside[:, [1, 2]], outside[:, [2, 0]]])
    across = edges[mine[edges].all(1)]
    return Neighbourhood(rows[mine], ~free[mine], faces[taken], rows[across])


def _nearby(x: Tensor, y: Tensor, extent: float, damaged: Tensor, reach: float) -> Tensor:
    """(V,) bool: at least the vertices within `reach` of a corner of the `damaged` (D, 3), and not many more.

    Those in the same cell of a square grid, or in one of the eight round it; x and y (V,) from 0 to `extent`.
    """
    if not reach < extent:
        return torch.ones_like(x, dtype=torch.bool)
    # With one more cell on every side, so that each has eight round it.
    cells = int(extent / reach) + 4
    cell = (y / reach + 1).to(torch.int32) * cells + (x / reach + 1).to(torch.int32)
    marked = torch.zeros(cells * cells, dtype=torch.bool, device=x.device)
    marked[cell[damaged.reshape(-1)].long()] = True
    marked = marked.reshape(cells, cells)
    wide = marked | marked.roll(1, 0) | marked.roll(-1, 0)
    wide = wide | wide.roll(1, 1) | wide.roll(-1, 1)
    return wide.reshape(-1).index_select(0, cell)
