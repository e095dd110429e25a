"""The mid-side nodes of curved triangles and quads, by edge; and what becomes of them when edges flip, come and go.

before          after            An edge that stays keeps its node.  The node of an edge that went goes to an edge
u ---m--- w     u       w        that came: where one edge took the place of another, to that one, so that its number
                |               stays in the same two triangles; otherwise to the nearest one.
  t   s           t-m-s
"""

from dataclasses import dataclass, field

import numpy as np

from ..errors import InvalidMeshError
from .elements import Elements
from .quads import QUAD_SIDES
from .validity import SIDES


@dataclass(frozen=True, eq=False)
class Middles:
    """The mid-side nodes of the edges of a mesh.

    edges   (E, 2) int64 rows of points, the lower one first, in ascending order
    nodes   (E,) int64 the row of the node of each edge
    curved  (T,) bool: the triangle has mid-side nodes; others are linear
    quads   (Q,) bool: the quad has mid-side nodes
    centres (Q,) int64 the row of the node in the middle of each quad, -1 where there is none
    """

    edges: np.ndarray
    nodes: np.ndarray
    curved: np.ndarray
    quads: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))
    centres: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))

    @classmethod
    def of(
        cls, triangles: np.ndarray, middles: np.ndarray, quads: np.ndarray | None = None,
        of_quads: np.ndarray | None = None,
    ) -> "Middles":  # fmt: skip
        """From triangles (T, 3) and the nodes (T, 3) of their sides, -1 for a triangle without.

        quads, of_quads  (Q, 4), and the nodes (Q, 5) of their sides and middles, likewise

        Raises InvalidMeshError for an edge with two nodes, a node of two edges, and a node that is a corner.
        """
        curved = np.asarray((middles >= 0).all(1))
        quads = np.zeros((0, 4), np.int64) if quads is None else quads
        of_quads = np.full((len(quads), 5), -1) if of_quads is None else of_quads
        second = np.asarray((of_quads[:, :4] >= 0).all(1))
        sides = np.sort(np.concatenate([_sides(triangles[curved]), _quad_sides(quads[second])]), 1)
        own = np.concatenate([middles[curved].reshape(-1), of_quads[second, :4].reshape(-1)])
        edges, first, edge = np.unique(sides, axis=0, return_index=True, return_inverse=True)
        nodes = own[first]
        differ = own != nodes[edge.reshape(-1)]
        if differ.any():
            k = int(differ.argmax())
            raise InvalidMeshError(
                f"the edge {sides[k].tolist()} has two mid-side nodes, {nodes[edge.reshape(-1)[k]]} and {own[k]}: "
                "elements that share an edge must share its node"
            )
        centres = of_quads[:, 4]
        every = np.concatenate([nodes, centres[centres >= 0]])
        values, counts = np.unique(every, return_counts=True)
        if (counts > 1).any():
            node = values[counts > 1][0]
            where = "edges" if not (centres == node).any() else "edges and quads"
            raise InvalidMeshError(
                f"node {node} is the mid-side node of {counts.max()} {where}, and must be that of one"
            )
        corners = np.isin(every, triangles) | np.isin(every, quads)
        if corners.any():
            raise InvalidMeshError(
                f"node {every[corners][0]} is a mid-side node of one element and a corner of another"
            )
        return cls(edges, nodes, curved, second, centres)

    def at(self, edges: np.ndarray) -> np.ndarray:
        """(N,) the row of each of the edges (N, 2), in either direction, among `edges`; -1 where there is none."""
        return rows_of_edges(self.edges, edges)

    def of_sides(self, faces: np.ndarray) -> np.ndarray:
        """(N, 3) the nodes of the sides of the curved triangles (N, 3).  Raises InvalidMeshError for a side without."""
        at = self.at(_sides(faces))
        if (at < 0).any():
            raise InvalidMeshError(f"the edge {_sides(faces)[at < 0][0].tolist()} has no mid-side node")
        return self.nodes[at].reshape(-1, 3)

    def six(self, triangles: np.ndarray) -> np.ndarray:
        """(N, 6) the nodes of those of the triangles (T, 3) that are curved, wound and begun as these are."""
        faces = triangles[self.curved]
        return np.concatenate([faces, self.of_sides(faces)], 1)

    def nine(self, quads: np.ndarray) -> np.ndarray:
        """(N, 9) the nodes of those of the quads (Q, 4) that are curved; -1 for a middle without a node."""
        if not self.quads.any():
            return np.zeros((0, 9), np.int64)
        own = quads[self.quads]
        at = self.at(_quad_sides(own))
        return np.concatenate([own, self.nodes[at].reshape(-1, 4), self.centres[self.quads, None]], 1)

    def elements(self, triangles: np.ndarray, quads: np.ndarray) -> Elements:
        """The curved ones of the triangles (T, 3) and quads (Q, 4)."""
        nine = self.nine(quads)
        return Elements(self.six(triangles), nine, np.full((len(nine), 9, 2), np.nan))


@dataclass(frozen=True, eq=False)
class Followed:
    """The mid-side nodes after a change of the triangles, and where each comes from.

    middles  those of the triangles after; nodes that were made get rows from the number of points on
    origin   (E,) the edge before, for edges that stayed; -1 for others
    spare    rows of nodes that no edge needs any more
    """

    middles: Middles
    origin: np.ndarray
    spare: np.ndarray


