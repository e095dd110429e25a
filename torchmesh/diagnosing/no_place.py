r"""Free vertices without a place: a proof that no positions make the triangles valid, by going from edge to edge.

     +-------------+      Inside a boundary that does not cross itself a valid mesh covers the domain once, so that
     |      /\     |      all of its edges lie in it.  The domain is cut into triangles, the cells.  A vertex loses a
     |    a/  \    |      cell if for one of its neighbours, wherever that still may be,
     +----+    +---+
     |  v    .   u |        - no straight line inside the domain joins the cell to it (`lines_of_sight`), or
     +-------------+        - a triangle of both vertices would be inverted, wherever its third corner still may be.

A vertex that has lost all cells has no place.  Fixed vertices are where they are.  Taking values away by pairs of
neighbours until nothing changes is arc consistency (Mackworth, Consistency in networks of relations, Artificial
Intelligence 8, 1977).  Then cells are cut into four, which shows more, and all starts again with what is left.

The search computes by floating point; a proof is told when `check_no_place` has found it right by exact signs.
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch

from ..mesh.batch import MeshBatch
from ..mesh.connectivity import boundary_edges, triangle_components, twins
from ..triangulating.arrays import Obstacle
from ..triangulating.polygon import loops_of
from ..triangulating.polygon_triangulation import triangulate_polygon
from .lines_of_sight import Cells, Run, TooMany, beside, cut_in_four, unblocked
from .no_place_check import check_no_place
from .no_place_steps import Level, NoPlace, Place, Step, needed

# What a call costs whatever it is asked, in determinants.
_CALL = 5_000


@dataclass(frozen=True)
class PlaceOptions:
    """How long `vertex_without_place` looks.

    cuts        how often cells are cut into four
    most_lines  runs of chords that are followed at most; domains with more are left alone
    most_parts  parts of cells at most; a cut that leads to more is left out
    most_work   determinants of three points, and pairs of parts, that are looked at at most.  Of the hard cases of
                experiments/robustness/kept_triangles.py with 120 to 500 triangles none that was proved impossible took
                more than half of this, and the others take a second of a processor
    each        of `most_lines`, `most_parts` and `most_work` meshes of more than 500 triangles have so much more for
                each of them: what else is tried takes longer there, too
    vague       a third corner that has more than this part of all parts of cells tells nothing about a triangle
    tries       neighbours' parts that are tried singly before all are
    """

    cuts: int = 1
    most_lines: int = 25_000
    most_parts: int = 450
    most_work: int = 20_000_000
    each: tuple[int, float, int] = (40, 0.5, 20_000)
    vague: float = 0.3
    tries: int = 3


def vertex_without_place(mesh: MeshBatch, options: PlaceOptions | None = None) -> NoPlace | None:
    """A proof that a free vertex of one mesh has no place, in the first piece that has one."""
    points = mesh.points.detach().to("cpu", torch.float64).numpy()
    triangles, fixed = mesh.triangles.cpu(), mesh.fixed.cpu().numpy()
    label = triangle_components(triangles, mesh.twin.cpu())
    for piece in range(int(label.max()) + 1 if len(label) else 0):
        faces = triangles[label == piece]
        found = no_place(points, faces.numpy(), fixed, boundary_edges(faces, twins(faces)).numpy(), options)
        if found is not None:
            return found
    return None


def no_place(
    points: np.ndarray,
    triangles: np.ndarray,
    fixed: np.ndarray,
    boundary: np.ndarray,
    options: PlaceOptions | None = None,
) -> NoPlace | None:
    """A proof that some vertex of a piece has no place; None where none is found, which proves nothing.

    points     (V, 2) float64
    triangles  (T, 3) the piece; fixed (V,) bool
    boundary   (E, 2) its directed boundary edges
    """
    loops = loops_of(boundary)
    alone = len(boundary) and len(np.unique(boundary[:, 0])) == len(boundary)
    if not alone or not fixed[boundary].all() or fixed[triangles].all():
        return None
    work = triangulate_polygon(points.copy(), loops, np.ones(len(points)))
    if isinstance(work, Obstacle):
        return None
    try:
        search = _Search(points, triangles, fixed, work.corners, options or PlaceOptions())
    except TooMany:
        return None
    for proof in search.proofs():
        if not check_no_place(points, triangles, fixed, proof):
            return proof
    return None


class _Search:
    """The parts of cells that each free vertex has still, and why it has lost the others."""

    def __init__(
        self, points: np.ndarray, triangles: np.ndarray, fixed: np.ndarray, cells: np.ndarray, options: PlaceOptions
    ) -> None:
        more = max(0, len(triangles) - 500)
        lines, parts, work = options.most_lines, options.most_parts, options.most_work
        lines, self.most_parts, self.work = (
            int(most + more * each) for most, each in zip((lines, parts, work), options.each, strict=True)
        )
        self.fixed, self.cells, self.options = fixed, cells, options
        low, high = points[cells].min((0, 1)), points[cells].max((0, 1))
        self.xy = (points - (low + high) / 2) / (high - low).max()
        self.apex = {
            (int(t[k - 2]), int(t[k - 1])): int(t[k]) for t in triangles.tolist() for k in range(3)
        }  # the third corner on the left of an edge
        self.near: dict[int, list[int]] = defaultdict(list)
        for one, other in self.apex:
            self.near[one].append(other)
            if (other, one) not in self.apex:
                self.near[other].append(one)
        self.free = np.unique(triangles[~fixed[triangles]]).tolist()
        self.chords = Cells(self.xy, cells, lines)
        held = {u for v in self.free for u in self.near[v] if fixed[u]} & set(cells.ravel().tolist())
        self.runs_of = {u: self.chords.from_corner(u) for u in sorted(held)}
        # The runs from each cell, once lines from fixed vertices have proved nothing.
        self.runs: list[list[Run]] = []
        self.steps: list[Step] = []
        self.levels: list[Level] = []

    def proofs(self) -> Iterator[NoPlace]:
        """Take places away until a vertex has none, or nothing changes: the proof, short and then with all steps."""
        self.has = {v: np.ones(len(self.cells), bool) for v in self.free}
        for cut in range(self.options.cuts + 1):
            if cut and not self.cut():
                return
            if not cut:
                places: list[Place] = [(cell,) for cell in range(len(self.cells))]
                self.level(places, np.arange(len(self.cells)), self.xy[self.cells])
            vertex = self.emptied()
            if vertex is not None:
                short = needed(vertex, self.steps, self.levels, self.apex, self.fixed)
                yield NoPlace(vertex, self.cells, short)
                yield NoPlace(vertex, self.cells, tuple(self.steps))
                return

    def cut(self) -> bool:
        """Cut into four the parts that some vertex has still; are they few enough?"""
        last = self.levels[-1]
        rows = np.flatnonzero(np.any(list(self.has.values()), 0))
        if 4 * len(rows) > self.most_parts or self.work <= 0:
            return False
        places = [(*last.places[row], part) for row in rows.tolist() for part in range(4)]
        for v, has in self.has.items():
            self.has[v] = np.repeat(has[rows], 4)
        self.level(places, np.repeat(last.home[rows], 4), cut_in_four(last.corners[rows]))
        return True

    def level(self, places: list[Place], home: np.ndarray, corners: np.ndarray) -> None:
        """Go on with these parts."""
        rows = _by_cell(home)
        seen = {
            u: self.reached(runs, self.xy[u][None, None], rows, corners, False)[0] for u, runs in self.runs_of.items()
        }
        self.levels.append(Level(places, home, corners, np.ones((len(home), 0), bool), seen))
        self.hulls: dict[int, np.ndarray] = {}
        self.support: dict[tuple[int, int], np.ndarray] = {}

    def join(self) -> bool:
        """Look which parts straight lines join; False if lines are too many."""
        level = self.levels[-1]
        try:
            self.runs = self.runs or [self.chords.from_cell(cell) for cell in range(len(self.cells))]
        except TooMany:
            return False
        rows, whole = _by_cell(level.home), len(level.places[0]) == 1
        joined = np.zeros((len(level.home), len(level.home)), bool)
        for cell, here in rows.items():
            joined[np.ix_(here, here)] = True
            joined[here] |= self.reached(self.runs[cell], level.corners[here], rows, level.corners, whole)
        level.joined = joined & joined.T
        return True

    def reached(
        self, runs: list[Run], start: np.ndarray, rows: dict[int, np.ndarray], corners: np.ndarray, whole: bool
    ) -> np.ndarray:
        """(S, N) bool: the parts that a line reaches from the parts `start` (S, K, 2) by one of the runs."""
        found = np.zeros((len(start), len(corners)), bool)
        there = [run for run in runs if run.cell in rows]
        for run in there if whole else [run for run in there if not run.lefts]:
            found[:, rows[run.cell]] = True
        if whole:
            return found
        there = [run for run in there if run.lefts]
        # Runs of like length are looked at together.
        there.sort(key=lambda run: len(run.lefts) + len(run.rights))
        for first in range(0, len(there), 16):
            some = there[first : first + 16]
            at = np.concatenate([rows[run.cell] for run in some])
            each = np.repeat(np.arange(len(some)), [len(rows[run.cell]) for run in some])
            lefts, rights = (
                self.xy[_padded(ends)][each] for ends in zip(*((r.lefts, r.rights) for r in some), strict=True)
            )
            open_ = unblocked(start, corners[at], lefts, rights)
            for k in range(len(some)):
                found[:, at[each == k]] |= open_[:, each == k]
        return found

    def emptied(self) -> int | None:
        """Take places away by pairs of neighbours until nothing changes; a vertex that has none left, if one has."""
        for v in self.free:
            for u in self.near[v]:
                if self.fixed[u]:
                    self.revised(v, u)
            if not self.has[v].any():
                return v
        if not self.join():
            return None
        waiting = {v: int(self.has[v].sum()) for v in self.free}
        while waiting and self.work > 0:
            u = min(waiting, key=waiting.__getitem__)
            del waiting[u]
            for v in self.near[u]:
                if self.fixed[v]:
                    continue
                others = {u, *(w for w in (self.apex.get((u, v)), self.apex.get((v, u))) if w is not None)}
                less = [self.revised(v, w) for w in sorted(others)]
                if any(less):
                    waiting[v] = int(self.has[v].sum())
                    if not waiting[v]:
                        return v
        return None

    def revised(self, v: int, u: int) -> bool:
        """Take from the free vertex v what does not go with anything of u; does it lose something?"""
        level, has = self.levels[-1], self.has[v]
        rows = np.flatnonzero(has)
        support = self.support.setdefault((v, u), np.full(len(has), -1))
        if self.fixed[u]:
            columns = np.zeros(1, np.int64)
            joined = level.seen[u][rows][:, None] if u in level.seen else np.ones((len(rows), 1), bool)
        else:
            columns = np.flatnonzero(self.has[u])
            # What went well before comes first.
            known = support[rows]
            good = np.asarray(known >= 0)
            good[good] = self.has[u][known[good]]
            good[good] = self.goes(v, u, rows[good], known[good])
            rows = rows[~good]
            joined = level.joined[np.ix_(rows, columns)]
        self.work -= _CALL + joined.size
        for _ in range(self.options.tries):
            some = joined.any(1)
            if not len(rows) or not some.any():
                break
            first = joined.argmax(1)
            good = np.array(some)
            good[some] = self.goes(v, u, rows[some], columns[first[some]])
            support[rows[good]] = columns[first[good]]
            joined[np.flatnonzero(some), first[some]] = False
            rows, joined = rows[~good], joined[~good]
        at, of = np.nonzero(joined)
        going = self.goes(v, u, rows[at], columns[of])
        support[rows[at[going]]] = columns[of[going]]
        lost = rows[~np.isin(np.arange(len(rows)), at[going])]
        self.steps += [Step(v, level.places[row], u) for row in lost.tolist()]
        has[lost] = False
        if len(lost):
            self.hulls.pop(v, None)
        return len(lost) > 0

    def goes(self, v: int, u: int, here: np.ndarray, there: np.ndarray) -> np.ndarray:
        """(N,) bool: with v in the parts `here` and u in `there` (N,), both triangles at their edge can be upright."""
        good: np.ndarray = np.ones(len(here), bool)
        if not len(here):
            return good
        corners = self.levels[-1].corners
        start = corners[here]
        ends = np.broadcast_to(self.xy[u], (len(here), 1, 2)) if self.fixed[u] else corners[there]
        for third, sign in ((self.apex.get((v, u)), 1.0), (self.apex.get((u, v)), -1.0)):
            if third is None or not (self.fixed[third] or self.has[third].mean() <= self.options.vague):
                continue
            hull = self.hull(third)
            self.work -= len(here) * 3 * ends.shape[1] * len(hull)
            good &= beside(start, ends, hull[None], sign)
        return good

    def hull(self, v: int) -> np.ndarray:
        """(H, 2) points whose hull holds all places of the vertex."""
        if self.fixed[v]:
            return self.xy[v][None]
        if v not in self.hulls:
            points = np.unique(self.levels[-1].corners[self.has[v]].reshape(-1, 2), axis=0)
            self.hulls[v] = points[_on_hull(points)] if len(points) > 6 else points
        return self.hulls[v]


def _by_cell(home: np.ndarray) -> dict[int, np.ndarray]:
    """The parts of each cell."""
    return {int(cell): np.flatnonzero(home == cell) for cell in np.unique(home)}


def _padded(ends: tuple[tuple[int, ...], ...]) -> np.ndarray:
    """(N, M) the vertices of each row, the last one repeated."""
    most = max(map(len, ends))
    return np.array([[*row, *[row[-1]] * (most - len(row))] for row in ends])


def _on_hull(points: np.ndarray) -> list[int]:
    """The rows of the points (N, 2), ascending by x and y, that are on their convex hull."""
    found: list[int] = []
    for rows in (range(len(points)), range(len(points) - 1, -1, -1)):
        chain: list[int] = []
        for row in rows:
            x, y = points[row]
            while len(chain) > 1:
                (ax, ay), (bx, by) = points[chain[-2]], points[chain[-1]]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0:
                    break
                chain.pop()
            chain.append(row)
        found += chain[:-1]
    return found
