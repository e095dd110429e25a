"""The triangulation of a polygon with holes, exact: Shapely proposes, exact signs decide.

triangulate_polygon   with the loops' vertices only
triangulate_with      with vertices and edges inside, at once
"""

from typing import Any

import numpy as np

from .arrays import Obstacle, among, distinct, signs
from .polygon import loop_edges, turns_left, why_not_simple, winding
from .recovery import recover
from .triangulation import Triangulation

# Vertices times triangles up to which each vertex is held against each triangle's box; more go through a tree.
_TABLE = 100_000


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
    if recover(work, np.concatenate([rim, segments])):
        return None
    made = Triangulation(points, _enclosed(work, rim), spacing)
    if recover(made, segments):
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
    obstacle = recover(work, rim)
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
