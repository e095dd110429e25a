"""Metric tensors of the plane as their entries m11, m12, m22 in (N, 3): the formulae.

In a metric M the length of an edge e is sqrt(e^T M e).  Only the shape of M counts here, so most are scaled to
determinant 1.
"""

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch
from ..mesh.triangle import SQRT3


def metric_of_targets(matrices: Tensor, name: str) -> Tensor:
    """(N, 3) the metrics of determinant 1 in which triangles with the matrices W (N, 2, 2) are equilateral.

    M = W^-T E^T E W^-1 up to a factor, with E the matrix of the equilateral triangle.  Raises InvalidMeshError
    for matrices of another shape, or with a determinant that is not positive; it calls them `name`.
    """
    if matrices.ndim != 3 or matrices.shape[1:] != (2, 2):
        raise InvalidMeshError(f"{name} must be (N, 2, 2), not {tuple(matrices.shape)}")
    w = matrices.to(torch.float64)
    unit = _near_one(w)
    bad = ~(unit[:, 0, 0] * unit[:, 1, 1] - unit[:, 0, 1] * unit[:, 1, 0] > 0)
    if bool(bad.any()):
        row = int(bad.nonzero()[0])
        raise InvalidMeshError(
            f"{name} row {row} is {matrices[row].tolist()}: the determinant of a target matrix must be positive"
        )
    metric = equilateral_metric(w)
    return metric / determinant(metric).sqrt()[:, None]


def equilateral_metric(edges: Tensor) -> Tensor:
    """(T, 3) a metric in which triangles with the edge matrices E (T, 2, 2) are equilateral, of any size.

    The adjugate of E C E^T with C = [[1, -1/2], [-1/2, 1]], which is E^-T W^T W E^-1 up to a factor, W the matrix
    of the equilateral triangle.
    """
    e = _near_one(edges)
    e1x, e1y, e2x, e2y = e[:, 0, 0], e[:, 1, 0], e[:, 0, 1], e[:, 1, 1]
    return torch.stack(
        [
            e1y * e1y + e2y * e2y - e1y * e2y,
            -(e1x * e1y + e2x * e2y - 0.5 * (e1x * e2y + e2x * e1y)),
            e1x * e1x + e2x * e2x - e1x * e2x,
        ],
        1,
    )


def edge_matrices(batch: MeshBatch) -> Tensor:
    """(T, 2, 2) float64 with the columns b - a and c - a."""
    a, b, c = batch.points.to(torch.float64)[batch.triangles].unbind(1)
    return torch.stack([b - a, c - a], 2)


def shape_edges(batch: MeshBatch) -> Tensor:
    """(T, 2, 2) the edge matrices of triangles that are equilateral where those of the batch are as they should be.

    These are those of the triangles themselves.  A half of a quad is the image of half a square under a linear map,
    and has here the edges of the equilateral triangle under that map.
    """
    edges = edge_matrices(batch)
    if not len(batch.quads):
        return edges
    # From half a square, with the edges (1, 0) and (1, 1), to the equilateral triangle: W_half^-1 W.
    to_equilateral = edges.new_tensor([[1.0, 0.5 - SQRT3 / 2], [0.0, SQRT3 / 2]])
    return torch.where(batch.of_quads[:, None, None], edges @ to_equilateral, edges)


def stretching(direction: Tensor, aspect: Tensor) -> Tensor:
    """(N, 3) I + (1 / aspect^2 - 1) d d^T, d the direction (N, 2) scaled to length 1, or 0 where it is 0.

    Raises InvalidMeshError for directions of another shape.
    """
    if direction.ndim != 2 or direction.shape[1] != 2:
        raise InvalidMeshError(f"directions must be (N, 2), not {tuple(direction.shape)}")
    d = direction.to(torch.float64)
    largest = d.abs().amax(1, keepdim=True)
    d = d / torch.where(largest > 0, largest, 1.0)
    x, y = d.unbind(1)
    square = x * x + y * y
    factor = (1 / aspect.to(d).square() - 1) / torch.where(square > 0, square, 1.0)
    return torch.stack([1 + factor * x * x, factor * x * y, 1 + factor * y * y], 1)


def turned(metric: Tensor, direction: Tensor) -> Tensor:
    """(N, 3) metrics with the eigenvalues of `metric` (N, 3) and the eigenvectors of `direction` (N, 3).

    A symmetric matrix is half its trace times I plus a deviator.  The size of the deviator is half the difference
    of the eigenvalues, and the ratio of its entries gives their directions.
    """
    half_trace, own = 0.5 * (metric[:, 0] + metric[:, 2]), 0.5 * (metric[:, 0] - metric[:, 2])
    size = (own * own + metric[:, 1] * metric[:, 1]).sqrt()
    plain, oblique = 0.5 * (direction[:, 0] - direction[:, 2]), direction[:, 1]
    there = (plain * plain + oblique * oblique).sqrt()
    factor = size / torch.where(there > 0, there, 1.0)
    plain, oblique = torch.where(there > 0, factor * plain, own), torch.where(there > 0, factor * oblique, metric[:, 1])
    return torch.stack([half_trace + plain, oblique, half_trace - plain], 1)


def determinant(metric: Tensor) -> Tensor:
    """(N,) the determinants."""
    return metric[:, 0] * metric[:, 2] - metric[:, 1] * metric[:, 1]


def _near_one(matrices: Tensor) -> Tensor:
    """(N, 2, 2) the matrices over their largest entry, so that no square leaves the range of numbers."""
    size = matrices.abs().amax((1, 2))
    return matrices / torch.where(size > 0, size, 1.0)[:, None, None]
