"""Is it proved that these meshes cannot be valid?  Certificates are checked with whole numbers and fractions alone.

    python experiments/robustness/check_certificates.py FILE ...

A file holds one JSON object a line (or one in all), as torchmesh writes them: points, triangles, fixed vertices and
certificates.  This program imports nothing of torchmesh; it reads JSON and computes with fractions.  Its claim is: with
these triangles and fixed vertices no positions of the other vertices make all triangles turn to the left.

What it relies on.  Upright triangles cover each point as often as the boundary goes round it to the left (the degree of
a map).  So if the boundary consists of loops of fixed vertices that meet neither themselves nor each other, one of
which turns to the left and all others to the right, a valid mesh covers its domain once, its edges lie inside, meet
in common ends only, and touch the boundary in their ends only.  Validity is an open condition, so free vertices may be
taken to lie on no line that is spoken of here.

The exit status is 0 if each mesh has a certificate and all certificates hold.
"""

from __future__ import annotations

import json
import sys
from fractions import Fraction
from pathlib import Path

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


def fixed_triangle(mesh: Mesh, given: dict) -> None:
    a, b, c = given["triangle"]
    demand(mesh.third.get((a, b)) == c, "there is no such triangle")
    demand({a, b, c} <= mesh.fixed, "a corner is free")
    demand(side(*(mesh.points[v] for v in (a, b, c))) <= 0, "the triangle is upright")


def empty_kernel(mesh: Mesh, given: dict) -> None:
    v, weights = given["vertex"], [Fraction(w) for w in given["weights"]]
    demand(min(weights) >= 0 and any(weights), "a weight is negative, or all are zero")
    demand(len(weights) == len(given["edges"]), "edges and weights are not alike in number")
    sums = [Fraction(0)] * 3
    for (a, b), w in zip(given["edges"], weights, strict=True):
        demand(mesh.third.get((a, b)) == v and {a, b} <= mesh.fixed, f"{(a, b)} is no fixed edge of its triangles")
        (ax, ay), (bx, by) = mesh.points[a], mesh.points[b]
        nx, ny = ay - by, bx - ax  # a point p is on the left if n.p > n.a
        for k, term in enumerate((nx, ny, nx * ax + ny * ay)):
            sums[k] += w * term
    demand(sums[0] == 0 and sums[1] == 0 and sums[2] >= 0, "the weights prove nothing")


def edges_meet(mesh: Mesh, given: dict) -> None:
    mesh.demand_domain()
    one, other = (tuple(edge) for edge in given["edges"])
    for edge in (one, other):
        demand(edge in mesh.third or edge[::-1] in mesh.third, f"there is no edge {edge}")
        demand(set(edge) <= mesh.fixed, f"an end of {edge} is free")
    demand(set(one) != set(other) and meet(mesh.points, one, other), "the edges do not meet")


def vertex_outside(mesh: Mesh, given: dict) -> None:
    v = given["vertex"]
    demand(v in mesh.fixed, "the vertex is free")
    demand(any(v in t for t in mesh.triangles), "the vertex has no triangle")
    demand(all(a in mesh.fixed for a, _ in mesh.boundary), "a vertex of the boundary is free")
    demand(mesh.rounds(mesh.points[v]) <= 0, "the boundary goes round the vertex to the left")


def point_outside(mesh: Mesh, given: dict) -> None:
    demand(all(a in mesh.fixed for a, _ in mesh.boundary), "a vertex of the boundary is free")
    demand(mesh.rounds(tuple(Fraction(x) for x in given["point"])) < 0, "the boundary does not go round the point so")


def euler(mesh: Mesh) -> int:
    """The Euler number, a vertex counted once for each fan of triangles at it."""
    fans, left = 0, set(mesh.third)
    # From the corner at a of the triangle abc to the next one round a, across the edge from c to a; open fans first.
    for start in [*mesh.boundary, *mesh.third]:
        if start in left:
            fans += 1
        edge = start
        while edge in left:
            left.discard(edge)
            edge = (edge[0], mesh.third[edge])
    edges = len({frozenset(edge) for edge in mesh.third})
    return fans - edges + len(mesh.triangles)


