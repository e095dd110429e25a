"""Positions of mid-side nodes when the corners of their triangles have moved.

edge                                              its node
neither end moved                                 stays, to the bit
of the boundary or an interface, moved            turns and grows with the edge; a straight one stays straight
inside, both of its elements were upright         the same
inside, otherwise; or new                         the middle

The node in the middle of a quad goes where the sides of the quad ask for it, unless none of its nodes has moved.
Where an element is not upright then, nodes inside are moved (`unfolding`), until all signs are right, exactly.
"""

from dataclasses import dataclass, replace

import numpy as np

from .elements import Elements
from .middles import Followed, Middles, rows_of_edges
from .unfolding import Unfolding, needs_mending, unfold

# An edge is straight if its node is off the middle by less than this part of its length, or by this many roundings of
# the coordinates of the file.
_STRAIGHT, _ROUNDINGS = 1e-6, 8.0


@dataclass(frozen=True, eq=False)
class Before:
    """A mesh with mid-side nodes before its corners moved.

    points   (V, 2)
    faces    (T, 3)
    quads    (Q, 4)
    middles  its mid-side nodes
    epsilon  the rounding of its coordinates, relative to their size
    """

    points: np.ndarray
    faces: np.ndarray
    quads: np.ndarray
    middles: Middles
    epsilon: float = 2.0**-52


@dataclass(frozen=True, eq=False)
class After:
    """The mesh whose mid-side nodes are to be placed.

    points    (V', 2); those of nodes are replaced, unless they are not those of `Before` and lie on the boundary
    faces     (T', 3)
    quads     (Q, 4), those of before, row by row
    followed  its mid-side nodes, and the edges before that they come from
    held      (K, 2) edges of the boundary and of interfaces
    fixed     (V',) bool, vertices and nodes that must not move to mend anything
    """

    points: np.ndarray
    faces: np.ndarray
    quads: np.ndarray
    followed: Followed
    held: np.ndarray
    fixed: np.ndarray


def placed(before: Before, after: After, new_vertex: np.ndarray, unfolding: Unfolding | None) -> np.ndarray:
    """(V' + made, 2) the points after, with all mid-side nodes placed; corners move only where nothing else mends.

    new_vertex  (V,) the row of each point before, -1 if it is gone
    unfolding   how triangles that are not upright are mended; None: they are not
    """
    middles, origin = after.followed.middles, after.followed.origin
    points = np.concatenate([after.points, np.zeros((int((middles.nodes >= len(after.points)).sum()), 2))])
    a, b = points[middles.edges].transpose(1, 0, 2)
    position = (a + b) / 2
    kept = np.flatnonzero(origin >= 0)
    old = origin[kept]
    held = np.zeros(len(middles.edges), bool)
    at = rows_of_edges(middles.edges, after.held)
    held[at[at >= 0]] = True
    meant = held[kept] | _between_upright(before)[old]
    straight = is_straight(before.points, before.middles, before.epsilon)[old]
    position[kept] = _carried(before, new_vertex, old, a[kept], b[kept], middles.edges[kept], meant & ~straight)
    still, given = _still(before, points, middles, new_vertex, kept, old)
    position[kept[still]] = before.points[before.middles.nodes[old[still]]]
    asked = held[kept] & given
    position[kept[asked]] = points[middles.nodes[kept[asked]]]
    points[middles.nodes] = position
    elements = _elements(before, after, new_vertex)
    points = elements.settled(points)
    return points if unfolding is None else _mended(before, points, after, elements, new_vertex, held, unfolding)


def _elements(before: Before, after: After, new_vertex: np.ndarray) -> Elements:
    """The curved elements after, with where the nodes of quads were before."""
    made = after.followed.middles.elements(after.faces, after.quads)
    given = before.middles.nine(before.quads)
    return replace(made, were=np.where((given < 0)[..., None], np.nan, before.points[given]))


def is_straight(points: np.ndarray, middles: Middles, epsilon: float = 2.0**-52) -> np.ndarray:
    """(E,) bool: the node lies in the middle of its edge, up to rounding."""
    a, b = points[middles.edges].transpose(1, 0, 2)
    off = np.abs(points[middles.nodes] - (a + b) / 2).max(1)
    size = np.abs(points[middles.edges]).max((1, 2))
    return off <= np.maximum(_STRAIGHT * np.abs(b - a).max(1), _ROUNDINGS * epsilon * size)


def _between_upright(before: Before) -> np.ndarray:
    """(E,) bool: all elements at the edge are upright before."""
    elements = before.middles.elements(before.faces, before.quads)
    whole = np.ones(len(before.middles.edges), bool)
    bad = ~elements.upright(before.points)
    whole[before.middles.at(elements.sides[bad].reshape(-1, 2))] = False
    return whole


