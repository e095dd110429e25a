"""The areas that triangles of two meshes share, by clipping one triangle with the three edges of the other.

      c                 Sutherland & Hodgman, Reentrant polygon clipping, Communications of the ACM 17, 1974.
     / \\               The polygon that is left is kept as directed segments in no order, because a half-plane
----x---y---- cuts     makes of each segment a shorter one and adds one, from where the boundary leaves it to
   /     \\            where it comes back.  All pairs then take the same steps: 3, 4, 5 and 6 segments.
  a-------b
"""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import torch

from ..kernels.library import library
from ..kernels.overlaps import shared_areas
from .pairs import Side, touching_boxes

# Pairs that are clipped at once: their coordinates then stay in the processor's cache.
_CHUNK = 16384

# The same in compiled loops, which keep nothing; an interrupt waits for one call at most.
_COMPILED_CHUNK = 1 << 19

# An overlap below this part of the smaller of its triangles is rounding.
_NOTHING = 1e-13


class Overlaps(NamedTuple):
    """Pairs of triangles that share an area.

    after, before  (P,) their rows, in ascending order of `after` and then of `before`
    area           (P,) the area that they share, positive, in units of `Side`
    moments        (P, 6) the integrals of 1, x, y, x^2, xy and y^2 over it, with the first corner of the triangle
                   of `before` as origin; None where nobody asked for them
    """

    after: np.ndarray
    before: np.ndarray
    area: np.ndarray
    moments: np.ndarray | None


class Segments(NamedTuple):
    """The boundary of a convex polygon for each of P pairs: (m, P) coordinates of starts a and of ends b."""

    ax: np.ndarray
    ay: np.ndarray
    bx: np.ndarray
    by: np.ndarray


def signed_areas(side: Side) -> np.ndarray:
    """(T,) the signed areas of the triangles, in units of `Side`."""
    (ax, bx, cx), (ay, by, cy) = side.x[side.triangles].T, side.y[side.triangles].T
    return 0.5 * ((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))


def overlaps(before: Side, after: Side, wanted: np.ndarray | None = None, moments: bool = False) -> Overlaps:
    """All pairs of triangles of one mesh that share an area; inverted triangles count as their mirror images.

    wanted  (T',) bool, which triangles of `after` to look at; None: all of them
    """
    rows = np.arange(len(after.triangles)) if wanted is None else np.flatnonzero(wanted)
    low, high = after.triangle_boxes()
    i, j = touching_boxes(
        before, (low[rows], high[rows], after.triangle[rows]), (*before.triangle_boxes(), before.triangle)
    )
    i = rows[i]
    sizes = [np.abs(signed_areas(side)) for side in (after, before)]
    some = (sizes[0][i] > 0) & (sizes[1][j] > 0)
    i, j = i[some], j[some]
    upright = [_upright_corners(side) for side in (after, before)]
    chunk = _CHUNK if library() is None else _COMPILED_CHUNK
    starts = range(0, len(i), chunk)
    if not starts:
        none = np.zeros(0, np.int64)
        return Overlaps(none, none, np.zeros(0), np.zeros((0, 6)) if moments else None)

    def clipped(start: int) -> Overlaps:
        here, there = i[start : start + chunk], j[start : start + chunk]
        pairs = upright[0], here, upright[1], there
        area, integrals = _clipped(*pairs, moments) if library() is None else shared_areas(*pairs, moments)
        smaller = np.minimum(sizes[0].take(here), sizes[1].take(there))
        area = np.minimum(area, smaller)
        shared = np.flatnonzero(area > _NOTHING * smaller)
        return Overlaps(
            here.take(shared), there.take(shared), area.take(shared),
            None if integrals is None else integrals.take(shared, 0),
        )  # fmt: skip

    if len(starts) == 1:
        return clipped(0)
    # numpy lets other threads run while it computes.
    with ThreadPoolExecutor(torch.get_num_threads()) as threads:
        return _joined(list(threads.map(clipped, starts)))


def _joined(parts: list[Overlaps]) -> Overlaps:
    i, j, area = (np.concatenate([part[k] for part in parts]) for k in range(3))
    known = [part.moments for part in parts if part.moments is not None]
    return Overlaps(i, j, area, np.concatenate(known) if known else None)


def _upright_corners(side: Side) -> np.ndarray:
    """(6, T) x and y of the corners, counter-clockwise from the first one."""
    faces = side.triangles.copy()
    turned = signed_areas(side) < 0
    faces[turned] = faces[turned][:, [0, 2, 1]]
    a, b, c = faces.T
    return np.stack([side.x[a], side.x[b], side.x[c], side.y[a], side.y[b], side.y[c]])


