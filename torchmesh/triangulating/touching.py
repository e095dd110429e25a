"""Boundaries that touch themselves and do not cross: cracks, domains that meet themselves in points or along edges.

a --- c ---- b      The sides of a crack lie on each other.  They have vertices of their own, not always in the
d -- e --- f        same positions.  Vertices in one position become one, and an edge is parted where a vertex
                    of the other side lies in it: what is left is a plane graph, in which a crack is a line
|                   inside the domain.  It is triangulated as such.  Then every corner of a triangle is given
v                   back the vertex of its own side, and what was parted is joined again.

o-o--o-o
"""

import functools
from dataclasses import dataclass

import numpy as np

from .arrays import Obstacle, among, distinct, next_in_triangle, signs
from .crossings import crossing_pairs
from .recovery import Exact
from .triangulation import Triangulation

# So many pairs of edges that meet are looked at before all: one that crosses is enough to give up.
_ENOUGH = 1000


@dataclass(frozen=True, eq=False)
class PlaneBoundary:
    """The edges of a boundary as a plane graph: no two meet but in a common vertex.

    first    (V,) int64 the first vertex of the boundary in the position of each one; itself for all others
    ends     (N, 2) int64 the directed parts of the edges, by these first vertices; the domain is on the left
    names    (N, 2) int64 the same by the vertices of the edge's own side: V + i stands for stop i
    edge     (N,) int64 the edge of which each is a part
    stops    (S,) int64 the vertices at which edges were parted: stop i has the position of the vertex stops[i]
    parted   (S,) int64 the edges that they part
    paired   (N,) bool: the domain is on both sides
    touched  (K,) int64 the vertices that share their position or lie within an edge, and the ends of such edges
    twice    (M,) int64 the edges that run along a part of an earlier one the same way
    crossing (P, 2) int64 edges that cross, or some of them if there are very many; the graph is not plane there
    """

    first: np.ndarray
    ends: np.ndarray
    names: np.ndarray
    edge: np.ndarray
    stops: np.ndarray
    parted: np.ndarray
    paired: np.ndarray
    touched: np.ndarray
    twice: np.ndarray
    crossing: np.ndarray

    @property
    def open_ends(self) -> np.ndarray:
        """(M, 2) the directed parts with the domain on their left only."""
        return self.ends[~self.paired]

    @property
    def lines(self) -> np.ndarray:
        """(L, 2) the parts with the domain on both sides, each once."""
        both = self.ends[self.paired]
        return both[both[:, 0] < both[:, 1]]

    @property
    def sound(self) -> bool:
        """Is it a plane graph, with every edge of some length and no two on the same side of a line?"""
        return not (len(self.twice) or len(self.crossing) or (self.ends[:, 0] == self.ends[:, 1]).any())


def plane_boundary(points: np.ndarray, boundary: np.ndarray, group: np.ndarray | None = None) -> PlaneBoundary:
    """The boundary as a plane graph, as far as its edges do not cross.

    points    (V, 2) float64
    boundary  (E, 2) int64 directed edges with the domain on their left
    group     (V,) int64: vertices of different groups have nothing to do with each other; None: all are of one
    """
    group = np.zeros(len(points), np.int64) if group is None else group
    vertices = distinct(boundary)
    first = first_in_position(points, vertices, group)
    edges = first[boundary]
    long = np.flatnonzero(edges[:, 0] != edges[:, 1])
    of_edge = group[edges[long, 0]]
    pairs = long[crossing_pairs(points, edges[long], of_edge, enough=_ENOUGH)]
    crossing, within = _judged(points, edges, pairs)
    if len(pairs) >= _ENOUGH and not len(crossing):
        crossing, within = _judged(points, edges, long[crossing_pairs(points, edges[long], of_edge)])
    edge, stops = _along(points, edges, within)
    ends, names, owner = _parted(edges, boundary, edge, stops, len(points))
    there, back = ends @ np.array([len(points), 1]), ends @ np.array([1, len(points)])
    order = np.argsort(there, kind="stable")
    again = order[1:][there[order[1:]] == there[order[:-1]]]
    shared = np.bincount(first[vertices], minlength=len(points))[first[vertices]] > 1
    touched = distinct(np.concatenate([vertices[shared], stops, boundary[edge].ravel()]))
    paired = among(back, there) & (ends[:, 0] != ends[:, 1])
    return PlaneBoundary(first, ends, names, owner, stops, edge, paired, touched, distinct(owner[again]), crossing)


def first_in_position(points: np.ndarray, vertices: np.ndarray, group: np.ndarray) -> np.ndarray:
    """(V,) for the `vertices` (N,) the first of them in the same position and `group` (V,); for others themselves."""
    first = np.arange(len(points))
    rows = vertices[np.lexsort((vertices, points[vertices, 1], points[vertices, 0], group[vertices]))]
    if len(rows):
        new = (points[rows[1:]] != points[rows[:-1]]).any(1) | (group[rows[1:]] != group[rows[:-1]])
        starts = np.concatenate([[True], new])
        first[rows] = rows[starts][np.cumsum(starts) - 1]
    return first


