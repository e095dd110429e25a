r"""The triangles of one mesh as a net whose edges are flipped one by one, whatever its vertices' positions are.

  c              c         An edge can be flipped if two triangles share it, if it is not constrained, and if the
 / \            /|\        other diagonal is no edge yet.  Rows stay: the triangles a, b, c and b, a, d become
a---b    -->   a | b       a, d, c and d, b, c.
 \ /            \|/
  d              d
"""

import math

import numpy as np
import torch
from torch import Tensor

from ..mesh.batch import MeshBatch

Edge = tuple[int, int]

# Twice the area of an equilateral triangle, in squares of its edge.
_EQUILATERAL = 0.75**0.5


class Wiring:
    """The triangles of one mesh, flipped edge by edge; rows stay.

    faces  the corners of each triangle
    row    the triangle on the left of each half-edge
    stay   the edges that must not be flipped
    """

    def __init__(self, mesh: MeshBatch) -> None:
        self.faces = mesh.triangles.tolist()
        self.row = {edge: row for row, face in enumerate(self.faces) for edge in edges_of(face)}
        self.stay = {frozenset(edge) for edge in mesh.constrained_edges.tolist()}

    def copy(self) -> "Wiring":
        other: Wiring = object.__new__(Wiring)
        other.faces, other.row, other.stay = self.faces.copy(), self.row.copy(), self.stay
        return other

    def across(self, a: int, b: int) -> Edge | None:
        """The corners left and right of the edge from a to b, if it can be flipped."""
        one, other = self.row.get((a, b)), self.row.get((b, a))
        if one is None or other is None or (self.stay and {a, b} in self.stay):
            return None
        c, d = sum(self.faces[one]) - a - b, sum(self.faces[other]) - a - b
        return None if c == d or (c, d) in self.row or (d, c) in self.row else (c, d)

    def flip(self, a: int, b: int) -> bool:
        """Flip the edge, if that can be."""
        ends = self.across(a, b)
        if ends is None:
            return False
        c, d = ends
        one, other = self.row.pop((a, b)), self.row.pop((b, a))
        self.faces[one], self.faces[other] = [a, d, c], [d, b, c]
        rows = self.row
        rows[a, d] = rows[d, c] = rows[c, a] = one
        rows[d, b] = rows[b, c] = rows[c, d] = other
        return True

    def triangles(self) -> Tensor:
        return torch.tensor(self.faces, dtype=torch.int64)

    def edges(self) -> set[frozenset[int]]:
        return {frozenset(edge) for edge in self.row}


def edges_of(face: list[int]) -> tuple[Edge, Edge, Edge]:
    a, b, c = face
    return (a, b), (b, c), (c, a)


def offers(wiring: Wiring, points: np.ndarray, size: np.ndarray, least: float, every: bool) -> list[tuple[float, Edge]]:
    """Edges that can be flipped, each after its cost; those of the lowest cost first.

    The cost of a flip is what it adds to a sum over all triangles: a triangle whose area is less than a bound counts
    with the square of the difference, and any other with 0.  A flip of negative cost makes the mesh less tangled.

    points  (V, 2) float64
    size    (V,) the usual length of an edge around each vertex
    least   the bound; areas are measured in units of that of an equilateral triangle whose edges have the usual length
    every   the edges of all triangles below the bound are looked at; otherwise those of inverted triangles alone
    """
    faces = np.array(wiring.faces)
    rows = np.flatnonzero(_det(points, size, faces) <= (least if every else 0.0)).tolist()
    edges = sorted({(min(edge), max(edge)) for row in rows for edge in edges_of(wiring.faces[row])})
    added = costs(wiring, edges, points, size, least)
    return sorted((cost, edge) for cost, edge in zip(added, edges, strict=True) if cost < math.inf)


def costs(wiring: Wiring, edges: list[Edge], points: np.ndarray, size: np.ndarray, least: float) -> list[float]:
    """What flipping each of the edges costs, as `offers` says; infinite if it cannot be flipped."""
    corners = [(*edge, *(wiring.across(*edge) or (-1, -1))) for edge in edges]
    a, b, c, d = np.array(corners, np.int64).reshape(-1, 4).T
    around = np.stack([a, b, c, b, a, d, a, d, c, d, b, c], 1).reshape(-1, 4, 3)
    lack = np.minimum(_det(points, size, around) - least, 0.0) ** 2
    added: list[float] = np.where(c < 0, np.inf, lack[:, 2:].sum(1) - lack[:, :2].sum(1)).tolist()
    return added


def flip_apart(wiring: Wiring, edges: list[Edge], most: int) -> list[Edge]:
    """Flip at most so many of the edges, in their order, of which no two share a triangle; those flipped."""
    taken: set[int] = set()
    made: list[Edge] = []
    for a, b in edges:
        rows = {wiring.row.get((a, b), -1), wiring.row.get((b, a), -1)}
        if len(made) < most and -1 not in rows and not rows & taken and wiring.flip(a, b):
            made.append((a, b))
            taken |= rows
    return made


