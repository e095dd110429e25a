"""Slits of no width: two stretches of boundary that lie on each other, with the mesh on both sides.

        a ---- b          the edges a b and c d lie on each other, as do a and d, b and c:
        d ---- c          sewn up, the slit is a constrained edge a b of an ordinary mesh

A crack in a model is one.  The boundary touches itself there, and yet valid triangles exist.
"""

import numpy as np


def sewing(points: np.ndarray, triangles: np.ndarray, boundary: np.ndarray, piece: np.ndarray) -> np.ndarray | None:
    """(V,) for each vertex the first of those it is sewn to, if there is a slit that can be sewn up; else None.

    points (V, 2); triangles (T, 3); boundary (E, 2) the boundary edges, with the mesh on their left; piece (V,)
    labels what is joined by edges: pieces are not sewn to each other.

    Not sewn is what would give a triangle twice the same corner, or an edge three triangles.
    """
    # np.unique would sort, and load numpy.ma.
    vertices, position = np.flatnonzero(np.bincount(boundary.reshape(-1))), np.full(len(points), -1)
    order = vertices[np.lexsort((points[vertices, 1], points[vertices, 0], piece[vertices]))]
    new = (points[order[1:]] != points[order[:-1]]).any(1) | (piece[order[1:]] != piece[order[:-1]])
    if new.all():
        return None
    position[order] = np.cumsum(np.concatenate([[True], new])) - 1
    tail, head = position[boundary].T
    there, back = tail * len(points) + head, head * len(points) + tail
    known, first, times = np.unique(there, return_index=True, return_counts=True)
    at = np.minimum(np.searchsorted(known, back), len(known) - 1)
    own = np.searchsorted(known, there)
    facing = (known[at] == back) & (times[at] == 1) & (times[own] == 1) & (tail != head)
    one, two = boundary[facing], boundary[first[at[facing]]][:, ::-1]
    if not len(one):
        return None
    name = np.arange(len(points))
    while True:
        before = name.copy()
        least = np.minimum(name[one], name[two])
        np.minimum.at(name, one, least)
        np.minimum.at(name, two, least)
        name = name[name]
        if np.array_equal(name, before):
            break
    sewn = name[triangles]
    ways = np.concatenate([sewn[:, [0, 1]], sewn[:, [1, 2]], sewn[:, [2, 0]]])
    keys = np.sort(ways[:, 0] * len(points) + ways[:, 1])
    sound = (ways[:, 0] != ways[:, 1]).all() and (keys[1:] != keys[:-1]).all()
    return name if sound else None