def follow(
    before: Middles,
    faces: np.ndarray,
    points: np.ndarray,
    triangles: np.ndarray,
    curved: np.ndarray,
    new_vertex: np.ndarray,
    quads: np.ndarray | None = None,
) -> Followed:
    """The mid-side nodes `before` of triangles `faces` (T, 3), for the `triangles` (T', 3) that take their place.

    points      (V', 2) after; only nearness is told by them
    curved      (T',) bool: which triangles have mid-side nodes
    new_vertex  (V,) the row of each vertex and node after, -1 if it is gone
    quads       (Q, 4) after; they are those of before, row by row.  None: there are none
    """
    quads = np.zeros((0, 4), np.int64) if quads is None else quads
    sides = np.concatenate([_sides(triangles[curved]), _quad_sides(quads[before.quads])])
    edges = np.unique(np.sort(sides, 1), axis=0)
    ends, node = new_vertex[before.edges], new_vertex[before.nodes]
    alive = (ends >= 0).all(1) & (node >= 0)
    at = np.full(len(before.edges), -1)
    at[alive] = rows_of_edges(edges, ends[alive])
    origin = np.full(len(edges), -1)
    origin[at[at >= 0]] = np.flatnonzero(at >= 0)
    nodes = np.where(origin >= 0, node[origin], -1)
    free = np.flatnonzero((at < 0) & (node >= 0))
    fresh = np.flatnonzero(origin < 0)
    free, fresh = _across(before, faces, new_vertex, edges, nodes, node, free, fresh)
    middle = points[edges[fresh]].mean(1) if len(fresh) else np.zeros((0, 2))
    # An edge with an end that is gone is looked for at the other end.
    some = np.where(ends[free] >= 0, ends[free], ends[free][:, ::-1])
    was = points[np.maximum(some, 0)].mean(1) if len(free) else np.zeros((0, 2))
    for k, j in _nearest_pairs(was, middle):
        nodes[fresh[j]] = node[free[k]]
        free[k] = -1
    made = np.flatnonzero(nodes < 0)
    nodes[made] = len(points) + np.arange(len(made))
    centres = np.where(before.centres >= 0, new_vertex[before.centres], -1)
    return Followed(Middles(edges, nodes, curved, before.quads, centres), origin, node[free[free >= 0]])


def _across(
    before: Middles, faces: np.ndarray, new_vertex: np.ndarray, edges: np.ndarray, nodes: np.ndarray,
    node: np.ndarray, free: np.ndarray, fresh: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Gives the nodes of flipped edges to the edges between the opposite corners; what is left of free and fresh."""
    if not len(free) or not len(fresh):
        return free, fresh
    opposite = np.full((len(before.edges), 2), -1)
    sides = _sides(faces[before.curved])
    apex = np.roll(faces[before.curved], 1, 1).reshape(-1)
    edge = before.at(sides)
    order = edge.argsort(kind="stable")
    first = np.concatenate([[True], edge[order][1:] != edge[order][:-1]])
    opposite[edge[order][first], 0] = apex[order][first]
    opposite[edge[order][~first], 1] = apex[order][~first]
    pair = opposite[free]
    whole = (pair >= 0).all(1)
    there = np.full(len(free), -1)
    there[whole] = rows_of_edges(edges[fresh], new_vertex[pair[whole]])
    # Of several edges that would go to the same one, the first does.
    _, one = np.unique(there, return_index=True)
    one = one[there[one] >= 0]
    nodes[fresh[there[one]]] = node[free[one]]
    return np.delete(free, one), np.delete(fresh, there[one])


def _nearest_pairs(one: np.ndarray, other: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of rows of two sets of points, as many as the smaller set has, nearest pairs first among neighbours."""
    if not len(one) or not len(other):
        return []
    from scipy.spatial import cKDTree

    pairs: list[tuple[int, int]] = []
    left, right = np.arange(len(one)), np.arange(len(other))
    while len(left) and len(right):
        away, near = (np.asarray(found) for found in cKDTree(other[right]).query(one[left]))
        order = np.lexsort((left, away))
        _, first = np.unique(near[order], return_index=True)
        chosen = order[np.sort(first)]
        pairs += list(zip(left[chosen].tolist(), right[near[chosen]].tolist(), strict=True))
        right = np.delete(right, near[chosen])
        left = np.delete(left, chosen)
    return pairs


def rows_of_edges(edges: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(N,) the row of each of the edges `wanted` (N, 2), in either direction, among ascending `edges` (E, 2); or -1."""
    if not len(edges) or not len(wanted):
        return np.full(len(wanted), -1)
    count = int(max(edges.max(), wanted.max())) + 1
    keys = edges[:, 0] * count + edges[:, 1]
    found = wanted.min(1) * count + wanted.max(1)
    at = keys.searchsorted(found).clip(max=len(keys) - 1)
    return np.where(keys[at] == found, at, -1)


def _sides(faces: np.ndarray) -> np.ndarray:
    """(3N, 2) the sides of the triangles (N, 3), in the order of their nodes."""
    return faces[:, SIDES].reshape(-1, 2)


def _quad_sides(quads: np.ndarray) -> np.ndarray:
    """(4N, 2) the sides of the quads (N, 4), in the order of their nodes."""
    return quads[:, QUAD_SIDES].reshape(-1, 2)
