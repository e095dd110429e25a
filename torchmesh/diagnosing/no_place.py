r"""Free vertices without a place: a proof that no positions make the triangles valid, by going from edge to edge.

         d1    d2
     +---/-----\---+      Inside one boundary that does not cross itself a valid mesh covers the polygon once, so that
     |  / t     \  |      all of its edges lie in it.  The polygon is cut into triangles, the cells.  An edge from cell
     +-/---+-----\-+      t to cell t' crosses all chords d between them, and can do so only if a straight line has
           |      \|      their left ends on one side and their right ends on the other.  A vertex loses a cell
           |    d3 +
           | t'    |        - that no straight line joins to a fixed neighbour, or to any cell that a free neighbour has
           +-------+          still; or that lies beyond a fixed edge of which the vertex has to be on the left.

A vertex that has lost all cells has no place.  That chords have no straight line in common is shown by two segments
between ends of one side each that cross properly, or by an end of one side inside a triangle of ends of the other
(Kirchberger's theorem): exact signs.  Taking values away by pairs of neighbours until nothing changes is arc
consistency (Mackworth, Consistency in networks of relations, Artificial Intelligence 8, 1977).
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import torch

from ..mesh.batch import MeshBatch
from ..mesh.connectivity import boundary_edges, triangle_components, twins
from ..triangulating.arrays import Obstacle, signs
from ..triangulating.polygon import loops_of
from ..triangulating.polygon_triangulation import triangulate_polygon

# Boundaries of more vertices are left alone: the pairs of cells are too many.
_MOST = 250

# In these directions the ends of many chords are looked at.
_DIRECTIONS = np.stack([np.cos(np.arange(16) * np.pi / 8), np.sin(np.arange(16) * np.pi / 8)], 1)

Chord = tuple[int, int]


@dataclass(frozen=True)
class Step:
    """A vertex loses a cell.

    vertex, cell  which
    fixed         (a,) a fixed neighbour to which no straight line leads; (a, b) a fixed edge whose right side the cell
                  is on, where the mesh has the triangle (a, b, vertex); () for a free neighbour
    neighbour     the free neighbour of which no cell that is left can be reached; -1 if there is none
    """

    vertex: int
    cell: int
    fixed: tuple[int, ...] = ()
    neighbour: int = -1


@dataclass(frozen=True)
class NoPlace:
    """The proof that a free vertex has no place.

    vertex  which
    cells   (C, 3) the corners of the cells
    steps   in order; a step holds because of those before it
    """

    vertex: int
    cells: np.ndarray
    steps: tuple[Step, ...]


def vertex_without_place(mesh: MeshBatch) -> NoPlace | None:
    """A proof that a free vertex of one mesh has no place, in the first piece that has one."""
    points = mesh.points.detach().to("cpu", torch.float64).numpy()
    triangles, fixed = mesh.triangles.cpu(), mesh.fixed.cpu().numpy()
    label = triangle_components(triangles, mesh.twin.cpu())
    for piece in range(int(label.max()) + 1 if len(label) else 0):
        faces = triangles[label == piece]
        found = no_place(points, faces.numpy(), fixed, boundary_edges(faces, twins(faces)).numpy())
        if found is not None:
            return found
    return None


def no_place(points: np.ndarray, triangles: np.ndarray, fixed: np.ndarray, boundary: np.ndarray) -> NoPlace | None:
    """A proof that some vertex of a piece has no place; None where none is found, which proves nothing.

    points     (V, 2) float64
    triangles  (T, 3) the piece; fixed (V,) bool
    boundary   (E, 2) its directed boundary edges, which are one loop that does not cross itself
    """
    loops = loops_of(boundary)
    if len(loops) != 1 or len(loops[0]) > _MOST or len(np.unique(loops[0])) < len(loops[0]):
        return None
    work = triangulate_polygon(points.copy(), loops, np.ones(len(points)))
    if isinstance(work, Obstacle):
        return None
    return _Search(points, triangles, fixed, work.corners).run()


class _Search:
    """The cells that each free vertex has still, and why it has lost the others."""

    def __init__(self, points: np.ndarray, triangles: np.ndarray, fixed: np.ndarray, cells: np.ndarray) -> None:
        self.points, self.triangles, self.fixed, self.cells = points, triangles, fixed, cells
        self.left = _left_of(cells)
        self.joined = np.eye(len(cells), dtype=bool)
        for cell in range(len(cells)):
            self.joined[cell, self.reached(_sides(cells[cell]))] = True
        self.joined &= self.joined.T
        self.has = {int(v): np.ones(len(cells), bool) for v in np.unique(triangles[~fixed[triangles]])}
        self.steps: list[Step] = []

    def reached(self, sides: list[Chord]) -> list[int]:
        """The cells that a straight line reaches across these chords (left end, right end)."""
        found: list[int] = []
        stack: list[tuple[Chord, tuple[Chord, ...]]] = [(chord, ()) for chord in sides]
        while stack:
            chord, run = stack.pop()
            cell = self.left.get(chord)
            if cell is None or _inseparable(self.points, run := (*run, chord)):
                continue
            found.append(cell)
            stack += [(onward, run) for onward in _onward(self.cells[cell], chord)]
        return found

    def run(self) -> NoPlace | None:
        """Take cells away until a vertex has none, or nothing changes."""
        if not self.has:
            return None
        edges = np.unique(np.sort(np.concatenate([self.triangles[:, [k, (k + 1) % 3]] for k in range(3)]), 1), axis=0)
        mixed = edges[self.fixed[edges].sum(1) == 1]
        seen: dict[int, np.ndarray] = {}
        for one, other in mixed.tolist():
            a, v = (one, other) if self.fixed[one] else (other, one)
            around = np.flatnonzero((self.cells == a).any(1))
            if not len(around):
                continue  # a fixed vertex inside is no corner of a cell
            if a not in seen:
                seen[a] = np.ones(len(self.cells), bool)
                far = [_opposite(self.cells[cell], a) for cell in around.tolist()]
                seen[a][np.append(around, np.array(self.reached(far), dtype=np.int64))] = False
            self.lose(v, seen[a], fixed=(a,))
        for k in range(3):
            v, a, b = self.triangles[:, k], self.triangles[:, (k + 1) % 3], self.triangles[:, (k + 2) % 3]
            for row in np.flatnonzero(~self.fixed[v] & self.fixed[a] & self.fixed[b]).tolist():
                ends = int(a[row]), int(b[row])
                one, other = (np.full(self.cells.size, end) for end in ends)
                beyond = (signs(self.points, one, other, self.cells.ravel()).reshape(-1, 3) <= 0).all(1)
                self.lose(int(v[row]), beyond, fixed=ends)
        near: dict[int, list[int]] = {v: [] for v in self.has}
        for one, other in edges[~self.fixed[edges].any(1)].tolist():
            near[one].append(other)
            near[other].append(one)
        waiting = dict.fromkeys(self.has)
        while waiting:
            u = next(iter(waiting))
            del waiting[u]
            if not self.has[u].any():
                return self.told(u)
            reach = self.joined[self.has[u]].any(0)
            for v in near[u]:
                if self.lose(v, ~reach, neighbour=u):
                    waiting[v] = None
        return None

    def lose(self, v: int, cells: Any, fixed: tuple[int, ...] = (), neighbour: int = -1) -> bool:
        """The vertex loses these cells (C,) bool, if it has them still; does it lose any?"""
        lost = np.flatnonzero(self.has[v] & cells)
        self.steps += [Step(v, cell, fixed, neighbour) for cell in lost.tolist()]
        self.has[v][lost] = False
        return len(lost) > 0

    def told(self, vertex: int) -> NoPlace:
        """The proof, with those steps only that it takes."""
        needed = {(vertex, cell) for cell in range(len(self.cells))}
        kept = []
        for step in reversed(self.steps):
            if (step.vertex, step.cell) in needed:
                kept.append(step)
                if step.neighbour >= 0:
                    reach = np.flatnonzero(self.joined[step.cell]).tolist()
                    needed |= {(step.neighbour, cell) for cell in reach}
        return NoPlace(vertex, self.cells, tuple(kept[::-1]))


def _left_of(cells: np.ndarray) -> dict[Chord, int]:
    """Of each directed side of the cells, the cell on its left."""
    return {side: row for row, cell in enumerate(cells) for side in _directed(cell)}


def _directed(cell: np.ndarray) -> Iterator[Chord]:
    a, b, c = cell.tolist()
    yield from ((a, b), (b, c), (c, a))


def _sides(cell: np.ndarray) -> list[Chord]:
    """The sides as chords (left end, right end), as they are seen from the inside."""
    return [(b, a) for a, b in _directed(cell)]


def _opposite(cell: np.ndarray, corner: int) -> Chord:
    return next(side for side in _sides(cell) if corner not in side)


def _onward(cell: np.ndarray, chord: Chord) -> list[Chord]:
    """The two other sides of a cell that is entered across a chord (left end, right end)."""
    return [side for side in _sides(cell) if set(side) != set(chord)]


def _inseparable(points: np.ndarray, run: tuple[Chord, ...]) -> bool:
    """Is it sure that no straight line crosses all chords (left end, right end) of the run?"""
    lefts, rights = (tuple(dict.fromkeys(chord[i] for chord in run)) for i in (0, 1))
    if len(lefts) + len(rights) < 4 or _parted(points[list(lefts)], points[list(rights)]):
        return False
    lefts, rights = _outermost(points, lefts), _outermost(points, rights)
    # Floating point proposes what crosses most clearly, and exact signs decide.
    pairs = (np.array(list(itertools.combinations(ends, 2)), dtype=np.int64).reshape(-1, 2) for ends in (lefts, rights))
    one, other = (pair[:, None, :] if first else pair[None] for first, pair in zip((True, False), pairs, strict=True))
    a, b, c, d = points[one[..., 0]], points[one[..., 1]], points[other[..., 0]], points[other[..., 1]]
    clear = np.minimum(-_area(a, b, c) * _area(a, b, d), -_area(c, d, a) * _area(c, d, b))
    if clear.size and clear.max() > 0:
        row, column = np.unravel_index(int(clear.argmax()), clear.shape)
        if _cross(points, *one[row, 0].tolist(), *other[0, column].tolist()):
            return True
    for inner, outer in ((lefts, rights), (rights, lefts)):
        three = np.array(list(itertools.combinations(outer, 3)), dtype=np.int64).reshape(-1, 3)
        p, (a, b, c) = points[list(inner)][:, None], points[three].transpose(1, 0, 2)
        areas = np.stack([_area(p, a, b), _area(p, b, c), _area(p, c, a)])
        clear = np.maximum(areas.min(0), -areas.max(0))
        if clear.size and clear.max() > 0:
            row, column = np.unravel_index(int(clear.argmax()), clear.shape)
            if _inside(points, inner[row], *three[column].tolist()):
                return True
    return False


def _outermost(points: np.ndarray, ends: tuple[int, ...]) -> tuple[int, ...]:
    """Of many ends those that are farthest in one of some directions: fewer ends prove less, and nothing wrong."""
    if len(ends) <= len(_DIRECTIONS):
        return ends
    return tuple(ends[i] for i in np.unique((points[list(ends)] @ _DIRECTIONS.T).argmax(0)).tolist())


def _area(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Twice the signed areas of the triangles abc, rounded."""
    area: np.ndarray = (b - a)[..., 0] * (c - a)[..., 1] - (b - a)[..., 1] * (c - a)[..., 0]
    return area


