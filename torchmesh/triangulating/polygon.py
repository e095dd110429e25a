"""Polygons with holes, given as loops of vertices: are they simple, what is inside, their triangulation.

A domain lies on the left of its loops: one outer loop counter-clockwise, holes clockwise.  Loops
may share vertices; Shapely only proposes, exact signs decide.
"""

from typing import Any

import numpy as np
import torch

from ..mesh.connectivity import boundary_loops
from .arrays import Obstacle, among, distinct, signs
from .triangulation import Triangulation

# Rows of a vertices-times-edges table worked on at once.
_CHUNK = 2_000_000


# Vertices times triangles up to which each vertex is held against each triangle's box.
_TABLE = 100_000


# Pairs of segments judged at once, and segments whose partners are looked for first.
_PAIRS = 100_000


_FIRST_ROWS = 16


def unit_exponent(points: np.ndarray) -> int:
    """k such that dividing by 2**k brings the points near 1 and loses no bit; 0 if none does."""
    exponent = int(np.frexp(np.abs(points).max())[1])
    there = np.ldexp(points, -exponent)
    return exponent if np.array_equal(np.ldexp(there, exponent), points) else 0


def loops_of(rim: np.ndarray) -> list[np.ndarray]:
    """The closed walks along the directed edges `rim` (E, 2), none of which passes a vertex twice."""
    return [loop.numpy() for loop in boundary_loops(torch.from_numpy(rim))]


def loop_edges(loop: np.ndarray) -> np.ndarray:
    """(n, 2) the directed edges of a loop (n,)."""
    return np.stack([loop, np.roll(loop, -1)], 1)


def crossing_pairs(
    points: np.ndarray, segments: np.ndarray, group: np.ndarray | None = None, enough: int | None = None
) -> np.ndarray:
    """(P, 2) the pairs of rows of `segments` (S, 2) that meet other than in a vertex both have.

    They cross, touch, overlap, or end in different vertices at one place.  `group` (S,): only pairs
    of the same group are looked at.  `enough`: having found so many pairs, look no further.
    """
    if len(segments) < 2:
        return np.zeros((0, 2), np.int64)
    ends = points[segments]
    low, high = ends.min(1), ends.max(1)
    left, right = (low, high) if group is None else _side_by_side(low, high, group)
    swept = _swept(left, right)
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


