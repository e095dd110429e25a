"""The steps of a proof that a vertex has no place, and of all steps of a search those that its proof takes."""

from dataclasses import dataclass

import numpy as np

# A cell, and then, for each cut into four, which part: 0 to 2 at the corners, 3 in the middle.
Place = tuple[int, ...]


@dataclass(frozen=True)
class Step:
    """A vertex loses a place, because of a neighbour: nothing that is left of this goes with it."""

    vertex: int
    place: Place
    neighbour: int


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


@dataclass
class Level:
    """Parts of cells of one size.

    places   their names (N,)
    home     (N,) the cell of each
    corners  (N, 3, 2) in a unit of the domain's extent
    joined   (N, N) bool, a straight line joins them; (N, 0) before anybody has looked
    seen     by fixed vertex, (N,) bool, a straight line joins it to them
    """

    places: list[Place]
    home: np.ndarray
    corners: np.ndarray
    joined: np.ndarray
    seen: dict[int, np.ndarray]


def needed(
    vertex: int, steps: list[Step], levels: list[Level], apex: dict[tuple[int, int], int], fixed: np.ndarray
) -> tuple[Step, ...]:
    """The steps, in their order, that together show that the vertex has no place; a few more may be among them.

    steps   all of a search, in order
    levels  its parts of cells, uncut ones first
    apex    the third corner on the left of an edge; fixed (V,) bool
    """
    when = {(step.vertex, step.place): number for number, step in enumerate(steps)}
    row = [{place: k for k, place in enumerate(level.places)} for level in levels]
    wanted = {(v, place) for v, place in when if v == vertex}
    # All that these vertices have lost before a step.
    before: dict[int, int] = {}
    kept = []

    def of_neighbour(step: Step, number: int) -> bool:
        """What the neighbour has lost becomes wanted; does the step go by triangles, too?"""
        by_triangles = False
        for depth in range(len(step.place)):
            level = levels[depth]
            joined = np.flatnonzero(level.joined[row[depth][step.place[: depth + 1]]])
            lost = [(step.neighbour, level.places[k]) for k in joined.tolist()]
            early = [key for key in lost if when.get(key, number) < number]
            wanted.update(early)
            by_triangles = len(early) < len(lost)
        return by_triangles

    for number in range(len(steps) - 1, -1, -1):
        step = steps[number]
        v, u = step.vertex, step.neighbour
        if (v, step.place) not in wanted and number >= before.get(v, 0):
            continue
        kept.append(step)
        level = levels[len(step.place) - 1]
        if not fixed[u]:
            by_triangles = of_neighbour(step, number)
        else:
            by_triangles = u not in level.seen or bool(level.seen[u][row[len(step.place) - 1][step.place]])
        for third in (apex.get((v, u)), apex.get((u, v))) if by_triangles else ():
            if third is not None and not fixed[third]:
                before[third] = max(before.get(third, 0), number)
    return tuple(kept[::-1])
