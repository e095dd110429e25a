r"""The shape that triangles have on the whole at each place: the local median of their metrics.

Every triangle is equilateral in one metric of determinant 1.  With half its trace t and its deviator d, such a metric
is a point (t, d) of the hyperboloid t^2 - d^2 = 1, on which

    t t' - d d' = cosh(distance)

is the inverse mean ratio of a triangle of the one metric as the other metric sees it.  A mesh that is stretched four to
one throughout is one point there, and its median is that point; a few bad triangles, however bad, do not move it far.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.means import Means
from .metric_tensors import determinant, equilateral_metric, shape_edges


@dataclass(frozen=True)
class MedianOptions:
    """How `median_metric` works.

    sweeps   the median is over about so many rings of triangles round a vertex, weighted less the further away; four
             rings are some fifty triangles, so that a tangle of a few does not outweigh them
    rounds   steps of Weiszfeld's iteration; the weights settle to a few per cent in four
    nearest  a triangle counts as at least so far from the median, as a hyperbolic distance: 0.1 is a stretching of ten
             per cent, and weights need a bound
    """

    sweeps: int = 4
    rounds: int = 4
    nearest: float = 0.1

    def __post_init__(self) -> None:
        for name in ("sweeps", "rounds"):
            if getattr(self, name) < 1:
                raise ValueError(f"MedianOptions.{name} must be at least 1, not {getattr(self, name)}")
        if not self.nearest > 0:
            raise ValueError(f"MedianOptions.nearest must be positive, not {self.nearest}")


def median_metric(batch: MeshBatch, counted: Tensor, options: MedianOptions | None = None) -> Tensor:
    """(V, 3) entries m11, m12, m22 of the local median of the metrics of the triangles, of determinant 1.

    counted  (T,) bool, the triangles whose shapes count; where none is near, the metric is that of the plane

    The geometric median on the hyperboloid by Weiszfeld's iteration: each step is the weighted sum of the metrics,
    scaled to determinant 1, with the inverse hyperbolic sines of the distances as weights (Fletcher, Venkatasubramanian
    & Joshi, The geometric median on Riemannian manifolds with application to robust atlas estimation, NeuroImage 45,
    2009).  Turning or stretching the mesh turns or stretches the median.
    """
    options = options or MedianOptions()
    metric = triangle_metrics(batch)
    counted = counted & metric.isfinite().all(1)
    metric = torch.where(counted[:, None], metric, metric.new_tensor([1.0, 0.0, 1.0]))
    means = Means(batch)
    # The first weights bound each triangle by its own size, so that slivers do not drown the others.
    weight = counted / (0.5 * (metric[:, 0] + metric[:, 2]))
    found = _spread(means, metric * weight[:, None], options.sweeps)
    for _ in range(options.rounds):
        ratio = ratio_in(metric, _at_triangles(means, found))
        weight = counted / (ratio.square() - 1).clamp_min(options.nearest**2).sqrt()
        found = _spread(means, metric * weight[:, None], options.sweeps)
    return found


def usual_ratio(batch: MeshBatch, metric: Tensor, counted: Tensor, options: MedianOptions | None = None) -> Tensor:
    """(V,) the local mean of the inverse mean ratios of triangles, as the metric (V, 3) of determinant 1 sees them.

    counted  (T,) bool, the triangles that count; where none is near, the mean is 1
    """
    sweeps, means = (options or MedianOptions()).sweeps, Means(batch)
    own = triangle_metrics(batch)
    counted = counted & own.isfinite().all(1)
    own = torch.where(counted[:, None], own, own.new_tensor([1.0, 0.0, 1.0]))
    ratio = torch.where(counted, ratio_in(own, _at_triangles(means, metric)), 0.0)
    total, weight = (_diffused(means, column, sweeps) for column in (ratio, counted.to(ratio.dtype)))
    return torch.where(weight > 0, total / torch.where(weight > 0, weight, 1.0), 1.0)


def triangle_metrics(batch: MeshBatch) -> Tensor:
    """(T, 3) the metrics of determinant 1 in which the triangles are equilateral; not finite for flat ones."""
    metric = equilateral_metric(shape_edges(batch))
    return metric / determinant(metric).sqrt()[:, None]


def ratio_in(metric: Tensor, seen_by: Tensor) -> Tensor:
    """(N,) the inverse mean ratios of triangles with the metrics (N, 3) in other metrics, all of determinant 1.

    Half the trace of the one times the inverse of the other: t t' - d d'.
    """
    a, b = metric.unbind(1), seen_by.unbind(1)
    return 0.5 * (a[0] * b[2] + a[2] * b[0]) - a[1] * b[1]


def _spread(means: Means, values: Tensor, sweeps: int) -> Tensor:
    """(V, 3) the values (T, 3) summed over the triangles round each vertex and beyond, scaled to determinant 1."""
    return _unit(torch.stack([_diffused(means, column.contiguous(), sweeps) for column in values.unbind(1)], 1))


def _diffused(means: Means, values: Tensor, sweeps: int) -> Tensor:
    """(V,) means of the values (T,) over the triangles round each vertex, taken so many times."""
    at_vertices = means.round_vertices(values)
    for _ in range(sweeps - 1):
        at_vertices = means.round_vertices(means.of_corners(at_vertices))
    return at_vertices


def _at_triangles(means: Means, metric: Tensor) -> Tensor:
    """(T, 3) the metric (V, 3) at the triangles: the mean over the corners, scaled to determinant 1."""
    return _unit(torch.stack([means.of_corners(column.contiguous()) for column in metric.unbind(1)], 1))


def _unit(metric: Tensor) -> Tensor:
    """Metrics (N, 3) scaled to determinant 1; that of the plane where there is none."""
    size = metric[:, 0] + metric[:, 2]
    some = size > 0
    near_one = metric / torch.where(some, size, 1.0)[:, None]
    det = determinant(near_one)
    some &= det > 0
    unit = near_one / torch.where(some, det, 1.0).sqrt()[:, None]
    return torch.where(some[:, None], unit, metric.new_tensor([1.0, 0.0, 1.0]))
