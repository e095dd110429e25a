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

    points   (V, 2) float64
    spacing  (V,) as in `Triangulation`

    Returns what is wrong with the loops if they bound no domain.  GEOS proposes a constrained Delaunay
    triangulation, which is checked exactly.  If it fails (near-degenerate loops), the vertices are inserted
    into a big triangle, the boundary is recovered, and its inside is cut out: exact from end to end.
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


def is_triangulation_of(points: np.ndarray, corners: np.ndarray, boundary: np.ndarray) -> bool:
    """All of `corners` (T, 3) counter-clockwise, each edge in two of them, but `boundary` (E, 2) in one as directed."""
    if not len(corners) or (signs(points, *corners.T) <= 0).any():
        return False
    count = len(points)
    ways = np.concatenate([corners, corners[:, [1, 2, 0]]]).reshape(2, -1)
    there, back = np.sort(ways[0] * count + ways[1]), ways[1] * count + ways[0]
    found = np.minimum(np.searchsorted(there, back), len(there) - 1)
    # What has no edge back, seen from its other side.
    single = np.sort(back[there[found] != back])
    unique = bool((there[1:] != there[:-1]).all())
    return unique and np.array_equal(single, np.sort(boundary[:, 1] * count + boundary[:, 0]))


def _proposed(points: np.ndarray, loops: list[np.ndarray]) -> np.ndarray | None:
    """GEOS's triangles (T, 3) if exact signs confirm them."""
    import shapely

    outer = int(np.argmax(turns_left(points, loops)))
    polygon = shapely.Polygon(points[loops[outer]], [points[loop] for i, loop in enumerate(loops) if i != outer])
    if not polygon.is_valid:
        return None
    corners = _named(points, np.concatenate(loops), shapely.constrained_delaunay_triangles(polygon))
    boundary = np.concatenate([loop_edges(loop) for loop in loops])
    return corners if corners is not None and is_triangulation_of(points, corners, boundary) else None


def _named(points: np.ndarray, vertices: np.ndarray, pieces: Any) -> np.ndarray | None:
    """(T, 3) GEOS's triangles as rows of `points`, none clockwise; of `vertices` in one position the first is meant."""
    import shapely

    positions = shapely.get_coordinates(shapely.get_parts(pieces))
    if not len(positions) or len(positions) % 4:
        return None
    known, first = np.unique(points[vertices, 0] + 1j * points[vertices, 1], return_index=True)
    wanted = (positions[:, 0] + 1j * positions[:, 1]).reshape(-1, 4)[:, :3]
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
    """The domain on the left of simple `loops` with the vertices of `inner` (N,) that lie in it; None if this fails.

    segments  (K, 2) edges that must be there, and are locked

    Does at once what `triangulate_polygon`, `insert` and `recover` do step by step: GEOS triangulates all the
    vertices in a big triangle, and the boundary and the segments are recovered in it.  The result is checked
    exactly, and is Delaunay except at the edges asked for.
    """
    import shapely

    boundary = np.concatenate([loop_edges(loop) for loop in loops])
    # Vertices outside would only hinder the recovery of the boundary.
    vertices = np.concatenate([boundary[:, 0], inner[winding(points, inner, boundary) == 1]])
    more, big = _with_big_triangle(points, vertices)
    names = np.concatenate([vertices, big])
    try:
        with np.errstate(all="ignore"):
            pieces = shapely.delaunay_triangles(shapely.MultiPoint(more[names]))
    except shapely.errors.GEOSException:  # "could not locate vertex", where positions are all but the same
        return None
    corners = _named(more, names, pieces)
    if corners is None or not is_triangulation_of(more, corners, loop_edges(big)):
        return None
    work = Triangulation(more, corners, np.zeros(len(more)))
    if recover(work, np.concatenate([boundary, segments])):
        return None
    enclosed = _enclosed(work, boundary)
    # Where the loops bound no domain, corners of the big triangle may be among those enclosed.
    if not is_triangulation_of(more, enclosed, boundary):
        return None
    made = Triangulation(points, enclosed, spacing)
    if recover(made, segments):
        return None
    made.flip_to_delaunay(np.arange(len(made.corners)))
    _spread_inward(made.spacing, made.corners, boundary)
    return made


def _spread_inward(spacing: np.ndarray, corners: np.ndarray, boundary: np.ndarray) -> None:
    """Give vertices of `corners` (T, 3) inside the `boundary` (E, 2) the mean of their neighbours, ring by ring."""
    known = np.zeros(len(spacing), bool)
    known[boundary] = True
    tail, head = corners.ravel(), corners[:, [1, 2, 0]].ravel()
    while len(rows := np.flatnonzero(known[tail] & ~known[head])):
        total = np.bincount(head[rows], spacing[tail[rows]], len(spacing))
        count = np.bincount(head[rows], minlength=len(spacing))
        ring = count > 0
        spacing[ring] = total[ring] / count[ring]
        known |= ring


def _cut_out(points: np.ndarray, loops: list[np.ndarray], spacing: np.ndarray) -> np.ndarray | Obstacle:
    """(T, 3) the same by exact steps only: a big triangle, the vertices, the boundary, and what is on its left."""
    boundary = np.concatenate([loop_edges(loop) for loop in loops])
    vertices = distinct(boundary)
    more, big = _with_big_triangle(points, vertices)
    work = Triangulation(more, big[None], np.zeros(len(more)))
    refused = work.insert(vertices, np.zeros(len(vertices), np.int64))
    if len(refused):
        return Obstacle("vertex {} of the boundary is in the position of another", (int(refused[0]),))
    obstacle = recover(work, boundary)
    if obstacle:
        return obstacle
    corners = _enclosed(work, boundary)
    return (
        corners
        if is_triangulation_of(more, corners, boundary)
        else Obstacle("the boundary does not enclose one domain")
    )


def _with_big_triangle(points: np.ndarray, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`points` (V, 2) and three more far round the `vertices` (N,); the rows of these."""
    reach = 2.0 ** np.ceil(np.log2(np.abs(points[vertices]).max()) + 3)
    big = np.array([[-reach, -reach], [reach, -reach], [0, reach]])
    return np.concatenate([points, big]), len(points) + np.arange(3)


def _enclosed(work: Triangulation, boundary: np.ndarray) -> np.ndarray:
    """(T, 3) the triangles on the left of the edges `boundary` (E, 2), as far as one reaches without crossing these."""
    count = len(work.points)
    keys = work.corners.ravel() * count + work.corners[:, [1, 2, 0]].ravel()
    first = among(keys, boundary[:, 0] * count + boundary[:, 1])
    wall = first | among(keys, boundary[:, 1] * count + boundary[:, 0])
    inside = np.zeros(len(work.corners), bool)
    front = np.flatnonzero(first) // 3
    while len(front):
        inside[front] = True
        h = (3 * front[:, None] + np.arange(3)).ravel()
        front = distinct(work.twin[h[~wall[h]]] // 3)
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
