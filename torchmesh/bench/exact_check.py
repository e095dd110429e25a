"""An independent check of a result: signs in exact rationals and incidence by counting, without torchmesh's own."""

from __future__ import annotations

from collections import Counter
from fractions import Fraction

import numpy as np

from ..mesh.batch import MeshBatch
from ..mesh.interfaces import holding
from . import boundary

Array = np.ndarray


def faults(given: MeshBatch, after: MeshBatch) -> list[str]:
    """What is wrong with `after` as the improved `given`, in words; an empty list if nothing is.

    No triangle may be flat or inverted.  Every fixed vertex keeps its position.  Each edge has at most one triangle
    on either side, the boundary is that of `given`, and so is the Euler number.  Vertices and triangles may have
    other rows than in `given`.
    """
    found = []
    flat = inverted(after.points.numpy(), after.triangles.numpy())
    if flat:
        found.append(f"{flat} triangles inverted or flat")
    positions = [[tuple(p) for p in mesh.points.tolist()] for mesh in (given, after)]
    held = {p for p, fixed in zip(positions[0], holding(given).fixed.tolist(), strict=True) if fixed}
    if not held <= set(positions[1]):
        found.append("fixed vertices have moved")
    sides = [directed(mesh.triangles.numpy(), mesh.quads.numpy()) for mesh in (given, after)]
    if max(sides[1].values()) > 1:
        found.append("an edge has two triangles on one side")
    curves = [
        {(position[u], position[v]) for u, v in side if (v, u) not in side}
        for position, side in zip(positions, sides, strict=True)
    ]
    if curves[0] != curves[1]:
        found.append("another boundary")
    # The Euler number is V - E + F, and 2 E = 3 T + 4 Q + the number of boundary edges.
    euler = [2 * len(_used(mesh)) - len(mesh.triangles) - 2 * len(mesh.quads) for mesh in (given, after)]
    if euler[0] != euler[1]:
        found.append("another Euler number")
    return found


def inverted(points: Array, triangles: Array) -> int:
    """How many triangles have an area that is not positive, exactly.

    Floating point decides where its error bound allows; the other triangles are computed in rationals.
    """
    a, b, c = points[triangles].transpose(1, 0, 2)
    with np.errstate(over="ignore", invalid="ignore"):  # an overflow leaves the sign to the rationals
        left, right = (b - a)[:, 0] * (c - a)[:, 1], (b - a)[:, 1] * (c - a)[:, 0]
        # Shewchuk 1997: the error of the difference is below (3 + 16 e) e (|left| + |right|), e = 2^-53, as long as
        # neither product underflows; the second term is far above what an underflow can lose.
        bound = 4 * 2.0**-53 * (np.abs(left) + np.abs(right)) + 2.0**-1060
        doubtful = np.flatnonzero(~(np.abs(left - right) > bound))
        count = int((left - right < -bound).sum())
    for row in doubtful:
        (ax, ay), (bx, by), (cx, cy) = ([Fraction(v) for v in p] for p in points[triangles[row]].tolist())
        count += (bx - ax) * (cy - ay) <= (by - ay) * (cx - ax)
    return count


def double_areas(points: Array, triangles: Array) -> Array:
    """(T,) twice the signed areas, rounded."""
    a, b, c = points[triangles].transpose(1, 0, 2)
    return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]


def directed(triangles: Array, quads: Array | None = None) -> Counter:
    """How many triangles and quads run along each directed edge."""
    sides = Counter((u, v) for a, b, c in triangles.tolist() for u, v in ((a, b), (b, c), (c, a)))
    for a, b, c, d in () if quads is None else quads.tolist():
        sides.update(((a, b), (b, c), (c, d), (d, a)))
    return sides


def _used(mesh: MeshBatch) -> Array:
    """The vertices that triangles or quads have."""
    return np.unique(np.concatenate([mesh.triangles.numpy().ravel(), mesh.quads.numpy().ravel()]))


def boundary_is_simple(mesh: MeshBatch) -> bool:
    """Whether the boundary is a simple polygon with simple, disjoint holes inside it, by shapely."""
    import shapely

    rings = [shapely.LinearRing(mesh.points[loop].numpy()) for loop in boundary.loops(mesh.triangles)]
    rings.sort(key=lambda ring: -shapely.Polygon(ring).area)
    return all(ring.is_simple for ring in rings) and bool(shapely.Polygon(rings[0], rings[1:]).is_valid)
