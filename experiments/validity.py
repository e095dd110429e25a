"""An independent check of a result: signs in exact rationals and incidence by counting, without torchmesh's own."""

from __future__ import annotations

from collections import Counter
from fractions import Fraction

import numpy as np

import torchmesh as tm

Array = np.ndarray


def faults(given: tm.MeshBatch, after: tm.MeshBatch) -> list[str]:
    """What is wrong with `after` as the improved `given`, in words; an empty list if nothing is.

    No triangle may be flat or inverted, every fixed vertex is where it was, each edge has one triangle on either
    side but for the boundary's, which are those of `given`, and the Euler number is the same.  Rows may differ.
    """
    found = []
    flat = inverted(after.points.numpy(), after.triangles.numpy())
    if flat:
        found.append(f"{flat} triangles inverted or flat")
    places = [[tuple(p) for p in mesh.points.tolist()] for mesh in (given, after)]
    if not {p for p, fixed in zip(places[0], given.fixed.tolist(), strict=True) if fixed} <= set(places[1]):
        found.append("fixed vertices have moved")
    sides = [directed(mesh.triangles.numpy()) for mesh in (given, after)]
    if max(sides[1].values()) > 1:
        found.append("an edge has two triangles on one side")
    rims = [
        {(place[u], place[v]) for u, v in side if (v, u) not in side} for place, side in zip(places, sides, strict=True)
    ]
    if rims[0] != rims[1]:
        found.append("another boundary")
    # The Euler number is V - E + T, and 2 E = 3 T + the boundary's edges.
    euler = [2 * len(np.unique(mesh.triangles.numpy())) - len(mesh.triangles) for mesh in (given, after)]
    if euler[0] != euler[1]:
        found.append("another Euler number")
    return found


def inverted(points: Array, triangles: Array) -> int:
    """Triangles whose area is not positive: by floating point where its error bound decides, else by rationals."""
    a, b, c = points[triangles].transpose(1, 0, 2)
    left, right = (b - a)[:, 0] * (c - a)[:, 1], (b - a)[:, 1] * (c - a)[:, 0]
    # Shewchuk 1997: the error of the difference is below (3 + 16 e) e (|left| + |right|), e = 2^-53.
    bound = 4 * 2.0**-53 * (np.abs(left) + np.abs(right))
    doubtful = np.flatnonzero(~(np.abs(left - right) > bound))
    count = int((left - right < -bound).sum())
    for row in doubtful:
        (ax, ay), (bx, by), (cx, cy) = ([Fraction(v) for v in p] for p in points[triangles[row]].tolist())
        count += (bx - ax) * (cy - ay) <= (by - ay) * (cx - ax)
    return count


def directed(triangles: Array) -> Counter:
    """How often each directed edge is run along."""
    return Counter((u, v) for a, b, c in triangles.tolist() for u, v in ((a, b), (b, c), (c, a)))
