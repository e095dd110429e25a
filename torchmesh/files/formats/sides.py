"""Finds the sides of elements again after flips.

Solver files name an edge by an element and the number of a side.  Flips give the edge to another element:

    element 7, side 2  ->  edge from vertex 3 to vertex 5  ->  element 12, side 0

Side k of a triangle leads from its corner k to its corner k + 1, counted round.
"""

import numpy as np


def edges_of(rows: np.ndarray, elements: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """(n, 2) the edges, tail first, that are the sides (n,) of the elements (n,) among the triangles `rows` (R, 3)."""
    return np.stack([rows[elements, sides], rows[elements, (sides + 1) % 3]], 1).reshape(-1, 2)


def followed(
    before: np.ndarray, after: np.ndarray, elements: np.ndarray, sides: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The element (n,) and the side (n,) that each side of `before` is in `after`.

    before, after  (R, 3) the triangles, with the same vertices; an interior edge stays on the side it is on
    elements       (n,) rows of `before`
    sides          (n,) 0, 1 or 2

    Raises ValueError for an edge that is gone.
    """
    wanted = edges_of(before, elements, sides)
    same = (edges_of(after, elements, sides) == wanted).all(1)
    if same.all():
        return elements, sides
    count = int(max(before.max(), after.max())) + 1
    heads = np.roll(after, -1, 1)
    keys = np.concatenate([(after * count + heads).reshape(-1), (heads * count + after).reshape(-1)])
    order = keys.argsort(kind="stable")  # an edge in its own direction comes before the same edge in the other one
    at = keys[order].searchsorted(wanted[:, 0] * count + wanted[:, 1]).clip(max=len(keys) - 1)
    found = order[at]
    if (keys[found] != wanted[:, 0] * count + wanted[:, 1]).any():
        raise ValueError("an edge that it names as the side of an element is gone")
    found = found % (3 * len(after))
    return np.where(same, elements, found // 3), np.where(same, sides, found % 3)
