"""What is done to a valid mesh: vertices inside go anywhere, edges flip at random, the whole is turned and scaled."""

from collections.abc import Callable

import numpy as np

from . import cracks

Array = np.ndarray
# New positions (N, 2) for the free vertices among the points (V, 2), of which `free` (N,) are the rows.
Throw = Callable[[np.random.Generator, Array, Array], Array]


def _size(points: Array) -> float:
    return float(np.ptp(points, axis=0).max())


def _on_edges(rng: np.random.Generator, points: Array, free: Array) -> Array:
    ends = points[rng.integers(len(points), size=(2, len(free)))]
    return 0.5 * (ends[0] + ends[1])


THROWS: dict[str, Throw] = {
    "as given": lambda rng, p, free: p[free],
    "jittered": lambda rng, p, free: (
        p[free] + _size(p) * 10 ** rng.uniform(-3, 0) * rng.normal(size=(len(free), 2)) / np.sqrt(len(p))
    ),
    "a few far away": lambda rng, p, free: np.where(
        rng.uniform(size=(len(free), 1)) < 0.1, p[free] + _size(p) * rng.normal(size=(len(free), 2)), p[free]
    ),
    "anywhere": lambda rng, p, free: p.mean(0) + _size(p) * rng.choice([0.1, 1, 100]) * rng.normal(size=(len(free), 2)),
    "one point": lambda rng, p, free: np.tile(p.mean(0) + _size(p) * rng.normal(size=2), (len(free), 1)),
    "a line": lambda rng, p, free: p.mean(0) + rng.normal(size=(len(free), 1)) * rng.normal(size=2) * _size(p),
    "shuffled": lambda rng, p, free: p[rng.permutation(free)],
    "on vertices": lambda rng, p, free: p[rng.integers(len(p), size=len(free))],
    "on edges": _on_edges,
    "mirrored": lambda rng, p, free: p.min(0) + p.max(0) - p[free],
    "shrunk": lambda rng, p, free: p.mean(0) + 1e-9 * (p[free] - p.mean(0)),
    "far outside": lambda rng, p, free: p[free] * rng.choice([1e3, 1e9, 1e15]),
}


def flipped(rng: np.random.Generator, triangles: Array) -> Array:
    """The triangles after some random flips, in half of the cases none; signs are not looked at."""
    count = int(rng.choice([0, 0, 3, 30])) if len(triangles) < 400 else 0
    return cracks.flipped(triangles, count, rng) if count else triangles


def transform(rng: np.random.Generator) -> Callable[[Array], Array]:
    """A map of points (V, 2): turned, scaled and moved, which may round vertices onto each other."""
    angle = rng.choice([0.0, 0.0, rng.uniform(0, 2 * np.pi)])
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    scale = rng.choice([1.0, 1.0, 1.0, 1e-3, 1e6, 1e-140, 1e140])
    shift = rng.choice([0.0, 0.0, 0.0, 10.0, 1e6]) * rng.normal(size=2)
    return lambda points: (points @ turn + shift) * scale
