"""Triangles that nothing can change: their corners stay, and no edge of theirs may flip."""

import torch
from torch import Tensor

from .batch import MeshBatch
from .kept_edges import constrained_half_edges
from .ragged import true_rows


def frozen_triangles(batch: MeshBatch, stays: Tensor | None = None) -> Tensor:
    """(T,) bool: the corners of the triangle stay, and its edges are constrained or on the boundary.

    One edge at least is constrained: a triangle by itself, with three edges on the boundary, is not looked for.

    stays  (V,) bool, the vertices that do not move; None: the fixed ones
    """
    frozen = torch.zeros(len(batch.triangles), dtype=torch.bool, device=batch.triangles.device)
    if not len(batch.constrained_edges) and not len(batch.quads):
        return frozen
    rows = true_rows((batch.fixed if stays is None else stays)[batch.triangles].all(1))
    if not len(rows):
        return frozen
    constrained = constrained_half_edges(batch).reshape(-1, 3)[rows]
    kept = (constrained | (batch.twin.reshape(-1, 3)[rows] < 0)).all(1) & constrained.any(1)
    return frozen.index_put_((rows,), kept)
