"""Triangulations inside a boundary that lies over itself, as a strip of more than one turn does.

Such a loop bounds a disc that is laid into the plane with overlaps.  Whether it does is decided by the triangles
themselves, chord by chord (Shor & Van Wyk, Detecting and decomposing self-overlapping curves, Computational Geometry 2,
1992): the part of the loop from i to j, closed by the chord from j to i, can be triangulated if some k between them
makes a counter-clockwise triangle i, k, j, and the parts from i to k and from k to j can be triangulated.
"""

import numpy as np

from .arrays import signs

# The work grows with the third power of the vertices: a second at this number.
MOST = 240


def triangulate_immersed(points: np.ndarray, loop: np.ndarray) -> np.ndarray | None:
    """(n-2, 3) counter-clockwise triangles of the vertices of `loop` (n,), on its left; None if there are none.

    Of several vertices k the one that sees its chord under the largest angle is taken, as in a Delaunay triangulation.
    None, too, for loops of more than MOST vertices.
    """
    n = len(loop)
    if not 3 <= n <= MOST:
        return None
    third = np.full((n, n), -1)
    possible = np.eye(n, k=1, dtype=bool)
    xy = points[loop]
    for length in range(2, n):
        for i in range(n - length):
            j = i + length
            k = np.arange(i + 1, j)
            k = k[possible[i, k] & possible[k, j]]
            k = k[signs(points, np.full(len(k), loop[i]), loop[k], np.full(len(k), loop[j])) > 0] if len(k) else k
            if len(k):
                possible[i, j] = True
                third[i, j] = k[_angle_rank(xy[i], xy[k], xy[j]).argmax()]
    if not possible[0, n - 1]:
        return None
    corners, waiting = [], [(0, n - 1)]
    while waiting:
        first, last = waiting.pop()
        if last - first > 1:
            between = int(third[first, last])
            corners.append((first, between, last))
            waiting += [(first, between), (between, last)]
    return loop[np.array(corners)]


def _angle_rank(a: np.ndarray, p: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(K,) minus the cosine of the angle at each p (K, 2) between a and b."""
    u, v = a - p, b - p
    with np.errstate(all="ignore"):
        cosine = (u * v).sum(1) / np.sqrt((u * u).sum(1) * (v * v).sum(1))
    return np.where(np.isfinite(cosine), -cosine, -1.0)
