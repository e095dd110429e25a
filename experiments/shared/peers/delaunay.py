"""Delaunay triangulations of libigl and scipy; neither moves a vertex."""

from __future__ import annotations

import numpy as np
import torch

from torchmesh.bench import boundary
from torchmesh.bench.exact_check import double_areas
from torchmesh.bench.methods.outcome import Outcome, need
from torchmesh.bench.stopwatch import Stopwatch

Array = np.ndarray


def libigl(points: Array, triangles: Array, fixed: Array) -> Outcome:
    """libigl's intrinsic Delaunay flips, which need a valid mesh."""
    need("igl")
    import igl

    lengths = igl.edge_lengths(points, triangles)
    with Stopwatch() as watch:
        result = igl.intrinsic_delaunay_triangulation(lengths, triangles)
    return Outcome(points, result[1], watch.seconds, "flips only")


def scipy_delaunay(points: Array, triangles: Array, fixed: Array) -> Outcome:
    """scipy's Delaunay triangulation of the points: it fills their hull and keeps no boundary."""
    need("scipy")
    from scipy.spatial import Delaunay

    with Stopwatch() as watch:
        simplices = Delaunay(points).simplices
    made = simplices.astype(np.int64)
    clockwise = double_areas(points, made) < 0
    made[clockwise] = made[clockwise, ::-1]
    given = boundary.edges(torch.from_numpy(triangles)).numpy()
    sides = np.stack([made.ravel(), np.roll(made, -1, 1).ravel()], 1)
    lost = len(np.setdiff1d(_edge_keys(given, len(points)), _edge_keys(sides, len(points))))
    return Outcome(points, made, watch.seconds, f"hull of the points; {lost} boundary edges lost")


def _edge_keys(edges: Array, vertices: int) -> Array:
    return edges.min(1) * vertices + edges.max(1)
