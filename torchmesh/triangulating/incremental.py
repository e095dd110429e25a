"""A constrained Delaunay triangulation, vertex by vertex, without compiled loops: the twin of source/delaunay.hpp.

It takes the same decisions in the same order, and is there for machines without a compiler.  The whole plane round the
vertices is triangulated, inside a box; `inside` says which triangles are in the domain.  Half-edges are those of
`mesh.connectivity`: h = 3 * triangle + corner.
"""

from fractions import Fraction
from typing import TypeVar

# Signs are computed by floating point first, and by the same formula in exact numbers where that cannot decide.
Number = TypeVar("Number", float, Fraction)

_EPSILON = 2.0**-53
_ORIENTATION_BOUND = (3 + 16 * _EPSILON) * _EPSILON
_INCIRCLE_BOUND = (10 + 96 * _EPSILON) * _EPSILON
# In sums below this a product may have lost bits to underflow, and the filter's bound does not hold.
_UNDERFLOW = 1e-270

# The reach of the box in extents of the points, and how often a cavity is looked for without the triangles that the new
# vertex does not see.
_REACH = 8
_TRIES = 32


def next_of(h: int) -> int:
    """The half-edge after h in its triangle."""
    return h - 2 if h % 3 == 2 else h + 1


def previous_of(h: int) -> int:
    """The half-edge before h in its triangle."""
    return h + 2 if h % 3 == 0 else h - 1


