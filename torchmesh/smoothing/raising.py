"""Slivers that the minimiser cannot see as upright, or whose energy overflows, are raised first.

     .                       v             A vertex v lies so near to the opposite edge that the height is lost when
    /  \\         ->        /   \\           positions are measured from the middle of the mesh.  It is moved away
a --- v --- b            a ------- b       from such edges, as far as all its triangles stay upright by exact signs.
"""

import numpy as np
import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.connectivity import corners_of, touching
from ..mesh.ragged import spread, true_rows
from ..mesh.units import centre_and_unit_of_triangles
from ..triangulating.arrays import signs

# A triangle whose area is at most this part of the square of an edge is raised.
_FLAT = 1e-12

# A vertex moves by this part of the mean length of its edges at first, and by halves of it so often.
_FIRST = 0.25
_HALVES = 36


def raised(batch: MeshBatch, free: Tensor, at: Tensor) -> MeshBatch:
    """The batch with the slivers of the meshes `at` (B,) bool raised, as far as their `free` (V,) corners allow it.

    All triangles of these meshes must be upright, and stay so.
    """
    triangles = batch.triangles
    flat = _flat(_centred(batch)[triangles]) & spread(at, batch.triangle_offsets)
    near = touching(triangles, corners_of(triangles, flat, len(batch.points)))
    star, movable = triangles[near].cpu().numpy(), free.cpu()
    points = batch.points.detach().clone().cpu()
    for row in triangles[true_rows(flat)].tolist():
        ends = points[row].double()
        if bool(_flat(ends[None])):
            opposite = (ends[[1, 2, 0]] - ends[[2, 0, 1]]).norm(dim=1)
            for k in opposite.argsort(descending=True).tolist():
                if bool(movable[row[k]]) and _raise(points, star, row[k]):
                    break
    return batch.with_points(points.to(batch.points.device))


def _centred(batch: MeshBatch) -> Tensor:
    """(V, 2) float64 the positions as `optimising.objective.pack` measures them."""
    offsets = batch.point_offsets
    centre, unit = centre_and_unit_of_triangles(batch.points, batch.triangles, offsets)
    return (batch.points.to(torch.float64) - spread(centre, offsets)) / spread(unit, offsets)[:, None]


def _flat(corner: Tensor) -> Tensor:
    """(T,) bool: the triangles with the corners (T, 3, 2) are all but flat."""
    (e1x, e1y), (e2x, e2y) = ((corner[:, k] - corner[:, 0]).unbind(1) for k in (1, 2))
    return e1x * e2y - e1y * e2x <= _FLAT * torch.maximum(e1x * e1x + e1y * e1y, e2x * e2x + e2y * e2y)


def _raise(points: Tensor, star: np.ndarray, vertex: int) -> bool:
    """Move the vertex in `points` (V, 2) away from the opposite edges of its flat triangles; has it moved?

    star  (N, 3) triangles, among them all those of the vertex
    """
    rows, corner = np.nonzero(star == vertex)
    link = points[torch.from_numpy(np.stack([star[rows, (corner + k) % 3] for k in (1, 2)], 1))].double()
    here = points[vertex].double()
    flat = _flat(torch.cat([here.expand(len(link), 1, 2), link], 1))
    along = link[flat, 1] - link[flat, 0]
    inward = torch.stack([-along[:, 1], along[:, 0]], 1) / along.norm(dim=1, keepdim=True)
    way = inward.sum(0) * _FIRST * (link - here).norm(dim=2).mean()
    for halves in range(_HALVES):
        # The places in which all triangles are upright form a convex set: in its middle there is room on both sides.
        far, half = ((here + way * 0.5 ** (halves + k)).to(points) for k in (0, 1))
        if _all_upright(far, link) and _all_upright(half, link):
            points[vertex] = half
            return True
    return False


def _all_upright(apex: Tensor, link: Tensor) -> bool:
    """Are the triangles from a vertex at `apex` (2,) to the edges `link` (N, 2, 2) upright, by exact signs?"""
    places = torch.cat([apex.double()[None], link.reshape(-1, 2)]).numpy()
    first = 1 + 2 * np.arange(len(link))
    return bool((signs(places, np.zeros_like(first), first, first + 1) > 0).all())
