"""Values of triangles and edges summed up and averaged at the vertices, and back."""

import functools

import torch
from torch import Tensor

from ..kernels import packing, ragged
from ..kernels.library import library_for
from .batch import MeshBatch
from .connectivity import edges, vertex_triangle_counts
from .detached import loops_may_read
from .ragged import take
from .triangle import corners, squared_edge_lengths


def sums_at_vertices(elements: Tensor, values: Tensor, vertices: int) -> Tensor:
    """(V, ...) the sum of the `values` (N, ...) of the elements at each vertex; 0 where there are none.

    elements  (N, k) int64: edges (k = 2) or triangles (k = 3).  Column is added after column, so that
              a sum's bits do not depend on what else is in the batch
    """
    total = values.new_zeros((vertices, *values.shape[1:]))
    for column in elements.unbind(1):
        total.index_add_(0, column, values)
    return total


def means_at_vertices(elements: Tensor, values: Tensor, vertices: int) -> tuple[Tensor, Tensor]:
    """(V,) the mean of the `values` (N,) of the elements at each vertex, 0 without any; (V,) bool: there are any.

    elements  (N, k) int64, as in `sums_at_vertices`
    """
    number = torch.bincount(elements.reshape(-1), minlength=vertices)
    return sums_at_vertices(elements, values, vertices) / number.clamp_min(1), number > 0


class Means:
    """Means from vertices to triangles and back, many times over the same triangles."""

    def __init__(self, batch: MeshBatch) -> None:
        self.triangles = batch.triangles.contiguous()
        self.count = vertex_triangle_counts(batch.triangles, len(batch.points)).clamp_min(1)

    @functools.cached_property
    def _corners(self) -> tuple[Tensor, ...]:
        return tuple(v.contiguous() for v in self.triangles.unbind(1))

    def of_corners(self, values: Tensor) -> Tensor:
        """(T,) the mean of `values` (V,) over each triangle's corners."""
        if _plain_numbers(values):
            return ragged.means_of_corners(self.triangles, values.contiguous())
        a, b, c = (take(values, v) for v in self._corners)
        return a.add_(b).add_(c).div_(3)

    def round_vertices(self, values: Tensor) -> Tensor:
        """(V,) the mean of `values` (T,) over the triangles round each vertex; 0 for unused ones."""
        if _plain_numbers(values):
            return ragged.means_round_vertices(self.triangles, values.contiguous(), self.count)
        total = values.new_zeros(len(self.count))
        for v in self._corners:
            total.index_add_(0, v, values)
        return total.div_(self.count)


def _plain_numbers(values: Tensor) -> bool:
    """Whether the compiled loops can do it: one number a row, in double precision."""
    return values.ndim == 1 and values.dtype == torch.float64 and loops_may_read(values)


def vertex_size(batch: MeshBatch) -> Tensor:
    """(V,) root mean square edge length round each vertex, in the batch's unit; 0 for unused ones."""
    if library_for(batch.points) is not None:
        return packing.vertex_size(batch.points.to(torch.float64), batch.triangles)
    ab, bc, ca = squared_edge_lengths(corners(batch.points.to(torch.float64), batch.triangles))
    a, b, c = (v.contiguous() for v in batch.triangles.unbind(1))
    total = ab.new_zeros(len(batch.points))
    total.index_add_(0, a, ab + ca).index_add_(0, b, ab + bc).index_add_(0, c, bc + ca)
    count = vertex_triangle_counts(batch.triangles, len(batch.points)).clamp_min(1)
    return (total / (2 * count)).sqrt()


def local_widths(batch: MeshBatch) -> Tensor:
    """(V,) the mean length of the edges at each vertex, in the batch's unit; 0 at vertices without any."""
    ends = edges(batch.triangles, batch.twin)
    a, b = batch.points.to(torch.float64)[ends].unbind(1)
    length = (b - a).norm(dim=1)
    return means_at_vertices(ends, length, len(batch.points))[0]
