r"""Is a proof that a vertex has no place right?  Step by step, in whole numbers.

Positions are binary fractions, and so are the corners of parts of cells: times a power of two all are whole numbers,
and no sign is ever rounded.  Three statements are used:

    side      The determinant of three points is linear in each of them.  Over all triples of points in three parts it
              is greatest at three corners: if it is not positive there, no such triple turns to the left.
    line      A line that crosses chords has their left ends on its left and their right ends on its right.  If one
              exists, one exists that leans on an end of each side, and has the others on it or on their sides.
    cover     The cells are a triangulation of the domain, and four parts cover what was cut into them.

experiments/robustness/check_certificates.py states the same again, apart from this package.
"""

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from .no_place_steps import NoPlace, Place, Step

Point = tuple[int, int]
Points = tuple[Point, ...]
Chord = tuple[int, int]


def check_no_place(points: np.ndarray, triangles: np.ndarray, fixed: np.ndarray, proof: NoPlace) -> list[str]:
    """What is wrong with a proof, by exact signs alone; an empty list: it proves its claim.

    The boundary must be of fixed vertices, and bound a domain.  Arguments as in `no_place.no_place`.
    """
    check = _Check(points, triangles, fixed, proof)
    return check.of_cells() or check.of_steps(proof)


class _Check:
    """What a proof speaks of, in whole numbers."""

    def __init__(self, points: np.ndarray, triangles: np.ndarray, fixed: np.ndarray, proof: NoPlace) -> None:
        depth = max((len(step.place) for step in proof.steps), default=1)
        self.points = _whole(points, depth)
        self.fixed = fixed
        faces = [tuple(turned) for t in triangles.tolist() for turned in (t, t[1:] + t[:1], t[2:] + t[:2])]
        self.apex = {(a, b): c for a, b, c in faces}
        self.cells = [tuple(cell) for cell in proof.cells.tolist()]
        self.left = {side: row for row, (a, b, c) in enumerate(self.cells) for side in ((a, b), (b, c), (c, a))}
        self.left_places: dict[int, set[Place]] = {}
        self.memo: dict[tuple[Place, int | Place], bool] = {}
        self.corner_memo: dict[Place, Points] = {}
        self.hulls: dict[int, Points] = {}
        self.ends_of: dict[int, set[int]] = defaultdict(set)
        for row, cell in enumerate(self.cells):
            for v in cell:
                self.ends_of[v].add(row)

    def of_cells(self) -> list[str]:
        """What is wrong with the cells."""
        wrong = []
        bound = {edge for edge in self.apex if edge[::-1] not in self.apex}
        if any(_side(*(self.points[v] for v in cell)) <= 0 for cell in self.cells):
            wrong.append("a cell is not counter-clockwise")
        if len(self.left) != 3 * len(self.cells) or {s for s in self.left if s[::-1] not in self.left} != bound:
            wrong.append("the cells are no triangulation of the boundary")
        if not all(self.fixed[a] for a, _ in bound):
            wrong.append("a vertex of the boundary is free")
        return wrong

    def of_steps(self, proof: NoPlace) -> list[str]:
        """What is wrong with the steps."""
        wrong = []
        for step in proof.steps:
            v, u = step.vertex, step.neighbour
            if self.fixed[v] or ((v, u) not in self.apex and (u, v) not in self.apex):
                wrong.append(f"{step} names no free vertex with a neighbour")
            elif not self.holds(step):
                wrong.append(f"{step}: something is left that goes with it")
            elif not self.lose(v, step.place):
                wrong.append(f"{step} is of a place that was lost before")
        if self.fixed[proof.vertex] or self.places(proof.vertex):
            wrong.append(f"vertex {proof.vertex} has a place left")
        return wrong

    def places(self, v: int) -> set[Place]:
        """What a free vertex has still."""
        return self.left_places.setdefault(v, {(row,) for row in range(len(self.cells))})

    def lose(self, v: int, place: Place) -> bool:
        """The vertex loses a place; what holds it is cut into four until it is there.  Did it have it?"""
        has = self.places(v)
        for depth in range(1, len(place)):
            if place[:depth] in has:
                has.remove(place[:depth])
                has |= {(*place[:depth], part) for part in range(4)}
        self.hulls.pop(v, None)
        had = place in has
        has.discard(place)
        return had

    def holds(self, step: Step) -> bool:
        """Does nothing that the neighbour has still go with the place?"""
        v, u = step.vertex, step.neighbour
        here = self.corners(step.place)
        others: Sequence[int | Place] = [u] if self.fixed[u] else self.cut(u, len(step.place))
        for other in others:
            there = (self.points[other],) if isinstance(other, int) else self.corners(other)
            if not (self.inverted(v, u, here, there) or self.apart(step.place, other)):
                return False
        return True

    def cut(self, v: int, depth: int) -> list[Place]:
        """What a free vertex has still, in parts no larger than those of so many numbers."""
        stack, found = list(self.places(v)), []
        while stack:
            place = stack.pop()
            if len(place) >= depth:
                found.append(place)
            else:
                stack += [(*place, part) for part in range(4)]
        return found

    def inverted(self, v: int, u: int, here: Points, there: Points) -> bool:
        """Is a triangle at the edge from v to u inverted, wherever in these hulls both are?"""
        for third, sign in ((self.apex.get((v, u)), 1), (self.apex.get((u, v)), -1)):
            if third is None:
                continue
            corners = self.hull(third)
            if all(sign * _side(p, q, r) <= 0 for p in here for q in there for r in corners):
                return True
        return False

    def hull(self, v: int) -> Points:
        """Points of which one is farthest in any direction among all places of the vertex."""
        if self.fixed[v]:
            return (self.points[v],)
        if v not in self.hulls:
            self.hulls[v] = _on_hull({p for place in self.places(v) for p in self.corners(place)})
        return self.hulls[v]

    def corners(self, place: Place) -> Points:
        """The corners of a part of a cell."""
        if place not in self.corner_memo:
            if len(place) == 1:
                a, b, c = (self.points[v] for v in self.cells[place[0]])
            else:
                a, b, c = self.corners(place[:-1])
                ab, bc, ca = _middle(a, b), _middle(b, c), _middle(c, a)
                a, b, c = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))[place[-1]]
            self.corner_memo[place] = (a, b, c)
        return self.corner_memo[place]

    def apart(self, place: Place, other: int | Place) -> bool:
        """Is it sure that no straight line inside the domain joins the place to the other one, or to a fixed vertex?"""
        key = place, other
        if key not in self.memo:
            self.memo[key] = self._apart(place, other)
        return self.memo[key]

    def _apart(self, place: Place, other: int | Place) -> bool:
        ends = self.ends_of.get(other, set()) if isinstance(other, int) else {other[0]}
        if not ends or place[0] in ends:
            return False
        here = self.corners(place)
        there = (self.points[other],) if isinstance(other, int) else self.corners(other)
        pairs = [(p, q) for p in here for q in there]
        a, b, c = self.cells[place[0]]
        # A chord that has been crossed, the ends so far, a line between these, and the cells that lie behind.
        stack: list[tuple[Chord, list[int], list[int], tuple[int, int], frozenset[int]]] = []
        for chord in ((b, a), (c, b), (a, c)):
            stack.append((chord, [chord[0]], [chord[1]], chord, frozenset({place[0]})))
        while stack:
            chord, lefts, rights, line, behind = stack.pop()
            # Chords that end in the fixed vertex need not be crossed to get there.
            if other not in chord and self.blocked(pairs, chord):
                continue
            cell = self.left.get(chord)
            if cell is None or cell in behind:
                continue
            if cell in ends:
                return False
            (new,) = set(self.cells[cell]) - set(chord)
            for onward in ((new, chord[1]), (chord[0], new)):
                more_lefts = [*lefts, new] if onward[0] == new else lefts
                more_rights = [*rights, new] if onward[1] == new else rights
                leaning = self.line(more_lefts, more_rights, line, other)
                if leaning is not None:
                    stack.append((onward, more_lefts, more_rights, leaning, behind | {cell}))
        return True

    def blocked(self, pairs: list[tuple[Point, Point]], chord: Chord) -> bool:
        """Is an end of the chord on the wrong side of all lines?"""
        left, right = (self.points[v] for v in chord)
        return all(_side(p, q, left) <= 0 for p, q in pairs) or all(_side(p, q, right) >= 0 for p, q in pairs)

    def line(self, lefts: list[int], rights: list[int], last: tuple[int, int], other: int | Place) -> Chord | None:
        """Two of the ends on whose line, in this direction, left ends are on the left and right ends on the right."""
        if other in lefts or other in rights:
            return last  # the line ends there, and what it leans on tells no more

        def fits(a: Point, b: Point) -> bool:
            return all(_side(a, b, self.points[v]) >= 0 for v in lefts) and all(
                _side(a, b, self.points[v]) <= 0 for v in rights
            )

        if fits(self.points[last[0]], self.points[last[1]]):
            return last
        for left in lefts:
            for right in rights:
                for pair in ((left, right), (right, left)):
                    if fits(self.points[pair[0]], self.points[pair[1]]):
                        return pair
        return None


def _whole(points: np.ndarray, depth: int) -> list[Point]:
    """The points (V, 2) times a power of two that makes whole numbers of them, and of what `depth` cuts halve."""
    ratios = [value.as_integer_ratio() for value in points.ravel().tolist()]
    scale = max(bottom for _, bottom in ratios) << depth
    numbers = [top * (scale // bottom) for top, bottom in ratios]
    return list(zip(numbers[::2], numbers[1::2], strict=True))


def _side(a: Point, b: Point, c: Point) -> int:
    """Twice the signed area of the triangle abc."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _middle(a: Point, b: Point) -> Point:
    return (a[0] + b[0]) // 2, (a[1] + b[1]) // 2


def _on_hull(points: set[Point]) -> Points:
    """The corners of the convex hull."""
    found: list[Point] = []
    for run in (sorted(points), sorted(points, reverse=True)):
        chain: list[Point] = []
        for point in run:
            while len(chain) > 1 and _side(chain[-2], chain[-1], point) <= 0:
                chain.pop()
            chain.append(point)
        found += chain[:-1] or chain
    return tuple(dict.fromkeys(found))
