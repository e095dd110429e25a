"""Independent judges: signs, areas and incidence in Python's exact rationals, without torchmesh."""

from collections import Counter
from fractions import Fraction

import numpy as np


def sign(value) -> int:
    return (value > 0) - (value < 0)


def whole(points) -> tuple[list[tuple[int, int]], int]:
    """The first two coordinates of points as integers of one unit, and how many units are one: a power of two.

    Integers multiply several times faster than rationals.
    """
    ratios = [(float(p[0]).as_integer_ratio(), float(p[1]).as_integer_ratio()) for p in points]
    unit = max((d for pair in ratios for _, d in pair), default=1)
    return [(x * (unit // dx), y * (unit // dy)) for (x, dx), (y, dy) in ratios], unit


def double_area(a, b, c) -> Fraction:
    """Twice the signed area of the triangle abc; each corner two floats."""
    ((ax, ay), (bx, by), (cx, cy)), unit = whole((a, b, c))
    return Fraction((bx - ax) * (cy - ay) - (by - ay) * (cx - ax), unit * unit)


def incircle(a, b, c, d) -> Fraction:
    """Positive when d lies inside the circle through the counter-clockwise abc."""
    ((ax, ay), (bx, by), (cx, cy), (dx, dy)), unit = whole((a, b, c, d))
    ax, ay, bx, by, cx, cy = ax - dx, ay - dy, bx - dx, by - dy, cx - dx, cy - dy
    determinant = (
        (ax * ax + ay * ay) * (bx * cy - by * cx)
        - (bx * bx + by * by) * (ax * cy - ay * cx)
        + (cx * cx + cy * cy) * (ax * by - ay * bx)
    )
    return Fraction(determinant, unit**4)


def double_areas(mesh) -> list[Fraction]:
    """Twice the signed area of every triangle of a mesh."""
    return areas_of(mesh.points.tolist(), mesh.triangles.tolist())


def areas_of(points, triangles) -> list[Fraction]:
    """Twice the signed area of every triangle, each three rows of the points, of which two coordinates are read."""
    corners, unit = whole(points)
    areas = []
    for a, b, c in triangles:
        (ax, ay), (bx, by), (cx, cy) = corners[a], corners[b], corners[c]
        areas.append(Fraction((bx - ax) * (cy - ay) - (by - ay) * (cx - ax), unit * unit))
    return areas


def inverted(mesh) -> int:
    """Number of triangles whose area is not positive."""
    return sum(area <= 0 for area in double_areas(mesh))


def inverted_area(mesh) -> Fraction:
    """Sum of |area| of the triangles whose area is negative."""
    return sum((-area for area in double_areas(mesh) if area < 0), Fraction(0)) / 2


def total_area(mesh) -> Fraction:
    return sum(double_areas(mesh), Fraction(0)) / 2


def edge_counts(triangles) -> Counter:
    """How many triangles each undirected edge has."""
    rows = np.asarray(triangles).tolist()
    return Counter(frozenset(pair) for a, b, c in rows for pair in ((a, b), (b, c), (c, a)))


def directed_edges(triangles) -> Counter:
    """How often each directed edge is run along; once at most on an oriented manifold."""
    rows = np.asarray(triangles).tolist()
    return Counter(pair for a, b, c in rows for pair in ((a, b), (b, c), (c, a)))


def boundary(triangles) -> set[tuple[int, int]]:
    """The directed edges that no triangle runs along the other way."""
    edges = set(directed_edges(triangles))
    return {(u, v) for u, v in edges if (v, u) not in edges}


def triangle_set(triangles) -> set[tuple[int, int, int]]:
    """The triangles as a set, each turned so that its smallest vertex comes first: winding counts, rotation not."""
    return {min((a, b, c), (b, c, a), (c, a, b)) for a, b, c in np.asarray(triangles).tolist()}
