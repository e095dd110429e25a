"""A triangulation of the vertices of a mesh whose own triangles overlap: what lies between them, and no more.

It is the Delaunay triangulation of the vertices inside the boundary, with the boundary and the constrained edges as
edges of it.  A hole stays a hole, and values on the two sides of an interface are not mixed.
"""

import numpy as np
import torch

from ..mesh import connectivity
from ..triangulating.arrays import signs
from ..triangulating.polygon import loops_of, why_not_simple, winding
from ..triangulating.polygon_triangulation import triangulate_with


def domain_triangles(points: np.ndarray, triangles: np.ndarray, constrained: np.ndarray) -> np.ndarray:
    """(T', 3) counter-clockwise triangles over the vertices of one mesh.

    points       (V, 2) float64
    triangles    (T, 3) the triangles of the mesh, which only tell its boundary and which vertices are used
    constrained  (K, 2) edges that are to be kept

    Where the boundary is no simple polygon, or where edges cross each other, there is no such triangulation.  Then it
    is the Delaunay triangulation without the triangles whose middle lies outside the boundary.
    """
    faces = torch.from_numpy(triangles)
    boundary = connectivity.boundary_edges(faces, connectivity.twins(faces)).numpy()
    loops = loops_of(boundary)
    used = np.unique(triangles)
    inner = _one_at_each_position(points, used, np.unique(boundary))
    if why_not_simple(points, loops) is None:
        for segments in (constrained, constrained[:0]):
            made = triangulate_with(points, loops, np.zeros(len(points)), inner, segments)
            if made is not None:
                return made.corners
            if not len(constrained):
                break
    return _unconstrained(points, np.concatenate([np.unique(boundary), inner]), boundary)


def _one_at_each_position(points: np.ndarray, used: np.ndarray, boundary: np.ndarray) -> np.ndarray:
    """The `used` vertices that are not on the boundary, one of those that coincide and none on a boundary vertex."""
    order = np.concatenate([boundary, np.setdiff1d(used, boundary)])
    _, first = np.unique(points[order], axis=0, return_index=True)
    return order[np.sort(first[first >= len(boundary)])]


def _unconstrained(points: np.ndarray, vertices: np.ndarray, boundary: np.ndarray) -> np.ndarray:
    from scipy.spatial import Delaunay, QhullError

    vertices = vertices[np.sort(np.unique(points[vertices], axis=0, return_index=True)[1])]
    try:
        corners = vertices[Delaunay(points[vertices]).simplices.astype(np.int64)]
    except QhullError:  # fewer than three vertices, or all on a line
        return np.zeros((0, 3), np.int64)
    sign = signs(points, *corners.T)
    corners = np.where((sign < 0)[:, None], corners[:, ::-1], corners)[sign != 0]
    middles = points[corners].mean(1)
    everything = np.concatenate([points, middles])
    return corners[winding(everything, len(points) + np.arange(len(corners)), boundary) != 0]
