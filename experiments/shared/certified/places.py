"""A vertex without a place: steps by which it loses the domain, each checked by signs of whole numbers."""

from __future__ import annotations

from experiments.shared.certified.mesh import Mesh, Point, demand, side, whole


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