def _clipped(
    after: np.ndarray, i: np.ndarray, before: np.ndarray, j: np.ndarray, moments: bool
) -> tuple[np.ndarray, np.ndarray | None]:
    """The areas (P,) and moments (P, 6) that the pairs i, j (P,) share, where they do."""
    t, s = after.take(i, 1), before.take(j, 1)
    x, y = t[:3], t[3:]
    x -= s[0]
    y -= s[3]
    ux, uy, vx, vy = s[1] - s[0], s[4] - s[3], s[2] - s[0], s[5] - s[3]
    # The edges of the triangle before: through which point, in which direction.
    zero = np.zeros_like(ux)
    lines = ((zero, zero, ux, uy), (ux, uy, vx - ux, vy - uy), (zero, zero, -vx, -vy))
    apart, cutters = np.zeros(len(i), bool), np.zeros(len(i), np.int8)
    for k, (px, py, dx, dy) in enumerate(lines):
        left = dx * (y - py) - dy * (x - px)
        apart |= left.max(0) <= 0
        cutters += (left.min(0) < 0) * np.int8(1 << k)
    cutters[apart] = -1
    area = np.zeros(len(i))
    integrals = np.zeros((len(i), 6)) if moments else None
    # Only the edges that the triangle after crosses have to cut it; pairs with the same ones take the same steps.
    for group in range(8):
        rows = np.flatnonzero(cutters == group)
        if not len(rows):
            continue
        tx, ty = x[:, rows], y[:, rows]
        polygon = Segments(tx, ty, tx[[1, 2, 0]], ty[[1, 2, 0]])
        for k in range(3):
            if group >> k & 1:
                polygon = _cut(polygon, *(v[rows] for v in lines[k]))
        area[rows] = 0.5 * (polygon.ax * polygon.by - polygon.ay * polygon.bx).sum(0)
        if integrals is not None:
            integrals[rows] = _moments(polygon)
    return area, integrals


def _cut(polygon: Segments, px: np.ndarray, py: np.ndarray, dx: np.ndarray, dy: np.ndarray) -> Segments:
    """What is on the left of the lines through p in the direction d, all (P,); one segment more than before."""
    ax, ay, bx, by = polygon
    at_a = dx * (ay - py) - dy * (ax - px)
    at_b = dx * (by - py) - dy * (bx - px)
    in_a, in_b = at_a >= 0, at_b >= 0
    leaves, comes = in_a & ~in_b, in_b & ~in_a
    crosses = leaves | comes
    share = at_a / np.where(crosses, at_a - at_b, 1.0)
    x, y = ax + share * (bx - ax), ay + share * (by - ay)
    made = [np.zeros((len(ax) + 1, ax.shape[1])) for _ in range(4)]
    for out, inside, value, crossing, there in zip(
        made, (in_a, in_a, in_b, in_b), polygon, (x, y, x, y), (comes, comes, leaves, leaves), strict=True
    ):
        np.copyto(out[:-1], value, where=inside)
        np.copyto(out[:-1], crossing, where=there)
    for k in range(len(ax)):
        np.copyto(made[0][-1], x[k], where=leaves[k])
        np.copyto(made[1][-1], y[k], where=leaves[k])
        np.copyto(made[2][-1], x[k], where=comes[k])
        np.copyto(made[3][-1], y[k], where=comes[k])
    return Segments(*made)


def _moments(polygon: Segments) -> np.ndarray:
    """(P, 6) integrals of 1, x, y, x^2, xy, y^2, as sums over the triangles of the origin and each segment.

    The midpoints of the edges integrate quadratic functions exactly (Strang & Fix, An Analysis of the Finite Element
    Method, 1973, section 4.3).
    """
    ax, ay, bx, by = polygon
    area = 0.5 * (ax * by - ay * bx)
    nodes = ((0.5 * ax, 0.5 * ay), (0.5 * bx, 0.5 * by), (0.5 * (ax + bx), 0.5 * (ay + by)))
    sums = [area.sum(0)]
    for f in (lambda x, y: x, lambda x, y: y, lambda x, y: x * x, lambda x, y: x * y, lambda x, y: y * y):
        sums.append((area / 3 * sum(f(x, y) for x, y in nodes)).sum(0))
    return np.stack(sums, 1)
