"""Random polygons with holes, as loops of vertices, shared by the tests of triangulations."""

import itertools

import numpy as np

from torchmesh.triangulating.crossings import crossing_pairs
from torchmesh.triangulating.polygon import loop_edges, winding

SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)

# A square, and a square hole that leaves it through two vertices that both have: no edges cross.
CROSSED = np.array([[0, 0], [2, 0], [2, 0.5], [2, 1.5], [2, 2], [0, 2], [1, 0.5], [1, 1.5], [3, 1.5], [3, 0.5]])
CROSSED_LOOPS = [[0, 1, 2, 3, 4, 5], [6, 7, 3, 8, 9, 2]]


def star(count, rng, low=0.5, high=1.0):
    angle = 2 * np.pi * np.arange(count) / count
    radius = rng.uniform(low, high, count)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1)


def star_with_holes(rng):
    """A star-shaped outer loop and two star-shaped holes: points and loops."""
    parts = [star(int(rng.integers(8, 60)), rng)]
    parts += [0.15 * star(int(rng.integers(3, 20)), rng) + centre for centre in ([-0.22, 0.0], [0.22, 0.0])]
    starts = np.cumsum([0, *map(len, parts)])
    loops = [np.arange(a, b) for a, b in itertools.pairwise(starts)]
    return np.concatenate(parts), [loops[0], loops[1][::-1].copy(), loops[2][::-1].copy()]


def edges_of(loops):
    return np.concatenate([loop_edges(loop) for loop in loops])


def star_with_vertices(seed, scale=1.0, offset=0.0):
    """A star with holes, vertices in and round it, a segment between two of those inside; which are inside."""
    rng = np.random.default_rng(seed)
    points, loops = star_with_holes(rng)
    inner = len(points) + np.arange(60)
    points = np.concatenate([points, rng.uniform(-1, 1, (60, 2))]) * scale + offset
    inside = inner[winding(points, inner, edges_of(loops)) == 1]
    boundary = edges_of(loops)
    pairs = (np.array([[u, v]]) for u, v in itertools.combinations(inside.tolist(), 2))
    segment = next(pair for pair in pairs if not len(crossing_pairs(points, np.concatenate([boundary, pair]))))
    return points, loops, inner, inside, segment
