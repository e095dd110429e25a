"""Meshes whose boundary is at fault, or lies over itself; most of them can never be valid.

What is known of them: the strip that lies over itself is valid as it is made.  Of the others nothing is asked but that
nothing false is said of them, and that it does not take long.
"""

from collections.abc import Callable

import numpy as np
import torch

from torchmesh.mesh import connectivity

from .domains import Arrays, polygon

Array = np.ndarray


def strip(rng: np.random.Generator, triangles: int) -> Arrays:
    """A valid annular strip of up to three turns, which lies over itself."""
    rows = int(rng.integers(1, 6))
    columns = max(24, triangles // (2 * rows))
    angle = np.linspace(0, np.radians(rng.uniform(370, 1080)), columns + 1)
    radius = np.linspace(1.0, rng.uniform(1.2, 2.0), rows + 1)
    points = np.stack([np.outer(np.cos(angle), radius), np.outer(np.sin(angle), radius)], 2).reshape(-1, 2)
    return points, _grid(columns, rows)[:, ::-1].copy(), np.zeros((0, 2), np.int64)


def torus(rng: np.random.Generator, triangles: int) -> Arrays:
    """A torus with a hole, or the surface of a ball with one: a handle, or more triangles than room."""
    side = max(4, round(np.sqrt(triangles / 2)))
    i, j = (v.ravel() for v in np.meshgrid(np.arange(side), np.arange(side), indexing="ij"))
    a, b = i * side + j, (i + 1) % side * side + j
    c, d = (i + 1) % side * side + (j + 1) % side, i * side + (j + 1) % side
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    faces = faces[~np.isin(np.arange(len(faces)), [0, side * side])]
    points = rng.uniform(0.5, 1.0, (side * side, 2))
    points[[0, side, side + 1, 1]] = [[0, 0], [0, 3], [3, 3], [3, 0]]
    return points, faces, np.zeros((0, 2), np.int64)


def _spoilt(spoil: Callable[[np.random.Generator, Array, Array], None]) -> Callable[..., Arrays | None]:
    """A polygon whose boundary was spoilt: `spoil` changes the points, given the boundary edges (E, 2), in place."""

    def make(rng: np.random.Generator, triangles: int) -> Arrays | None:
        made = polygon(rng, triangles)
        if made is None:
            return None
        points, faces, edges = made
        rows = torch.from_numpy(faces)
        points = points.copy()
        spoil(rng, points, connectivity.boundary_edges(rows, connectivity.twins(rows)).numpy())
        return points, faces, edges

    return make


def _swap(rng: np.random.Generator, points: Array, edges: Array) -> None:
    for u, v in edges[rng.integers(len(edges), size=int(rng.integers(1, 3)))]:
        points[[u, v]] = points[[v, u]]


def _coincide(rng: np.random.Generator, points: Array, edges: Array) -> None:
    u, v = edges[rng.integers(len(edges))]
    points[u] = points[v]


def _cross(rng: np.random.Generator, points: Array, edges: Array) -> None:
    points[rng.choice(edges[:, 0], int(rng.integers(1, 4)))] *= rng.choice([-1.0, -0.3, 0.1])


def _random(rng: np.random.Generator, points: Array, edges: Array) -> None:
    points[edges[:, 0]] = rng.normal(size=(len(edges), 2))


def _flat(rng: np.random.Generator, points: Array, edges: Array) -> None:
    points[edges[:, 0], 1] = 0.0


def _inside_out(rng: np.random.Generator, points: Array, edges: Array) -> None:
    points[edges[:, 0], 0] *= -1


def _grid(columns: int, rows: int) -> Array:
    index = np.arange((columns + 1) * (rows + 1)).reshape(columns + 1, rows + 1)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    return np.concatenate([np.stack([a, b, c], 2), np.stack([a, c, d], 2)]).reshape(-1, 3)


IMPOSSIBLE: dict[str, Callable[[np.random.Generator, int], Arrays | None]] = {
    "strips over themselves": strip,
    "handles": torus,
    "neighbours swapped": _spoilt(_swap),
    "neighbours in one position": _spoilt(_coincide),
    "a few across": _spoilt(_cross),
    "boundary anywhere": _spoilt(_random),
    "boundary on a line": _spoilt(_flat),
    "boundary inside out": _spoilt(_inside_out),
}
