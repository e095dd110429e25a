"""Values at the nodes of six-node triangles for other nodes: by the quadratic functions of these triangles.

    2             Each triangle is divided at its nodes into four straight ones, in which points are found as in any
   / \\            mesh, in tangles, too.  A point in one of the four has coordinates in the triangle, from which a few
  5---4           steps of Newton's method lead to those of the curved triangle, and these to the weights of the six
 / \\ / \\          nodes.  A quadratic function of x and y is carried over exactly where sides are straight.
0---3---1
"""

from dataclasses import replace

import numpy as np
import torch

from ..mesh.batch import MeshBatch
from ..mesh.quads import halved
from ..transferring.sparse_rows import Entries, SparseRows
from ..transferring.transfer import Transfer, prepared
from .placed import Placed

# The four parts, by nodes, and the coordinates of the nodes in the triangle: those of corners 1 and 2.
_PARTS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
_PLACES = np.array([[0.0, 0], [1, 0], [0, 1], [0.5, 0], [0.5, 0.5], [0, 0.5]])

# Newton's method ends after so many steps; a point that has not been met then to this part of its triangle's size keeps
# the weights of the straight part.
_STEPS, _MET = 8, 1e-12


def prepared_through_nodes(before: Placed, after: Placed) -> Transfer:
    """The way from values at the vertices and nodes of a mesh to those of another one; as `transferring.prepared`."""
    linear = prepared(_divided(before), _divided(after), "points")
    return replace(linear, rows=_quadratic(linear.rows, before, after.mesh.points.to(torch.float64).numpy()))


def _divided(placed: Placed) -> MeshBatch:
    """The mesh with each curved triangle as four straight ones."""
    faces = placed.mesh.triangles.numpy()
    parts = placed.six[:, _PARTS].reshape(-1, 3)
    both = torch.from_numpy(np.concatenate([faces[~placed.middles.curved], parts]))
    offsets = placed.mesh.triangle_offsets.new_tensor([0, len(both)])
    none = placed.mesh.constrained_edges[:0]
    return halved(replace(placed.mesh, triangles=both, triangle_offsets=offsets, constrained_edges=none, _twin=None))


def _quadratic(rows: SparseRows, before: Placed, at: np.ndarray) -> SparseRows:
    """The rows with the weights of six nodes, for points that lie in a part of a curved triangle.

    at  (V', 2) where the points are
    """
    row, column, weight = rows.rows.numpy(), rows.columns.numpy(), rows.weights.numpy()
    count = rows.shape[0]
    times = np.bincount(row, minlength=count)
    start = np.cumsum(times) - times
    three = np.flatnonzero(times == 3)
    entry = start[three][:, None] + np.arange(3)
    parts = before.six[:, _PARTS].reshape(-1, 3)
    keys, first = np.unique(np.sort(parts, 1), axis=0, return_index=True)
    part = _found(keys, first, np.sort(column[entry], 1))
    some = part >= 0
    three, entry, part = three[some], entry[some], part[some]
    order = (column[entry][:, :, None] == parts[part][:, None]).argmax(2)
    place = (_PLACES[_PARTS[part % 4]][np.arange(len(part))[:, None], order] * weight[entry][:, :, None]).sum(1)
    six = before.six[part // 4]
    nodes = before.mesh.points.to(torch.float64).numpy()[six]
    place, met = _inverse(nodes, at[three], place)
    three, six, place = three[met], six[met], place[met]
    rest = ~np.isin(row, three)
    mine = Entries(np.repeat(three, 6), six.reshape(-1), _shapes(place).reshape(-1))
    return SparseRows.of([Entries(row[rest], column[rest], weight[rest]), mine], rows.shape)


def _found(keys: np.ndarray, values: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(N,) the value of each row of `wanted` (N, 3) among the rows `keys` (K, 3); -1 where there is none."""
    both, inverse = np.unique(np.concatenate([keys, wanted]), axis=0, return_inverse=True)
    table = np.full(len(both), -1)
    table[inverse.reshape(-1)[: len(keys)]] = values
    return table[inverse.reshape(-1)[len(keys) :]]


def _shapes(place: np.ndarray) -> np.ndarray:
    """(N, 6) the quadratic functions of the six nodes at the coordinates (N, 2)."""
    x, y = place.T
    z = 1 - x - y
    return np.stack([z * (2 * z - 1), x * (2 * x - 1), y * (2 * y - 1), 4 * z * x, 4 * x * y, 4 * y * z], 1)


def _inverse(nodes: np.ndarray, at: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The coordinates (N, 2) of the points `at` in triangles with the nodes (N, 6, 2), and where they were met (N,)."""
    size = np.ptp(nodes, axis=1).max(1) if len(nodes) else np.zeros(0)
    for _ in range(_STEPS):
        off = at - (_shapes(place)[:, :, None] * nodes).sum(1)
        x, y = place.T
        z, none = 1 - x - y, np.zeros(len(place))
        along = np.stack([1 - 4 * z, 4 * x - 1, none, 4 * (z - x), 4 * y, -4 * y], 1)
        across = np.stack([1 - 4 * z, none, 4 * y - 1, -4 * x, 4 * x, 4 * (z - y)], 1)
        (a, b), (c, d) = ((g[:, :, None] * nodes).sum(1).T for g in (along, across))
        determinant = a * d - b * c
        determinant = np.where(determinant == 0, np.inf, determinant)
        place = (
            place + np.stack([d * off[:, 0] - c * off[:, 1], a * off[:, 1] - b * off[:, 0]], 1) / determinant[:, None]
        )
        place = place.clip(-1, 2)
    off = np.abs(at - (_shapes(place)[:, :, None] * nodes).sum(1)).max(1, initial=0.0)
    inside = (place >= -0.1).all(1) & (place.sum(1) <= 1.1)
    return place, (off <= _MET * size) & inside
