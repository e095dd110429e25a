"""The plain greedy loop: look at every edge, flip the one whose opposite angles sum to most, start again.

Slow, obvious and independent of torchmesh; signs are exact.
"""

import math

from exact import double_area, incircle


def opposite_angle(p, u, w) -> float:
    """The unsigned angle at p between the rays to u and to w."""
    ax, ay, bx, by = u[0] - p[0], u[1] - p[1], w[0] - p[0], w[1] - p[1]
    return math.atan2(abs(ax * by - ay * bx), ax * bx + ay * by)


def flip_to_delaunay(points, triangles, constrained=()) -> tuple[list[list[int]], int]:
    """Triangles and the number of flips, of a valid mesh, when no unconstrained edge fails the in-circle test."""
    rows = [list(row) for row in triangles]
    kept = {frozenset(edge) for edge in constrained}
    flips = 0
    while True:
        best = None
        owner = {}
        for i, row in enumerate(rows):
            for k in range(3):
                owner[row[k], row[(k + 1) % 3]] = i, row[(k + 2) % 3]
        for (u, w), (i, s) in owner.items():
            if u > w or (w, u) not in owner or frozenset((u, w)) in kept:
                continue
            j, r = owner[w, u]
            if (s, r) in owner or (r, s) in owner:
                continue
            p = {v: points[v] for v in (u, w, s, r)}
            if (
                incircle(p[u], p[w], p[s], p[r]) > 0
                and double_area(p[u], p[r], p[s]) > 0
                and double_area(p[r], p[w], p[s]) > 0
            ):
                total = opposite_angle(p[s], p[u], p[w]) + opposite_angle(p[r], p[u], p[w])
                if best is None or total > best[0]:
                    best = total, i, j, [u, r, s], [r, w, s]
        if best is None:
            return rows, flips
        _, i, j, rows[i], rows[j] = best
        flips += 1