def turns(mesh: Mesh, given: dict) -> None:
    part = mesh.part(mesh.piece(given["triangle"]))
    demand(all(a in mesh.fixed for a, _ in part.boundary), "a vertex of the boundary is free")
    # The boundary edge after one, round the same fan of triangles.
    onward = {}
    for a, b in part.boundary:
        edge = (b, part.third[a, b])
        while edge[::-1] in part.third:
            edge = (b, part.third[edge[::-1]])
        onward[a, b] = edge
    arrow = {}
    for a, b in part.boundary:
        (ax, ay), (bx, by) = part.points[a], part.points[b]
        arrow[a, b] = bx - ax, by - ay
        demand(any(arrow[a, b]), "a boundary edge has no length")
    # A direction along no edge; how often does the direction of the boundary pass it, to the left less to the right?
    slope = Fraction(1)
    while any(y == slope * x for x, y in arrow.values()):
        slope += Fraction(1, 1 + len(arrow))
    ray = (Fraction(1), slope)
    count = 0
    for edge, following in onward.items():
        u, w = arrow[edge], arrow[following]
        turn, before, after = side((0, 0), u, w), side((0, 0), u, ray), side((0, 0), ray, w)
        if turn > 0:
            count += before > 0 and after > 0
        elif turn < 0:
            count -= before < 0 and after < 0
        elif u[0] * w[0] + u[1] * w[1] < 0:
            # A reversal is a turn to the right, since the angle of the triangles between is positive.
            count -= before < 0
    demand(count < euler(part), "the boundary turns round often enough")


def handles(mesh: Mesh, given: dict) -> None:
    mesh.demand_domain()
    demand(euler(mesh) < 2 - len(mesh.loops()), "the mesh has no handle")


class NoPlace:
    """A vertex loses the domain bit by bit.  A place is a cell, or one of four parts of a place."""

    def __init__(self, mesh: Mesh, given: dict) -> None:
        mesh.demand_domain()
        self.mesh, self.vertex = mesh, given["vertex"]
        self.steps = [(v, tuple(place), u) for v, place, u in given["steps"]]
        depth = max((len(place) for _, place, _ in self.steps), default=1)
        self.points = whole(mesh.points, depth)
        self.cells = [tuple(cell) for cell in given["cells"]]
        self.on_left: dict[tuple[int, int], int] = {}
        for row, (a, b, c) in enumerate(self.cells):
            demand(side(self.points[a], self.points[b], self.points[c]) > 0, "a cell does not turn to the left")
            for edge in ((a, b), (b, c), (c, a)):
                demand(edge not in self.on_left, "two cells are on the same side of an edge")
                self.on_left[edge] = row
        bound = {edge for edge in self.on_left if edge[::-1] not in self.on_left}
        demand(bound == set(mesh.boundary), "the cells do not have the boundary of the mesh")
        self.has: dict[int, set] = {}
        self.known: dict = {}

    def check(self) -> None:
        demand(self.vertex not in self.mesh.fixed, "the vertex is fixed")
        demand(any(self.vertex in t for t in self.mesh.triangles), "the vertex has no triangle")
        for v, place, u in self.steps:
            demand(v not in self.mesh.fixed, f"vertex {v} is fixed")
            demand((v, u) in self.mesh.third or (u, v) in self.mesh.third, f"{v} and {u} are no neighbours")
            for other in [u] if u in self.mesh.fixed else self.cut(u, len(place)):
                demand(self.excluded(v, place, u, other), f"vertex {v} at {place} may go with {u} at {other}")
            self.lose(v, place)
        demand(not self.of(self.vertex), f"vertex {self.vertex} has a place left")

    def of(self, v: int) -> set:
        return self.has.setdefault(v, {(row,) for row in range(len(self.cells))})

    def cut(self, v: int, depth: int) -> list:
        """The places of a vertex, the larger ones cut into parts of so many numbers."""
        places = sorted(self.of(v))
        while any(len(place) < depth for place in places):
            places = [p for q in places for p in ([q] if len(q) >= depth else [(*q, k) for k in range(4)])]
        return places

    def lose(self, v: int, place: tuple) -> None:
        has = self.of(v)
        for depth in range(1, len(place)):
            if place[:depth] in has:
                has.remove(place[:depth])
                has.update((*place[:depth], k) for k in range(4))
        has.discard(place)

    def corners(self, place) -> list[Point]:
        """The corners of a place, or the position of a fixed vertex."""
        if isinstance(place, int):
            return [self.points[place]]
        a, b, c = (self.points[v] for v in self.cells[place[0]])
        for part in place[1:]:
            ab, bc, ca = (tuple((x + y) // 2 for x, y in zip(p, q, strict=True)) for p, q in ((a, b), (b, c), (c, a)))
            a, b, c = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))[part]
        return [a, b, c]

    def excluded(self, v: int, place: tuple, u: int, other) -> bool:
        here, there = self.corners(place), self.corners(other)
        for edge, sign in (((v, u), 1), ((u, v), -1)):
            w = self.mesh.third.get(edge)
            if w is None:
                continue
            corners = {p for at in ([w] if w in self.mesh.fixed else self.of(w)) for p in self.corners(at)}
            # The determinant is linear in each point, so that it is greatest at corners.
            if all(sign * side(p, q, r) <= 0 for p in here for q in there for r in corners):
                return True
        return self.apart(place, other)

    def apart(self, place: tuple, other) -> bool:
        if (place, other) not in self.known:
            self.known[place, other] = self.no_line(place, other)
        return self.known[place, other]

    def no_line(self, place: tuple, other) -> bool:
        """No segment inside the domain joins the place to the other: all ways through the cells are shut."""
        of_vertex = isinstance(other, int)
        ends = {row for row, cell in enumerate(self.cells) if other in cell} if of_vertex else {other[0]}
        if not ends or place[0] in ends:
            return False
        pairs = [(p, q) for p in self.corners(place) for q in self.corners(other)]
        a, b, c = self.cells[place[0]]
        ways = [((b, a), (b,), (a,), {place[0]}), ((c, b), (c,), (b,), {place[0]}), ((a, c), (a,), (c,), {place[0]})]
        while ways:
            (left, right), lefts, rights, been = ways.pop()
            if other not in (left, right) and (
                all(side(p, q, self.points[left]) <= 0 for p, q in pairs)
                or all(side(p, q, self.points[right]) >= 0 for p, q in pairs)
            ):
                continue  # an end of the chord is on the wrong side of all segments
            cell = self.on_left.get((left, right))
            if cell is None or cell in been:
                continue  # a straight line does not come back to a triangle
            if cell in ends:
                return False
            (new,) = set(self.cells[cell]) - {left, right}
            for chord, more, fewer in (
                ((new, right), (*lefts, new), rights),
                ((left, new), lefts, (*rights, new)),
            ):
                if other in more or other in fewer or self.stabbed(more, fewer):
                    ways.append((chord, more, fewer, been | {cell}))
        return True

    def stabbed(self, lefts: tuple, rights: tuple) -> bool:
        """May a line have these on its left and those on its right?  Then one does that leans on one of each."""
        left, right = [self.points[v] for v in dict.fromkeys(lefts)], [self.points[v] for v in dict.fromkeys(rights)]
        for a in left:
            for b in right:
                for p, q in ((a, b), (b, a)):
                    if all(side(p, q, c) >= 0 for c in left) and all(side(p, q, c) <= 0 for c in right):
                        return True
        return False


