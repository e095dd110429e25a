"""Polygons with holes, given as loops of vertices: are they simple, and what lies inside.

A domain lies on the left of its loops: one outer loop counter-clockwise, holes clockwise.  Loops
may share vertices.  Exact signs decide.
"""

import functools

import numpy as np
import torch

from ..mesh.connectivity import boundary_loops
from .arrays import Obstacle, among, signs
from .crossings import crossing_pairs, overlapping_boxes
from .recovery import Exact

# Rows of a vertices-times-edges table worked on at once, which bounds the memory.
_CHUNK = 2_000_000


def unit_exponent(points: np.ndarray) -> int:
    """k such that dividing by 2**k brings the points near 1 and loses no bit; 0 if none does."""
    exponent = int(np.frexp(np.abs(points).max())[1])
    there = np.ldexp(points, -exponent)
    return exponent if np.array_equal(np.ldexp(there, exponent), points) else 0


def loops_of(boundary: np.ndarray) -> list[np.ndarray]:
    """The closed walks along the directed edges `boundary` (E, 2), none of which passes a vertex twice."""
    return [loop.numpy() for loop in boundary_loops(torch.from_numpy(boundary))]


def loop_edges(loop: np.ndarray) -> np.ndarray:
    """(n, 2) the directed edges of a loop (n,)."""
    return np.stack([loop, np.concatenate([loop[1:], loop[:1]])], 1)


def turns_left(points: np.ndarray, loops: list[np.ndarray]) -> np.ndarray:
    """(L,) 1 for a counter-clockwise simple loop, -1 for a clockwise one, 0 where the first corner is flat."""
    if not loops:
        return np.zeros(0, np.int8)
    flat = np.concatenate(loops)
    size = np.array([len(loop) for loop in loops])
    start = np.cumsum(size) - size
    first = start + [_lowest(points[loop]) for loop in loops]
    before = np.where(first == start, start + size, first) - 1
    after = np.where(first + 1 == start + size, start, first + 1)
    return signs(points, flat[before], flat[first], flat[after])


def _lowest(xy: np.ndarray) -> int:
    """The row of `xy` (N, 2) that comes first by x, then by y."""
    x = xy[:, 0]
    leftmost = np.flatnonzero(x == x.min())
    return int(leftmost[xy[leftmost, 1].argmin()])


