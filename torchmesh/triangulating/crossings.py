"""Which segments meet: pairs found by their boxes, judged by exact signs."""

import numpy as np

from ..kernels import geometry
from ..kernels.library import library
from .arrays import signs

# Pairs of segments that are judged at once, which bounds the memory.
_PAIRS = 100_000

# The compiled sweep gives up after so many pairs, a few hundredths of a second.
_SWEPT = 5_000_000

# The search in a tree begins with so many segments: their partners tell how many the next ones may be.
_FIRST_ROWS = 16


def crossing_pairs(
    points: np.ndarray, segments: np.ndarray, group: np.ndarray | None = None, enough: int | None = None
) -> np.ndarray:
    """(P, 2) the pairs of rows of `segments` (S, 2) that meet other than in a vertex both have.

    They cross, touch, overlap, or end in different vertices in one position.  `group` (S,): only pairs
    of the same group are looked at.  `enough`: having found so many pairs, look no further.
    """
    if len(segments) < 2:
        return np.zeros((0, 2), np.int64)
    if library() is not None:
        known = geometry.crossing_pairs(points, segments, group, _SWEPT)
        if known is not None:
            return known
    ends = points[segments]
    low, high = ends.min(1), ends.max(1)
    left, right = (low, high) if group is None else _side_by_side(low, high, group)
    swept = overlapping_boxes(left, right)
    if swept is not None:
        i, j = swept
        near = ((low[i] <= high[j]) & (low[j] <= high[i])).all(1)
        if group is not None:
            near &= group[i] == group[j]
        pairs = np.stack([i[near], j[near]], 1)
        return pairs[_meet(points, segments[pairs[:, 0]], segments[pairs[:, 1]])]
    import shapely

    boxes = shapely.box(left[:, 0], left[:, 1], right[:, 0], right[:, 1])
    tree = shapely.STRtree(boxes)
    found: list[np.ndarray] = []
    start, rows = 0, _FIRST_ROWS
    while start < len(boxes):
        i, j = tree.query(boxes[start : start + rows])
        i = i + start
        # Long segments lie in each other's boxes by the thousand: few at a time then, many where they are short.
        start, rows = start + rows, max(1, min(_PAIRS, rows * _PAIRS // max(1, len(i))))
        near = i < j
        if group is not None:
            near &= group[i] == group[j]
        i, j = i[near], j[near]
        # Boxes computed again here: what GEOS does with zero-width boxes need not concern us.
        near = ((low[i] <= high[j]) & (low[j] <= high[i])).all(1)
        pairs = np.stack([i[near], j[near]], 1).astype(np.int64)
        for first in range(0, len(pairs), _PAIRS):
            part = pairs[first : first + _PAIRS]
            found.append(part[_meet(points, segments[part[:, 0]], segments[part[:, 1]])])
            if enough is not None and sum(map(len, found)) >= enough:
                return np.concatenate(found)
    return np.concatenate(found) if found else np.zeros((0, 2), np.int64)


def cross_properly(points: np.ndarray, a: int, b: int, c: int, d: int) -> bool:
    """Whether the segments ab and cd cross in a point that is an end of neither."""
    of_ends = signs(points, *np.array([[a, b, c], [a, b, d], [c, d, a], [c, d, b]]).T)
    return bool(of_ends[0] * of_ends[1] < 0 and of_ends[2] * of_ends[3] < 0)


def overlapping_boxes(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The rows i < j (P,) of the boxes from `low` to `high` (S, 2) that overlap, in order; None if that is long work.

    A line is swept over the boxes from left to right; what overlaps in x is looked at.
    """
    order = np.argsort(low[:, 0], kind="stable")
    count = np.searchsorted(low[order, 0], high[order, 0], "right") - np.arange(1, len(order) + 1)
    if (total := int(count.sum())) > _PAIRS:
        return None
    first = np.repeat(np.arange(len(order)), count)
    behind = np.arange(total) - np.repeat(np.cumsum(count) - count, count)
    i, j = order[first], order[first + 1 + behind]
    near = (low[i, 1] <= high[j, 1]) & (low[j, 1] <= high[i, 1])
    i, j = np.minimum(i, j)[near], np.maximum(i, j)[near]
    order = np.lexsort((j, i))
    return i[order], j[order]


def _side_by_side(low: np.ndarray, high: np.ndarray, group: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The boxes from `low` to `high` (S, 2), each group shrunk to a square of its own; a hair larger, for rounding."""
    _, label = np.unique(group, return_inverse=True)
    corner = np.full((int(label.max()) + 1, 2), np.inf)
    far = -corner
    np.minimum.at(corner, label, low)
    np.maximum.at(far, label, high)
    extent = (far - corner).max(1)
    extent = np.where(extent > 0, extent, 1.0)[label, None]
    shift = np.stack([3.0 * label, np.zeros(len(label))], 1)
    return (low - corner[label]) / extent + shift - 1e-9, (high - corner[label]) / extent + shift + 1e-9


def _meet(points: np.ndarray, one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """(P,) bool: the segments `one` and `two` (P, 2), whose boxes overlap, meet as in `crossing_pairs`."""
    (a, b), (c, d) = one.T, two.T
    shared = ((a == c) | (a == d)).astype(int) + ((b == c) | (b == d))
    meet = shared == 2
    apart = np.flatnonzero(shared == 0)
    p, q, r, s = a[apart], b[apart], c[apart], d[apart]
    across = signs(points, p, q, r) * signs(points, p, q, s) <= 0
    meet[apart] = across & (signs(points, r, s, p) * signs(points, r, s, q) <= 0)
    # Two edges with one common vertex meet elsewhere only if they run the same way from it.
    joint = np.flatnonzero(shared == 1)
    a, b, c, d = a[joint], b[joint], c[joint], d[joint]
    origin = np.where((a == c) | (a == d), a, b)
    p, q = np.where(origin == a, b, a), np.where(origin == c, d, c)
    one_way, other_way = points[p] - points[origin], points[q] - points[origin]
    same_way = np.flatnonzero((np.sign(one_way) == np.sign(other_way)).all(1))
    meet[joint[same_way]] = signs(points, origin[same_way], p[same_way], q[same_way]) == 0
    return meet
