"""A mesh with mid-side nodes in their positions, and how many of its six-node triangles are inverted."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from ..curving.middles import Middles
from ..curving.validity import scaled_jacobian, upright
from ..mesh.batch import MeshBatch
from ..mesh.measure import quality
from ..mesh.vertex_map import VertexMap


@dataclass(frozen=True, eq=False)
class Placed:
    """A mesh with its mid-side nodes in their positions.

    mesh        points with nodes, and the straight triangles
    middles     the nodes by edge
    vertex_map  from the file's rows to those of the mesh; None where they are the same
    """

    mesh: MeshBatch
    middles: Middles
    vertex_map: VertexMap | None = None

    @cached_property
    def six(self) -> np.ndarray:
        """(N, 6) the nodes of the curved triangles."""
        return self.middles.six(self.mesh.triangles.numpy())

    @cached_property
    def inverted(self) -> np.ndarray:
        """(T,) bool: the triangle is curved, and its Jacobian is not positive everywhere."""
        bad = np.zeros(len(self.middles.curved), bool)
        bad[self.middles.curved] = ~upright(self.mesh.points, torch.from_numpy(self.six)).numpy()
        return bad

    @property
    def upright(self) -> np.ndarray:
        """(T,) bool: the triangle is not inverted, by its Jacobian if it is curved."""
        return np.where(self.middles.curved, ~self.inverted, _straight_upright(self.mesh))

    @property
    def minimum(self) -> float:
        """The least scaled Jacobian of the curved triangles."""
        return float(scaled_jacobian(self.mesh.points, torch.from_numpy(self.six)).min())

    def summary(self) -> "CurvedSummary":
        curved = self.middles.curved
        linear = ~_straight_upright(self.mesh)[~curved]
        return CurvedSummary(int(curved.sum()), int(self.inverted.sum()), int(linear.sum()), self.minimum)


@dataclass(frozen=True)
class CurvedSummary:
    """Counts of a mesh with six-node triangles.

    curved            its six-node triangles
    inverted          those of them that are inverted
    inverted_linear   inverted triangles among the others
    minimum           the least scaled Jacobian of its six-node triangles
    """

    curved: int
    inverted: int
    inverted_linear: int
    minimum: float

    def to_dict(self) -> dict[str, int | float]:
        """What a record of a mesh says of them."""
        return {
            "curved": self.curved,
            "inverted_curved": self.inverted,
            "minimum_scaled_jacobian": self.minimum,
        }

    @property
    def all_inverted(self) -> int:
        """Inverted triangles of both kinds."""
        return self.inverted + self.inverted_linear

    @classmethod
    def of_all(cls, parts: "Sequence[CurvedSummary]") -> "CurvedSummary":
        """Of several meshes together."""
        return cls(
            sum(p.curved for p in parts),
            sum(p.inverted for p in parts),
            sum(p.inverted_linear for p in parts),
            min(p.minimum for p in parts),
        )


def _straight_upright(mesh: MeshBatch) -> np.ndarray:
    """(T,) bool: the straight triangle is upright."""
    return quality(mesh).upright.numpy()