def _swept(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
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


def turns_left(points: np.ndarray, loops: list[np.ndarray]) -> np.ndarray:
    """(L,) 1 for a counter-clockwise simple loop, -1 for a clockwise one, 0 where the first corner is flat."""
    if not loops:
        return np.zeros(0, np.int8)
    flat = np.concatenate(loops)
    size = np.array([len(loop) for loop in loops])
    start = np.cumsum(size) - size
    first = start + [_lowest(points[loop]) for loop in loops]
    before = np.where(first == start, start + size, first) - 1
    after = np.where(first + 1 == start + size, start, first + 1)
    return signs(points, flat[before], flat[first], flat[after])


def _lowest(xy: np.ndarray) -> int:
    """The row of `xy` (N, 2) that comes first by x, then by y."""
    x = xy[:, 0]
    leftmost = np.flatnonzero(x == x.min())
    return int(leftmost[xy[leftmost, 1].argmin()])


def winding(points: np.ndarray, p: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(N,) how often the closed walks made of the directed `edges` (E, 2) go round the vertices p (N,).

    Exact for vertices not on an edge; a vertex on one is an end of a ray, counted half-open.
    """
    total = np.zeros(len(p), np.int64)
    y = points[:, 1]
    step = max(1, _CHUNK // max(1, len(edges)))
    for start in range(0, len(p), step):
        part = p[start : start + step]
        up = (y[edges[:, 0]] <= y[part, None]) & (y[edges[:, 1]] > y[part, None])
        down = (y[edges[:, 0]] > y[part, None]) & (y[edges[:, 1]] <= y[part, None])
        i, e = np.nonzero(up | down)
        side = signs(points, edges[e, 0], edges[e, 1], part[i])
        counted = np.where(up[i, e] & (side > 0), 1, 0) - np.where(down[i, e] & (side < 0), 1, 0)
        np.add.at(total, start + i, counted)
    return total


def why_not_simple(points: np.ndarray, loops: list[np.ndarray]) -> Obstacle | None:
    """What keeps the loops from bounding one domain on their left, if anything."""
    rim = np.concatenate([loop_edges(loop) for loop in loops])
    pairs = crossing_pairs(points, rim)
    if len(pairs):
        return Obstacle("the edges [{}, {}] and [{}, {}] of the rim meet", tuple(rim[pairs[0]].ravel().tolist()))
    turn = turns_left(points, loops)
    if (turn > 0).sum() != 1 or (turn == 0).any():
        return Obstacle(f"the rim has {(turn > 0).sum()} outer loops, not one")
    outer = loops[int(turn.argmax())]
    for i, hole in enumerate(loops):
        if turn[i] > 0:
            continue
        inner = _one_not_in(hole, outer)
        if winding(points, inner, loop_edges(outer))[0] != 1:
            return Obstacle("the hole through vertex {} lies outside the outer loop", tuple(inner.tolist()))
    nested = nested_holes(points, [loops[i] for i in np.flatnonzero(turn < 0)])
    if nested is not None:
        return Obstacle(
            "the hole through vertex {} lies inside the one through vertex {}", (int(nested[0][0]), int(nested[1][0]))
        )
    return None


def nested_holes(points: np.ndarray, holes: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray] | None:
    """A hole and another that holds it, of clockwise loops that do not cross; None if there is none."""
    if len(holes) < 2:
        return None
    low = np.stack([points[hole].min(0) for hole in holes])
    high = np.stack([points[hole].max(0) for hole in holes])
    near = _swept(low, high)
    if near is None:
        import shapely

        boxes = shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
        near = shapely.STRtree(boxes).query(boxes)
    i, j = np.concatenate(near), np.concatenate(near[::-1])
    within = ((low[j] <= low[i]) & (high[i] <= high[j])).all(1) & (i != j)
    for a, b in zip(i[within].tolist(), j[within].tolist(), strict=True):
        if winding(points, _one_not_in(holes[a], holes[b]), loop_edges(holes[b]))[0]:
            return holes[a], holes[b]
    return None


def _one_not_in(loop: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(1,) a vertex of `loop` that `other` does not pass; its first if it passes them all."""
    alone = loop[~among(loop, other)]
    return alone[:1] if len(alone) else loop[:1]


def triangulate_polygon(points: np.ndarray, loops: list[np.ndarray], spacing: np.ndarray) -> Triangulation | Obstacle:
    """The domain on the left of `loops`, triangulated with exactly the loops' vertices.

    points (V, 2) float64; spacing (V,) as in `Triangulation`.  Returns what is wrong with the loops
    when they bound no domain.  Tries GEOS's constrained Delaunay triangulation, checks it exactly,
    and where it does not hold (near-degenerate loops) inserts the vertices into a big triangle,
    recovers the rim and cuts it out: exact from end to end.
    """
    obstacle = why_not_simple(points, loops)
    if obstacle:
        return obstacle
    corners = _proposed(points, loops)
    if corners is None:
        built = _cut_out(points, loops, spacing)
        if isinstance(built, Obstacle):
            return built
        corners = built
    return Triangulation(points, corners, spacing)


def is_triangulation_of(points: np.ndarray, corners: np.ndarray, rim: np.ndarray) -> bool:
    """All of `corners` (T, 3) counter-clockwise, each edge in two of them, but `rim` (E, 2) in one as directed."""
    if not len(corners) or (signs(points, *corners.T) <= 0).any():
        return False
    count = len(points)
    ways = np.concatenate([corners, np.roll(corners, -1, 1)]).reshape(2, -1)
    there, back = np.sort(ways[0] * count + ways[1]), ways[1] * count + ways[0]
    found = np.minimum(np.searchsorted(there, back), len(there) - 1)
    # What has no edge back, seen from its other side.
    single = np.sort(back[there[found] != back])
    unique = bool((there[1:] != there[:-1]).all())
    return unique and np.array_equal(single, np.sort(rim[:, 1] * count + rim[:, 0]))


def _proposed(points: np.ndarray, loops: list[np.ndarray]) -> np.ndarray | None:
    """GEOS's triangles (T, 3) if exact signs confirm them."""
    import shapely

    outer = int(np.argmax(turns_left(points, loops)))
    polygon = shapely.Polygon(points[loops[outer]], [points[loop] for i, loop in enumerate(loops) if i != outer])
    if not polygon.is_valid:
        return None
    corners = _named(points, np.concatenate(loops), shapely.constrained_delaunay_triangles(polygon))
    rim = np.concatenate([loop_edges(loop) for loop in loops])
    return corners if corners is not None and is_triangulation_of(points, corners, rim) else None


def _named(points: np.ndarray, vertices: np.ndarray, pieces: Any) -> np.ndarray | None:
    """(T, 3) GEOS's triangles as rows of `points`, none clockwise; of `vertices` in one place the first is meant."""
    import shapely

    places = shapely.get_coordinates(shapely.get_parts(pieces))
    if not len(places) or len(places) % 4:
        return None
    known, first = np.unique(points[vertices, 0] + 1j * points[vertices, 1], return_index=True)
    wanted = (places[:, 0] + 1j * places[:, 1]).reshape(-1, 4)[:, :3]
    found = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
    if (known[found] != wanted).any():
        return None
    corners = vertices[first[found]]
    turned = signs(points, *corners.T) < 0
    corners[turned] = corners[turned][:, ::-1]
    return corners


def triangulate_with(
    points: np.ndarray, loops: list[np.ndarray], spacing: np.ndarray, inner: np.ndarray, segments: np.ndarray
) -> Triangulation | None:
    """The domain on the left of simple `loops` with those of the vertices `inner` (N,) that lie in it; None if hard.

    segments (K, 2) edges that are to be there, and locked.  At once what `triangulate_polygon`, `insert` and
    `recover` do step by step: GEOS's Delaunay triangulation of all the vertices in a big triangle, in which the
    rim and the segments are recovered.  Checked exactly; Delaunay but for the edges asked for.
    """
    import shapely

    rim = np.concatenate([loop_edges(loop) for loop in loops])
    # Those outside would only stand in the rim's way.
    vertices = np.concatenate([rim[:, 0], inner[winding(points, inner, rim) == 1]])
    more, big = _with_big_triangle(points, vertices)
    names = np.concatenate([vertices, big])
    try:
        with np.errstate(all="ignore"):
            pieces = shapely.delaunay_triangles(shapely.MultiPoint(more[names]))
    except shapely.errors.GEOSException:  # "could not locate vertex", where places are all but the same
        return None
    corners = _named(more, names, pieces)
    if corners is None or not is_triangulation_of(more, corners, loop_edges(big)):
        return None
    work = Triangulation(more, corners, np.zeros(len(more)))
    if work.recover(np.concatenate([rim, segments])):
        return None
    made = Triangulation(points, _enclosed(work, rim), spacing)
    if made.recover(segments):
        return None
    made.flip_to_delaunay(np.arange(len(made.corners)))
    _spread_inward(made.spacing, made.corners, rim)
    return made


def _spread_inward(spacing: np.ndarray, corners: np.ndarray, rim: np.ndarray) -> None:
    """Give the vertices of `corners` (T, 3) inside the `rim` (E, 2) the mean of their neighbours', ring by ring."""
    known = np.zeros(len(spacing), bool)
    known[rim] = True
    tail, head = corners.ravel(), corners[:, [1, 2, 0]].ravel()
    while len(rows := np.flatnonzero(known[tail] & ~known[head])):
        total = np.bincount(head[rows], spacing[tail[rows]], len(spacing))
        count = np.bincount(head[rows], minlength=len(spacing))
        ring = count > 0
        spacing[ring] = total[ring] / count[ring]
        known |= ring


def _cut_out(points: np.ndarray, loops: list[np.ndarray], spacing: np.ndarray) -> np.ndarray | Obstacle:
    """(T, 3) the same by exact steps only: a big triangle, the vertices, the rim, and what is on its left."""
    rim = np.concatenate([loop_edges(loop) for loop in loops])
    vertices = distinct(rim)
    more, big = _with_big_triangle(points, vertices)
    work = Triangulation(more, big[None], np.zeros(len(more)))
    refused = work.insert(vertices, np.zeros(len(vertices), np.int64))
    if len(refused):
        return Obstacle("vertex {} of the rim is in the place of another", (int(refused[0]),))
    obstacle = work.recover(rim)
    if obstacle:
        return obstacle
    corners = _enclosed(work, rim)
    return corners if is_triangulation_of(points, corners, rim) else Obstacle("the rim does not enclose one domain")


def _with_big_triangle(points: np.ndarray, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`points` (V, 2) and three more far round the `vertices` (N,); the rows of these."""
    reach = 2.0 ** np.ceil(np.log2(np.abs(points[vertices]).max()) + 3)
    big = np.array([[-reach, -reach], [reach, -reach], [0, reach]])
    return np.concatenate([points, big]), len(points) + np.arange(3)


def _enclosed(work: Triangulation, rim: np.ndarray) -> np.ndarray:
    """(T, 3) the triangles on the left of the locked edges `rim` (E, 2)."""
    count = len(work.points)
    keys = work.corners.ravel() * count + work.corners[:, [1, 2, 0]].ravel()
    inside = np.zeros(len(work.corners), bool)
    front = np.flatnonzero(among(keys, rim[:, 0] * count + rim[:, 1])) // 3
    while len(front):
        inside[front] = True
        h = (3 * front[:, None] + np.arange(3)).ravel()
        front = distinct(work.twin[h[~work.locked[h]]] // 3)
        front = front[(front >= 0) & ~inside[front]]
    return work.corners[inside]


def locate(points: np.ndarray, vertices: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(N,) a closed triangle of `corners` (T, 3) around each vertex (N,), -1 for those outside them all."""
    home = np.full(len(vertices), -1)
    if not len(vertices):
        return home
    if len(vertices) * len(corners) <= _TABLE:
        low, high, at = points[corners].min(1), points[corners].max(1), points[vertices]
        t, i = np.nonzero(((low[:, None] <= at) & (at <= high[:, None])).all(2))
    else:
        import shapely

        pieces = shapely.polygons(points[corners])
        shapely.prepare(pieces)
        t, i = shapely.STRtree(shapely.points(points[vertices])).query(pieces, predicate="intersects")
    a, b, c = corners[t].T
    p = vertices[i]
    inside = (signs(points, a, b, p) >= 0) & (signs(points, b, c, p) >= 0) & (signs(points, c, a, p) >= 0)
    home[i[inside]] = t[inside]
    return home