def _carried(
    before: Before, new_vertex: np.ndarray, old: np.ndarray, a: np.ndarray, b: np.ndarray, edges: np.ndarray,
    bent: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """(K, 2) the nodes of the edges `old` (K,) between the ends a and b: in the middle, and beside it where `bent`.

    The way from the middle to the node turns and grows as the edge does: it is multiplied by the quotient of the edges
    as complex numbers.
    """
    rows = before.middles.edges[old]
    turned = new_vertex[rows[:, 0]] != edges[:, 0]
    rows = np.where(turned[:, None], rows[:, ::-1], rows)
    u, w = before.points[rows].transpose(1, 0, 2)
    middle = (a + b) / 2
    away, was, now = (
        np.ascontiguousarray(v).view(complex)[:, 0]
        for v in (before.points[before.middles.nodes[old]] - (u + w) / 2, w - u, b - a)
    )
    some = bent & (was != 0)
    step = np.zeros_like(away)
    step[some] = away[some] * (now[some] / was[some])
    return np.where(some[:, None], middle + step[:, None].view(float), middle)


def _still(
    before: Before, points: np.ndarray, middles: Middles, new_vertex: np.ndarray, kept: np.ndarray, old: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(K,) bool each: no end of the edge moved; and somebody has moved the node, with both ends or with neither."""
    rows = before.middles.edges[old]
    moved = (points[new_vertex[rows]] != before.points[rows]).any(2)
    given = (points[middles.nodes[kept]] != before.points[before.middles.nodes[old]]).any(1)
    return ~moved.any(1), given & (moved[:, 0] == moved[:, 1])


def _mended(
    before: Before, points: np.ndarray, after: After, elements: Elements, new_vertex: np.ndarray, held: np.ndarray,
    unfolding: Unfolding,
) -> np.ndarray:  # fmt: skip
    """The points, with nodes inside moved where an element is not upright, or has become poor."""
    middles = after.followed.middles
    # What came with a poor Jacobian, and has not changed, stays as it is.
    came = _unchanged(before, points, new_vertex, elements)
    # Where straight elements are inverted still, no side can mend them.
    lost = elements.straight_inverted(points)
    bad = ~elements.upright(points) & ~lost
    if not (bad | (needs_mending(points, elements, unfolding.aim) & ~came & ~lost)).any():
        return points
    fixed = np.concatenate([after.fixed, np.zeros(len(points) - len(after.fixed), bool)])
    side = middles.at(elements.sides.reshape(-1, 2)).reshape(-1, 4)
    free = ~held & ~_marked(after, middles)
    # First the nodes inside go to the middles of their edges, wherever that helps.
    for _ in range(unfolding.straightenings):
        rows = np.unique(side[bad])
        rows = rows[free[rows]]
        trial = points.copy()
        trial[middles.nodes[rows]] = trial[middles.edges[rows]].mean(1)
        trial = elements.settled(trial)
        now = ~elements.upright(trial) & ~lost
        if now.sum() >= bad.sum():
            break
        points, bad = trial, now
    may = ~came & ~lost
    bad |= needs_mending(points, elements, unfolding.aim) & may
    may |= bad
    stay = fixed | _on(after.held, len(points))
    stay[_straight_corners(after, middles)] = True
    return unfold(points, elements, side, middles, free, stay, bad, may, unfolding)


def _straight_corners(after: After, middles: Middles) -> np.ndarray:
    """The corners of elements without mid-side nodes, of which no curved element may move one."""
    flat = [after.faces[~middles.curved].reshape(-1)]
    flat.append(after.quads[~middles.quads].reshape(-1) if len(middles.quads) else after.quads.reshape(-1))
    return np.concatenate(flat)


def _unchanged(before: Before, points: np.ndarray, new_vertex: np.ndarray, elements: Elements) -> np.ndarray:
    """(N,) bool: no node of the element has moved, and it was an element before."""
    old = np.full(len(points), -1)
    old[new_vertex[new_vertex >= 0]] = np.flatnonzero(new_vertex >= 0)
    rows = old[elements.six]
    same = (rows >= 0).all(1)
    same[same] = (before.points[rows[same]] == points[elements.six[same]]).all((1, 2))
    given = np.sort(before.middles.six(before.faces), 1)
    whole = np.concatenate([given, np.sort(rows, 1)])
    _, number = np.unique(whole, axis=0, return_inverse=True)
    of_triangles = same & np.isin(number.reshape(-1)[len(given) :], number.reshape(-1)[: len(given)])
    there = (elements.nine >= 0)[..., None]
    of_quads = ((points[elements.nine] == elements.were) | ~there).all((1, 2))
    return np.concatenate([of_triangles, of_quads])


def _marked(after: After, middles: Middles) -> np.ndarray:
    """(E,) bool: the node is one that the user has fixed."""
    there = middles.nodes < len(after.fixed)
    marked = np.zeros(len(middles.nodes), bool)
    marked[there] = after.fixed[middles.nodes[there]]
    return marked


def _on(edges: np.ndarray, count: int) -> np.ndarray:
    """(count,) bool: the vertex is an end of one of the edges (K, 2)."""
    on = np.zeros(count, bool)
    on[edges] = True
    return on
