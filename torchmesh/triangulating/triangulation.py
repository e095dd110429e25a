"""A triangulation under construction: vertices go in, edges are flipped and recovered, no sign is guessed.

Every step starts from counter-clockwise triangles and ends with them, by exact orientation signs.
Half-edges are those of `connectivity`: h = 3 * triangle + corner.  A vertex goes in as a fan:

        c                     c
       / \\                   /|\\             inside a triangle: 1 becomes 3
      / p \\        ->       / p \\            on an edge:        2 become 4
     a --- b                a --- b           row i of the fan is (outer edge i, p)

A step is done for many triangles at once, at most one vertex each.
"""

import numpy as np
import torch

from ..mesh import connectivity
from .arrays import Obstacle, among, following, preceding, signs

# Corners are cocircular when the sine of the two opposite angles' sum is within this of zero: far
# above its rounding error, so that every flip made is one of exact arithmetic and flipping ends.
_COCIRCULAR = 1e-12


# Flip rounds after a round of insertion: enough to keep vertex degrees small.
_ROUNDS_PER_INSERTION = 2


# Where to try to put a vertex into a triangle, as weights of its corners: the centroid, and where a
# triangle a few floating-point numbers wide may still have one inside.
_PLACES = [(1, 1, 1), (2, 1, 1), (1, 2, 1), (1, 1, 2), (1, 2, 2), (2, 1, 2), (2, 2, 1), (6, 1, 1), (1, 6, 1), (1, 1, 6)]


_NONE = np.zeros(0, np.int64)


