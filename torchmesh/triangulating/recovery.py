"""Edges of a triangulation recovered by flips: exact, and sure to end."""

import numpy as np

from .arrays import Obstacle, among, next_in_triangle
from .triangulation import Triangulation


class Exact:
    """Products of coordinate differences as Python integers, all times one power of two."""

    def __init__(self, points: np.ndarray) -> None:
        self.points = points
        mantissa, exponent = np.frexp(points)
        self.shift = max(0, 53 - int(exponent[mantissa != 0].min(initial=53)))
        self.known: dict[int, tuple[int, int]] = {}

    def __getitem__(self, p: int) -> tuple[int, int]:
        if p not in self.known:
            (nx, dx), (ny, dy) = (v.as_integer_ratio() for v in self.points[p].tolist())
            self.known[p] = (nx << self.shift) // dx, (ny << self.shift) // dy
        return self.known[p]

    def cross(self, u: int, v: int, p: int) -> int:
        """(v - u) x (p - u): positive when p is left of uv, in proportion to its distance."""
        (ux, uy), (vx, vy), (px, py) = self[u], self[v], self[p]
        return (vx - ux) * (py - uy) - (vy - uy) * (px - ux)

    def dot(self, u: int, v: int, p: int) -> int:
        """(v - u) . (p - u): how far p is along uv."""
        (ux, uy), (vx, vy), (px, py) = self[u], self[v], self[p]
        return (vx - ux) * (px - ux) + (vy - uy) * (py - uy)

    def later(self, p: int, q: int, r: int) -> int:
        """Positive if the ray pq comes after the ray pr, counter-clockwise from the x axis; 0 if they are alike."""
        (px, py), (qx, qy), (rx, ry) = self[p], self[q], self[r]
        below = (qy < py or (qy == py and qx < px)), (ry < py or (ry == py and rx < px))
        return below[0] - below[1] or -((qx - px) * (ry - py) - (qy - py) * (rx - px))


def recover(work: Triangulation, segments: np.ndarray) -> Obstacle | None:
    """Flip edges until each of `segments` (K, 2) is an edge, and lock it.

    Returns the obstacle if a segment passes through a vertex, crosses a locked edge, or leaves the domain.
    Each flip takes the edge from w, the vertex on the left that is farthest from the line, to z, the farthest
    neighbour of w across the line.  That quadrilateral is strictly convex at both (ties go to the vertex
    farther along), and w never comes back, so the flips end; Sloan 1993 leaves that open.
    """
    if not len(segments):
        return None
    count = len(work.points)
    there, wanted = (
        np.minimum(u, v) * count + np.maximum(u, v) for u, v in ((work.corners, work.corners[:, [1, 2, 0]]), segments.T)
    )
    work.locked |= among(there.ravel(), wanted)
    exact = Exact(work.points)
    for u, v in segments[~among(wanted, there)].tolist():
        obstacle = _recover_one(work, u, v, exact)
        if obstacle:
            return obstacle
    return None


class _Line:
    """The segment from u to v; how far vertices are to the left of it, and along it, is computed once for each.

    places  by vertex, `Exact.cross` and `Exact.dot` of it
    """

    def __init__(self, exact: Exact, u: int, v: int) -> None:
        self.exact, self.u, self.v = exact, u, v
        self.places: dict[int, tuple[int, int]] = {}

    def place(self, p: int) -> tuple[int, int]:
        """How far p is to the left, and how far along."""
        known = self.places.get(p)
        if known is None:
            known = self.places[p] = self.exact.cross(self.u, self.v, p), self.exact.dot(self.u, self.v, p)
        return known


def _recover_one(work: Triangulation, u: int, v: int, exact: Exact) -> Obstacle | None:
    line = _Line(exact, u, v)
    crossed, obstacle = _crossed(work, line, None)
    while crossed:
        flat = work.corners.ravel()
        tails, heads = flat[crossed].tolist(), flat[next_in_triangle(np.array(crossed))].tolist()
        w = max(heads, key=line.places.__getitem__)
        i = max((i for i, head in enumerate(heads) if head == w), key=lambda i: _right_of(line.places[tails[i]]))
        work.flip_one(crossed[i])
        # Of the half-edges crossed, only this one and the next are in the two triangles that have changed.
        before, after = crossed[: max(i - 1, 0)], crossed[i + 2 :]
        found, obstacle = _crossed(work, line, crossed[i - 1] if i else None, after[0] if after else None)
        crossed = [] if obstacle else before + found + after
    if obstacle:
        return obstacle
    flat = work.corners.ravel()
    spokes = np.flatnonzero((flat == u) | (flat == v))
    work.locked[spokes[among(flat[next_in_triangle(spokes)], np.array([u, v]))]] = True
    return None


def _right_of(place: tuple[int, int]) -> tuple[int, int]:
    """How far a `_Line.place` is to the right, and how far along."""
    return -place[0], place[1]


def _crossed(
    work: Triangulation, line: _Line, start: int | None, end: int | None = None
) -> tuple[list[int], Obstacle | None]:
    """The half-edges that the line crosses from right (tail) to left (head), in order.

    start  the one to begin with; None: the first one
    end    the one before which to end; None: after the last one
    """
    crossed: list[int] = []
    if start is None:
        start, obstacle = _first_crossed(work, line)
        if start is None:
            return [], obstacle
    corners, e = work.corners, start
    while e != end:
        g = int(work.twin[e])
        if g < 0 or work.locked[e]:
            a, b = int(corners[e // 3, e % 3]), int(corners[e // 3, (e + 1) % 3])
            return [], Obstacle("the edge [{}, {}] crosses the edge [{}, {}]", (line.u, line.v, a, b))
        crossed.append(e)
        p = int(corners[g // 3, (g + 2) % 3])
        if p == line.v:
            break
        side = line.place(p)[0]
        if side == 0:
            return [], Obstacle("the edge [{}, {}] passes through vertex {}", (line.u, line.v, p))
        e = g - g % 3 + (g + (1 if side > 0 else 2)) % 3
    return crossed, None


def _first_crossed(work: Triangulation, line: _Line) -> tuple[int | None, Obstacle | None]:
    """The first half-edge that the line crosses; None where it is an edge, or for the obstacle."""
    corners, u, v = work.corners, line.u, line.v
    starts = np.flatnonzero(corners.ravel() == u).tolist()
    spokes = [(h, int(corners[h // 3, (h + 1) % 3]), int(corners[h // 3, (h + 2) % 3])) for h in starts]
    if any(v in (a, b) for _, a, b in spokes):
        return None, None
    for h, a, b in spokes:
        for p in (a, b):
            side, along = line.place(p)
            if side == 0 and along > 0:
                return None, Obstacle("the edge [{}, {}] passes through vertex {}", (u, v, p))
        if line.place(a)[0] < 0 < line.place(b)[0]:
            return h - h % 3 + (h + 1) % 3, None
    return None, Obstacle("the edge [{}, {}] leaves the domain at vertex {}", (u, v, u))
