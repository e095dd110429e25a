"""One cavity: new triangles inside its boundary, with exactly the vertices that it has.

            +---+                  +---+                  +---+
           / \\ / \\                /     \\                /|\\  |\
          +---x---+     -->      +   x   +     -->      + | x-+-+
           \\ / \\ /                \\     /                \\|/  |/
            +---+                  +---+                  +---+

The boundary is triangulated first.  Vertices inside are then inserted where they are; vertices that lie outside, or on
others, are spread over the triangles where there is room.
"""

from dataclasses import dataclass

import numpy as np

from ..triangulating.arrays import Obstacle, among, distinct
from ..triangulating.crossings import cross_properly, crossing_pairs
from ..triangulating.immersed import triangulate_immersed
from ..triangulating.placing import place_vertices
from ..triangulating.polygon import loops_of, why_not_simple
from ..triangulating.polygon_triangulation import is_triangulation_of, locate, triangulate_polygon, triangulate_with
from ..triangulating.recovery import recover
from ..triangulating.touching import PlaneBoundary, of_own_sides, plane_boundary
from ..triangulating.triangulation import Triangulation

# Free vertices nearer to each other than this part of the cavity's mean spacing are on one spot: only one stays there.
_CLUSTER = 1e-6


@dataclass(frozen=True, eq=False)
class Cavity:
    """A cavity to fill, with vertices numbered in its own way.

    points    (V, 2)
    boundary  (E, 2) its boundary edges, counter-clockwise around it and clockwise around its holes
    dangling  (K, 2) edges inside that must be there
    fixed     (V,) bool, vertices that must stay
    keep      (V,) bool, vertices that stay where possible
    dtype     the precision of the positions to choose
    over_itself  the boundary may lie over itself, where it is one loop
    """

    points: np.ndarray
    boundary: np.ndarray
    dangling: np.ndarray
    fixed: np.ndarray
    keep: np.ndarray
    dtype: np.dtype
    over_itself: bool = False

    def filled(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | Obstacle:
        """The triangles (T, 3), the points, and which of them moved (V,) bool; or what is in the way."""
        obstacle = why_not_simple(self.points, loops_of(self.boundary))
        plane = None if obstacle is None else self._touching(obstacle)
        spacing, on_boundary = self._spacing()
        if obstacle and plane is None and not self.over_itself:
            return obstacle
        anchors, free = np.flatnonzero(self.fixed & ~on_boundary), ~self.fixed & ~on_boundary
        stay = self._apart(np.flatnonzero(free & self.keep))
        if obstacle and plane is None:
            work = self._immersed(obstacle, spacing, anchors, stay)
        elif plane is None:
            work = self._triangulated(loops_of(self.boundary), spacing, anchors, stay, self.dangling)
        else:
            lines, loops = plane.lines, loops_of(plane.open_ends)
            anchors = np.concatenate([anchors, distinct(lines)[~among(distinct(lines), plane.open_ends)]])
            segments = np.concatenate([lines, plane.first[self.dangling]])
            work = self._triangulated(loops, spacing, anchors, stay, segments)
            if not isinstance(work, Obstacle):
                work = of_own_sides(work, plane, self.dangling)
        if isinstance(work, Obstacle):
            return work
        moved = free.copy()
        moved[work.corners] = False
        left = place_vertices(work, np.flatnonzero(moved), self.dtype)
        if len(left):
            return Obstacle(
                f"no room between floating-point numbers for {len(left)} vertices, as {{}}", (int(left[0]),)
            )
        return work.corners, work.points, moved

    def _spacing(self) -> tuple[np.ndarray, np.ndarray]:
        """(V,) the mean length of the boundary edges at each vertex, and (V,) bool: is it on the boundary?"""
        ends, count = self.points[self.boundary], len(self.points)
        length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        degree = np.bincount(self.boundary.ravel(), minlength=count)
        total = np.bincount(self.boundary.ravel(), np.repeat(length, 2), count)
        return total / np.maximum(degree, 1), degree > 0

    def _apart(self, vertices: np.ndarray) -> np.ndarray:
        """`vertices` (N,) without those that are on the spot of another."""
        ends = self.points[self.boundary]
        area = 0.5 * float((ends[:, 0, 0] * ends[:, 1, 1] - ends[:, 0, 1] * ends[:, 1, 0]).sum())
        # The side of the square that each vertex had if they shared the area.
        spacing = np.sqrt(abs(area) / max(len(vertices), 1))
        return vertices[_scattered(self.points[vertices], _CLUSTER * spacing)]

    def _touching(self, obstacle: Obstacle) -> PlaneBoundary | None:
        """The boundary as a plane graph, if it does no more than touch itself, in fixed vertices only; else None.

        obstacle  why it is not simple
        """
        if len(obstacle.vertices) == 4 and cross_properly(self.points, *obstacle.vertices):
            return None
        plane = plane_boundary(self.points, self.boundary)
        if not plane.sound or plane.paired.all() or not self.fixed[plane.touched].all():
            return None
        return None if why_not_simple(self.points, loops_of(plane.open_ends)) else plane

    def _triangulated(
        self,
        loops: list[np.ndarray],
        spacing: np.ndarray,
        anchors: np.ndarray,
        stay: np.ndarray,
        segments: np.ndarray,
    ) -> Triangulation | Obstacle:
        """The domain of the `loops` with all `anchors` (N,) and `segments` (K, 2), and of `stay` those that fit in."""
        inside = np.concatenate([anchors, stay])
        work = triangulate_with(self.points.copy(), loops, spacing, inside, segments)
        if work is not None and among(anchors, work.corners).all():
            return work
        return self._step_by_step(loops, spacing, anchors, stay, segments)

    def _immersed(
        self, obstacle: Obstacle, spacing: np.ndarray, anchors: np.ndarray, stay: np.ndarray
    ) -> Triangulation | Obstacle:
        """The disc that a boundary of one loop bounds although it lies over itself, or the `obstacle`."""
        loops = loops_of(self.boundary)
        if len(loops) != 1 or len(self.dangling) or len(loops[0]) != len(self.boundary):
            return obstacle
        corners = triangulate_immersed(self.points, loops[0])
        if corners is None or not is_triangulation_of(self.points, corners, self.boundary):
            return obstacle
        work = Triangulation(self.points.copy(), corners, spacing)
        work.flip_to_delaunay(np.arange(len(corners)))
        refused = _insert(work, anchors)
        if len(refused):
            return Obstacle("the fixed vertex {} lies outside its region, or on its boundary", (int(refused[0]),))
        _insert(work, stay)
        return work

    def _step_by_step(
        self,
        loops: list[np.ndarray],
        spacing: np.ndarray,
        anchors: np.ndarray,
        stay: np.ndarray,
        segments: np.ndarray,
    ) -> Triangulation | Obstacle:
        """What `triangulate_with` does, with reasons: all `anchors` (N,), and of `stay` (N,) those that fit in."""
        work = triangulate_polygon(self.points.copy(), loops, spacing)
        if isinstance(work, Obstacle):
            return work
        refused = _insert(work, anchors)
        if len(refused):
            return Obstacle(
                "the fixed vertex {} lies outside its region, on its boundary, or on another vertex",
                (int(refused[0]),),
            )
        crossing = crossing_pairs(self.points, segments)
        if len(crossing):
            ends = tuple(segments[crossing[0]].ravel().tolist())
            return Obstacle("the constrained edges [{}, {}] and [{}, {}] meet", ends)
        obstacle = recover(work, segments)
        if obstacle is not None:
            return obstacle
        _insert(work, stay)
        return work


def _insert(work: Triangulation, vertices: np.ndarray) -> np.ndarray:
    """Insert `vertices` where they are; returns those that cannot go in."""
    if not len(vertices):
        return vertices
    # The triangles of the boundary are long, and their bounding boxes large.  Once a few vertices are in, the others
    # are located fast.
    order = np.random.default_rng(0).permutation(vertices)
    cuts = [len(order) // 64, len(order) // 8] if len(order) > 2000 else []
    refused = []
    for part in np.split(order, cuts):
        home = locate(work.points, part, work.corners)
        refused += [part[home < 0], work.insert(part[home >= 0], home[home >= 0])]
    return np.concatenate(refused)


def _scattered(points: np.ndarray, distance: float) -> np.ndarray:
    """Rows of `points` (N, 2), one from each square of side `distance`; all if the squares cannot be numbered."""
    with np.errstate(all="ignore"):
        square = np.floor((points - points.min(0, initial=np.inf)) / distance)
    if not np.isfinite(square).all():
        return np.arange(len(points))
    return np.unique(square[:, 0] + 1j * square[:, 1], return_index=True)[1]
