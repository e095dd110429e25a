"""Vertices inserted into a triangulation at free positions, where triangles are too large."""

import numpy as np

from .triangulation import Triangulation

# Where to try to put a vertex into a triangle, as weights of its corners: the centroid, and positions where a
# triangle that is only a few floating-point numbers wide may still have one inside.
_WEIGHTS = [
    (1, 1, 1),
    (2, 1, 1),
    (1, 2, 1),
    (1, 1, 2),
    (1, 2, 2),
    (2, 1, 2),
    (2, 2, 1),
    (6, 1, 1),
    (1, 6, 1),
    (1, 1, 6),
]


def place_vertices(work: Triangulation, vertices: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """Insert `vertices` (N,) at centroids of the triangles that exceed their `spacing` most.

    Positions are rounded to `dtype`, and used only if they are inside by exact signs.  Returns the
    vertices for which no triangle has room left between the floating-point numbers.
    """
    full = np.zeros(len(work.corners), bool)
    if len(vertices):
        work.flip_to_delaunay(np.arange(len(work.corners)))
    while len(vertices):
        a, b, c = (work.points[work.corners[:, i]] for i in range(3))
        area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        excess = np.where(full, 0.0, np.maximum(area, np.finfo(float).tiny))
        excess /= work.spacing[work.corners].mean(1) ** 2
        most = excess.max()
        if most <= 0:
            break
        t = np.flatnonzero(excess > most / 3)
        if len(t) > len(vertices):
            t = t[np.argsort(-excess[t], kind="stable")[: len(vertices)]]
        used = vertices[: len(t)]
        inside = np.zeros(len(t), bool)
        for one, two, three in _WEIGHTS:
            out = np.flatnonzero(~inside)
            if not len(out):
                break
            s, total = t[out], one + two + three
            positions = a[s] + (two * (b[s] - a[s]) + three * (c[s] - a[s])) / total
            work.points[used[out]] = positions.astype(dtype)
            inside[out] = (work.sides(s, used[out]) > 0).all(1)
        full[t[~inside]] = True
        if not inside.any():
            continue
        work.points[used[: inside.sum()]] = work.points[used[inside]]
        used = used[: inside.sum()]
        vertices = vertices[len(used) :]
        slots, _ = work.fan(3 * t[inside][:, None] + np.arange(3), used)
        full = np.concatenate([full, np.zeros(len(work.corners) - len(full), bool)])
        # A flip may make room again.
        full[work.flip_to_delaunay(slots.ravel())] = False
    return vertices
