"""The edges that no flip may remove: those that are constrained, and those of quads."""

import torch
from torch import Tensor

from . import connectivity
from .batch import MeshBatch


def constrained_half_edges(mesh: MeshBatch) -> Tensor:
    """(3T,) bool: the half-edges, both of an edge, that no flip may remove: constrained ones, and those of quads."""
    return connectivity.half_edges_on(mesh.triangles, kept_edges(mesh), len(mesh.points))


def kept_edges(mesh: MeshBatch) -> Tensor:
    """(K, 2) the constrained edges, and the edges and diagonals of the quads whose halves are among the triangles."""
    if not len(mesh.quads) or mesh.rows_per_quad != 2:
        return mesh.constrained_edges
    a, b, c, d = mesh.quads.unbind(1)
    return torch.cat([mesh.constrained_edges, *(torch.stack(e, 1) for e in ((a, b), (b, c), (c, d), (d, a), (a, c)))])