def winding(points: np.ndarray, p: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(N,) how often the closed walks made of the directed `edges` (E, 2) go round the vertices p (N,).

    Exact for vertices not on an edge; a vertex on one is an end of a ray, counted half-open.
    """
    total, y = np.zeros(len(p), np.int64), points[:, 1]
    order = np.argsort(y[p], kind="stable")
    height, (first, last) = y[p[order]], y[edges].T
    # The vertices whose rays meet an edge follow each other in this order, from its lower end to below its upper one.
    start, stop = (np.searchsorted(height, f(first, last)) for f in (np.minimum, np.maximum))
    ends = np.cumsum(stop - start)
    begin = 0
    while begin < len(edges):
        done = ends[begin - 1] if begin else 0
        end = max(begin + 1, int(np.searchsorted(ends, done + _CHUNK, "right")))
        counts = (stop - start)[begin:end]
        e = np.repeat(np.arange(begin, end), counts)
        i = order[np.arange(len(e)) + np.repeat(start[begin:end] - (ends[begin:end] - counts - done), counts)]
        side = signs(points, edges[e, 0], edges[e, 1], p[i])
        up = (first < last)[e]
        total += np.bincount(i[up & (side > 0)], minlength=len(p)) - np.bincount(i[~up & (side < 0)], minlength=len(p))
        begin = end
    return total


def windings(points: np.ndarray, p: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(E,) what each of the directed `edges` (E, 2) adds to the turns of its walk round the vertex of p (E,) beside it.

    The sum over a closed walk is what `winding` counts.
    """
    y = points[:, 1]
    low, high = y[edges[:, 0]] <= y[p], y[edges[:, 1]] > y[p]
    turns = np.zeros(len(edges), np.int64)
    some = np.flatnonzero(low == high)
    side = signs(points, edges[some, 0], edges[some, 1], p[some])
    turns[some] = np.where(low[some], side > 0, 0) - np.where(low[some], 0, side < 0)
    return turns


def why_not_simple(points: np.ndarray, loops: list[np.ndarray]) -> Obstacle | None:
    """What keeps the loops from bounding one domain on their left, if anything."""
    boundary = np.concatenate([loop_edges(loop) for loop in loops])
    pairs = crossing_pairs(points, boundary)
    if len(pairs):
        return Obstacle(
            "the edges [{}, {}] and [{}, {}] of the boundary meet", tuple(boundary[pairs[0]].ravel().tolist())
        )
    crossed = _crossed_vertex(points, boundary)
    if crossed is not None:
        return Obstacle("the boundary crosses itself at vertex {}", (crossed,))
    turn = turns_left(points, loops)
    if (turn > 0).sum() != 1 or (turn == 0).any():
        return Obstacle(f"the boundary has {(turn > 0).sum()} outer loops, not one")
    outer = loops[int(turn.argmax())]
    for i, hole in enumerate(loops):
        if turn[i] > 0:
            continue
        inner = _one_not_in(hole, outer)
        if winding(points, inner, loop_edges(outer))[0] != 1:
            return Obstacle("the hole through vertex {} lies outside the outer loop", tuple(inner.tolist()))
    nested = nested_holes(points, [loops[i] for i in np.flatnonzero(turn < 0)])
    if nested is not None:
        return Obstacle(
            "the hole through vertex {} lies inside the one through vertex {}", (int(nested[0][0]), int(nested[1][0]))
        )
    return None


def _crossed_vertex(points: np.ndarray, boundary: np.ndarray) -> int | None:
    """A vertex at which loops cross, of loops whose edges (E, 2) meet in common vertices only; None if there is none.

    The domain extends counter-clockwise from an edge that leaves a vertex to the next edge there, so that one must
    arrive.
    """
    leaving = np.bincount(boundary[:, 0], minlength=len(points))
    shared = np.flatnonzero(leaving > 1)
    if not len(shared):
        return None
    exact = Exact(points)
    around: dict[int, list[tuple[int, bool]]] = {v: [] for v in shared.tolist()}
    for u, v in boundary[(leaving[boundary] > 1).any(1)].tolist():
        if u in around:
            around[u].append((v, True))
        if v in around:
            around[v].append((u, False))
    for p, spokes in around.items():
        order = functools.cmp_to_key(functools.partial(exact.later, p))
        leaves = [leave for _, leave in sorted(spokes, key=lambda spoke: order(spoke[0]))]
        if any(a == b for a, b in zip(leaves, leaves[1:] + leaves[:1], strict=True)):
            return p
    return None


def nested_holes(points: np.ndarray, holes: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray] | None:
    """A hole and another that holds it, of clockwise loops that do not cross; None if there is none."""
    if len(holes) < 2:
        return None
    low = np.stack([points[hole].min(0) for hole in holes])
    high = np.stack([points[hole].max(0) for hole in holes])
    near = overlapping_boxes(low, high)
    if near is None:
        import shapely

        boxes = shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
        near = shapely.STRtree(boxes).query(boxes)
    i, j = np.concatenate(near), np.concatenate(near[::-1])
    within = ((low[j] <= low[i]) & (high[i] <= high[j])).all(1) & (i != j)
    for a, b in zip(i[within].tolist(), j[within].tolist(), strict=True):
        if winding(points, _one_not_in(holes[a], holes[b]), loop_edges(holes[b]))[0]:
            return holes[a], holes[b]
    return None


def _one_not_in(loop: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(1,) a vertex of `loop` that `other` does not pass; its first if it passes them all."""
    alone = loop[~among(loop, other)]
    return alone[:1] if len(alone) else loop[:1]
