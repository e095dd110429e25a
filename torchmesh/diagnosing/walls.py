"""The pieces of a mesh that are not valid, and the edges that triangles cannot lie across.

o-----------o     boundary    an edge with a triangle on one side only, or a slit that is sewn up
| \\  A  /   |     constraint  a constrained edge inside
|   o   B   |     held        an edge between two fixed vertices, when the triangles are to stay
| /         |     A, B        regions, closed off by such edges
o-----------o
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..mesh import connectivity
from ..mesh.batch import MeshBatch
from ..triangulating.arrays import signs
from .slits import sewing

BOUNDARY, CONSTRAINT, HELD = range(3)


@dataclass(frozen=True, eq=False)
class Walls:
    """The pieces of one mesh that have an inverted triangle, and the half-edges along their boundary and walls.

    points     (V, 2) float64
    triangles  (T, 3) int64 the triangles of these pieces; where a slit is sewn up, each of its vertices has
               the row of the first vertex in its position
    region     (T,) int64 the region of each triangle, numbered by first triangles
    piece      (V,) int64 the piece of each vertex, as it was before sewing
    used       (V,) bool, corners of the triangles
    fixed      (V,) bool, those of them that are fixed
    ends       (H, 2) int64 tail and head of each half-edge on the boundary or a wall
    kind       (H,) int64, BOUNDARY, CONSTRAINT or HELD
    once       (H,) bool, one half-edge of each edge
    alone      (H,) bool, no triangle lies on the other side
    own, other (H,) int64 the regions on the left and on the right; where a half-edge is alone, `other` means nothing
    sewn       is there a slit that was sewn up
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
    sewn: bool

    @classmethod
    def of(cls, mesh: MeshBatch, keep: bool, sew: bool) -> "Walls | None":
        """The walls of one mesh; None if all of its triangles are upright.

        keep  are the triangles to stay, so that edges between fixed vertices are walls, too
        sew   are slits to be sewn up
        """
        points = mesh.points.detach().to("cpu", torch.float64).numpy()
        count = len(points)
        triangles, twin, label = _invalid_pieces(points, mesh.triangles.cpu(), mesh.twin.cpu())
        if not len(triangles):
            return None
        piece = np.zeros(count, np.int64)
        piece[triangles.numpy()] = label.numpy()[:, None]
        constraints, held = mesh.constrained_edges.cpu(), mesh.fixed.cpu()
        slit = torch.zeros_like(twin, dtype=torch.bool)
        name = None
        if sew:
            boundary = connectivity.boundary_edges(triangles, twin)
            name = sewing(points, triangles.numpy(), boundary.numpy(), piece)
        if name is not None:
            first = torch.from_numpy(name)
            triangles, constraints = first[triangles], first[constraints]
            slit, twin = twin < 0, connectivity.twins(triangles)
            slit &= twin >= 0
            label = connectivity.triangle_components(triangles, twin)
        tails, heads = connectivity.tails(triangles), connectivity.heads(triangles)
        inner = twin >= 0
        wall = slit | (connectivity.half_edges_on(triangles, constraints, count) & inner)
        parted = wall | (held[tails] & held[heads] & inner) if keep else wall
        region = connectivity.triangle_components(triangles, twin, parted) if bool(parted.any()) else label
        h = (~inner | parted).nonzero().squeeze(1)
        across = twin[h]
        kind = torch.where((across < 0) | slit[h], BOUNDARY, torch.where(wall[h], CONSTRAINT, HELD))
        used = np.zeros(count, bool)
        used[triangles.numpy()] = True
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
            region[h // 3].numpy(),
            region[torch.where(across < 0, h, across) // 3].numpy(),
            name is not None,
        )


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
