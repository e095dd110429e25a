"""A metric tensor for every point of the plane, in which ideal triangles are equilateral."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch, vertex_mesh
from ..mesh.means import sums_at_vertices
from .jacobian import EdgeMap
from .metric_tensors import determinant, metric_of_targets, stretching

# A matrix that is symmetric but for this part of its largest entry was rounded, perhaps in single precision.
_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class MetricField:
    """A metric for the plane, in which ideal triangles are equilateral.

    values  (V, 3) entries m11, m12, m22 or (V, 2, 2) matrices, one a vertex of the batch, which
            moves with the vertex; or a function of positions (N, 2) to (N, 3) or (N, 2, 2), which is called with
            the positions of the vertices at the start of every smoothing and flipping.  Within a triangle
            the metric is the mean of those at its corners, each scaled to determinant 1.

    Raises ValueError for a tensor of another shape.  That the metric is positive definite is checked where it is
    used.
    """

    values: Tensor | Callable[[Tensor], Tensor]

    def __post_init__(self) -> None:
        if isinstance(self.values, Tensor) and self.values.shape[1:] not in ((3,), (2, 2)):
            raise ValueError(f"MetricField.values must be (V, 3) or (V, 2, 2), not {tuple(self.values.shape)}")
        if not isinstance(self.values, Tensor) and not callable(self.values):
            raise ValueError(f"MetricField.values must be a tensor or a function, not {type(self.values).__name__}")

    @classmethod
    def from_targets(cls, matrices: Tensor | Callable[[Tensor], Tensor]) -> "MetricField":
        """The metric in which triangles with the target matrix W of their position are equilateral.

        matrices  (V, 2, 2) one W a vertex, or a function of positions (N, 2) to (N, 2, 2): the columns are two edges
                  of the ideal triangle as it lies there, from its corner a to b and to c, counter-clockwise; of any
                  size

        M = W^-T E^T E W^-1 with E the matrix of the equilateral triangle.  A metric tells only in which direction
        triangles are long, not which of their edges is the long one; so edges may flip.
        SmoothOptions(targets=...) takes such a function as it is.  Raises InvalidMeshError, naming the row, where
        det W is not positive.
        """
        if isinstance(matrices, Tensor):
            return cls(metric_of_targets(matrices, "targets"))
        return cls(lambda positions: metric_of_targets(matrices(positions), "the target function's result"))

    @classmethod
    def from_triangles(cls, batch: MeshBatch, matrices: Tensor) -> "MetricField":
        """The metric of target matrices W (T, 2, 2), one a triangle of the batch: the mean of those round each vertex.

        Each is scaled to determinant 1 first.  Raises InvalidMeshError, naming the row, where det W is not positive.
        """
        if len(matrices) != len(batch.triangles):
            raise InvalidMeshError(
                f"targets must be {len(batch.triangles)} matrices, one a triangle, not {len(matrices)}"
            )
        return cls(mean_at_vertices(batch, metric_of_targets(matrices, "targets")))

    @classmethod
    def stretched(
        cls,
        direction: Tensor | Callable[[Tensor], Tensor],
        aspect: float | Tensor | Callable[[Tensor], Tensor],
    ) -> "MetricField":
        """The metric of triangles `aspect` times as long in `direction` as they are wide.

        direction  (V, 2) of any length, or a function of positions (N, 2) to (N, 2); where it is 0, triangles are
                   equilateral
        aspect     a number, (V,), or a function of positions to (N,), all positive

        I + (1 / aspect^2 - 1) d d^T, d the direction scaled to length 1.  Raises ValueError for a number or tensor
        that is not positive; what a function returns is checked where it is used.
        """
        if not callable(aspect) and not bool((torch.as_tensor(aspect) > 0).all()):
            raise ValueError(f"MetricField.stretched needs a positive aspect, not {aspect}")
        if not callable(direction) and not callable(aspect):
            return cls(stretching(direction, torch.as_tensor(aspect)))

        def metric(positions: Tensor) -> Tensor:
            there = direction(positions) if callable(direction) else direction
            ratio = aspect(positions) if callable(aspect) else torch.as_tensor(aspect, device=positions.device)
            return stretching(there, ratio)

        return cls(metric)

    def at_vertices(self, batch: MeshBatch) -> Tensor:
        """(V, 3) float64 entries of the metric at the batch's vertices, scaled to determinant 1.

        Raises InvalidMeshError, naming the vertex, where it is not positive definite.
        """
        values, count = self.values, len(batch.points)
        name = "MetricField.values"
        if not isinstance(values, Tensor):
            values, name = values(batch.points), "the metric function's result"
        if values.shape not in ((count, 3), (count, 2, 2)):
            raise InvalidMeshError(f"{name} must be ({count}, 3) or ({count}, 2, 2), not {tuple(values.shape)}")
        values = values.to(batch.points.device, torch.float64)
        if values.ndim == 3:
            values = _entries(values, name)
        # Near 1 before it is squared.
        size = (values[:, 0] + values[:, 2])[:, None]
        values = values / torch.where(size > 0, size, 1.0)
        det = determinant(values)
        bad = ~((size[:, 0] > 0) & (values[:, 0] > 0) & (det > 0) & values.isfinite().all(1))
        if bool(bad.any()):
            row = int(bad.nonzero()[0])
            raise InvalidMeshError(
                f"mesh {int(vertex_mesh(batch)[row])}: {name} row {row} is not positive definite "
                "(or so thin that it rounds to that)"
            )
        return values / det.sqrt()[:, None]


def _entries(matrices: Tensor, name: str) -> Tensor:
    """(V, 3) the entries of symmetric matrices (V, 2, 2); InvalidMeshError, which calls them `name`, for others."""
    skew = (matrices[:, 0, 1] - matrices[:, 1, 0]).abs() > _ROUNDING * matrices.abs().amax((1, 2))
    if bool(skew.any()):
        row = int(skew.nonzero()[0])
        raise InvalidMeshError(f"{name} row {row} is {matrices[row].tolist()}: a metric is symmetric")
    mean = 0.5 * matrices[:, 0, 1] + 0.5 * matrices[:, 1, 0]
    return torch.stack([matrices[:, 0, 0], mean, matrices[:, 1, 1]], 1)


def mean_at_vertices(batch: MeshBatch, metric: Tensor) -> Tensor:
    """(V, 3) a multiple of the mean of the metrics (T, 3) of the triangles round each vertex."""
    total = sums_at_vertices(batch.triangles, metric, len(batch.points))
    # Any metric serves for a vertex that belongs to no triangle.
    total[total[:, 0] == 0] = total.new_tensor([1.0, 0.0, 1.0])
    return total


def edge_map_of(metric: Tensor, triangles: Tensor) -> EdgeMap:
    """The roots of the metrics of `triangles` (T, 3): the means of those at their corners, `metric` (V, 3)."""
    return EdgeMap.root_of(sum(metric[triangles[:, corner]] for corner in range(3)))  # type: ignore[arg-type]