def _parted(one: np.ndarray, other: np.ndarray) -> bool:
    """Is there a line between the points (N, 2) and (M, 2), as far as floating point tells?

    This is asked first since it is so most often; what it says "yes" to proves nothing, and is no step of a proof.
    """
    # Where there is a line, one along a pair of points, one of each set, leans on both.
    direction = (other[None] - one[:, None]).reshape(-1, 2)
    normal = np.stack([-direction[:, 1], direction[:, 0]], 1)
    a, b = normal @ one.T, normal @ other.T
    slack = 1e-12 * np.maximum(np.abs(a).max(1), np.abs(b).max(1))
    return bool(((a.min(1) >= b.max(1) - slack) | (b.min(1) >= a.max(1) - slack)).any())


def _sign(points: np.ndarray, a: int, b: int, c: int) -> int:
    """The exact sign of the area of the triangle abc."""
    (ax, ay), (bx, by), (cx, cy) = (tuple(map(Fraction, points[v].tolist())) for v in (a, b, c))
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    return (area > 0) - (area < 0)


def _cross(points: np.ndarray, a: int, b: int, c: int, d: int) -> bool:
    """Do the segments ab and cd cross in a point inside both?"""
    if _sign(points, a, b, c) * _sign(points, a, b, d) >= 0:
        return False
    return _sign(points, c, d, a) * _sign(points, c, d, b) < 0


