r"""Straight lines in a polygon with holes: which cells of a triangulation of it they join.

         d1    d2
     +---/-----\---+      A line from cell t to cell t' crosses chords, the sides of cells between them, one after
     |  / t     \  |      the other.  It can do so only if the left ends of the chords are on its left, and the right
     +-/---+-----\-+      ends on its right.  All such lines lie between two extreme ones, which lean on an end of
           |      \|      each side; they are brought up to date when a chord comes in.  Round a hole lines may go two
           |    d3 +      ways: then two runs of chords lead to one cell.
           | t'    |
           +-------+      Cells are cut into four for a closer look.  From a part a of t no line leads to a part b of
                          t' if an end of a chord is on the wrong side of all lines from the corners of a to those of b:
the side of a point on which a line runs is given by a determinant that is linear in each of its three points.

What is found here by floating point is a proposal; `no_place_check` decides.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

Chord = tuple[int, int]

# What rounding may leave of a determinant that is zero, in units of the square of the extent.
_ROUNDING = 1e-13


class TooMany(Exception):
    """More runs than were allowed."""


@dataclass(frozen=True)
class Run:
    """The chords that a line crosses on its way to a cell: the different left and right ends."""

    cell: int
    lefts: tuple[int, ...]
    rights: tuple[int, ...]


class Cells:
    """The cells, and the runs of chords across which straight lines lead.

    points  (V, 2) float64
    cells   (C, 3) the corners of each cell, counter-clockwise
    most    runs that may be looked for in all; beyond, `TooMany` is raised
    """

    def __init__(self, points: np.ndarray, cells: np.ndarray, most: int) -> None:
        self.cells, self.most = cells, most
        self.left = left_of(cells)
        self.xy = [(x, y) for x, y in points.tolist()]

    def from_cell(self, cell: int) -> list[Run]:
        """The runs from anywhere in a cell to all others that a line reaches."""
        stack = [(chord, Run(cell, chord[:1], chord[1:]), chord[::-1], chord) for chord in sides(self.cells[cell])]
        return self._followed(stack)

    def from_corner(self, corner: int) -> list[Run]:
        """The runs from a corner of cells; to these themselves no chord leads."""
        around = np.flatnonzero((self.cells == corner).any(1)).tolist()
        far = [_opposite(self.cells[cell], corner) for cell in around]
        stack = [(c, Run(0, c[:1], c[1:]), (corner, c[0]), (corner, c[1])) for c in far]
        return [Run(cell, (), ()) for cell in around] + self._followed(stack)

    def _followed(self, stack: list[tuple[Chord, Run, Chord, Chord]]) -> list[Run]:
        """The runs onward from chords that have been entered, each with its two extreme lines.

        The line that turns most to the left leans on a right end and then on a left end, the one that turns most to the
        right on a left end and then on a right end.
        """
        found: list[Run] = []
        while stack:
            chord, run, leftmost, rightmost = stack.pop()
            cell = self.left.get(chord)
            if cell is None:
                continue
            self.most -= 1
            if self.most < 0:
                raise TooMany
            run = Run(cell, run.lefts, run.rights)
            found.append(run)
            (new,) = set(self.cells[cell].tolist()) - set(chord)
            for onward in ((new, chord[1]), (chord[0], new)):
                to_the_left = onward[0] == new
                lines = (
                    self._with_left(run, leftmost, rightmost, new)
                    if to_the_left
                    else self._with_right(run, leftmost, rightmost, new)
                )
                if lines is None:
                    continue
                lefts, rights = run.lefts, run.rights
                if to_the_left and new not in lefts:
                    lefts = (*lefts, new)
                if not to_the_left and new not in rights:
                    rights = (*rights, new)
                stack.append((onward, Run(cell, lefts, rights), *lines))
        return found

    def _with_left(self, run: Run, leftmost: Chord, rightmost: Chord, new: int) -> tuple[Chord, Chord] | None:
        """The extreme lines with another left end; None if there is no line any more."""
        if self._side(*rightmost, new) <= 0 and new not in rightmost:
            return None
        if self._side(*leftmost, new) < 0:
            pivot = leftmost[0]
            for right in run.rights:
                if pivot in run.rights and self._side(pivot, new, right) > 0:
                    pivot = right
            leftmost = pivot, new
        return leftmost, rightmost

    def _with_right(self, run: Run, leftmost: Chord, rightmost: Chord, new: int) -> tuple[Chord, Chord] | None:
        """The same with another right end."""
        if self._side(*leftmost, new) >= 0 and new not in leftmost:
            return None
        if self._side(*rightmost, new) > 0:
            pivot = rightmost[0]
            for left in run.lefts:
                if pivot in run.lefts and self._side(pivot, new, left) < 0:
                    pivot = left
            rightmost = pivot, new
        return leftmost, rightmost

    def _side(self, a: int, b: int, c: int) -> float:
        (ax, ay), (bx, by), (cx, cy) = self.xy[a], self.xy[b], self.xy[c]
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def left_of(cells: np.ndarray) -> dict[Chord, int]:
    """Of each directed side of the cells, the cell on its left."""
    return {side: row for row, cell in enumerate(cells) for side in _directed(cell)}


def _directed(cell: np.ndarray) -> Iterator[Chord]:
    a, b, c = cell.tolist()
    yield from ((a, b), (b, c), (c, a))


def sides(cell: np.ndarray) -> list[Chord]:
    """The sides as chords (left end, right end), as they are seen from the inside."""
    return [(b, a) for a, b in _directed(cell)]


def _opposite(cell: np.ndarray, corner: int) -> Chord:
    return next(side for side in sides(cell) if corner not in side)


def cut_in_four(corners: np.ndarray) -> np.ndarray:
    """(4N, 3, 2) the parts of the triangles `corners` (N, 3, 2): at each corner in turn, and the middle one."""
    a, b, c = corners.transpose(1, 0, 2)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
    return np.stack([np.stack(part, 1) for part in parts], 1).reshape(-1, 3, 2)


def cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The cross products of vectors (..., 2)."""
    product: np.ndarray = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    return product