def _det(points: np.ndarray, size: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(...) the areas of triangles (..., 3) in units of an equilateral one of the usual size."""
    a, b, c = (points[faces[..., k]] for k in range(3))
    double = (b - a)[..., 0] * (c - a)[..., 1] - (b - a)[..., 1] * (c - a)[..., 0]
    det: np.ndarray = double / (size[faces].mean(-1) ** 2 * _EQUILATERAL)
    return det


def backwards(start: Wiring, flips: list[Edge] | None) -> list[Edge] | None:
    """The flips that undo those, which begin at `start`; None for None."""
    wiring, undone = start.copy(), list[Edge]()
    for edge in flips or ():
        ends = wiring.across(*edge)
        if ends is not None and wiring.flip(*edge):
            undone.append(ends)
    return None if flips is None else undone[::-1]


def way_between(start: Wiring, end: Wiring, longest: int = 4, round_about: int = 40) -> list[Edge] | None:
    """Flips that lead from the triangles of one net to those of another; None where none were found.

    Edges of `end` are put in one by one, first those that one flip puts in, then those that two do, and so on: along a
    strip of triangles that leads from one end of the edge to the other, all edges that it crosses are flipped so that
    they begin at the one.  Such strips do not cross edges of `end` that are there already, so that each time fewer are
    left to be put in.  Where no edge can be put in so, one is put in along a strip that may cross them, too.

    longest      strips cross so many edges at most
    round_about  how often, at most, an edge is put in along a strip that may cross edges of `end`
    """
    wiring, goal = start.copy(), end.edges()
    rows = dict[int, set[int]]()
    for row, face in enumerate(wiring.faces):
        for v in face:
            rows.setdefault(v, set()).add(row)
    made = _put_in_all(wiring, rows, goal, longest)
    for _ in range(round_about):
        if goal <= wiring.edges():
            break
        flips = _put_in_one(wiring, rows, goal, longest)
        if flips is None:
            return None
        made += flips + _put_in_all(wiring, rows, goal, longest)
    return made if goal <= wiring.edges() else None


def _put_in_all(wiring: Wiring, rows: dict[int, set[int]], goal: set[frozenset[int]], longest: int) -> list[Edge]:
    """Put in edges of the goal along strips that cross none of them, as long as there are such strips; the flips."""
    made = list[Edge]()
    crossings = 1
    while crossings <= longest:
        flips = list[Edge]()
        for edge in _missing(wiring, goal):
            flips += _put_in(wiring, rows, edge, goal, crossings) or ()
        made += flips
        # An edge that is put in may make room for others, by fewer flips.
        crossings = 1 if flips else crossings + 1
    return made


def _put_in_one(
    wiring: Wiring, rows: dict[int, set[int]], goal: set[frozenset[int]], longest: int
) -> list[Edge] | None:
    """Put in one edge of the goal along a strip that may cross others of them; the flips, None if there are none."""
    for crossings in range(2, longest + 1):
        for edge in _missing(wiring, goal):
            flips = _put_in(wiring, rows, edge, set(), crossings)
            if flips is not None:
                return flips
    return None


def _missing(wiring: Wiring, goal: set[frozenset[int]]) -> list[frozenset[int]]:
    """The edges of the goal that are not there, in the order of their vertices."""
    return sorted(goal - wiring.edges(), key=sorted)


def _put_in(
    wiring: Wiring, rows: dict[int, set[int]], edge: frozenset[int], stay: set[frozenset[int]], crossings: int
) -> list[Edge] | None:
    """Put in an edge along a strip that crosses so many edges at most, and none of `stay`; the flips."""
    one, other = sorted(edge)
    for a, b in ((one, other), (other, one)):
        strip = _strip(wiring, rows, a, b, stay, crossings)
        flips = None if strip is None else _fanned(wiring, rows, a, strip)
        if flips is not None:
            return flips
    return None


def _strip(
    wiring: Wiring, rows: dict[int, set[int]], a: int, b: int, stay: set[frozenset[int]], longest: int
) -> list[Edge] | None:
    """The fewest edges that a strip of triangles from the vertex a to b crosses, none of which stays."""
    seen = set(rows[a])
    reached: list[tuple[int, tuple[Edge, ...]]] = [(row, ()) for row in sorted(seen)]
    for _ in range(longest):
        last, reached = reached, []
        for row, crossed in last:
            for u, w in edges_of(wiring.faces[row]):
                other = wiring.row.get((w, u))
                if other is None or other in seen or {u, w} in wiring.stay or frozenset((u, w)) in stay:
                    continue
                if b in wiring.faces[other]:
                    return [*crossed, (u, w)]
                seen.add(other)
                reached.append((other, (*crossed, (u, w))))
    return None


def _fanned(wiring: Wiring, rows: dict[int, set[int]], a: int, strip: list[Edge]) -> list[Edge] | None:
    """Flip the edges of a strip so that all begin at a; None, and nothing changed, where one cannot be flipped."""
    tried = wiring.copy()
    if not all(tried.flip(*edge) for edge in strip):
        return None
    for u, w in strip:
        c, d = wiring.across(u, w) or (a, a)
        one, other = wiring.row[u, w], wiring.row[w, u]
        wiring.flip(u, w)
        # The edge from u to w had c on its left: what is one now has u, what is other w.
        rows[w].discard(one)
        rows[u].discard(other)
        rows[c].add(other)
        rows[d].add(one)
    return strip
