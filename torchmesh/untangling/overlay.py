r"""A start inside the domain for meshes of a disc: by way of a circle, where both mesh and domain are valid.

      the mesh               on a circle               the domain, triangulated
      on a circle            the domain                with its boundary's vertices only
      .-----.                .-----.                   +--+  +--+
     / \ | / \              / \  /| \                  |\ |  | /|      A vertex lies in a cell on the circle, and goes
    |---v---|      over    |   \/ |  |      to         | \+--+/ |      to the same position in that cell of the domain.
     \ / | \ /              \  /\ | /                  |  v    \|
      '-----'                '-----'                   +--------+

Every free vertex at the mean of its neighbours makes a mesh valid whose boundary is convex (Tutte, How to draw a graph,
1963; Floater, Parametric tilings and scattered data approximation, 1998), and any triangulation of a polygon is valid
on a circle.  The map between is one to one, so that vertices are in the domain and in order; only edges may cut across
its boundary.  For long bands this is a much better start than means of neighbours in the domain itself.
"""

import numpy as np
import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.certificate import euler_numbers
from ..mesh.connectivity import boundary_edges
from ..optimising.laplacian import harmonic_extension

# So many pairs of a vertex and a cell are looked at together.
_PAIRS = 4_000_000


def overlaid(mesh: MeshBatch, free: Tensor) -> Tensor | None:
    """(V, 2) positions of one mesh, by way of a circle; None unless it is a disc whose boundary is fixed, and simple.

    free  (V,) bool, the vertices that move: all but those of the boundary
    """
    from ..triangulating.arrays import Obstacle
    from ..triangulating.polygon_triangulation import triangulate_polygon

    used = torch.zeros_like(free).index_fill_(0, mesh.triangles.ravel(), True)
    loops = loops_around(mesh, used & ~free, 1)
    if loops is None:
        return None
    points = mesh.points.to(torch.float64)
    work = triangulate_polygon(points.numpy().copy(), loops, np.ones(len(points)))
    if isinstance(work, Obstacle):
        return None
    angle = 2 * np.pi * np.arange(len(loops[0])) / len(loops[0])
    circle = torch.zeros_like(points)
    circle[torch.from_numpy(loops[0])] = torch.from_numpy(np.stack([np.cos(angle), np.sin(angle)], 1))
    one = torch.ones(len(mesh.triangles), dtype=torch.float64)
    there = harmonic_extension(mesh.triangles, (one, one, one), ~free, circle, mesh.point_offsets)
    moves = (used & free).nonzero().squeeze(1)
    cells = torch.from_numpy(work.corners)
    over = points.clone()
    over[moves] = through_cells(there[moves], circle[cells], points[cells])
    return over.to(mesh.points)


def loops_around(mesh: MeshBatch, held: Tensor, count: int) -> list[np.ndarray] | None:
    """The vertices of each loop of the boundary; None unless the mesh is in one piece and has so many simple loops.

    held  (V,) bool, the vertices of triangles that do not move; None is returned if they are not those of the boundary
    """
    from ..triangulating.polygon import loops_of

    boundary = boundary_edges(mesh.triangles, mesh.twin)
    # Simple loops have as many vertices as edges.
    if len(boundary) != int(held.sum()) or not bool(held[boundary].all()):
        return None
    loops = loops_of(boundary.numpy())
    # V - E + F is 1 for a disc, and one less for each hole.
    in_one_piece = int(euler_numbers(mesh, mesh.twin)) == 2 - count
    return loops if len(loops) == count and in_one_piece else None


def through_cells(at: Tensor, here: Tensor, there: Tensor) -> Tensor:
    """(N, 2) where the points `at` (N, 2) go by the map that takes each cell from one position to another.

    here, there  (C, 3, 2) the corners of the cells

    A point that by rounding is in no cell goes with the nearest one.
    """
    a, b, c = here.unbind(1)
    found = torch.empty_like(at)
    step = max(1, _PAIRS // len(here))
    for first in range(0, len(at), step):
        p = at[first : first + step, None]
        weight = torch.stack([_double_area(b, c, p), _double_area(c, a, p), _double_area(a, b, p)], -1)
        weight = weight / weight.sum(-1, keepdim=True)
        cell = weight.amin(-1).nan_to_num(-torch.inf).argmax(1)
        part = weight[torch.arange(len(cell)), cell].clamp_min(0)
        part = part / part.sum(-1, keepdim=True)
        found[first : first + step] = (part[:, :, None] * there[cell]).sum(1)
    return found


def _double_area(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    u, w = b - a, c - a
    return u[..., 0] * w[..., 1] - u[..., 1] * w[..., 0]
