"""Which vertices and triangles of a batch lie near others, counted in rings of neighbours."""

import torch
from torch import Tensor

from . import connectivity
from .batch import MeshBatch


def touching(batch: MeshBatch, vertices: Tensor) -> Tensor:
    """(T,) bool: the triangles with a corner among `vertices` (V,) bool."""
    return connectivity.touching(batch.triangles, vertices)


def corners_of(batch: MeshBatch, triangles: Tensor) -> Tensor:
    """(V,) bool: the corners of the `triangles` (T,) bool."""
    return connectivity.corners_of(batch.triangles, triangles, len(batch.points))


def rewired(before: MeshBatch, after: MeshBatch) -> Tensor:
    """(V,) bool: the corners of the triangles of `after` that have other corners than in `before`."""
    changed = torch.zeros(len(after.triangles), dtype=torch.bool, device=after.triangles.device)
    return corners_of(after, changed.index_fill_(0, (before.triangles != after.triangles).nonzero()[:, 0], True))


def surroundings(batch: MeshBatch, triangles: Tensor, rings: int) -> Tensor:
    """(V,) bool: the corners of the `triangles` (T,) bool, and `rings` - 1 rings of vertices round them."""
    near = corners_of(batch, triangles)
    for _ in range(rings - 1):
        near = corners_of(batch, touching(batch, near))
    return near
