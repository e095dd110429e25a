"""The mesher of `front` without compiled loops: the twin of source/front.cpp, which takes the same decisions.

It works vertex by vertex in Python, some hundred times as slow as the compiled loops.
"""

import heapq
import math

import torch
from torch import Tensor

from .incremental import Incremental, next_of

_SQRT3 = math.sqrt(3.0)
_BITS = 2**64 - 1

_VERTEX, _SEGMENT, _BOUNDARY = 1, 2, 3


class OutlineMesher:
    """Meshes an outline; `front.outline_mesher` names the arguments."""

    def __init__(self, points: Tensor, held: Tensor, boundary: Tensor, segments: Tensor) -> None:
        self.vertices, self.held = len(points), held.tolist()
        x, y = points.unbind(1)
        self.triangulation = Incremental(x.tolist(), y.tolist())
        self.fault = self._build(boundary.tolist(), segments.tolist())
        if self.fault:
            return
        self.grown = self.triangulation.copy()
        d, last = self.grown, 0
        for v in self._in_good_order(False):
            t = d.locate(d.x[v], d.y[v], last, False)
            if t < 0:
                continue
            last = t
            if d.inside[t] and d.insert(v, t):
                last = d.made[0]

    def background(self) -> Tensor:
        """(T, 3) int64 the triangles of all the vertices that are inside; those of the others are in none."""
        return _triangles_of(self.grown)

    def mesh(
        self, size: Tensor, done: float, room: float, low: float, filled: tuple[int, int] | None = None
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """The triangles (T, 3); of the new vertices positions, sizes, corners and weights."""
        d = self.triangulation
        self.done, self.room, self.low = done, room, low
        self.size, self.near = [*size.tolist(), *[0.0] * 4], [0] * len(d.x)
        self.radius, self.stamp = list[float](), list[int]()
        self.waiting: list[tuple[float, int, int]] = []
        for h, v in enumerate(self.grown.vertex):
            if self.grown.inside[h // 3]:
                self.near[v] = h // 3
        for t in range(d.triangles()):
            self._measure(t)
        for t in range(d.triangles()):
            self._ask(t)
        while self.waiting:
            _, t, stamp = heapq.heappop(self.waiting)
            if self.stamp[t] == stamp and self._active(t):
                self._place(t)
        added = len(d.x) - self.vertices - 4
        if filled is not None and filled[0] <= added < filled[1]:
            self._fill(filled[1] - added)
        return self._result()

    def _fill(self, count: int) -> None:
        """Put up to `count` more vertices at the centres of the circles that are largest for the size wanted."""
        d = self.triangulation
        for t in range(d.triangles()):
            self._measure(t)
        waiting = [(-self.radius[t], t, self.stamp[t]) for t in range(d.triangles()) if self.radius[t] > 0]
        heapq.heapify(waiting)
        while count > 0 and waiting:
            _, t, stamp = heapq.heappop(waiting)
            px, py, radius = self._circle(t)
            if self.stamp[t] != stamp or not math.isfinite(radius):
                continue
            if self._place_at(px, py, t, d.vertex[3 * t], self._wanted(3 * t)):
                count -= 1
                for m in d.made:
                    if self.radius[m] > 0:
                        heapq.heappush(waiting, (-self.radius[m], m, self.stamp[m]))

    def _result(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        d, first = self.triangulation, self.vertices + 4
        triangles = _triangles_of(d)
        new = range(first, len(d.x))
        homes = [self._home(p) for p in new]
        points = torch.tensor([[d.x[p], d.y[p]] for p in new], dtype=torch.float64).reshape(-1, 2)
        return (
            torch.where(triangles >= first, triangles - 4, triangles),
            points,
            torch.tensor(self.size[first:], dtype=torch.float64),
            torch.tensor([corners for corners, _ in homes], dtype=torch.int64).reshape(-1, 3),
            torch.tensor([weights for _, weights in homes], dtype=torch.float64).reshape(-1, 3),
        )

    def _in_good_order(self, held: bool) -> list[int]:
        """The vertices in rounds, each of twice as many as all before it, and along a snake in each."""
        x, y = self.triangulation.x, self.triangulation.y
        rows = [v for v in range(self.vertices) if self.held[v] == held]
        if not rows:
            return rows
        left, bottom = min(x[v] for v in rows), min(y[v] for v in rows)
        width = max(max(x[v] for v in rows) - left, max(y[v] for v in rows) - bottom, 1e-300)
        rounds = 0
        while 2**rounds < len(rows) // 32 + 1:
            rounds += 1
        keys = []
        for v in rows:
            bits, turn = _mixed(v), rounds
            while turn > 0 and bits >> (63 - (rounds - turn)) & 1:
                turn -= 1
            cells = 0.7 * math.sqrt(len(rows) / 2 ** (rounds - turn)) + 1
            line, place = int((y[v] - bottom) / width * cells), int((x[v] - left) / width * cells)
            keys.append((turn, line, -place if line % 2 else place, v))
        return [v for *_, v in sorted(keys)]

    def _build(self, boundary: list[list[int]], segments: list[list[int]]) -> int:
        d, last = self.triangulation, 0
        for v in self._in_good_order(True):
            t = d.locate(d.x[v], d.y[v], last, False)
            if t < 0 or not d.insert(v, t):
                return _VERTEX
            last = d.made[0]
        if not all(d.recover(u, w) for u, w in [*boundary, *segments]):
            return _SEGMENT
        return 0 if d.label(boundary) else _BOUNDARY

    def _circle(self, t: int) -> tuple[float, float, float]:
        """Centre and radius of the circle round a triangle; the radius is infinite where it has no area."""
        d = self.triangulation
        a, b, c = d.vertex[3 * t : 3 * t + 3]
        bx, by, dx, dy = d.x[b] - d.x[a], d.y[b] - d.y[a], d.x[c] - d.x[a], d.y[c] - d.y[a]
        area, bb, dd = 2 * (bx * dy - by * dx), bx * bx + by * by, dx * dx + dy * dy
        if not area > 0:
            return 0.0, 0.0, math.inf
        ux, uy = (dy * bb - by * dd) / area, (bx * dd - dx * bb) / area
        return d.x[a] + ux, d.y[a] + uy, math.sqrt(ux * ux + uy * uy)

    def _measure(self, t: int) -> None:
        """Note the radius of a new triangle over the size wanted."""
        d = self.triangulation
        while len(self.radius) <= t:
            self.radius.append(-1.0)
            self.stamp.append(0)
        self.stamp[t] += 1
        self.radius[t] = -1.0
        if d.inside[t]:
            a, b, c = d.vertex[3 * t : 3 * t + 3]
            self.radius[t] = 3 * self._circle(t)[2] / (self.size[a] + self.size[b] + self.size[c])

    def _is_front(self, h: int) -> bool:
        d = self.triangulation
        return d.locked[h] or self.radius[d.twin[h] // 3] <= self.done

    def _active(self, t: int) -> bool:
        return self.radius[t] > self.done and any(self._is_front(h) for h in range(3 * t, 3 * t + 3))

    def _ask(self, t: int) -> None:
        if self.triangulation.inside[t] and self._active(t):
            heapq.heappush(self.waiting, (-self.radius[t], t, self.stamp[t]))

    def _place(self, t: int) -> None:
        """Put a vertex into a triangle, on the front edge that is nearest to its size, or on the next."""
        edges = list(range(3 * t, 3 * t + 3))
        while True:
            best, least = -1, math.inf
            for h in edges:
                if self._is_front(h):
                    off = abs(math.log(self._length(h) / self._wanted(h)))
                    if off < least:
                        best, least = h, off
            if best < 0:
                break
            if self._place_on(best):
                return
            edges.remove(best)
        self.radius[t] = -1.0
        self.stamp[t] += 1
        # What is given up counts as done for its neighbours.
        for h in range(3 * t, 3 * t + 3):
            if self.triangulation.twin[h] >= 0:
                self._ask(self.triangulation.twin[h] // 3)

    def _length(self, h: int) -> float:
        d = self.triangulation
        u, w = d.vertex[h], d.vertex[next_of(h)]
        dx, dy = d.x[w] - d.x[u], d.y[w] - d.y[u]
        return math.sqrt(dx * dx + dy * dy)

    def _wanted(self, h: int) -> float:
        d = self.triangulation
        return 0.5 * (self.size[d.vertex[h]] + self.size[d.vertex[next_of(h)]])

    def _place_on(self, h: int) -> bool:
        """Put a vertex on the bisector of the front edge h, unless something is in its way."""
        d, t = self.triangulation, h // 3
        u, w = d.vertex[h], d.vertex[next_of(h)]
        mx, my, edge = 0.5 * (d.x[u] + d.x[w]), 0.5 * (d.y[u] + d.y[w]), self._length(h)
        nx, ny = -(d.y[w] - d.y[u]) / edge, (d.x[w] - d.x[u]) / edge
        cx, cy, radius = self._circle(t)
        if not math.isfinite(radius):
            return False
        depth, height = (cx - mx) * nx + (cy - my) * ny, 0.5 * _SQRT3 * self._wanted(h)
        far = min(height, depth)
        if not far > 0:
            return False
        if not self._place_at(mx + far * nx, my + far * ny, t, u, self._wanted(h)):
            return False
        for m in d.made:
            self._ask(m)
            if d.twin[3 * m] >= 0:
                self._ask(d.twin[3 * m] // 3)
        return True

    def _place_at(self, px: float, py: float, t: int, u: int, usual: float) -> bool:
        """Put a vertex at a point near the triangle t and its corner u; `usual` is the size where none is known."""
        d = self.triangulation
        where = d.locate(px, py, t, True)
        if where < 0 or not d.inside[where]:
            return False
        hint = self.grown.locate(px, py, self.near[u], False)
        if hint < 0 or not self.grown.inside[hint]:
            hint = self.near[u]
        here = self._size_in(hint, px, py)
        here = here if here > 0 else usual
        p = len(d.x)
        d.x.append(px)
        d.y.append(py)
        d.at.append(-1)
        if not d.insert(p, where, self.room * here, self.low):
            for values in (d.x, d.y, d.at):
                values.pop()
            return False
        self.size.append(here)
        self.near.append(hint)
        for m in d.made:
            self._measure(m)
        return True

    def _doubled(self, a: int, b: int, px: float, py: float) -> float:
        """Twice the area of the triangle of two vertices of the background and a point."""
        x, y = self.grown.x, self.grown.y
        return (x[a] - px) * (y[b] - py) - (y[a] - py) * (x[b] - px)

    def _size_in(self, t: int, px: float, py: float) -> float:
        """The size wanted at a point of a triangle of the background; -1 where that is not known."""
        v = self.grown.vertex[3 * t : 3 * t + 3]
        total = weights = 0.0
        for k in range(3):
            if v[k] >= self.vertices:
                return -1.0
            area = max(0.0, self._doubled(v[(k + 1) % 3], v[(k + 2) % 3], px, py))
            total += area * self.size[v[k]]
            weights += area
        return total / weights if weights > 0 else -1.0

    def _home(self, p: int) -> tuple[list[int], list[float]]:
        """The corners and weights with which a linear function over the background is read at the new vertex p."""
        d = self.triangulation
        v = self.grown.vertex[3 * self.near[p] : 3 * self.near[p] + 3]
        weights, total = [0.0] * 3, 0.0
        for k in range(3):
            if v[k] < self.vertices:
                weights[k] = max(0.0, self._doubled(v[(k + 1) % 3], v[(k + 2) % 3], d.x[p], d.y[p]))
            total += weights[k]
        corners = [row if row < self.vertices else -1 for row in v]
        return corners, [weight / total if total > 0 else 1.0 / 3 for weight in weights]


def _triangles_of(d: Incremental) -> Tensor:
    """(T, 3) int64 the triangles of the domain."""
    rows = torch.tensor(d.vertex, dtype=torch.int64).reshape(-1, 3)
    return rows[torch.tensor(d.inside, dtype=torch.bool)]


def _mixed(i: int) -> int:
    """Bits that look random, of a row."""
    i = ((i + 0x9E3779B97F4A7C15) * 0xBF58476D1CE4E5B9) & _BITS
    return ((i ^ (i >> 27)) * 0x94D049BB133111EB) & _BITS
