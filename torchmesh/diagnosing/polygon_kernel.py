"""What no positions of the free vertices can mend while the triangles stay: found by exact signs.

Not everything is found: whether valid positions exist is as hard as a system of quadratic inequalities.
These are the obstructions that one triangle, or the fixed edges round one vertex, show.  (An interior vertex
of fewer than three triangles, which none could mend either, is no part of an oriented manifold.)
"""

import itertools
from typing import TYPE_CHECKING

import numpy as np

from ..triangulating.arrays import signs

if TYPE_CHECKING:
    from fractions import Fraction

# Up to this many triangles round a vertex all triples of them are asked; beyond, a linear program.
_TRIPLES = 14


# Vertices judged at once.
_CHUNK = 1000


# What a linear program's maximum must fall short of zero by, in units of the ring's extent.
_SHORT = 1e-7


def inverted_fixed_triangles(points: np.ndarray, triangles: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """(N,) the rows of `triangles` whose three vertices are fixed and which are not upright."""
    rows = np.flatnonzero(fixed[triangles].all(1))
    return rows[signs(points, *triangles[rows].T) <= 0]


def vertices_without_kernel(
    points: np.ndarray, triangles: np.ndarray, fixed: np.ndarray, inner: np.ndarray, enough: int | None = None
) -> np.ndarray:
    """(N,) the free vertices of `inner` (V,) bool for which the fixed edges round them leave no position.

    enough  stop looking when so many are found

    A position is good when it lies strictly left of every edge of the ring.  Edges with a free end say nothing yet.
    By Helly's theorem there is no position exactly if three of these half-planes have nothing in common.
    """
    alone = (~fixed)[triangles].sum(1) == 1
    rows, corner = np.nonzero((~fixed & inner)[triangles] & alone[:, None])
    if not len(rows):
        return rows
    centre = triangles[rows, corner]
    ring = np.stack([triangles[rows, (corner + 1) % 3], triangles[rows, (corner + 2) % 3]], 1)
    order = np.argsort(centre, kind="stable")
    centre, ring = centre[order], ring[order]
    vertices, start, degree = np.unique(centre, return_index=True, return_counts=True)
    found = [vertices[:0]]
    for d in np.unique(degree).tolist():
        same = np.flatnonzero(degree == d)
        chunk = _CHUNK if d <= _TRIPLES else 1
        for first in range(0, len(same), chunk):
            if enough is not None and sum(map(len, found)) >= enough:
                break
            at = same[first : first + chunk]
            edges = ring[start[at][:, None] + np.arange(d)]
            empty = _empty_by_triples(points, edges) if d <= _TRIPLES else _empty_by_program(points, edges)
            found.append(vertices[at[empty]])
    return np.sort(np.concatenate(found))


def farkas_weights(points: np.ndarray, edges: np.ndarray) -> "tuple[np.ndarray, list[Fraction]] | None":
    """Three of the `edges` (d, 2) whose left sides have nothing in common, and weights that prove it (Farkas 1902).

    A point p is left of an edge if n.p > c.  The weights are not negative, not all zero, add the n to zero, and the c
    to no less than zero: then no p exists.
    """
    for some in itertools.combinations(range(len(edges)), 3):
        weights = _weights(points, edges[list(some)])
        if weights is not None:
            return edges[list(some)], weights
    return None


def _half_planes(points: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normals (M, d, 2) and offsets (M, d): n.p > c left of the edges (M, d, 2), in units of each ring."""
    xy = points[edges]
    low, high = xy.min((1, 2)), xy.max((1, 2))
    extent = np.maximum((high - low).max(1), np.finfo(float).tiny)[:, None, None, None]
    xy = (xy - low[:, None, None]) / extent
    a, b = xy[:, :, 0], xy[:, :, 1]
    normal = np.stack([a[..., 1] - b[..., 1], b[..., 0] - a[..., 0]], -1)
    return normal, (normal * a).sum(-1)


def _empty_by_triples(points: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(M,) bool: three of each vertex's half-planes, left of `edges` (M, d, 2), have nothing in common."""
    normal, offset = _half_planes(points, edges)
    empty = np.zeros(len(edges), bool)
    for i, j, k in itertools.combinations(range(edges.shape[1]), 3):
        # Farkas: weights that add the normals to zero and the offsets to no less.
        n, c = normal[:, [i, j, k]], offset[:, [i, j, k]]
        weight = np.stack([_cross(n[:, p], n[:, q]) for p, q in ((1, 2), (2, 0), (0, 1))], 1)
        same = (weight > -1e-12).all(1) | (weight < 1e-12).all(1)
        total = np.where((weight > -1e-12).all(1), 1, -1) * (weight * c).sum(1)
        for row in np.flatnonzero(same & (total > -1e-12) & ~empty):
            empty[row] = _surely_empty(points, edges[row, [i, j, k]])
    return empty


def _cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def _surely_empty(points: np.ndarray, edges: np.ndarray) -> bool:
    """Do the open half-planes left of three `edges` (3, 2) have nothing in common, in rational arithmetic?"""
    return _weights(points, edges) is not None


def _weights(points: np.ndarray, edges: np.ndarray) -> "list[Fraction] | None":
    """The weights of `farkas_weights` of three `edges` (3, 2), if there are some."""
    from fractions import Fraction

    normal, offset = [], []
    for a, b in points[edges].tolist():
        (ax, ay), (bx, by) = (tuple(map(Fraction, p)) for p in (a, b))
        normal.append((ay - by, bx - ax))
        offset.append((ay - by) * ax + (bx - ax) * ay)
    weight = [normal[p][0] * normal[q][1] - normal[p][1] * normal[q][0] for p, q in ((1, 2), (2, 0), (0, 1))]
    if not any(weight):
        return None  # parallel to each other: other triples tell
    if max(weight) <= 0:
        weight = [-w for w in weight]
    total = sum(w * c for w, c in zip(weight, offset, strict=True))
    return weight if min(weight) >= 0 and total >= 0 else None


def _empty_by_program(points: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(M,) bool: no position is left of all `edges` (M, d, 2) by a margin that rounding explains."""
    from scipy.optimize import linprog

    normal, offset = _half_planes(points, edges)
    length = np.maximum(np.linalg.norm(normal, axis=2), np.finfo(float).tiny)
    normal, offset = normal / length[..., None], offset / length
    empty = np.zeros(len(edges), bool)
    for row in range(len(edges)):
        rows = np.concatenate([-normal[row], np.ones((edges.shape[1], 1))], 1)
        best = linprog([0, 0, -1], rows, -offset[row], bounds=[(None, None), (None, None), (None, 1)])
        empty[row] = best.x is not None and best.x[2] < -_SHORT
    return empty
