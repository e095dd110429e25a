"""Fields that ride with their vertices while a mesh follows its boundary, and stay where they are while it is smoothed.

    given --step--> moved --flips, smoothing--> at rest --step--> moved --improve--> after
          values ride      values keep places          values ride     values keep places

Values that were handed on from mesh to mesh would be smeared each time.  Instead the vertices at the end are traced
back to where the material at their places was in the mesh given.  Values are read there, once.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import torch

from ..mesh.batch import MeshBatch
from ..mesh.connectivity import boundary_edges
from ..mesh.quads import halved
from ..transferring.transfer import prepared
from .field_transfer import FieldChoice, FieldTransfer
from .placed import Placed

# The mesh before and after a step, with the same triangles, in which values ride.
Step = tuple[MeshBatch, MeshBatch]


def traced_back(mesh: MeshBatch, steps: Sequence[Step]) -> MeshBatch:
    """The mesh with its vertices where the material at their places was before the steps, of which the last was last.

    A vertex that nothing but the steps has moved comes back to where it was, to the bit.
    """
    unused = torch.ones(len(mesh.points), dtype=torch.bool)
    for faces in (mesh.triangles, mesh.quads):
        unused[faces] = False
    points = mesh.points.to(torch.float64)
    for before, after in reversed(steps):
        there = after.points.to(torch.float64)
        # Of a vertex of no element, such as a mid-side node, the motion says nothing: it stands where it happens to.
        there = torch.where(unused[:, None], torch.nan, there)
        way = prepared(halved(after.with_points(there)), halved(mesh.with_points(points)), "points")
        points = way(before.points.to(torch.float64))[0]
    return mesh.with_points(points)


class RidingTransfer(FieldTransfer):
    """The transfer from the mesh `before`, which a file holds, by way of steps in which values ride."""

    def __init__(self, steps: Sequence[Step], before: MeshBatch, after: MeshBatch, choice: FieldChoice) -> None:
        super().__init__(before, after, choice)
        self.steps = [(a.to("cpu"), b.to("cpu")) for a, b in steps]

    @cached_property
    def after(self) -> MeshBatch:
        """The mesh at the end, in the places where its material was."""
        return traced_back(self._end, self.steps)

    def through_nodes(self, before: Placed, after: Placed) -> FieldTransfer:
        """As of `FieldTransfer`; mid-side nodes are traced back, too.

        Those of walls go with them: where a wall is curved, they lie beside the straight triangles that are traced.
        """
        back = traced_back(after.mesh, self.steps)
        walls = _walls(self.before)
        rows, now = before.middles.at(walls), after.middles.at(walls)
        rode = (back.points[walls] == self.before.points[walls]).all(2).all(1).numpy()
        kept = rode & (rows >= 0) & (now >= 0)
        nodes, own = before.middles.nodes[rows[kept]], after.middles.nodes[now[kept]]
        points = back.points.clone()
        points[own] = before.mesh.points[nodes].to(points.dtype)
        return super().through_nodes(before, replace(after, mesh=back.with_points(points)))


def _walls(mesh: MeshBatch) -> np.ndarray:
    """(K, 2) the edges of the boundary and of interfaces."""
    halves = halved(mesh)
    return torch.cat([boundary_edges(halves.triangles, halves.twin), halves.constrained_edges]).numpy()
