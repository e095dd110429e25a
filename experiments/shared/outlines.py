"""Closed polygons to be meshed or to be mapped onto, counter-clockwise.

A *loop* is an array (N, 3) of corners: x, y, and the size of mesh edges there, in the unit that the caller chooses.
An *outline* is an array (N, 2) of corners alone.
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np

Array = np.ndarray
Number = TypeVar("Number", float, Array)


def sized(corners: object, size: float) -> Array:
    """(N, 3) the loop along `corners` (N, 2) with one size."""
    return np.insert(np.array(corners, dtype=float), 2, size, 1)


def rectangle(left: float, bottom: float, right: float, top: float, size: float) -> Array:
    """(4, 3) the loop of a rectangle with one size."""
    return sized([(left, bottom), (right, bottom), (right, top), (left, top)], size)


def circle(x: float, y: float, radius: float, count: int, size: float) -> Array:
    """(count, 3) the loop of a regular polygon whose first corner lies to the right of its centre."""
    angles = [2 * math.pi * k / count for k in range(count)]
    return sized([(x + radius * math.cos(a), y + radius * math.sin(a)) for a in angles], size)


def half_thickness(x: Number, thickness: float) -> Number:
    """Half the height of a symmetric NACA airfoil at the part `x` of its chord, as thick as `thickness` chords.

    The trailing edge is closed (Abbott & von Doenhoff 1959, equation 6.2, with -0.1036 as the last coefficient).
    """
    curve = 0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4
    return 5 * thickness * curve


def spiral(turns: float) -> Array:
    """(N, 2) the outline of a strip of constant width wound `turns` times."""
    steps = max(24, round(48 * turns))
    angle = np.linspace(0, 2 * np.pi * turns, steps)
    radius = 0.6 + angle / (2 * np.pi)
    ray = np.stack([np.cos(angle), np.sin(angle)], 1)
    return np.concatenate([(radius + 0.2)[:, None] * ray, ((radius - 0.2)[:, None] * ray)[::-1]])
