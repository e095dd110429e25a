"""Which vertices of a batch lie near others, counted in rings of neighbours."""

import torch
from torch import Tensor

from .batch import MeshBatch
from .connectivity import corners_of, touching


def rewired(before: MeshBatch, after: MeshBatch) -> Tensor:
    """(V,) bool: the corners of the triangles of `after` that have other corners than in `before`."""
    changed = torch.zeros(len(after.triangles), dtype=torch.bool, device=after.triangles.device)
    changed.index_fill_(0, (before.triangles != after.triangles).nonzero()[:, 0], True)
    return corners_of(after.triangles, changed, len(after.points))


def surroundings(batch: MeshBatch, triangles: Tensor, rings: int) -> Tensor:
    """(V,) bool: the corners of the `triangles` (T,) bool, and `rings` - 1 rings of vertices round them."""
    near = corners_of(batch.triangles, triangles, len(batch.points))
    for _ in range(rings - 1):
        near = corners_of(batch.triangles, touching(batch.triangles, near), len(batch.points))
    return near