class Incremental:
    """Triangles inside a box; operations change them in place.

    x, y    coordinates of the vertices; the corners of the box follow the first `count`
    vertex, twin, locked  (3T,) of each half-edge
    inside  (T,) whether the triangle is in the domain
    at      (V,) a half-edge that begins at each vertex, -1 if there is none
    made    the triangles that the last insertion made
    """

    def __init__(self, x: list[float], y: list[float]) -> None:
        count = len(x)
        reach = _REACH * max(max(x) - min(x), max(y) - min(y))
        left, right, bottom, top = min(x) - reach, max(x) + reach, min(y) - reach, max(y) + reach
        self.x = [*x, left, right, right, left]
        self.y = [*y, bottom, bottom, top, top]
        self.vertex = [count, count + 1, count + 2, count, count + 2, count + 3]
        self.twin = [-1, -1, 3, 2, -1, -1]
        self.locked = [False] * 6
        self.inside = [False] * 2
        self.at = [-1] * len(self.x)
        for h in range(6):
            self.at[self.vertex[h]] = h
        self.made: list[int] = []

    def copy(self) -> "Incremental":
        """Another triangulation with the same triangles."""
        other = object.__new__(Incremental)
        for name, values in vars(self).items():
            setattr(other, name, list(values))
        return other

    def triangles(self) -> int:
        """How many triangles there are."""
        return len(self.vertex) // 3

    def side(self, a: int, b: int, px: float, py: float) -> int:
        """The sign of the point against the line from a to b: 1 on the left."""
        ax, ay, bx, by = self.x[a], self.y[a], self.x[b], self.y[b]
        left, right = (bx - ax) * (py - ay), (by - ay) * (px - ax)
        value = left - right
        if abs(value) > max((abs(left) + abs(right)) * _ORIENTATION_BOUND, _UNDERFLOW):
            return 1 if value > 0 else -1
        u, v, w, z, x, y = (Fraction(number) for number in (ax, ay, bx, by, px, py))
        exact = (w - u) * (y - v) - (z - v) * (x - u)
        return (exact > 0) - (exact < 0)

    def side_of(self, a: int, b: int, c: int) -> int:
        """The sign of the vertex c against the line from a to b."""
        return self.side(a, b, self.x[c], self.y[c])

    def in_circle(self, t: int, px: float, py: float) -> bool:
        """Whether the point lies inside the circle of the triangle."""
        a, b, c = self.vertex[3 * t : 3 * t + 3]
        given = self.x[a], self.y[a], self.x[b], self.y[b], self.x[c], self.y[c]
        value, magnitude = _incircle(*given, px, py)
        if abs(value) > max(magnitude * _INCIRCLE_BOUND, _UNDERFLOW):
            return value > 0
        exact = [Fraction(v) for v in (*given, px, py)]
        return _incircle(*exact)[0] > 0

    def locate(self, px: float, py: float, start: int, blocked: bool) -> int:
        """A triangle that the point is in or on; -1 where the walk ends at a locked edge, or does not end."""
        t, before = start, -1
        for step in range(4 * self.triangles() + 64):
            across = -1
            for k in range(3):
                h = 3 * t + (step % 3 + k) % 3
                if self.twin[h] >= 0 and self.twin[h] // 3 == before:
                    continue
                if self.side(self.vertex[h], self.vertex[next_of(h)], px, py) < 0:
                    across = h
                    break
            if across < 0:
                return t
            if self.twin[across] < 0 or (blocked and self.locked[across]):
                return -1
            before, t = t, self.twin[across] // 3
        return -1

    def insert(self, p: int, t: int, room: float = 0.0, low: float = 0.0) -> bool:
        """Put the vertex p into the triangle t, which it is in or on, unless something is in its way.

        room  the least distance from the vertices round it; 0: any, and any height
        low   the least height above a locked edge round it, over the length of that edge
        """
        px, py = self.x[p], self.y[p]
        banned: set[int] = set()
        for attempt in range(_TRIES):
            found = self._cavity(px, py, t, banned)
            if found is None:
                return False
            cavity, rim = found
            hidden = [h for h in rim if self.side(self.vertex[h], self.vertex[next_of(h)], px, py) <= 0]
            if not hidden:
                break
            # Round the end of a segment the search may have come to triangles that p does not see.
            if hidden[-1] // 3 == t or attempt == _TRIES - 1:
                return False
            banned.add(hidden[-1] // 3)
        for h in rim if room > 0 else ():
            u, w = self.vertex[h], self.vertex[next_of(h)]
            dx, dy, ex, ey = px - self.x[u], py - self.y[u], self.x[w] - self.x[u], self.y[w] - self.y[u]
            too_low = self.locked[h] and ex * dy - ey * dx < low * (ex * ex + ey * ey)
            if dx * dx + dy * dy < room * room or too_low:
                return False
        self._fill(p, cavity, rim)
        return True

    def edge(self, u: int, w: int) -> int:
        """The half-edge from u to w; -1 if there is none."""
        h = first = self.at[u]
        while h >= 0:
            if self.vertex[next_of(h)] == w:
                return h
            h = self.twin[previous_of(h)]
            if h == first:
                break
        return -1

    def recover(self, u: int, w: int) -> bool:
        """Make the segment from u to w an edge, and lock it; False where a vertex or a locked edge is in its way."""
        h, changed = self.edge(u, w), list[int]()
        if h < 0:
            crossed = self._crossed(u, w)
            if crossed is None or not self._flip_crossed(u, w, crossed, changed):
                return False
            h = self.edge(u, w)
        self.locked[h] = self.locked[self.twin[h]] = True
        self._restore(changed)
        return True

    def label(self, edges: list[list[int]]) -> bool:
        """Say which triangles are in the domain, on the left of the boundary edges; False where it does not close."""
        walls, stack = set[int](), list[int]()
        self.inside = [False] * self.triangles()
        for u, w in edges:
            h = self.edge(u, w)
            if h < 0 or h in walls:
                return False
            walls |= {h, self.twin[h]}
            stack.append(h // 3)
        while stack:
            t = stack.pop()
            if self.inside[t]:
                continue
            self.inside[t] = True
            for h in range(3 * t, 3 * t + 3):
                if self.twin[h] < 0:
                    return False
                if h not in walls:
                    stack.append(self.twin[h] // 3)
        return not any(self.inside[self.twin[self.edge(u, w)] // 3] for u, w in edges)

    def _cavity(self, px: float, py: float, t: int, banned: set[int]) -> tuple[list[int], list[int]] | None:
        """The triangles whose circles the point is in, and the half-edges round them; None where it cannot go in."""
        cavity, taken, rim = [t], {t}, list[int]()
        for i, here in enumerate(cavity):
            for h in range(3 * here, 3 * here + 3):
                g, u, w = self.twin[h], self.vertex[h], self.vertex[next_of(h)]
                if g < 0 or self.locked[h]:
                    if i == 0 and self.side(u, w, px, py) == 0:
                        return None
                    rim.append(h)
                    continue
                other = g // 3
                if other in taken:
                    continue
                into = other not in banned and self.in_circle(other, px, py)
                # A point on an edge is in the triangles of both sides.
                if into or (i == 0 and self.side(u, w, px, py) == 0):
                    taken.add(other)
                    cavity.append(other)
                else:
                    rim.append(h)
        # What was met before its neighbour had been taken in is not on the rim.
        rim = [h for h in rim if self.twin[h] < 0 or self.locked[h] or self.twin[h] // 3 not in taken]
        if any(self.x[self.vertex[h]] == px and self.y[self.vertex[h]] == py for h in rim):
            return None
        return cavity, rim

    def _fill(self, p: int, cavity: list[int], rim: list[int]) -> None:
        """Put a fan of triangles round p in place of the cavity."""
        sides = [(self.vertex[h], self.vertex[next_of(h)], self.twin[h], self.locked[h]) for h in rim]
        label = self.inside[cavity[0]]
        self.made = []
        for slot, (tail, head, outer, locked) in enumerate(sides):
            t = cavity[slot] if slot < len(cavity) else self.triangles()
            if t == self.triangles():
                self.vertex += [-1] * 3
                self.twin += [-1] * 3
                self.locked += [False] * 3
                self.inside.append(False)
            self.made.append(t)
            self.vertex[3 * t : 3 * t + 3] = tail, head, p
            self.twin[3 * t] = outer
            if outer >= 0:
                self.twin[outer] = 3 * t
            self.locked[3 * t : 3 * t + 3] = locked, False, False
            self.inside[t] = label
            self.at[tail] = 3 * t
        for t in self.made:
            g = self.at[self.vertex[3 * t + 1]] + 2
            self.twin[3 * t + 1], self.twin[g] = g, 3 * t + 1
        self.at[p] = 3 * self.made[0] + 2

    def _crossed(self, u: int, w: int) -> list[int] | None:
        """The half-edges between u and w that the segment crosses, in order; None where something is in its way."""
        h = first = self.at[u]
        while True:
            a, b = self.vertex[next_of(h)], self.vertex[previous_of(h)]
            right, left = self.side_of(u, w, a), self.side_of(u, w, b)
            ahead = (self.x[w] - self.x[u]) * (self.x[a] - self.x[u]) + (self.y[w] - self.y[u]) * (
                self.y[a] - self.y[u]
            ) > 0
            if right == 0 and ahead:
                return None
            if right < 0 < left:
                break
            h = self.twin[previous_of(h)]
            if h < 0 or h == first:
                return None
        across, crossed = next_of(h), list[int]()
        while True:
            if self.locked[across] or self.twin[across] < 0:
                return None
            crossed.append(across)
            g = self.twin[across]
            tip = self.vertex[previous_of(g)]
            if tip == w:
                return crossed
            where = self.side_of(u, w, tip)
            if where == 0:
                return None
            across = next_of(g) if where > 0 else previous_of(g)

    def _flip_crossed(self, u: int, w: int, crossed: list[int], changed: list[int]) -> bool:
        """Flip crossed edges until none is left (Sloan, Computers & Structures 47, 1993)."""
        waiting = [(self.vertex[h], self.vertex[next_of(h)]) for h in crossed]
        limit = 64 + 4 * len(waiting) ** 2
        for i, (tail, head) in enumerate(waiting):
            if i >= limit:
                return False
            h = self.edge(tail, head)
            if h < 0:
                continue
            g = self.twin[h]
            a, b, c, d = self.vertex[h], self.vertex[g], self.vertex[previous_of(h)], self.vertex[previous_of(g)]
            if self.side_of(c, a, d) <= 0 or self.side_of(d, b, c) <= 0:
                waiting.append((a, b))
                continue
            made = self._flip(h)
            if not {c, d} & {u, w} and self.side_of(u, w, c) * self.side_of(u, w, d) < 0:
                waiting.append((c, d))
            else:
                changed += [made // 3, self.twin[made] // 3]
        return self.edge(u, w) >= 0

    def _flip(self, h: int) -> int:
        """Turn the edge h inside its quadrilateral; the new half-edge of its triangle."""
        g = self.twin[h]
        t, s = h // 3, g // 3
        a, b, c, d = self.vertex[h], self.vertex[g], self.vertex[previous_of(h)], self.vertex[previous_of(g)]
        outer = [(self.twin[k], self.locked[k]) for k in (previous_of(h), next_of(g), previous_of(g), next_of(h))]
        self.vertex[3 * t : 3 * t + 3] = c, a, d
        self.vertex[3 * s : 3 * s + 3] = d, b, c
        for k, (partner, locked) in zip((3 * t, 3 * t + 1, 3 * s, 3 * s + 1), outer, strict=True):
            self.twin[k], self.locked[k] = partner, locked
            if partner >= 0:
                self.twin[partner] = k
        self.twin[3 * t + 2], self.twin[3 * s + 2] = 3 * s + 2, 3 * t + 2
        self.locked[3 * t + 2] = self.locked[3 * s + 2] = False
        self.at[c], self.at[a], self.at[d], self.at[b] = 3 * t, 3 * t + 1, 3 * s, 3 * s + 1
        return 3 * t + 2

    def _restore(self, changed: list[int]) -> None:
        """Flip the edges of the changed triangles, and what follows from that, until they are Delaunay."""
        while changed:
            t = changed.pop()
            for h in range(3 * t, 3 * t + 3):
                g = self.twin[h]
                if g < 0 or self.locked[h]:
                    continue
                d = self.vertex[previous_of(g)]
                if self.in_circle(t, self.x[d], self.y[d]):
                    made = self._flip(h)
                    changed += [made // 3, self.twin[made] // 3]
                    break


def _incircle(
    ax: Number, ay: Number, bx: Number, by: Number, cx: Number, cy: Number, dx: Number, dy: Number
) -> tuple[Number, Number]:
    """The in-circle determinant, positive where d is inside the circle of abc, and the sum of its terms' sizes."""
    ax, ay, bx, by, cx, cy = ax - dx, ay - dy, bx - dx, by - dy, cx - dx, cy - dy
    bc_l, bc_r, ca_l, ca_r, ab_l, ab_r = bx * cy, by * cx, cx * ay, cy * ax, ax * by, ay * bx
    a2, b2, c2 = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    value = (a2 * (bc_l - bc_r) + b2 * (ca_l - ca_r)) + c2 * (ab_l - ab_r)
    size = (a2 * (abs(bc_l) + abs(bc_r)) + b2 * (abs(ca_l) + abs(ca_r))) + c2 * (abs(ab_l) + abs(ab_r))
    return value, size
