"""Positions rounded to a grid so fine that no shape changes, and so coarse that rounding errors vanish on it.

Which of two diagonals is better, or when a minimisation ends, may hang on the last digit of a coordinate.  In a time
loop two runs whose bodies differ by 1e-13 would thus end with different edges all over the mesh.  Where decisions are
made on rounded positions, they are the same unless a coordinate lies right between two points of the grid.
"""

import torch
from torch import Tensor

from .batch import MeshBatch
from .measure import upright
from .ragged import segment_any, spread
from .triangle import corners, edge_lengths, signed_area

# The grid at a vertex is this power of two finer than the least height of a triangle at it.
_FINER = 14


def rounded(mesh: MeshBatch, at: Tensor) -> MeshBatch:
    """The batch with the positions of the meshes `at` (B,) bool rounded; not where that would invert a triangle.

    The grid at a vertex is a power of two, at most 2^-14 of the least height of a triangle at it.
    """
    if not bool(at.any()):
        return mesh
    t = corners(mesh.points.to(torch.float64), mesh.triangles)
    height = 2 * signed_area(t).abs() / torch.stack(edge_lengths(t)).amax(0)
    least = torch.full((len(mesh.points),), torch.inf, dtype=torch.float64, device=height.device)
    least.scatter_reduce_(0, mesh.triangles.reshape(-1), height.repeat_interleave(3), "amin")
    good = least.isfinite() & (least > 0) & spread(at, mesh.point_offsets)
    exponent = torch.frexp(torch.where(good, least, 1.0)).exponent - 1 - _FINER
    grid = torch.ldexp(torch.ones_like(least), exponent)[:, None]
    points = (mesh.points.to(torch.float64) / grid).round() * grid
    points = torch.where(good[:, None] & points.isfinite().all(1, keepdim=True), points, mesh.points.to(torch.float64))
    found = mesh.with_points(points.to(mesh.points.dtype))
    bad = segment_any(~upright(found), mesh.triangle_offsets)
    return (
        found
        if not bool(bad.any())
        else mesh.with_points(torch.where(spread(bad, mesh.point_offsets)[:, None], mesh.points, found.points))
    )


def unrounded(after: MeshBatch, rounded: MeshBatch, given: MeshBatch, stays: Tensor) -> MeshBatch:
    """`after`, which was made from `rounded`, with the given positions of all vertices that stay or did not move.

    stays  (V,) bool
    """
    back = stays | (after.points == rounded.points).all(1)
    return after.with_points(torch.where(back[:, None], given.points, after.points))
