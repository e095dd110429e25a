"""Meshes of domains that touch themselves: cracks whose sides are divided differently, and bays that close in a point.

Each is first opened a little, so that its boundary is a simple polygon, then triangulated, and then closed again: a
mesh with the right triangles for some other positions.  Random flips make worse of it.
"""

import numpy as np

from torchmesh.mesh.batch import MeshBatch
from torchmesh.triangulating.polygon_triangulation import triangulate_with


def opened_and_closed(opened, closed, inner, rng, flips=0, rounds=1):
    """A mesh of the simple polygon `opened` (n, 2) with the points `inner` in it, its boundary moved to `closed`."""
    points = np.concatenate([opened, inner])
    n = len(opened)
    work = triangulate_with(
        points, [np.arange(n)], np.ones(len(points)), np.arange(n, len(points)), np.zeros((0, 2), np.int64)
    )
    kept, triangles = np.unique(work.corners, return_inverse=True)
    triangles = flipped(triangles.reshape(-1, 3), flips, rng)
    points = np.concatenate([closed, inner])[kept]
    return points, triangles


def flipped(triangles, count, rng):
    """The triangles (T, 3) after so many random flips of interior edges, whatever becomes of their areas."""
    rows = [tuple(t) for t in triangles.tolist()]
    for _ in range(count):
        half = {(t[k], t[(k + 1) % 3]): (i, t[(k + 2) % 3]) for i, t in enumerate(rows) for k in range(3)}
        inner = sorted(e for e in half if e[0] < e[1] and e[::-1] in half)
        u, v = inner[rng.integers(len(inner))]
        (i, a), (j, b) = half[u, v], half[v, u]
        if a != b and (a, b) not in half and (b, a) not in half:
            rows[i], rows[j] = (a, u, b), (b, v, a)
    return np.array(rows)


def crack(rng, inner=12, flips=40, kinked=False, branch=False):
    """A square with a crack from its lower side: each lip has vertices of its own, at multiples of 1/8 along it."""
    path = np.array([[2, 0], [2, 2], [3, 3]] if kinked else [[2, 0], [2, 2.0]])
    length = len(path) - 1

    def at(s):
        k = np.minimum(s.astype(int), length - 1)
        return path[k] + (s - k)[:, None] * (path[k + 1] - path[k])

    sides = []
    for _ in range(2):
        chosen = np.flatnonzero(rng.random(8 * length - 1) < 0.3) + 1
        chosen = np.union1d(chosen, 8 * np.arange(1, length))  # a kink is a vertex on both sides
        sides.append(chosen / 8)
    left, right = np.concatenate([[0], sides[0]]), np.concatenate([[0], sides[1]])
    tip = at(np.array([float(length)]))
    width = 0.5
    shift = lambda s: np.stack([width * (1 - s / length), np.zeros_like(s)], 1)  # noqa: E731
    outside = np.array([[4, 0], [4, 4], [0, 4], [0, 0.0]])
    closed = np.concatenate([at(right)[::1], tip, at(left)[::-1]])
    opened = np.concatenate([at(right) + shift(right), tip, (at(left) - shift(left))[::-1]])
    # Counter-clockwise: from the mouth's left corner up the left lip, down the right one, and round the square.
    closed, opened = closed[::-1], opened[::-1]
    return opened_and_closed(
        np.concatenate([opened, outside]), np.concatenate([closed, outside]), rng.random((inner, 2)) * 4, rng, flips
    )


def two_lips(rng, flips=40):
    """The mesh of nine triangles with a crack of two edges."""
    points = np.array([[0, 0], [2, 0], [2, 3], [0, 3], [1, 0], [1, 0], [1, 1], [1, 1], [1, 2], [1, 2.5]])
    good = [[0, 4, 6], [0, 6, 8], [0, 8, 3], [3, 8, 9], [3, 9, 2], [9, 8, 2], [5, 1, 7], [7, 1, 8], [8, 1, 2]]
    return points, flipped(np.array(good), flips, rng)


def mesh_of(points, triangles):
    return MeshBatch.from_arrays(points, triangles)


def walk(rng, cells=12, split=0.4, flips=60):
    """A snake of unit cells on a lattice that touches itself wherever it comes back to where it was.

    Only neighbours along the snake share vertices.  Some of the sides of the cells have a vertex more.
    """
    path = [(0, 0)]
    while len(path) < cells:
        steps = [(path[-1][0] + i, path[-1][1] + j) for i, j in ((1, 0), (0, 1), (-1, 0), (0, -1))]
        free = [s for s in steps if s not in path]
        if not free:
            break
        path.append(free[rng.integers(len(free))])
    points, triangles, corner, middle = [], [], {}, {}
    for n, (i, j) in enumerate(path):
        ring = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
        shared = [p for p in ring if n and p in corner and corner[p][1] == n - 1]
        for p in ring:
            if p in shared:
                corner[p] = (corner[p][0], n)
            else:
                corner[p] = (len(points), n)
                points.append(p)
        chain = []
        for a, b in zip(ring, ring[1:] + ring[:1], strict=True):
            u, v = corner[a][0], corner[b][0]
            chain.append(u)
            if (v, u) not in middle:
                middle[u, v] = None
                if rng.random() < split:
                    middle[u, v] = len(points)
                    t = rng.integers(1, 8) / 8
                    points.append((a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])))
            found = middle.get((u, v), middle.get((v, u)))
            chain += [] if found is None else [found]
        centre = len(points)
        points.append((i + 0.5, j + 0.5))
        triangles += [[u, v, centre] for u, v in zip(chain, chain[1:] + chain[:1], strict=True)]
    return np.array(points, float), flipped(np.array(triangles), flips, rng)