def no_place(mesh: Mesh, given: dict) -> None:
    NoPlace(mesh, given).check()


KINDS = {
    "fixed triangle": fixed_triangle,
    "empty kernel": empty_kernel,
    "edges meet": edges_meet,
    "vertex outside": vertex_outside,
    "point outside": point_outside,
    "turns": turns,
    "handles": handles,
    "no place": no_place,
}


def check(data: dict) -> list[str]:
    """What is wrong with the certificates of a mesh; an empty list: it is proved that the mesh cannot be valid."""
    try:
        mesh = Mesh(data)
    except Wrong as wrong:
        return [str(wrong)]
    wrongs = [] if data["certificates"] else ["there is no certificate"]
    for given in data["certificates"]:
        try:
            KINDS[given["kind"]](mesh, given)
        except (Wrong, KeyError) as wrong:
            wrongs.append(f"{given.get('kind')}: {wrong}")
    return wrongs


def main(paths: list[str]) -> int:
    failed = 0
    for path in paths:
        for number, line in enumerate(filter(str.strip, Path(path).read_text().splitlines()), 1):
            data = json.loads(line)
            name = data.get("case", f"{path}, line {number}")
            wrongs = check(data)
            failed += bool(wrongs)
            kinds = ", ".join(dict.fromkeys(given["kind"] for given in data["certificates"]))
            print(f"{name}: {'; '.join(wrongs) if wrongs else 'proved: ' + kinds}")
    return int(failed > 0)


if __name__ == "__main__":
    if len(sys.argv) < 2 or {"-h", "--help"} & set(sys.argv):
        print(__doc__)
        sys.exit(0 if len(sys.argv) > 1 else 2)
    sys.exit(main(sys.argv[1:]))
