"""Curved sides of triangles and quads in pictures: the parabola through the ends and the node of an edge.

    c          A side from u to v whose node is m is the curve of Bezier with the control point c = 2 m - (u + v) / 2.
  .   .
u ..m.. v
"""

from dataclasses import dataclass, replace

import numpy as np
import torch

from ..files.placed import Placed
from ..mesh.batch import MeshBatch
from ..mesh.measure import Quality

# A side whose node is nearer to its middle than this part of its length is drawn straight.
_STRAIGHT = 1e-6

# A curved side is drawn in so many pieces.
_PIECES = 12


@dataclass(frozen=True, eq=False)
class Curves:
    """What is curved in a mesh.

    edges     (E, 2) int64, the ends of curved edges, the lower row first, in ascending order
    controls  (E, 2) float64, their control points
    nodes     (E, 2) float64, their nodes, which lie on them
    upright   (T,) bool: no six-node triangle, or one whose Jacobian is positive everywhere
    quads     (Q,) bool: the quad is not inverted, by its Jacobian if it is curved
    """

    edges: np.ndarray
    controls: np.ndarray
    nodes: np.ndarray
    upright: np.ndarray
    quads: np.ndarray

    @classmethod
    def of(cls, placed: Placed | None) -> "Curves | None":
        """Those of a mesh with mid-side nodes; None where all sides are straight and all triangles upright."""
        if placed is None:
            return None
        points = placed.mesh.points.detach().to("cpu", torch.float64).numpy()
        edges = placed.middles.edges
        a, b = points[edges].transpose(1, 0, 2)
        away = points[placed.middles.nodes] - (a + b) / 2
        bent = np.abs(away).max(1, initial=0) > _STRAIGHT * np.abs(b - a).max(1, initial=0)
        if not bent.any() and not placed.inverted.any() and not placed.inverted_quads.any():
            return None
        middle = (a + b)[bent] / 2
        return cls(edges[bent], middle + 2 * away[bent], middle + away[bent], ~placed.inverted, placed.quads_upright)

    def judged(self, quality: Quality) -> Quality:
        """The quality of the mesh, in which curved triangles and quads are judged by their Jacobians.

        A triangle whose straight one is inverted stays so.
        """
        upright = quality.upright & torch.from_numpy(self.upright).to(quality.upright.device)
        quads = torch.from_numpy(self.quads).to(quality.upright.device)
        more = (quality.upright & ~upright).sum() + (~quads).sum() - (~quality.quad_upright).sum()
        return replace(quality, upright=upright, quad_upright=quads, inverted=quality.inverted + more)

    def rows(self, edges: np.ndarray) -> np.ndarray:
        """(N,) the row of each of the edges (N, 2), in either direction; -1 for a straight one."""
        low, high = np.sort(edges, 1).T
        count = int(max(self.edges.max(initial=-1), edges.max(initial=-1))) + 1
        keys = self.edges[:, 0] * count + self.edges[:, 1]
        at = np.minimum(np.searchsorted(keys, low * count + high), max(len(keys) - 1, 0))
        return np.where(keys[at] == low * count + high, at, -1) if len(keys) else np.full(len(edges), -1)

    def lines(self, points: np.ndarray, edges: np.ndarray) -> list[np.ndarray]:
        """The edges (N, 2) as lines of points (n, 2), from the first end to the second."""
        t = np.linspace(0, 1, _PIECES + 1)[:, None]
        lines = list(points[edges])
        for k, row in enumerate(self.rows(edges).tolist()):
            if row >= 0:
                u, v = lines[k]
                lines[k] = (1 - t) ** 2 * u + 2 * t * (1 - t) * self.controls[row] + t**2 * v
        return lines

    def outlines(self, mesh: MeshBatch, shape: np.ndarray) -> list[np.ndarray]:
        """The outlines of all triangles, and then of all quads, whose corners are `shape` (T + Q, k, 2)."""
        outlines = list(shape)
        points = mesh.points.detach().to("cpu", torch.float64).numpy()
        for first, cells in ((0, mesh.triangles), (len(mesh.triangles), mesh.quads)):
            rows = cells.cpu().numpy()
            ends = np.stack([rows, np.roll(rows, -1, 1)], 2)
            bent = (self.rows(ends.reshape(-1, 2)).reshape(rows.shape) >= 0).any(1)
            for row in np.flatnonzero(bent).tolist():
                outlines[first + row] = np.concatenate([line[:-1] for line in self.lines(points, ends[row])])
        return outlines
