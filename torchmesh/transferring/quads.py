"""Values of triangles and quads as values of triangles alone, two of which stand for each quad, and back."""

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.quads import halved, halves_of
from ..mesh.triangle import corners, signed_area


def to_halves(batch: MeshBatch, values: Tensor) -> Tensor:
    """(T', ...) over the triangles of `halved(batch)`, from values (T + Q, ...) of triangles and then quads."""
    return values[_elements(batch).to(values.device)] if len(batch.quads) else values


def _elements(batch: MeshBatch) -> Tensor:
    """(T',) for each triangle of `halved(batch)` the element that it is of, among triangles and then quads."""
    rows, count = halved(batch).of_quads.cpu(), len(batch.triangles)
    element = torch.empty(len(rows), dtype=torch.int64)
    element[~rows] = torch.arange(count)
    element[rows] = count + torch.arange(len(batch.quads)).repeat_interleave(2)
    return element


def _shares(batch: MeshBatch, mean: bool) -> Tensor:
    """(Q, 2) the weights that a quad gives to its halves; `mean` as for `from_halves`."""
    area = signed_area(corners(batch.points.detach().to(torch.float64), halves_of(batch.quads))).abs().reshape(-1, 2)
    if not mean:
        return torch.nn.functional.one_hot(area.argmax(1), 2).to(area.dtype)
    total = area.sum(1, keepdim=True)
    return torch.where(total > 0, area / torch.where(total > 0, total, 1.0), 0.5)


def matrix_of_elements(before: MeshBatch, after: MeshBatch, matrix: Tensor, mean: bool) -> Tensor:
    """The sparse matrix (T' + Q', T + Q) over triangles and quads, of that over the triangles of the halved batches."""
    (rows, columns), weights = matrix.indices(), matrix.values()
    if len(after.quads):
        share = torch.ones(matrix.shape[0], dtype=torch.float64)
        share[halved(after).of_quads.cpu()] = _shares(after, mean).reshape(-1).cpu()
        rows, weights = _elements(after)[rows], share[rows] * weights
    if len(before.quads):
        columns = _elements(before)[columns]
    shape = tuple(len(batch.triangles) + len(batch.quads) for batch in (after, before))
    return torch.sparse_coo_tensor(torch.stack([rows, columns]), weights, shape, check_invariants=False).coalesce()


def from_halves(batch: MeshBatch, values: Tensor, mean: bool) -> Tensor:
    """(T + Q, ...) values of triangles and then quads, from those (T', ...) over the triangles of `halved(batch)`.

    mean  a quad has the mean of its halves by their areas, which keeps the sum of value times area; else the value of
          the larger half
    """
    if not len(batch.quads):
        return values
    rows = halved(batch).of_quads.to(values.device)
    floating = values.is_floating_point() or values.is_complex()
    shares = _shares(batch, mean and floating).to(values.device)
    halves = values[rows].reshape(-1, 2, *values.shape[1:])
    if mean and floating:
        share = shares.reshape(-1, 2, *[1] * (values.ndim - 1)).to(values.real.dtype)
        quads = (share * halves).sum(1)
    else:
        quads = halves[torch.arange(len(halves), device=values.device), shares.argmax(1)]
    return torch.cat([values[~rows], quads])
