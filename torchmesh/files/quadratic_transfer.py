"""Values at the nodes of curved elements for other nodes: by the quadratic functions of these elements.

    2             Each triangle is divided at its nodes into four straight ones, in which points are found as in any
   / \\            mesh, in tangles, too.  A point in one of the four has coordinates in the triangle, from which a few
  5---4           steps of Newton's method lead to those of the curved triangle, and these to the weights of the six
 / \\ / \\          nodes.  A quadratic function of x and y is carried over exactly where sides are straight.
0---3---1      Quads of eight and nine nodes are divided into six and eight in the same way; their functions are those
               of serendipity and of Lagrange.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from ..mesh.batch import MeshBatch
from ..mesh.quads import halved
from ..transferring.sparse_rows import Entries, SparseRows
from ..transferring.transfer import Transfer, prepared
from .placed import Placed

# Newton's method ends after so many steps; a point that has not been met then to this part of its element's size keeps
# the weights of the straight part.
_STEPS, _MET = 8, 1e-12

# Values (N, k) and derivatives (2, N, k) of the functions of k nodes at coordinates (N, 2).
_Functions = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class _Kind:
    """A type of curved element.

    parts      (P, 3) the straight triangles that it is divided into, by its nodes
    places     (k, 2) the coordinates of the nodes in the element
    functions  the functions of its nodes
    inside     (N,) bool for coordinates (N, 2): not beyond the element by more than a tenth of it
    """

    parts: np.ndarray
    places: np.ndarray
    functions: _Functions
    inside: Callable[[np.ndarray], np.ndarray]


def _of_triangle(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, y = place.T
    z, none = 1 - x - y, np.zeros(len(place))
    values = np.stack([z * (2 * z - 1), x * (2 * x - 1), y * (2 * y - 1), 4 * z * x, 4 * x * y, 4 * y * z], 1)
    along = np.stack([1 - 4 * z, 4 * x - 1, none, 4 * (z - x), 4 * y, -4 * y], 1)
    across = np.stack([1 - 4 * z, none, 4 * y - 1, -4 * x, 4 * x, 4 * (z - y)], 1)
    return values, np.stack([along, across])


def _of_nine(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    (fu, gu), (fv, gv) = (
        (
            np.stack([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)]),
            np.stack([4 * t - 3, 4 - 8 * t, 4 * t - 1]),
        )
        for t in place.T
    )
    i, j = np.array([0, 2, 2, 0, 1, 2, 1, 0, 1]), np.array([0, 0, 2, 2, 0, 1, 2, 1, 1])
    return (fu[i] * fv[j]).T, np.stack([(gu[i] * fv[j]).T, (fu[i] * gv[j]).T])


def _of_eight(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Those of nine nodes, of which the middle one stands at half the mid-side nodes less a quarter of the corners."""
    values, slopes = _of_nine(place)
    share = np.array([-0.25] * 4 + [0.5] * 4)
    return values[:, :8] + values[:, 8:] * share, slopes[:, :, :8] + slopes[:, :, 8:] * share


_ROUND = [[0, 4, 7], [4, 1, 5], [5, 2, 6], [6, 3, 7]]
_QUAD_PLACES = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0], [1, 0.5], [0.5, 1], [0, 0.5], [0.5, 0.5]])


def _in_square(place: np.ndarray) -> np.ndarray:
    return np.asarray(((place >= -0.1) & (place <= 1.1)).all(1))


_TRIANGLE = _Kind(
    np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]),
    np.array([[0.0, 0], [1, 0], [0, 1], [0.5, 0], [0.5, 0.5], [0, 0.5]]),
    _of_triangle,
    lambda place: np.asarray((place >= -0.1).all(1) & (place.sum(1) <= 1.1)),
)
_EIGHT = _Kind(np.array([*_ROUND, [4, 5, 7], [5, 6, 7]]), _QUAD_PLACES[:8], _of_eight, _in_square)
_NINE = _Kind(np.array([*_ROUND, [4, 8, 7], [4, 5, 8], [5, 6, 8], [6, 7, 8]]), _QUAD_PLACES, _of_nine, _in_square)


def prepared_through_nodes(before: Placed, after: Placed) -> Transfer:
    """The way from values at the vertices and nodes of a mesh to those of another one; as `transferring.prepared`."""
    linear = prepared(_divided(before), _divided(after), "points")
    nodes, at = (placed.mesh.points.to(torch.float64).numpy() for placed in (before, after))
    rows = linear.rows
    for kind, elements in _kinds(before):
        rows = _quadratic(rows, kind, elements, nodes, at)
    return replace(linear, rows=rows)


