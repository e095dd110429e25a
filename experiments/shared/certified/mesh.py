"""A mesh with fixed vertices, in fractions: its boundary, its pieces, and how often the boundary goes round a point."""

from __future__ import annotations

from fractions import Fraction

Point = tuple  # of two whole numbers or fractions


class Wrong(Exception):
    """A certificate does not hold; says why."""


def side(a: Point, b: Point, c: Point):
    """Twice the signed area of abc: positive if c is on the left of the line from a to b."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def demand(condition: bool, reason: str) -> None:
    if not condition:
        raise Wrong(reason)


class Mesh:
    """Points as fractions, triangles, fixed vertices, and what follows from these alone."""

    def __init__(self, data: dict) -> None:
        self.points = [tuple(Fraction(x) for x in p) for p in data["points"]]
        self.triangles = [tuple(t) for t in data["triangles"]]
        self.fixed = set(data["fixed"])
        self.third: dict[tuple[int, int], int] = {}
        for a, b, c in self.triangles:
            demand(len({a, b, c}) == 3, "a triangle has a vertex twice")
            for edge, corner in (((a, b), c), ((b, c), a), ((c, a), b)):
                demand(edge not in self.third, f"two triangles are on the same side of the edge {edge}")
                self.third[edge] = corner
        self.boundary = [edge for edge in self.third if edge[::-1] not in self.third]
        self._simple: bool | None = None

    def piece(self, triangle: int) -> list[int]:
        """The triangles that edges join to that one."""
        at = {edge: row for row, (a, b, c) in enumerate(self.triangles) for edge in ((a, b), (b, c), (c, a))}
        found, stack = {triangle}, [triangle]
        while stack:
            a, b, c = self.triangles[stack.pop()]
            for edge in ((b, a), (c, b), (a, c)):
                row = at.get(edge)
                if row is not None and row not in found:
                    found.add(row)
                    stack.append(row)
        return sorted(found)

    def part(self, rows: list[int]) -> Mesh:
        """A mesh of some of the triangles."""
        return Mesh({"points": self.points, "triangles": [self.triangles[r] for r in rows], "fixed": self.fixed})

    def loops(self) -> list[list[int]]:
        """The boundary as closed loops, each vertex in one of them and once."""
        after = dict(self.boundary)
        demand(len(after) == len(self.boundary), "a vertex is on the boundary twice")
        loops = []
        while after:
            loop = [next(iter(after))]
            while (following := after.pop(loop[-1], None)) is not None:
                loop.append(following)
            demand(loop[0] == loop[-1], "the boundary does not close")
            loops.append(loop[:-1])
        return loops

    def demand_domain(self) -> None:
        """The boundary is fixed, meets itself nowhere, and has one loop that turns to the left."""
        if self._simple is None:
            self._simple = True
            loops = self.loops()
            demand(all(v in self.fixed for loop in loops for v in loop), "a vertex of the boundary is free")
            areas = [sum(self.cross(a, b) for a, b in zip(loop, loop[1:] + loop[:1], strict=True)) for loop in loops]
            demand(
                sum(area > 0 for area in areas) == 1 and all(areas), "not one loop of the boundary turns to the left"
            )
            demand(len(self.piece(0)) == len(self.triangles), "the mesh is in pieces")
            points = whole(self.points, 0)
            edges = self.boundary
            for i, (a, b) in enumerate(edges):
                for c, d in edges[:i]:
                    demand(not meet(points, (a, b), (c, d)), f"the boundary edges {(a, b)} and {(c, d)} meet")

    def cross(self, a: int, b: int):
        (ax, ay), (bx, by) = self.points[a], self.points[b]
        return ax * by - ay * bx

    def rounds(self, p: Point) -> int:
        """How often the boundary goes round a point to the left."""
        count = 0
        for u, v in self.boundary:
            a, b = self.points[u], self.points[v]
            s = side(a, b, p)
            on = s == 0 and all(min(a[k], b[k]) <= p[k] <= max(a[k], b[k]) for k in (0, 1))
            demand(not on, "the point is on the boundary")
            if a[1] <= p[1] < b[1] and s > 0:
                count += 1
            if b[1] <= p[1] < a[1] and s < 0:
                count -= 1
        return count


def whole(points: list, depth: int) -> list[Point]:
    """The points times a number that makes whole numbers of them, and of what `depth` cuts halve."""
    scale = 1
    for p in points:
        for x in p:
            scale = scale * x.denominator // gcd(scale, x.denominator)
    scale <<= depth
    return [tuple(int(x * scale) for x in p) for p in points]


def gcd(a: int, b: int) -> int:
    while b:
        a, b = b, a % b
    return a


def meet(points: list, one: tuple, other: tuple) -> bool:
    """Do two segments meet, other than in a common end?"""
    a, b, c, d = (points[v] for v in (*one, *other))
    for k in (0, 1):
        if max(a[k], b[k]) < min(c[k], d[k]) or max(c[k], d[k]) < min(a[k], b[k]):
            return False
    common = set(one) & set(other)
    if common:
        if len(common) == 2:
            return True
        (v,) = common
        (p,), (q,) = set(one) - common, set(other) - common
        o, p, q = points[v], points[p], points[q]
        along = (p[0] - o[0]) * (q[0] - o[0]) + (p[1] - o[1]) * (q[1] - o[1])
        return side(o, p, q) == 0 and along >= 0
    s1, s2, s3, s4 = side(a, b, c), side(a, b, d), side(c, d, a), side(c, d, b)
    if s1 == s2 == s3 == s4 == 0:
        return True  # on one line, with boxes that meet
    sign = [(s > 0) - (s < 0) for s in (s1, s2, s3, s4)]
    return sign[0] * sign[1] <= 0 and sign[2] * sign[3] <= 0
