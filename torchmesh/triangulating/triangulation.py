"""A triangulation under construction: vertices are inserted and edges flipped; every sign is exact.

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
from .arrays import next_in_triangle, previous_in_triangle, signs

# Corners are cocircular when the sine of the two opposite angles' sum is within this of zero: far
# above its rounding error, so that every flip made is one of exact arithmetic and flipping ends.
_COCIRCULAR = 1e-12


# Flip rounds after a round of insertion: enough to keep vertex degrees small.
_ROUNDS_PER_INSERTION = 2


_NONE = np.zeros(0, np.int64)


class Triangulation:
    """Counter-clockwise triangles over some of the points; operations change them in place.

    points   (V, 2) float64; of the vertices not inserted yet, the position wanted
    corners  (T, 3) int64 rows of points
    twin     (3T,) int64, -1 on the boundary
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

        Returns the vertices that cannot be inserted: in the position of another vertex, on the boundary,
        or on a locked edge.  Each waiting vertex knows its triangle, and is handed on when that triangle
        is split or flipped, so no search is needed.
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
            triangles, home = self.fan(3 * t[face][:, None] + np.arange(3), new_face, waiting, home)
            quads, home = self.fan(
                np.stack(
                    [next_in_triangle(h), previous_in_triangle(h), next_in_triangle(g), previous_in_triangle(g)], 1
                ),
                new_edge,
                waiting,
                home,
            )
            dirty = np.concatenate([dirty, triangles.ravel(), quads.ravel()])
            for _ in range(_ROUNDS_PER_INSERTION):
                dirty, home = self._flip_round(dirty, waiting, home)
        self.flip_to_delaunay(dirty)
        return np.concatenate(refused)

    def flip_to_delaunay(self, dirty: np.ndarray) -> np.ndarray:
        """Flip the edges of the triangles `dirty` and what follows from it; the triangles looked at."""
        seen = [dirty]
        while len(dirty):
            dirty, _ = self._flip_round(dirty)
            seen.append(dirty)
        return np.concatenate(seen)

    def fan(
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
        u, v, w, z = (flat[i] for i in (h, g, previous_in_triangle(h), previous_in_triangle(g)))
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
        self.flip(h[win])
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

    def flip(self, h: np.ndarray) -> None:
        """Turn the edges h (M,), of different triangles, inside their quadrilaterals."""
        g = self.twin[h]
        t, s = h // 3, g // 3
        flat = self.corners.ravel()
        u, v, w, z = (flat[i] for i in (h, g, previous_in_triangle(h), previous_in_triangle(g)))
        old = np.concatenate(
            [previous_in_triangle(h), next_in_triangle(g), previous_in_triangle(g), next_in_triangle(h)]
        )
        new = np.concatenate([3 * t, 3 * t + 1, 3 * s, 3 * s + 1])
        partner, lock = self.twin[old], self.locked[old]
        self.corners[t] = np.stack([w, u, z], 1)
        self.corners[s] = np.stack([z, v, w], 1)
        self._move(old, new, partner, lock)
        self._pair(3 * t + 2, 3 * s + 2)

    def flip_one(self, h: int) -> None:
        """`flip` of one edge, in a tenth of the time that arrays of one number take."""
        corners, twin, locked = self.corners, self.twin, self.locked
        g = int(twin[h])
        t, i, s, j = h // 3, h % 3, g // 3, g % 3
        old = 3 * t + (i + 2) % 3, 3 * s + (j + 1) % 3, 3 * s + (j + 2) % 3, 3 * t + (i + 1) % 3
        new = 3 * t, 3 * t + 1, 3 * s, 3 * s + 1
        u, w, v, z = corners[t, i], corners[t, (i + 2) % 3], corners[s, j], corners[s, (j + 2) % 3]
        renamed = dict(zip(old, new, strict=True))
        outside = [(int(twin[e]), locked[e]) for e in old]
        corners[t], corners[s] = (w, u, z), (z, v, w)
        for e, (partner, lock) in zip(new, outside, strict=True):
            partner = renamed.get(partner, partner)
            twin[e], locked[e] = partner, lock
            if partner >= 0:
                twin[partner] = e
        twin[3 * t + 2], twin[3 * s + 2] = 3 * s + 2, 3 * t + 2
        locked[3 * t + 2] = locked[3 * s + 2] = False

    def _move(self, old: np.ndarray, new: np.ndarray, partner: np.ndarray, lock: np.ndarray) -> None:
        """Half-edges `old` are now called `new`; partner and lock are what they had."""
        order = np.argsort(old)
        found = np.minimum(np.searchsorted(old[order], partner), len(old) - 1)
        partner = np.where(old[order][found] == partner, new[order][found], partner) if len(old) else partner
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