def _kinds(placed: Placed) -> list[tuple[_Kind, np.ndarray]]:
    """The curved elements by their types, and the nodes (N, k) of those of each."""
    nine = placed.elements.nine
    has = nine[:, 8] >= 0
    found = (_TRIANGLE, placed.six), (_EIGHT, nine[~has, :8]), (_NINE, nine[has])
    return [(kind, nodes) for kind, nodes in found if len(nodes)]


def _divided(placed: Placed) -> MeshBatch:
    """The mesh with each curved element as its straight parts."""
    mesh, middles = placed.mesh, placed.middles
    quads = mesh.quads[torch.from_numpy(~middles.quads)] if len(middles.quads) else mesh.quads
    flat = mesh.triangles.numpy()[~middles.curved]
    both = torch.from_numpy(
        np.concatenate([flat, *(nodes[:, kind.parts].reshape(-1, 3) for kind, nodes in _kinds(placed))])
    )
    return halved(
        replace(
            mesh, triangles=both, triangle_offsets=mesh.triangle_offsets.new_tensor([0, len(both)]), quads=quads,
            quad_offsets=mesh.quad_offsets.new_tensor([0, len(quads)]),
            constrained_edges=mesh.constrained_edges[:0], _twin=None,
        )
    )  # fmt: skip


def _quadratic(rows: SparseRows, kind: _Kind, elements: np.ndarray, points: np.ndarray, at: np.ndarray) -> SparseRows:
    """The rows with the weights of all nodes, for points that lie in a part of one of the elements.

    elements  (N, k) the nodes of curved elements of one type, which lie at `points` (V, 2)
    at        (V', 2) where the points are
    """
    row, column, weight = rows.rows.numpy(), rows.columns.numpy(), rows.weights.numpy()
    count = rows.shape[0]
    times = np.bincount(row, minlength=count)
    start = np.cumsum(times) - times
    three = np.flatnonzero(times == 3)
    entry = start[three][:, None] + np.arange(3)
    parts = elements[:, kind.parts].reshape(-1, 3)
    keys, first = np.unique(np.sort(parts, 1), axis=0, return_index=True)
    part = _found(keys, first, np.sort(column[entry], 1))
    some = part >= 0
    three, entry, part = three[some], entry[some], part[some]
    order = (column[entry][:, :, None] == parts[part][:, None]).argmax(2)
    own, corners = part // len(kind.parts), kind.parts[part % len(kind.parts)]
    place = kind.places[corners][np.arange(len(part))[:, None], order]
    place = (place * weight[entry][:, :, None]).sum(1)
    nodes = elements[own]
    place, met = _inverse(kind, points[nodes], at[three], place)
    three, nodes, place = three[met], nodes[met], place[met]
    rest = ~np.isin(row, three)
    width = nodes.shape[1]
    mine = Entries(np.repeat(three, width), nodes.reshape(-1), kind.functions(place)[0].reshape(-1))
    return SparseRows.of([Entries(row[rest], column[rest], weight[rest]), mine], rows.shape)


def _found(keys: np.ndarray, values: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(N,) the value of each row of `wanted` (N, 3) among the rows `keys` (K, 3); -1 where there is none."""
    both, inverse = np.unique(np.concatenate([keys, wanted]), axis=0, return_inverse=True)
    table = np.full(len(both), -1)
    table[inverse.reshape(-1)[: len(keys)]] = values
    return table[inverse.reshape(-1)[len(keys) :]]


def _inverse(kind: _Kind, nodes: np.ndarray, at: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The coordinates (N, 2) of the points `at` in elements with the nodes (N, k, 2), and where they were met (N,)."""
    size = np.ptp(nodes, axis=1).max(1) if len(nodes) else np.zeros(0)
    for _ in range(_STEPS):
        values, slopes = kind.functions(place)
        off = at - (values[:, :, None] * nodes).sum(1)
        (a, b), (c, d) = ((g[:, :, None] * nodes).sum(1).T for g in slopes)
        determinant = a * d - b * c
        determinant = np.where(determinant == 0, np.inf, determinant)
        place = (
            place + np.stack([d * off[:, 0] - c * off[:, 1], a * off[:, 1] - b * off[:, 0]], 1) / determinant[:, None]
        )
        place = place.clip(-1, 2)
    off = np.abs(at - (kind.functions(place)[0][:, :, None] * nodes).sum(1)).max(1, initial=0.0)
    return place, (off <= _MET * size) & kind.inside(place)
