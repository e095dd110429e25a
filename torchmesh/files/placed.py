"""A mesh with mid-side nodes in their positions, and how many of its curved triangles and quads are inverted."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from ..curving.elements import Elements
from ..curving.middles import Middles
from ..mesh.batch import MeshBatch
from ..mesh.measure import Quality, quality
from ..mesh.vertex_map import VertexMap


@dataclass(frozen=True, eq=False)
class Placed:
    """A mesh with its mid-side nodes in their positions.

    mesh        points with nodes, and the straight triangles and quads
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
    def elements(self) -> Elements:
        """The curved triangles and quads."""
        return self.middles.elements(self.mesh.triangles.numpy(), self.mesh.quads.numpy())

    @cached_property
    def _bad(self) -> np.ndarray:
        """(N + M,) bool: the Jacobian of the curved triangle or quad is not positive everywhere."""
        return ~self.elements.upright(self.mesh.points.to(torch.float64).numpy())

    @cached_property
    def inverted(self) -> np.ndarray:
        """(T,) bool: the triangle is curved, and its Jacobian is not positive everywhere."""
        return _spread(self.middles.curved, self._bad[: len(self.elements.six)])

    @cached_property
    def inverted_quads(self) -> np.ndarray:
        """(Q,) bool: the quad is curved, and its Jacobian is not positive everywhere."""
        return _spread(self._curved_quads, self._bad[len(self.elements.six) :])

    @property
    def upright(self) -> np.ndarray:
        """(T,) bool: the triangle is not inverted, by its Jacobian if it is curved."""
        return np.where(self.middles.curved, ~self.inverted, self._straight.upright.numpy())

    @property
    def quads_upright(self) -> np.ndarray:
        """(Q,) bool: the quad is not inverted, by its Jacobian if it is curved."""
        return np.where(self._curved_quads, ~self.inverted_quads, self._straight.quad_upright.numpy())

    @property
    def minimum(self) -> float:
        """The least scaled Jacobian of the curved triangles and quads."""
        return float(self.elements.scaled(self.mesh.points.to(torch.float64).numpy()).min())

    @cached_property
    def _straight(self) -> Quality:
        """That of the triangles and quads of the corners."""
        return quality(self.mesh)

    @property
    def _curved_quads(self) -> np.ndarray:
        """(Q,) bool"""
        quads = self.middles.quads
        return quads if len(quads) else np.zeros(len(self.mesh.quads), bool)

    def summary(self) -> "CurvedSummary":
        curved, quads = self.middles.curved, self._curved_quads
        return CurvedSummary(
            int(curved.sum()),
            int(self.inverted.sum()),
            int((~self.upright & ~curved).sum()),
            self.minimum,
            int(quads.sum()),
            int(self.inverted_quads.sum()),
            int((~self.quads_upright & ~quads).sum()),
        )


def _spread(curved: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The values of the curved rows among all rows; false in others."""
    all_rows = np.zeros(len(curved), bool)
    all_rows[curved] = values
    return all_rows


@dataclass(frozen=True)
class CurvedSummary:
    """Counts of a mesh with six-node triangles or quads of eight or nine nodes.

    curved                  its six-node triangles
    inverted                those of them that are inverted
    inverted_linear         inverted triangles among the others
    minimum                 the least scaled Jacobian of its curved triangles and quads
    quads                   its quads with mid-side nodes
    inverted_quads          those of them that are inverted
    inverted_linear_quads   inverted quads among the others
    """

    curved: int
    inverted: int
    inverted_linear: int
    minimum: float
    quads: int = 0
    inverted_quads: int = 0
    inverted_linear_quads: int = 0

    @classmethod
    def of_straight(cls, mesh: MeshBatch) -> "CurvedSummary":
        """Of a mesh without mid-side nodes."""
        q = quality(mesh)
        quads = int((~q.quad_upright).sum())
        return cls(0, 0, int(q.inverted.sum()) - quads, 1.0, 0, 0, quads)

    def to_dict(self) -> dict[str, int | float]:
        """What a record of a mesh says of them."""
        quads = {"curved_quads": self.quads, "inverted_curved_quads": self.inverted_quads} if self.quads else {}
        return {
            "curved": self.curved,
            "inverted_curved": self.inverted,
            **quads,
            "minimum_scaled_jacobian": self.minimum,
        }

    @property
    def all_triangles_inverted(self) -> int:
        """Inverted triangles of both kinds."""
        return self.inverted + self.inverted_linear

    @property
    def all_quads_inverted(self) -> int:
        """Inverted quads of both kinds."""
        return self.inverted_quads + self.inverted_linear_quads

    @property
    def all_inverted(self) -> int:
        """Inverted triangles and quads of all kinds."""
        return self.all_triangles_inverted + self.all_quads_inverted

    @classmethod
    def of_all(cls, parts: "Sequence[CurvedSummary]") -> "CurvedSummary":
        """Of several meshes together."""
        counts = ("curved", "inverted", "inverted_linear", "quads", "inverted_quads", "inverted_linear_quads")
        sums = {name: sum(getattr(part, name) for part in parts) for name in counts}
        return cls(minimum=min(part.minimum for part in parts), **sums)
