"""Independent yardsticks: a serial compiled loop for the smoother's energy, and an exact Delaunay check.

They do without torchmesh's kernels and predicates.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

import numpy as np

Array = np.ndarray


def serial_energy() -> Callable[[Array, Array, Array], float]:
    """A compiled loop over triangles: (points (V, 2), triangles (T, 3), gradient (V, 2) filled) to sum of q^2.

    q is the inverse mean ratio (Kim 2017, equation 4).  One thread, float64, no fast-math.
    """
    import numba

    @numba.njit(boundscheck=False)
    def energy(points, triangles, gradient):  # type: ignore[no-untyped-def]
        gradient[:] = 0.0
        total = 0.0
        for t in range(triangles.shape[0]):
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
            vx, vy = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
            det = ux * vy - uy * vx
            # ||E W^-1||^2 = 4/3 (|u|^2 - u.v + |v|^2) and det(W^-1) = 2 / sqrt(3), so q = s / (sqrt(3) det).
            s = ux * ux + uy * uy - ux * vx - uy * vy + vx * vx + vy * vy
            inverse = 1.0 / (1.7320508075688772 * det)
            q = s * inverse
            total += q * q
            # d q^2 = 2 q (ds / (sqrt(3) det) - q d det / det)
            by_s, by_det = 2.0 * q * inverse, -2.0 * q * q / det
            fux, fuy = by_s * (2.0 * ux - vx) + by_det * vy, by_s * (2.0 * uy - vy) - by_det * vx
            fvx, fvy = by_s * (2.0 * vx - ux) - by_det * uy, by_s * (2.0 * vy - uy) + by_det * ux
            gradient[b, 0] += fux
            gradient[b, 1] += fuy
            gradient[c, 0] += fvx
            gradient[c, 1] += fvy
            gradient[a, 0] -= fux + fvx
            gradient[a, 1] -= fuy + fvy
        return total

    return energy


def interior_edges(triangles: Array) -> Array:
    """(E, 4) each interior edge: its ends u and w, the vertex s of the triangle on its left, r of that on its right."""
    tail, head, opposite = triangles.ravel(), np.roll(triangles, -1, 1).ravel(), np.roll(triangles, 1, 1).ravel()
    key = np.minimum(tail, head) * (int(triangles.max()) + 1) + np.maximum(tail, head)
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    if len(ordered) > 2 and (ordered[2:] == ordered[:-2]).any():
        raise ValueError("an edge has three triangles")
    first = np.flatnonzero(ordered[1:] == ordered[:-1])
    h, g = order[first], order[first + 1]
    if (tail[h] != head[g]).any():
        raise ValueError("two neighbours run along their edge the same way")
    return np.stack([tail[h], head[h], opposite[h], opposite[g]], 1)


def not_delaunay(points: Array, triangles: Array) -> int:
    """How many interior edges have the opposite vertex strictly inside the circle of the other triangle.

    Long doubles decide where their error bound allows; the other edges are computed in fractions.
    """
    u, w, s, r = points[interior_edges(triangles).T].astype(np.longdouble)
    ax, ay, bx, by, cx, cy = *(u - r).T, *(w - r).T, *(s - r).T
    a2, b2, c2 = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    det = a2 * (bx * cy - by * cx) + b2 * (cx * ay - cy * ax) + c2 * (ax * by - ay * bx)
    size = a2 * (abs(bx * cy) + abs(by * cx)) + b2 * (abs(cx * ay) + abs(cy * ax)) + c2 * (abs(ax * by) + abs(ay * bx))
    unsure = np.flatnonzero(abs(det) <= 64 * np.finfo(np.longdouble).eps * size)
    count = int((det > 0).sum()) - int((det[unsure] > 0).sum())
    return count + sum(_inside(*rows) for rows in zip(*(np.float64(v[unsure]) for v in (u, w, s, r)), strict=True))


def _inside(*corners: Array) -> bool:
    u, w, s, r = ([Fraction(float(x)) for x in corner] for corner in corners)
    (ax, ay), (bx, by), (cx, cy) = ([p[0] - r[0], p[1] - r[1]] for p in (u, w, s))
    return (ax * ax + ay * ay) * (bx * cy - by * cx) + (bx * bx + by * by) * (cx * ay - cy * ax) + (
        cx * cx + cy * cy
    ) * (ax * by - ay * bx) > 0
