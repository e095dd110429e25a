"""Rectangles whose boundary is laid, at equal steps, onto the outline of a letter or of a spiral."""

import numpy as np
import torch

from ...learning.outlines import bent_band, laid_along, spiral_loop
from ...triangulating.mesher import Outline
from ...warping.femwarp import relax
from ..case import Drawn, Family
from .drawing import is_simple, meshed, size


def _laid(rng: np.random.Generator, goal: np.ndarray) -> Drawn | None:
    """A rectangle with its boundary on `goal` and its interior at the means of neighbours."""
    width = rng.uniform(1, 3)
    corners = np.array([[0.0, 0], [width, 0], [width, 1], [0, 1]])
    made = meshed(Outline((corners,), (1.0,)), size(rng), rng)
    if made is None:
        return None
    mesh, loop = made
    points = mesh.points.clone()
    start = int(rng.integers(len(goal)))
    points[: len(loop)] = torch.from_numpy(laid_along(np.roll(goal, start, 0), len(loop)))
    if not is_simple(points, loop):
        return None
    return Drawn(mesh, relax(mesh.with_points(points)).points, details={"width": round(width, 3)})


def letters(rng: np.random.Generator, bends: float) -> Drawn | None:
    """Onto a band that bends so many times: 1 an L, 2 a U, 4 a G, 6 and more a spiral with corners."""
    return _laid(rng, bent_band(int(bends)))


def spirals(rng: np.random.Generator, turns: float) -> Drawn | None:
    """Onto a strip that is wound so many times."""
    return _laid(rng, spiral_loop(turns, rng.uniform(0.4, 0.65)))


FAMILIES = (
    Family("letters", letters, (1, 2, 3, 4, 6, 8), "bends", "a rectangle laid onto a letter"),
    Family("spirals", spirals, (0.5, 0.75, 1, 1.5, 2), "turns", "a rectangle laid onto a spiral"),
)
