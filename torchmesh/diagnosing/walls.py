"""The pieces of a mesh that are not valid, and the edges that triangles cannot lie across.

o-----------o     boundary    an edge with a triangle on one side only
| \\  A  /   |     constraint  a constrained edge inside, with both ends fixed
|   o   B   |     held        an edge between two fixed vertices, when the triangles are to stay
| /         |     A, B        regions, closed off by such edges
o-----------o
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from ..mesh import connectivity
from ..mesh.batch import MeshBatch
from ..mesh.ragged import true_rows
from ..triangulating.arrays import signs
from ..triangulating.touching import PlaneBoundary, plane_boundary

BOUNDARY, CONSTRAINT, HELD = range(3)


@dataclass(frozen=True, eq=False)
class Walls:
    """The pieces of one mesh that have an inverted triangle, and the half-edges along their boundary and walls.

    points     (V, 2) float64
    triangles  (T, 3) int64 the triangles of these pieces
    region     (T,) int64 the region of each triangle, numbered by first triangles
    piece      (V,) int64 the piece of each vertex
    used       (V,) bool, corners of the triangles
    fixed      (V,) bool, those of them that are fixed
    ends       (H, 2) int64 tail and head of each half-edge on the boundary or a wall
    kind       (H,) int64, BOUNDARY, CONSTRAINT or HELD
    once       (H,) bool, one half-edge of each edge
    alone      (H,) bool, no triangle lies on the other side
    own, other (H,) int64 the regions on the left and on the right; where a half-edge is alone, `other` means nothing
    sides      (R,) int64 half-edges of the mesh on the boundary of each region
    doubled    (V,) bool, vertices on stretches of boundary that lie on each other; None: nobody has looked
    """

    points: np.ndarray
    triangles: np.ndarray
    region: np.ndarray
    piece: np.ndarray
    used: np.ndarray
    fixed: np.ndarray
    ends: np.ndarray
    kind: np.ndarray
    once: np.ndarray
    alone: np.ndarray
    own: np.ndarray
    other: np.ndarray
    sides: np.ndarray
    doubled: np.ndarray | None = None

    @classmethod
    def of(cls, mesh: MeshBatch, keep: bool) -> "Walls | None":
        """The walls of one mesh; None if all of its triangles are upright.

        keep  are the triangles to stay, so that edges between fixed vertices are walls, too
        """
        points = mesh.points.detach().to("cpu", torch.float64).numpy()
        count = len(points)
        triangles, twin, label = _invalid_pieces(points, mesh.triangles.cpu(), mesh.twin.cpu())
        if not len(triangles):
            return None
        piece = np.zeros(count, np.int64)
        piece[triangles.numpy()] = label.numpy()[:, None]
        held = mesh.fixed.cpu()
        constraints = mesh.constrained_edges.cpu()
        constraints = constraints[held[constraints].all(1)]
        tails, heads = connectivity.tails(triangles), connectivity.heads(triangles)
        inner = twin >= 0
        wall = connectivity.half_edges_on(triangles, constraints, count) & inner
        parted = wall | (held[tails] & held[heads] & inner) if keep else wall
        region = connectivity.triangle_components(triangles, twin, parted) if bool(parted.any()) else label
        h = true_rows(~inner | parted)
        across = twin[h]
        kind = torch.where(across < 0, BOUNDARY, torch.where(wall[h], CONSTRAINT, HELD))
        used = np.zeros(count, bool)
        used[triangles.numpy()] = True
        own, other = region[h // 3], region[torch.where(across < 0, h, across) // 3]
        sides = torch.bincount(own[(across < 0) | (own != other)], minlength=int(region.max()) + 1)
        return cls(
            points,
            triangles.numpy(),
            region.numpy(),
            piece,
            used,
            used & held.numpy(),
            torch.stack([tails[h], heads[h]], 1).numpy(),
            kind.numpy(),
            ((across < 0) | (h < across)).numpy(),
            (across < 0).numpy(),
            own.numpy(),
            other.numpy(),
            sides.numpy(),
        )

    def in_plane(self) -> "tuple[Walls, PlaneBoundary]":
        """The same where boundaries touch themselves: vertices of a piece in one position are one, edges are parted.

        What is left are walls that meet in common vertices only; two stretches of boundary that lie on each other have
        triangles on both sides.  Edges that cross stay as they are.  The boundary is returned, too, with the edges that
        are `alone`, in their order.
        """
        rows = np.flatnonzero(self.alone)
        plane = plane_boundary(self.points, self.ends[rows], self.piece)
        rest = np.setdiff1d(np.arange(len(self.ends)), rows)
        tail, head = plane.ends.T
        there, back = tail * len(self.points) + head, head * len(self.points) + tail
        order = there.argsort()
        facing = order[np.minimum(np.searchsorted(there[order], back), len(order) - 1)] if len(order) else order
        own = self.own[rows][plane.edge]
        doubled = np.zeros(len(self.points), bool)
        doubled[plane.ends[plane.paired]] = True
        stands = plane.first == np.arange(len(self.points))
        walls = replace(
            self,
            triangles=plane.first[self.triangles],
            used=self.used & stands,
            fixed=self.fixed & stands,
            ends=np.concatenate([plane.ends, plane.first[self.ends[rest]]]),
            kind=np.concatenate([np.full(len(own), BOUNDARY), self.kind[rest]]),
            once=np.concatenate([~plane.paired | (tail < head), self.once[rest]]),
            alone=np.concatenate([~plane.paired, self.alone[rest]]),
            own=np.concatenate([own, self.own[rest]]),
            other=np.concatenate([own[facing], self.other[rest]]),
            doubled=doubled,
        )
        return walls, plane


def _invalid_pieces(points: np.ndarray, triangles: Tensor, twin: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The triangles (T', 3) of the pieces that have an inverted one, their twins (3T',), and (T',) their pieces.

    A piece whose triangles are all upright is valid, whatever its boundary does.
    """
    label = connectivity.triangle_components(triangles, twin)
    inverted = torch.from_numpy(signs(points, *triangles.numpy().T) <= 0)
    invalid = torch.zeros_like(inverted).index_fill_(0, label[inverted], True)[label]
    if bool(invalid.all()) or not bool(invalid.any()):
        return triangles[invalid], twin, label
    triangles = triangles[invalid]
    twin = connectivity.twins(triangles)
    return triangles, twin, connectivity.triangle_components(triangles, twin)