def _judged(points: np.ndarray, edges: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the `pairs` (P, 2) of edges that meet those that cross; and (Q, 2) edge and vertex, of vertices in an edge."""
    low, high = (end(points[edges[:, 0]], points[edges[:, 1]]) for end in (np.minimum, np.maximum))
    box = [np.ascontiguousarray(v) for v in (low[:, 0], high[:, 0], low[:, 1], high[:, 1])]
    x, y = (np.ascontiguousarray(v) for v in points.T)
    ends = [np.ascontiguousarray(v) for v in np.sort(edges, 1).T]
    touching = np.logical_and(*(end[pairs[:, 0]] == end[pairs[:, 1]] for end in ends))
    within = []
    for i, j in (pairs.T, pairs.T[::-1]):
        a, b = edges[i].T
        left, right, bottom, top = (v[i] for v in box)
        for p in edges[j].T:
            inside = (left <= x[p]) & (x[p] <= right) & (bottom <= y[p]) & (y[p] <= top) & (p != a) & (p != b)
            near = np.flatnonzero(inside)
            near = near[signs(points, a[near], b[near], p[near]) == 0]
            touching[near] = True
            within.append(i[near] * len(points) + p[near])
    found = distinct(np.concatenate(within))
    return pairs[~touching], np.stack([found // len(points), found % len(points)], 1)


def _along(points: np.ndarray, edges: np.ndarray, within: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(S,) edge and (S,) vertex of `within`, by edges, and along each edge in order."""
    edge, vertex = within.T
    way = points[edges[edge, 1]] - points[edges[edge, 0]]
    axis = np.abs(way).argmax(1)
    rows = np.arange(len(edge))
    order = np.lexsort((points[vertex, axis] * np.sign(way[rows, axis]), edge))
    return edge[order], vertex[order]


def _parted(
    edges: np.ndarray, boundary: np.ndarray, edge: np.ndarray, stops: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The parts of the edges: their ends (N, 2), the names (N, 2) of these, and the edges (N,) that they belong to."""
    parts = np.bincount(edge, minlength=len(edges)) + 1
    start = np.cumsum(parts) - parts
    owner = np.repeat(np.arange(len(edges)), parts)
    at = np.arange(len(stops)) + edge + 1
    ends, names = (np.repeat(e[:, :1], parts, 0).repeat(2, 1) for e in (edges, boundary))
    for array, tail, last in ((ends, stops, edges), (names, count + np.arange(len(stops)), boundary)):
        array[at, 0] = tail
        array[:-1, 1] = array[1:, 0]
        array[start + parts - 1, 1] = last[:, 1]
    return ends, names, owner


def wrong_turns(points: np.ndarray, plane: PlaneBoundary) -> list[int]:
    """The positions, by their first vertices, in which the boundary of a sound plane graph crosses itself.

    From the edge that leaves a vertex the domain extends counter-clockwise to the next edge there, which must be the
    one that arrives at the same vertex.
    """
    place = Exact(points)
    spokes: dict[int, list[tuple[int, int, bool]]] = {}
    for (u, v), (one, two) in zip(plane.ends.tolist(), plane.names.tolist(), strict=True):
        spokes.setdefault(u, []).append((v, one, True))
        spokes.setdefault(v, []).append((u, two, False))
    wrong = []
    for p, around in spokes.items():
        if len({name for _, name, _ in around}) > 1 and not _turns_well(place, p, around):
            wrong.append(p)
    return wrong


def _turns_well(place: Exact, p: int, around: list[tuple[int, int, bool]]) -> bool:
    """Is each edge that leaves a vertex in position p followed by the one that arrives there?

    around  for each edge in p its other end, the vertex in p, and whether it leaves
    """
    ways: dict[int, list[tuple[int, int, bool]]] = {}
    for spoke in around:
        ways.setdefault(spoke[0], []).append(spoke)

    def later(q: int, r: int) -> int:
        return place.later(p, q, r)

    order: list[int] = sorted(ways, key=functools.cmp_to_key(later))
    single = [k for k, q in enumerate(order) if len(ways[q]) == 1]
    if single:
        order = order[single[0] :] + order[: single[0]]
    row: list[tuple[int, int, bool]] = []
    for q in order:
        # Of two edges that lie on each other inside the domain, one ends the domain before and one begins that behind.
        inside = row[-1][2] if row else not single
        row += sorted(ways[q], key=lambda spoke: spoke[2] == inside)
    if not row[0][2]:
        row = [*row[1:], row[0]]
    pairs = zip(row[::2], row[1::2], strict=True)
    return all(out[2] and not back[2] and out[1] == back[1] and out[0] != back[0] for out, back in pairs)


def own_sides(work: Triangulation, plane: PlaneBoundary) -> np.ndarray | Obstacle:
    """(T, 3) the triangles of `work`, which are those of the plane graph, by the vertices of their own side.

    The triangles round a position are parted into fans by the edges of the boundary.  A fan begins at the edge that
    leaves its vertex and ends at the one that arrives there; where these two do not belong to one vertex, the boundary
    crosses itself in that position.
    """
    count, corners = len(plane.first), work.corners
    tails, heads = corners.ravel(), corners[:, [1, 2, 0]].ravel()
    known = plane.ends @ np.array([count, 1])
    order = known.argsort()
    there, back = tails * count + heads, heads * count + tails
    at = np.minimum(np.searchsorted(known[order], there), len(known) - 1)
    on = np.flatnonzero(known[order][at] == there)
    part = order[at[on]]
    wall = among(there, known) | among(back, known) | (work.twin < 0)
    h = np.flatnonzero(~wall)
    fan = _components(len(tails), h, next_in_triangle(work.twin[h]))
    fans = np.concatenate([fan[on], fan[next_in_triangle(on)]])
    names = np.concatenate([plane.names[part, 0], plane.names[part, 1]])
    low, high = np.full(int(fan.max()) + 1, np.iinfo(np.int64).max), np.full(int(fan.max()) + 1, -1)
    np.minimum.at(low, fans, names)
    np.maximum.at(high, fans, names)
    mixed = np.flatnonzero((low < high) & (high >= 0))
    if len(mixed):
        at_vertex = int(tails[np.flatnonzero(fan == mixed[0])[0]])
        return Obstacle("the boundary crosses itself at vertex {}", (at_vertex,))
    return np.where(high[fan] >= 0, low[fan], tails).reshape(-1, 3)


def _components(count: int, one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """(count,) the components of a graph with the edges `one` - `two`."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    graph = coo_matrix((np.ones(len(one), np.int8), (one, two)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1])


def without_stops(points: np.ndarray, corners: np.ndarray, plane: PlaneBoundary) -> np.ndarray:
    """(T', 3) the triangles without the stops, each of which leaves one triangle less.

    A stop lies within a straight edge of the boundary.  The triangles around it fill a polygon that is seen from it as
    a whole, so the polygon is simple; without the stop it is cut into ears (Meisters, Polygons have ears, American
    Mathematical Monthly 82, 1975).
    """
    count = len(plane.first)
    points = np.concatenate([points[:count], points[plane.stops]])
    for stop in range(count, len(points)):
        around = (corners == stop).any(1)
        onward = {}
        for row in corners[around].tolist():
            k = row.index(stop)
            onward[row[(k + 1) % 3]] = row[(k + 2) % 3]
        (begin,) = set(onward) - set(onward.values())
        ring = [begin]
        while ring[-1] in onward:
            ring.append(onward[ring[-1]])
        corners = np.concatenate([corners[~around], _ears(points, ring)])
    return corners


def _ears(points: np.ndarray, ring: list[int]) -> np.ndarray:
    """(n - 2, 3) triangles of the simple polygon with the vertices `ring` in counter-clockwise order."""
    triangles = []
    while len(ring) > 3:
        p = np.array(ring)
        before, after = np.roll(p, 1), np.roll(p, -1)
        convex = signs(points, before, p, after) > 0
        for i in np.flatnonzero(convex).tolist():
            a, b, c = int(before[i]), int(p[i]), int(after[i])
            others = np.setdiff1d(p, [a, b, c])
            rows = [np.full(len(others), v) for v in (a, b, c)]
            sides = [signs(points, rows[k], rows[(k + 1) % 3], others) >= 0 for k in range(3)]
            if not (sides[0] & sides[1] & sides[2]).any():
                triangles.append([a, b, c])
                del ring[i]
                break
        else:
            raise AssertionError("a simple polygon has an ear")
    return np.array([*triangles, ring])


def of_own_sides(work: Triangulation, plane: PlaneBoundary, locked: np.ndarray) -> Triangulation | Obstacle:
    """The triangulation of the plane graph by the vertices of their own sides, Delaunay but for `locked` (K, 2)."""
    corners = own_sides(work, plane)
    if isinstance(corners, Obstacle):
        return corners
    corners = without_stops(work.points, corners, plane)
    made = Triangulation(work.points, corners, work.spacing)
    tails, heads, count = corners.ravel(), corners[:, [1, 2, 0]].ravel(), len(work.points)
    keys = locked.min(1) * count + locked.max(1)
    made.locked = among(np.minimum(tails, heads) * count + np.maximum(tails, heads), keys)
    made.flip_to_delaunay(np.arange(len(corners)))
    return made
