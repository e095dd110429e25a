"""Values of triangles and quads as values of triangles alone, two of which stand for each quad, and back."""

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.quads import halved, halves_of
from ..mesh.triangle import corners, signed_area


def to_halves(batch: MeshBatch, values: Tensor) -> Tensor:
    """(T', ...) over the triangles of `halved(batch)`, from values (T + Q, ...) of triangles and then quads."""
    if not len(batch.quads):
        return values
    rows, count = halved(batch).of_quads, len(batch.triangles)
    element = torch.empty(len(rows), dtype=torch.int64)
    element[~rows.cpu()] = torch.arange(count)
    element[rows.cpu()] = count + torch.arange(len(batch.quads)).repeat_interleave(2)
    return values[element.to(values.device)]


def from_halves(batch: MeshBatch, values: Tensor, mean: bool) -> Tensor:
    """(T + Q, ...) values of triangles and then quads, from those (T', ...) over the triangles of `halved(batch)`.

    mean  a quad has the mean of its halves by their areas, which keeps the sum of value times area; else the value of
          the larger half
    """
    if not len(batch.quads):
        return values
    rows = halved(batch).of_quads.to(values.device)
    area = signed_area(corners(batch.points.detach().to(torch.float64), halves_of(batch.quads))).abs()
    pair = area.reshape(-1, 2).to(values.device)
    halves = values[rows].reshape(-1, 2, *values.shape[1:])
    if mean and (values.is_floating_point() or values.is_complex()):
        total = pair.sum(1, keepdim=True)
        share = torch.where(total > 0, pair / torch.where(total > 0, total, 1.0), 0.5)
        share = share.reshape(-1, 2, *[1] * (values.ndim - 1)).to(values.real.dtype)
        quads = (share * halves).sum(1)
    else:
        quads = halves[torch.arange(len(halves), device=values.device), pair.argmax(1)]
    return torch.cat([values[~rows], quads])