def _inside(points: np.ndarray, p: int, a: int, b: int, c: int) -> bool:
    """Is p inside the triangle abc, of either orientation, and on none of its sides?"""
    return abs(_sign(points, p, a, b) + _sign(points, p, b, c) + _sign(points, p, c, a)) == 3


def check_no_place(points: np.ndarray, triangles: np.ndarray, fixed: np.ndarray, proof: NoPlace) -> list[str]:
    """What is wrong with a proof, step by step and by exact signs alone; an empty list: it proves its claim.

    The boundary must be one loop of fixed vertices that does not cross itself.  Arguments as in `no_place`.
    """
    wrong = []
    cells, count = proof.cells, len(proof.cells)
    left = _left_of(cells)
    faces = {tuple(turned) for t in triangles.tolist() for turned in (t, t[1:] + t[:1], t[2:] + t[:2])}
    edges = {(a, b) for a, b, _ in faces} | {(b, a) for a, b, _ in faces}
    rim = {(a, b) for a, b, _ in faces if (b, a) not in {(p, q) for p, q, _ in faces}}
    if any(_sign(points, *cell) <= 0 for cell in cells.tolist()):
        wrong.append("a cell is not counter-clockwise")
    if len(left) != 3 * count or {side for side in left if side[::-1] not in left} != rim or count != len(rim) - 2:
        wrong.append("the cells are no triangulation of the boundary")
    if wrong:
        return wrong
    lost: dict[int, set[int]] = {}
    known: dict[tuple[int, int, tuple[int, ...]], bool] = {}

    def apart(one: int, end: int, corner: tuple[int, ...]) -> bool:
        key = one, end, corner
        if key not in known:
            known[key] = _never_joined(points, cells, left, *key)
        return known[key]

    for step in proof.steps:
        v, cell = step.vertex, step.cell
        if fixed[v]:
            wrong.append(f"vertex {v} is fixed")
        elif len(step.fixed) == 2:
            if (*step.fixed, v) not in faces or not fixed[list(step.fixed)].all():
                wrong.append(f"{step} names no triangle with a fixed edge")
            elif any(_sign(points, *step.fixed, corner) > 0 for corner in cells[cell].tolist()):
                wrong.append(f"{step}: the cell is not beyond the edge")
        else:
            other = step.fixed[0] if step.fixed else step.neighbour
            ends = np.flatnonzero((cells == other).any(1)).tolist() if step.fixed else range(count)
            if (v, other) not in edges or bool(fixed[other]) != bool(step.fixed) or not len(ends):
                wrong.append(f"{step} names no neighbour on the boundary, or none that is free")
            open_ends = set(ends) if step.fixed else set(ends) - lost.get(other, set())
            if not all(apart(cell, end, step.fixed) for end in open_ends):
                wrong.append(f"{step}: a straight line may lead there")
        lost.setdefault(v, set()).add(cell)
    if lost.get(proof.vertex, set()) != set(range(count)):
        wrong.append(f"vertex {proof.vertex} has a cell left")
    return wrong


def _never_joined(
    points: np.ndarray, cells: np.ndarray, left: dict[Chord, int], start: int, end: int, corner: tuple[int, ...]
) -> bool:
    """Is it sure that no straight line leads from a cell to another, or to that corner of it?"""
    stack: list[tuple[Chord, tuple[Chord, ...]]] = [(side, ()) for side in _sides(cells[start])]
    while stack:
        chord, run = stack.pop()
        cell = left.get(chord)
        if cell is None:
            continue
        run = (*run, chord)
        if cell == end:
            # Chords that end in the corner need not be crossed to get there.
            return _inseparable(points, tuple(c for c in run if not set(corner) & set(c)))
        stack += [(onward, run) for onward in _onward(cells[cell], chord)]
    return False
