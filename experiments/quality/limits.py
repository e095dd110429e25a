"""Limits of the quality that a boundary allows.

No mesh of a boundary has a lower maximum of the inverse mean ratio, or a larger minimum angle, than `boundary_limits`
says.  At a boundary vertex with the angle alpha between edges of lengths a and b stands a fan of k triangles, whose
sides in turn have some ratios r and angles t.  For both measures the triangles that are good enough make a convex set
in (log r, t), so the best fan has all ratios (b/a)^(1/k) and all angles alpha / k; k is free.  The inverse mean ratio
of a triangle is (r + 1/r - cos t) / (sqrt(3) sin t), the cosh of its hyperbolic distance from the equilateral one
(r e^{it} as a point of the half plane).  Its angles are t and, opposite the shorter side, arctan(sin t / (r - cos t)),
r >= 1, which exceeds theta where log r < log sin(t + theta) - log sin(theta), a concave function of t.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch

import torchmesh as tm
from torchmesh.bench import boundary

MOST_TRIANGLES_AT_A_CORNER = 24


class Limits(NamedTuple):
    """The least maximum of the inverse mean ratio and the largest minimum angle, in degrees."""

    ratio: float
    angle: float


def boundary_limits(mesh: tm.MeshBatch) -> Limits:
    """How good any mesh with this boundary can be."""
    edges = boundary.edges(mesh.triangles)
    order = edges[:, 0].argsort()
    following = torch.full((len(mesh.points),), -1)
    following[edges[order, 0]] = edges[order, 1]
    here, onward = edges.unbind(1)
    beyond = following[onward]
    back, out = mesh.points[here] - mesh.points[onward], mesh.points[beyond] - mesh.points[onward]
    # The mesh is on the left of its boundary, so its angle runs counter-clockwise from the edge out to the edge back.
    turn = torch.atan2(out[:, 0] * back[:, 1] - out[:, 1] * back[:, 0], (out * back).sum(1))
    alpha = torch.where(turn > 0, turn, turn + 2 * math.pi)
    ratio = (back.norm(dim=1) / out.norm(dim=1)).log().abs()
    k = torch.arange(1, MOST_TRIANGLES_AT_A_CORNER + 1)
    angle, step = alpha[:, None] / k, ratio[:, None] / k
    best = (2 * step.cosh() - angle.cos()) / (math.sqrt(3) * angle.sin())
    other = torch.atan2(angle.sin(), step.exp() - angle.cos())
    fits = angle < math.pi
    widest = torch.where(fits, torch.minimum(angle, other), 0.0).amax(1).min()
    return Limits(float(torch.where(fits, best, torch.inf).amin(1).max()), math.degrees(float(widest)))


def least_mean_without_interior(polygon: np.ndarray) -> float:
    """The least IMR average of any triangulation of a simple polygon (N, 2), counter-clockwise, without other vertices.

    By dynamic programming over the polygon's intervals (Klincsek, Minimal triangulations of polygonal domains, 1980):
    counter-clockwise triangles that fill a simple polygon are a triangulation of it.
    """
    count = len(polygon)
    least = np.full((count, count), np.inf)
    least[np.arange(count - 1), np.arange(1, count)] = 0.0
    for width in range(2, count):
        for i in range(count - width):
            j = i + width
            k = np.arange(i + 1, j)
            a, b, c = polygon[i], polygon[k], polygon[j]
            det = (b - a)[:, 0] * (c - a)[1] - (b - a)[:, 1] * (c - a)[0]
            squares = ((b - a) ** 2).sum(1) + ((c - b) ** 2).sum(1) + ((c - a) ** 2).sum()
            upright = det > 0
            ratio = np.where(upright, squares / (2 * math.sqrt(3) * np.where(upright, det, 1.0)), np.inf)
            least[i, j] = (least[i, k] + least[k, j] + ratio).min()
    return float(least[0, -1]) / (count - 2)