class Triangulation:
    """Counter-clockwise triangles over some of the points, in place.

    points   (V, 2) float64; of the vertices not yet in, the wanted place
    corners  (T, 3) int64 rows of points
    twin     (3T,) int64, -1 on the rim
    locked   (3T,) bool, edges that no flip may remove and no vertex may split
    spacing  (V,) the length of edge wanted at each vertex; a new vertex takes the mean of its fan
    """

    def __init__(self, points: np.ndarray, corners: np.ndarray, spacing: np.ndarray) -> None:
        self.points = points
        self.corners = corners
        self.twin = connectivity.twins(torch.from_numpy(corners)).numpy()
        self.locked = np.zeros(len(self.twin), bool)
        self.spacing = spacing

    def sides(self, t: np.ndarray, p: np.ndarray) -> np.ndarray:
        """(N, 3) exact sign of each vertex p (N,) against the three edges of triangle t (N,)."""
        corner = self.corners[t]
        return np.stack([signs(self.points, corner[:, i], corner[:, (i + 1) % 3], p) for i in range(3)], 1)

    def insert(self, vertices: np.ndarray, home: np.ndarray, seed: int = 0) -> np.ndarray:
        """Put `vertices` (N,) in where `points` has them; `home` (N,) is a closed triangle around each.

        Returns those that cannot go in: in the place of another vertex, on the rim, or on a locked
        edge.  Each waiting vertex knows its triangle and is handed on when that triangle splits or
        flips, so nothing is ever searched for.
        """
        order = np.random.default_rng(seed).permutation(len(vertices))
        waiting, home = vertices[order], home[order]
        refused = [vertices[:0]]
        dirty = np.zeros(0, np.int64)
        while len(waiting):
            first = np.full(len(self.corners), -1)
            first[home[::-1]] = np.arange(len(home))[::-1]
            pick = first[first >= 0]
            t, side = home[pick], self.sides(home[pick], waiting[pick])
            zeros = (side == 0).sum(1)
            h = 3 * t + (side == 0).argmax(1)
            stuck = (zeros > 1) | (side < 0).any(1) | ((zeros == 1) & ((self.twin[h] < 0) | self.locked[h]))
            other = np.where((zeros == 1) & ~stuck, self.twin[h] // 3, t)
            win = ~stuck & self._claimed(np.stack([t, other], 1), np.where(stuck, len(waiting), pick))
            refused.append(waiting[pick[stuck]])
            face, edge = win & (zeros == 0), win & (zeros == 1)
            new_face, new_edge = waiting[pick[face]], waiting[pick[edge]]
            stay = np.ones(len(waiting), bool)
            stay[pick[stuck | win]] = False
            waiting, home = waiting[stay], home[stay]
            h, g = h[edge], self.twin[h[edge]]
            triangles, home = self._fan(3 * t[face][:, None] + np.arange(3), new_face, waiting, home)
            quads, home = self._fan(
                np.stack([following(h), preceding(h), following(g), preceding(g)], 1), new_edge, waiting, home
            )
            dirty = np.concatenate([dirty, triangles.ravel(), quads.ravel()])
            for _ in range(_ROUNDS_PER_INSERTION):
                dirty, home = self._flip_round(dirty, waiting, home)
        self.flip_to_delaunay(dirty)
        return np.concatenate(refused)

    def spread(self, vertices: np.ndarray, dtype: np.dtype) -> np.ndarray:
        """Put `vertices` (N,) in at places of our choice: centroids, where `spacing` is exceeded most.

        Places are rounded to `dtype` and used only if exactly inside.  Returns those for which no
        triangle has room left between the floating-point numbers.
        """
        full = np.zeros(len(self.corners), bool)
        if len(vertices):
            self.flip_to_delaunay(np.arange(len(self.corners)))
        while len(vertices):
            a, b, c = (self.points[self.corners[:, i]] for i in range(3))
            area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
            excess = np.where(full, 0.0, np.maximum(area, np.finfo(float).tiny))
            excess /= self.spacing[self.corners].mean(1) ** 2
            most = excess.max()
            if most <= 0:
                break
            t = np.flatnonzero(excess > most / 3)
            if len(t) > len(vertices):
                t = t[np.argsort(-excess[t], kind="stable")[: len(vertices)]]
            used = vertices[: len(t)]
            inside = np.zeros(len(t), bool)
            for one, two, three in _PLACES:
                out = np.flatnonzero(~inside)
                if not len(out):
                    break
                s, total = t[out], one + two + three
                places = a[s] + (two * (b[s] - a[s]) + three * (c[s] - a[s])) / total
                self.points[used[out]] = places.astype(dtype)
                inside[out] = (self.sides(s, used[out]) > 0).all(1)
            full[t[~inside]] = True
            if not inside.any():
                continue
            self.points[used[: inside.sum()]] = self.points[used[inside]]
            used = used[: inside.sum()]
            vertices = vertices[len(used) :]
            slots, _ = self._fan(3 * t[inside][:, None] + np.arange(3), used)
            full = np.concatenate([full, np.zeros(len(self.corners) - len(full), bool)])
            # A flip may make room again.
            full[self.flip_to_delaunay(slots.ravel())] = False
        return vertices

    def flip_to_delaunay(self, dirty: np.ndarray) -> np.ndarray:
        """Flip the edges of the triangles `dirty` and what follows from it; the triangles looked at."""
        seen = [dirty]
        while len(dirty):
            dirty, _ = self._flip_round(dirty)
            seen.append(dirty)
        return np.concatenate(seen)

    def recover(self, segments: np.ndarray) -> Obstacle | None:
        """Flip until each of `segments` (K, 2) is an edge, and lock it; what stands in the way, if anything.

        Always flips the edge from the vertex w farthest from the line on its left to w's farthest
        neighbour z across the line.  That quadrilateral is strictly convex at both (ties go to the
        vertex farther along), w never comes back, so it ends; Sloan 1993 leaves that open.
        """
        if not len(segments):
            return None
        count = len(self.points)
        there, wanted = (
            np.minimum(u, v) * count + np.maximum(u, v)
            for u, v in ((self.corners, self.corners[:, [1, 2, 0]]), segments.T)
        )
        self.locked |= among(there.ravel(), wanted)
        exact = _Exact(self.points)
        for u, v in segments[~among(wanted, there)].tolist():
            obstacle = self._recover(u, v, exact)
            if obstacle:
                return obstacle
        return None

    def _recover(self, u: int, v: int, exact: "_Exact") -> Obstacle | None:
        while True:
            crossed, obstacle = self._crossed(u, v, exact)
            if obstacle:
                return obstacle
            if not crossed:
                break
            flat = self.corners.ravel()
            tails, heads = flat[crossed].tolist(), flat[following(np.array(crossed))].tolist()
            w = max(heads, key=lambda p: (exact.cross(u, v, p), exact.dot(u, v, p)))
            _, h = max(
                ((z, h) for z, head, h in zip(tails, heads, crossed, strict=True) if head == w),
                key=lambda zh: (-exact.cross(u, v, zh[0]), exact.dot(u, v, zh[0])),
            )
            self._flip(np.array([h]))
        flat = self.corners.ravel()
        spokes = np.flatnonzero((flat == u) | (flat == v))
        self.locked[spokes[among(flat[following(spokes)], np.array([u, v]))]] = True
        return None

    def _crossed(self, u: int, v: int, exact: "_Exact") -> tuple[list[int], Obstacle | None]:
        """The half-edges that the open segment uv crosses from right (tail) to left (head), in order."""
        corners = self.corners
        starts = np.flatnonzero(corners.ravel() == u).tolist()
        spokes = [(h, int(corners[h // 3, (h + 1) % 3]), int(corners[h // 3, (h + 2) % 3])) for h in starts]
        if any(v in (a, b) for _, a, b in spokes):
            return [], None
        for h, a, b in spokes:
            for p in (a, b):
                if exact.cross(u, v, p) == 0 and exact.dot(u, v, p) > 0:
                    return [], Obstacle("the edge [{}, {}] passes through vertex {}", (u, v, p))
            if exact.cross(u, v, a) < 0 < exact.cross(u, v, b):
                e = h - h % 3 + (h + 1) % 3
                break
        else:
            return [], Obstacle("the edge [{}, {}] leaves the domain at vertex {}", (u, v, u))
        crossed = []
        while True:
            g = int(self.twin[e])
            if g < 0 or self.locked[e]:
                a, b = int(corners[e // 3, e % 3]), int(corners[e // 3, (e + 1) % 3])
                return [], Obstacle("the edge [{}, {}] crosses the edge [{}, {}]", (u, v, a, b))
            crossed.append(e)
            p = int(corners[g // 3, (g + 2) % 3])
            if p == v:
                return crossed, None
            side = exact.cross(u, v, p)
            if side == 0:
                return [], Obstacle("the edge [{}, {}] passes through vertex {}", (u, v, p))
            e = g - g % 3 + (g + (1 if side > 0 else 2)) % 3

    def _fan(
        self, outer: np.ndarray, p: np.ndarray, waiting: np.ndarray = _NONE, home: np.ndarray = _NONE
    ) -> tuple[np.ndarray, np.ndarray]:
        """Replace the triangles inside the closed walks `outer` (M, k) of half-edges by fans around p (M,).

        Returns the rows of the fans (M, k), and where the `waiting` vertices are now.
        """
        count, k = outer.shape
        if not count:
            return np.zeros((0, k), np.int64), home
        old = len(self.corners)
        slots = np.empty((count, k), np.int64)
        slots[:, ::2][:, : k - 2] = outer[:, ::2][:, : k - 2] // 3
        fresh = np.ones(k, bool)
        fresh[::2][: k - 2] = False
        slots[:, fresh] = old + np.arange(2 * count).reshape(count, 2)
        tails = self.corners.ravel()[outer]
        partner, lock = self.twin[outer], self.locked[outer]
        self.corners = np.concatenate([self.corners, np.empty((2 * count, 3), np.int64)])
        self.twin = np.concatenate([self.twin, np.full(6 * count, -1)])
        self.locked = np.concatenate([self.locked, np.zeros(6 * count, bool)])
        self.corners[slots] = np.stack([tails, np.roll(tails, -1, 1), np.broadcast_to(p[:, None], tails.shape)], 2)
        self._move(outer.ravel(), (3 * slots).ravel(), partner.ravel(), lock.ravel())
        self._pair(3 * slots + 1, 3 * np.roll(slots, -1, 1) + 2)
        self.spacing[p] = self.spacing[tails].mean(1)
        if not len(waiting):
            return slots, home
        fan = np.full(len(self.corners), -1)
        for i in np.flatnonzero(~fresh):
            fan[slots[:, i]] = np.arange(count)
        touched = np.flatnonzero(fan[home] >= 0)
        row = fan[home[touched]]
        q = waiting[touched]
        left = np.stack([signs(self.points, p[row], tails[row, i], q) for i in range(k)], 1)
        sector = ((left >= 0) & (np.roll(left, -1, 1) <= 0)).argmax(1)
        home = home.copy()
        home[touched] = slots[row, sector]
        return slots, home

    def _flip_round(
        self, dirty: np.ndarray, waiting: np.ndarray = _NONE, home: np.ndarray = _NONE
    ) -> tuple[np.ndarray, np.ndarray]:
        """Flip a set of far-apart non-Delaunay edges of the triangles `dirty`; the triangles to look at next."""
        h = (3 * dirty[:, None] + np.arange(3)).ravel()
        h = h[(self.twin[h] >= 0) & ~self.locked[h]]
        listed = np.zeros(len(self.twin), bool)
        listed[np.minimum(h, self.twin[h])] = True
        h = np.flatnonzero(listed)
        if not len(h):
            return h, home
        g = self.twin[h]
        flat = self.corners.ravel()
        u, v, w, z = (flat[i] for i in (h, g, preceding(h), preceding(g)))
        (cos_w, sin_w), (cos_z, sin_z) = self._angle(w, u, v), self._angle(z, v, u)
        sine, cosine = sin_w * cos_z + cos_w * sin_z, cos_w * cos_z - sin_w * sin_z
        # Two angles of almost pi each have a sine of zero too.
        keep = (sine < -_COCIRCULAR) | ((sine < _COCIRCULAR) & (cosine > 0) & (cos_w < 0))
        if not keep.any():
            return h[:0], home
        keep[keep] = (signs(self.points, w[keep], u[keep], z[keep]) > 0) & (
            signs(self.points, z[keep], v[keep], w[keep]) > 0
        )
        h, g = h[keep], g[keep]
        pairs = np.stack([h // 3, g // 3], 1)
        win = self._claimed(pairs, np.arange(len(h)))
        self._flip(h[win])
        if len(waiting):
            partner = np.full(len(self.corners), -1)
            partner[pairs[win, 0]], partner[pairs[win, 1]] = pairs[win, 1], pairs[win, 0]
            first = np.full(len(self.corners), False)
            first[pairs[win, 0]] = True
            touched = np.flatnonzero(partner[home] >= 0)
            t = np.where(first[home[touched]], home[touched], partner[home[touched]])
            inside = signs(self.points, self.corners[t, 2], self.corners[t, 0], waiting[touched]) >= 0
            home = home.copy()
            home[touched] = np.where(inside, t, partner[t])
        return pairs.ravel(), home

    def _angle(self, at: np.ndarray, p: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cosine and sine of the angle at `at` from the ray to p to the ray to q."""
        x, y = self.points[:, 0], self.points[:, 1]
        ax, ay, bx, by = x[p] - x[at], y[p] - y[at], x[q] - x[at], y[q] - y[at]
        dot, cross = ax * bx + ay * by, ax * by - ay * bx
        size = np.maximum(np.hypot(ax, ay) * np.hypot(bx, by), np.finfo(float).tiny)
        return dot / size, cross / size

    def _flip(self, h: np.ndarray) -> None:
        """Turn the edges h (M,), of different triangles, inside their quadrilaterals."""
        g = self.twin[h]
        t, s = h // 3, g // 3
        flat = self.corners.ravel()
        u, v, w, z = (flat[i] for i in (h, g, preceding(h), preceding(g)))
        old = np.concatenate([preceding(h), following(g), preceding(g), following(h)])
        new = np.concatenate([3 * t, 3 * t + 1, 3 * s, 3 * s + 1])
        partner, lock = self.twin[old], self.locked[old]
        self.corners[t] = np.stack([w, u, z], 1)
        self.corners[s] = np.stack([z, v, w], 1)
        self._move(old, new, partner, lock)
        self._pair(3 * t + 2, 3 * s + 2)

    def _move(self, old: np.ndarray, new: np.ndarray, partner: np.ndarray, lock: np.ndarray) -> None:
        """Half-edges `old` are now called `new`; partner and lock are what they had."""
        order = np.argsort(old)
        place = np.minimum(np.searchsorted(old[order], partner), len(old) - 1)
        partner = np.where(old[order][place] == partner, new[order][place], partner) if len(old) else partner
        self.twin[new] = partner
        self.twin[partner[partner >= 0]] = new[partner >= 0]
        self.locked[new] = lock

    def _pair(self, h: np.ndarray, g: np.ndarray) -> None:
        """New inner edges: h and g are twins."""
        self.twin[h], self.twin[g] = g, h
        self.locked[h] = self.locked[g] = False

    def _claimed(self, triangles: np.ndarray, rank: np.ndarray) -> np.ndarray:
        """(M,) bool: of the rows wanting `triangles` (M, k), those of lowest rank at each of theirs."""
        holder = np.full(len(self.corners), np.iinfo(np.int64).max)
        np.minimum.at(holder, triangles, np.broadcast_to(rank[:, None], triangles.shape))
        return (holder[triangles] == rank[:, None]).all(1)


class _Exact:
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