def unblocked(start: np.ndarray, ends: np.ndarray, lefts: np.ndarray, rights: np.ndarray) -> np.ndarray:
    """(S, N) bool: no single end of a chord stands in the way of all lines from one part to another.

    start          (S, K, 2) the corners of parts, or (1, 1, 2) a point
    ends           (N, 3, 2) the corners of the parts that are to be reached
    lefts, rights  (N, L, 2), (N, R, 2) the ends of the chords on the way to each; some may be there twice
    """
    count, corners = start.shape[:2]
    p = start.reshape(-1, 2)
    free = np.ones((count, len(ends)), bool)
    between = cross(p[:, None, None], ends[None])
    for pillars, sign in ((lefts, 1.0), (rights, -1.0)):
        onward = cross(ends[:, :, None], pillars[:, None])
        back = cross(pillars[None], p[:, None, None])
        side = sign * (between[..., None] + onward[None] + back[:, :, None])
        most = side.max(2).reshape(count, corners, len(ends), -1).max(1)
        free &= (most > _ROUNDING).all(2)
    return free


def beside(start: np.ndarray, ends: np.ndarray, third: np.ndarray, sign: float) -> np.ndarray:
    """(N,) bool: some triangle of a corner of each, in this order, turns to the left (`sign` 1) or right (-1).

    start, ends  (N, K, 2), (N, M, 2)
    third        (N, H, 2), or (1, H, 2) for all
    """
    between = cross(start[:, :, None], ends[:, None])
    onward, back = cross(ends[:, :, None], third[:, None]), cross(third[:, None], start[:, :, None])
    side = sign * (between[..., None] + onward[:, None] + back[:, :, None])
    found: np.ndarray = side.max((1, 2, 3)) > _ROUNDING
    return found
