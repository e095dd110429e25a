"""The curved elements of a mesh, all together: six-node triangles, and quads of eight or nine nodes.

Rows of triangles come first.  Where a triangle stands in a table of four columns, its first entry stands there twice.
"""

from dataclasses import dataclass, field

import numpy as np
import torch

from ..mesh.predicates import orientation
from .quads import QUAD_SIDES, quad_scaled_jacobian, quads_upright
from .validity import SIDES, scaled_jacobian, upright


@dataclass(frozen=True, eq=False)
class Elements:
    """Curved elements by their nodes.

    six   (N, 6) of triangles
    nine  (M, 9) of quads; the centre is -1 where there is none
    were  (M, 9, 2) where the nodes of the quads were before anything moved; not a number where that is not known
    """

    six: np.ndarray
    nine: np.ndarray
    were: np.ndarray = field(default_factory=lambda: np.zeros((0, 9, 2)))

    def __len__(self) -> int:
        return len(self.six) + len(self.nine)

    def some(self, rows: np.ndarray) -> "Elements":
        """Those of some rows, in ascending order."""
        rows = np.sort(rows)
        quads = rows[rows >= len(self.six)] - len(self.six)
        return Elements(self.six[rows[rows < len(self.six)]], self.nine[quads], self.were[quads])

    @property
    def corners(self) -> np.ndarray:
        """(N + M, 4)"""
        return np.concatenate([self.six[:, [0, 1, 2, 0]], self.nine[:, :4]])

    @property
    def sides(self) -> np.ndarray:
        """(N + M, 4, 2) the ends of the sides; the first one of a triangle is there twice."""
        triangles = self.six[:, [*SIDES, SIDES[0]]]
        return np.concatenate([triangles, self.nine[:, QUAD_SIDES]])

    @property
    def nodes(self) -> np.ndarray:
        """The rows of all corners and nodes, each once."""
        return np.unique(np.concatenate([self.six.reshape(-1), self.nine[self.nine >= 0]]))

    def upright(self, points: np.ndarray) -> np.ndarray:
        """(N + M,) bool: the Jacobian is positive everywhere on the element; exact."""
        at = torch.from_numpy(points)
        both = upright(at, torch.from_numpy(self.six)), quads_upright(at, torch.from_numpy(self.nine))
        return torch.cat(both).numpy()

    def scaled(self, points: np.ndarray) -> np.ndarray:
        """(N + M,) the scaled Jacobians."""
        at = torch.from_numpy(points)
        triangles = scaled_jacobian(at, torch.from_numpy(self.six))
        return torch.cat([triangles, quad_scaled_jacobian(at, torch.from_numpy(self.nine))]).numpy()

    def scaled_straight(self, points: np.ndarray) -> np.ndarray:
        """(N + M,) the scaled Jacobians of the straight elements, at least 0: 1 for triangles and parallelograms."""
        at = points[self.nine[:, :4]]
        ahead, behind = np.roll(at, -1, 1) - at, np.roll(at, 1, 1) - at
        corner = ahead[..., 0] * behind[..., 1] - ahead[..., 1] * behind[..., 0]
        low, high = corner.min(1, initial=np.inf), np.abs(corner).max(1, initial=0.0)
        return np.concatenate([np.ones(len(self.six)), np.clip(low / np.maximum(high, 1e-300), 0.0, 1.0)])

    def straight_inverted(self, points: np.ndarray) -> np.ndarray:
        """(N + M,) bool: a corner of the straight triangle or quad is not upright."""
        round_and_on = self.nine[:, [0, 1, 2, 3, 0, 1]]
        turned = np.zeros(len(self.nine), bool)
        for k in range(4):
            turned |= _turned(points, round_and_on[:, k : k + 3])
        return np.concatenate([_turned(points, self.six[:, :3]), turned])

    def settled(self, points: np.ndarray) -> np.ndarray:
        """The points with the centres of quads where their sides ask for them; where nothing moved they stay."""
        has = self.nine[:, 8] >= 0
        if not has.any():
            return points
        rows, were = self.nine[has], self.were[has]
        nodes = points[rows[:, :8]]
        asked = nodes[:, 4:].sum(1) / 2 - nodes[:, :4].sum(1) / 4
        same = (nodes == were[:, :8]).all((1, 2))
        points = points.copy()
        points[rows[:, 8]] = np.where(same[:, None], were[:, 8], asked)
        return points


def _turned(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(N,) bool: the triangle of the rows (N, 3) is not upright."""
    a, b, c = (torch.from_numpy(points[corners[:, k]]).unbind(1) for k in range(3))
    return (orientation(*a, *b, *c) <= 0).numpy()
