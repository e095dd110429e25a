"""Triangles and quads while they are mended: who touches whom is asked anew after each step.

Nothing is taken for granted: an edge may have any number of faces, and neighbours may be wound against each other.
"""

import itertools

import numpy as np
import torch

from .clean_log import CleanLog
from .predicates import orientation
from .winding import enclosed_signs, turns_to_agree

# A vertex hangs in an edge from which it is no farther than this part of the edge's length: files in single precision
# have the middle of an edge within some 1e-7.
_HANGING = 1e-6

# Rounds of dividing; each divides at least one edge of every triangle that has to be divided.
_ROUNDS = 50


class Faces:
    """Triangles and quads while they are mended.

    points            (V, d) float64
    tri, quad         (T, 3), (Q, 4) int64
    of_tri, of_quad   the rows that they had, or are parts of; triangles of quad q have T + q
    """

    def __init__(self, points: np.ndarray, tri: np.ndarray, quad: np.ndarray) -> None:
        self.points, self.tri, self.quad = points, tri, quad
        self.of_tri, self.of_quad, self.given = np.arange(len(tri)), np.arange(len(quad)), len(tri)

    def renamed(self, name: np.ndarray) -> "Faces":
        """The same with vertex v called name[v]."""
        other = Faces(self.points, name[self.tri], name[self.quad])
        other.of_tri, other.of_quad, other.given = self.of_tri, self.of_quad, self.given
        return other

    def half_edges(self) -> tuple[np.ndarray, np.ndarray]:
        """(H, 2) the directed sides of all triangles, then of all quads, and (H,) the face of each."""
        ends = [np.stack([f, np.roll(f, -1, 1)], 2).reshape(-1, 2) for f in (self.tri, self.quad)]
        face = np.concatenate([np.arange(len(self.tri)).repeat(3), len(self.tri) + np.arange(len(self.quad)).repeat(4)])
        return np.concatenate(ends), face

    def shared(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(P,), (P,) the half-edges that follow each other on one edge, and (H,) how many each edge has."""
        ends, _ = self.half_edges()
        keys = ends.min(1) * len(self.points) + ends.max(1)
        order = keys.argsort(kind="stable")
        same = keys[order][1:] == keys[order][:-1]
        _, edge, times = np.unique(keys, return_inverse=True, return_counts=True)
        return order[:-1][same], order[1:][same], times[edge.reshape(-1)]

    def boundary(self) -> tuple[np.ndarray, np.ndarray]:
        """(E, 2) the sides that one face only has, and (E,) the half-edge of each."""
        ends, _ = self.half_edges()
        rows = np.flatnonzero(self.shared()[2] == 1)
        return ends[rows], rows

    def components(self) -> tuple[np.ndarray, np.ndarray]:
        """(T,), (Q,) the component of each triangle and quad, joined by sides that two faces have."""
        left, right, times = self.shared()
        face = self.half_edges()[1]
        inner = times[left] == 2
        label = components_of(len(self.tri) + len(self.quad), np.stack([face[left[inner]], face[right[inner]]], 1))
        return label[: len(self.tri)], label[len(self.tri) :]

    def crowded_vertices(self) -> np.ndarray:
        """The ends of sides that more than two different faces have."""
        other = Faces(self.points, self.tri, self.quad)
        other.drop_degenerate(CleanLog())
        other.drop_repeated(CleanLog())
        return np.unique(other.half_edges()[0][other.shared()[2] > 2])

    def drop_degenerate(self, log: CleanLog) -> None:
        """Faces with a corner twice go; a quad with three corners is a triangle."""
        a, b, c = self.tri.T
        bad = (a == b) | (b == c) | (c == a)
        log.did(
            int(bad.sum()), "triangle with a corner twice was removed", "triangles with a corner twice were removed"
        )
        self.tri, self.of_tri = self.tri[~bad], self.of_tri[~bad]
        if not len(self.quad):
            return
        again = self.quad == np.roll(self.quad, -1, 1)
        across = (self.quad[:, 0] == self.quad[:, 2]) | (self.quad[:, 1] == self.quad[:, 3])
        three = (again.sum(1) == 1) & ~across
        bad = (again.any(1) | across) & ~three
        log.did(
            int(three.sum()), "quad with three corners became a triangle", "quads with three corners became triangles"
        )
        log.did(int(bad.sum()), "quad with a corner twice was removed", "quads with corners twice were removed")
        left = self.quad[three][~again[three]].reshape(-1, 3)
        self.tri = np.concatenate([self.tri, left])
        self.of_tri = np.concatenate([self.of_tri, self.given + self.of_quad[three]])
        stays = ~three & ~bad
        self.quad, self.of_quad = self.quad[stays], self.of_quad[stays]

    def drop_repeated(self, log: CleanLog) -> None:
        """Of faces with the same corners the first stays."""
        for name, faces, rows in (("triangle", self.tri, self.of_tri), ("quad", self.quad, self.of_quad)):
            _, first = np.unique(np.sort(faces, 1), axis=0, return_index=True) if len(faces) else (None, np.arange(0))
            first = np.sort(first)
            count = len(faces) - len(first)
            log.did(count, f"{name} that was there twice was removed", f"{name}s that were there twice were removed")
            if name == "triangle":
                self.tri, self.of_tri = faces[first], rows[first]
            else:
                self.quad, self.of_quad = faces[first], rows[first]

    def drop_flat_on_boundary(self, log: CleanLog) -> None:
        """Triangles without area whose long side is on the boundary go: the other two sides take its place."""
        count = 0
        while len(self.tri):
            ends, rows = self.boundary()
            mine = rows < 3 * len(self.tri)
            ends, rows = ends[mine], rows[mine]
            apex = self.tri[rows // 3, (rows + 2 - rows // 3 * 3) % 3]
            within = _collinear(self.points, ends[:, 0], ends[:, 1], apex)
            within &= _between(self.points, ends[:, 0], ends[:, 1], apex)
            on_boundary = np.zeros(len(self.points), bool)
            on_boundary[ends] = True
            sides = np.bincount(rows // 3, minlength=len(self.tri))
            flat = np.unique(rows[within & (~on_boundary[apex] | (sides[rows // 3] > 1))] // 3)
            if not len(flat):
                break
            count += len(flat)
            stays = np.ones(len(self.tri), bool)
            stays[flat] = False
            self.tri, self.of_tri = self.tri[stays], self.of_tri[stays]
        log.did(count, "flat triangle on the boundary was removed", "flat triangles on the boundary were removed")

    def divide_hanging(self, merged: np.ndarray, tolerance: float, sew: bool, log: CleanLog) -> None:
        """Vertices that hang in a side divide its face, until none hangs."""
        hung: set[int] = set()
        divided: set[int] = set()
        for _ in range(_ROUNDS):
            face, start, stops = self._hanging(tolerance, sew)
            if not len(face):
                break
            # One side of a face at a time.
            _, first = np.unique(face, return_index=True)
            new: list[list[int]] = []
            of_new: list[int] = []
            gone: list[int] = []
            for i in first.tolist():
                hung.update(stops[i])
                gone.append(int(face[i]))
                ring, of = self._ring(int(face[i]), int(start[i]))
                divided.add(of)
                chain = [ring[0], *stops[i], ring[1]]
                new += [[u, v, ring[2]] for u, v in itertools.pairwise(chain)]
                new += [[ring[2], ring[3], ring[0]]] if len(ring) == 4 else []
                of_new += [of] * (len(new) - len(of_new))
            stays = np.ones(len(self.tri) + len(self.quad), bool)
            stays[gone] = False
            kept, quads = stays[: len(self.tri)], stays[len(self.tri) :]
            self.tri = np.concatenate([self.tri[kept], np.array(new)])
            self.of_tri = np.concatenate([self.of_tri[kept], np.array(of_new)])
            order = self.of_tri.argsort(kind="stable")
            self.tri, self.of_tri = self.tri[order], self.of_tri[order]
            self.quad, self.of_quad = self.quad[quads], self.of_quad[quads]
        log.did(
            len(hung),
            f"hanging vertex was joined (triangles or quads divided: {len(divided):,})",
            f"hanging vertices were joined (triangles or quads divided: {len(divided):,})",
        )

    def _ring(self, face: int, side: int) -> tuple[list[int], int]:
        """The corners of a face from the beginning of a side on, and the row that it had."""
        if face < len(self.tri):
            return np.roll(self.tri[face], -side).tolist(), int(self.of_tri[face])
        q = face - len(self.tri)
        return np.roll(self.quad[q], -side).tolist(), self.given + int(self.of_quad[q])

    def _hanging(self, tolerance: float, sew: bool) -> tuple[np.ndarray, np.ndarray, list[list[int]]]:
        """Faces with hanging vertices in a side: the face, the number of the side, the vertices along it."""
        from scipy.spatial import cKDTree

        ends, rows = self.boundary()
        face_of = self.half_edges()[1]
        label = np.concatenate(self.components())
        of_edge = label[face_of[rows]]
        vertices = np.unique(ends)
        neighbours: dict[int, set[int]] = {}
        components: dict[int, set[int]] = {}
        for (u, v), c in zip(ends.tolist(), of_edge.tolist(), strict=True):
            neighbours.setdefault(u, set()).add(v)
            neighbours.setdefault(v, set()).add(u)
            components.setdefault(u, set()).add(c)
            components.setdefault(v, set()).add(c)
        way = self.points[ends[:, 1]] - self.points[ends[:, 0]]
        length = np.linalg.norm(way, axis=1)
        reach = np.maximum(_HANGING * length, tolerance)
        near = cKDTree(self.points[vertices]).query_ball_point(
            (self.points[ends[:, 0]] + way / 2), 0.5 * length + reach, return_sorted=True
        )
        found: list[tuple[int, int, list[int]]] = []
        for i in np.flatnonzero(np.array([len(n) for n in near]) > 2).tolist():
            a, b = ends[i].tolist()
            at = vertices[near[i]]
            at = at[(at != a) & (at != b)]
            along = (self.points[at] - self.points[a]) @ way[i] / length[i] ** 2
            off = np.linalg.norm(self.points[at] - self.points[a] - along[:, None] * way[i], axis=1)
            inside = (off <= reach[i]) & (along * length[i] > reach[i]) & ((1 - along) * length[i] > reach[i])
            stops = at[inside][along[inside].argsort(kind="stable")].tolist()
            chain = [a, *stops, b]
            closed = all(v in neighbours[u] for u, v in itertools.pairwise(chain))
            if not (closed or sew):
                own = int(of_edge[i])
                stops = [m for m in stops if components[m] - {own}]
            if stops:
                face = int(face_of[rows[i]])
                side = rows[i] - 3 * face if face < len(self.tri) else rows[i] - 4 * face + len(self.tri)
                found.append((face, int(side), stops))
        return (
            np.array([f[0] for f in found], np.int64),
            np.array([f[1] for f in found], np.int64),
            [f[2] for f in found],
        )

    def wind(self, log: CleanLog) -> None:
        """Neighbours run along their side in opposite directions; in the plane, components turn counter-clockwise."""
        left, right, times = self.shared()
        ends, face = self.half_edges()
        inner = times[left] == 2
        left, right = left[inner], right[inner]
        clash = ends[left, 0] == ends[right, 0]
        count = len(self.tri) + len(self.quad)
        turn = np.zeros(count, bool)
        if clash.any():
            arrays = (torch.from_numpy(x) for x in (face[left], face[right], clash))
            turn = turns_to_agree(count, *arrays).numpy()
            if (turn[face[left]] ^ turn[face[right]] ^ clash).any():
                log.lines.append(
                    "some triangles cannot be wound consistently: this is no planar mesh (a Moebius strip)"
                )
        label = np.concatenate(self.components())
        if self.points.shape[1] == 2 or bool((self.points[np.unique(ends), 2] == self.points[ends[0, 0], 2]).all()):
            boundary, rows = self.boundary()
            boundary = np.where(turn[face[rows]][:, None], boundary[:, ::-1], boundary)
            group = torch.from_numpy(label[face[rows]])
            flat = torch.from_numpy(self.points[:, :2].copy())
            sign = enclosed_signs(flat, torch.from_numpy(boundary), group, int(label.max()) + 1).numpy()
            turn ^= sign[label] < 0
        one, two = turn[: len(self.tri)], turn[len(self.tri) :]
        self.tri = np.where(one[:, None], self.tri[:, ::-1], self.tri)
        self.quad = np.where(two[:, None], self.quad[:, ::-1], self.quad)
        log.did(int(turn.sum()), "triangle or quad was turned round", "triangles or quads were turned round")

    def tell_what_there_is(self, log: CleanLog) -> None:
        """Notes the components, and the sides that more than two faces have."""
        times = self.shared()[2]
        if (times > 2).any():
            u, v = self.half_edges()[0][times > 2][0].tolist()
            log.lines.append(
                f"more than two triangles have the edge of the given vertices {u} and {v}: that was not mended"
            )
        sizes = np.sort(np.bincount(np.concatenate(self.components())))[::-1]
        what = "triangles and quads" if len(self.quad) else "triangles"
        listed = ", ".join(f"{size:,}" for size in sizes[:10].tolist()) + (", ..." if len(sizes) > 10 else "")
        log.lines.append(f"{len(sizes):,} component{'s' * (len(sizes) > 1)} of {listed} {what}")


def _collinear(points: np.ndarray, a: np.ndarray, b: np.ndarray, p: np.ndarray) -> np.ndarray:
    """(N,) bool: do the rows a, b, p (N,) of the points (V, d) lie exactly on a line?"""
    flat = np.ones(len(a), bool)
    axes = [(0, 1)] if points.shape[1] == 2 else [(0, 1), (1, 2), (2, 0)]
    for x, y in axes:
        rows = [torch.from_numpy(points[row, k].copy()) for row in (a, b, p) for k in (x, y)]
        flat &= orientation(*rows).numpy() == 0
    return flat


def _between(points: np.ndarray, a: np.ndarray, b: np.ndarray, p: np.ndarray) -> np.ndarray:
    """(N,) bool: are the rows p (N,) in the box of a and b, and at neither of them?"""
    low, high = np.minimum(points[a], points[b]), np.maximum(points[a], points[b])
    inside = ((low <= points[p]) & (points[p] <= high)).all(1)
    return inside & (points[p] != points[a]).any(1) & (points[p] != points[b]).any(1)


def components_of(count: int, pairs: np.ndarray) -> np.ndarray:
    """(count,) the components of the graph with the edges `pairs` (P, 2), numbered by their first members."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    graph = coo_matrix((np.ones(len(pairs), np.int8), pairs.T), shape=(count, count))
    found = connected_components(graph, directed=False)[1]
    _, first, label = np.unique(found, return_index=True, return_inverse=True)
    return np.asarray(first.argsort().argsort()[label.reshape(-1)])
