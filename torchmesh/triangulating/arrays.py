"""Signs and rows in numpy, for triangulations of one polygon."""

from dataclasses import dataclass

import numpy as np
import torch

from ..kernels.geometry import row_signs
from ..kernels.library import library
from ..mesh.predicates import orientation

# Above three roundings of the products in an orientation, and where none of them underflows.
_CLEAR = 1e-15


_NO_UNDERFLOW = 1e-270


def signs(points: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """(N,) int8 exact orientation of the rows a, b, c (N,) of `points` (V, 2)."""
    if library() is not None:
        return row_signs(points, a, b, c)
    x, y = points[:, 0], points[:, 1]
    rows = ax, ay, bx, by, cx, cy = x[a], y[a], x[b], y[b], x[c], y[c]
    # A tensor operation on a few rows costs more than the sums; most need no more than these.
    with np.errstate(over="ignore", invalid="ignore"):
        left, right = (bx - ax) * (cy - ay), (by - ay) * (cx - ax)
        determinant, magnitude = left - right, np.abs(left) + np.abs(right)
        clear = (np.abs(determinant) > _CLEAR * magnitude) & (magnitude > _NO_UNDERFLOW) & np.isfinite(magnitude)
    sign = ((determinant > 0).view(np.int8) - (determinant < 0).view(np.int8)).astype(np.int8)
    if not clear.all():
        unclear = np.flatnonzero(~clear)
        sign[unclear] = orientation(*(torch.from_numpy(v[unclear]) for v in rows)).numpy()
    return sign


def distinct(values: np.ndarray) -> np.ndarray:
    """(N,) the different `values`, ascending.  As np.unique, which loads numpy.ma first."""
    values = np.sort(values, axis=None)
    return values[np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))] if len(values) else values


def among(values: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Bool, as `values`: is it one of `others` (N,)?  As np.isin, which may load numpy.ma, too."""
    if not others.size:
        return np.zeros(values.shape, bool)
    known = np.sort(others, axis=None)
    return np.asarray(known[np.minimum(np.searchsorted(known, values), len(known) - 1)] == values)


def next_in_triangle(h: np.ndarray) -> np.ndarray:
    """The half-edge after h in its triangle, as that of `connectivity`."""
    return np.where(h % 3 == 2, h - 2, h + 1)


def previous_in_triangle(h: np.ndarray) -> np.ndarray:
    """The half-edge before h in its triangle, as that of `connectivity`."""
    return np.where(h % 3 == 0, h + 2, h - 1)


@dataclass(frozen=True)
class Obstacle:
    """Why something cannot be done: a text with a {} for each of the vertices."""

    text: str
    vertices: tuple[int, ...] = ()

    def __str__(self) -> str:
        return self.text.format(*self.vertices)

    def renumbered(self, names: np.ndarray) -> "Obstacle":
        """The same with vertex v called names[v]."""
        return Obstacle(self.text, tuple(int(names[v]) for v in self.vertices))
