"""Lengths and sizes in a metric, for remeshing towards triangles that are not equilateral in the plane.

The metric has determinant 1 everywhere (`MetricField.at_vertices`) and says how triangles are stretched.  The size
field says how long edges should be when the metric measures them: sqrt(e^T M e), where M is the mean of the metrics
at both ends.  An edge is good if that length is the size wanted (Loseille & Alauzet, Continuous mesh framework, SIAM
Journal on Numerical Analysis 49, 2011; here size and stretching are kept apart).  Areas are measured in the plane.
"""

from dataclasses import replace

import torch
from torch import Tensor

from ..mesh import connectivity
from ..mesh.batch import MeshBatch
from ..mesh.measure import Quality, quality
from ..mesh.ragged import counts_from_offsets, segment_max, segment_sum
from ..optimising.laplacian import harmonic_extension
from ..optimising.metric_field import MetricField
from ..optimising.targets import target_quality
from .sizing import SizeConformity, Sizes, conformity, mean_at_vertices, size_field


def metric_lengths(batch: MeshBatch, edges: Tensor, metric: Tensor) -> Tensor:
    """(E,) float64 the lengths of the edges (E, 2) in the metric (V, 3), with entries m11, m12, m22."""
    points = batch.points.to(torch.float64)
    step = points[edges[:, 0]] - points[edges[:, 1]]
    size = step.abs().amax(1)
    x, y = (step / torch.where(size > 0, size, 1.0)[:, None]).unbind(1)
    m11, m12, m22 = (0.5 * (metric[edges[:, 0]] + metric[edges[:, 1]])).unbind(1)
    return size * (m11 * x * x + 2 * m12 * x * y + m22 * y * y).sqrt()


def metric_size_field(batch: MeshBatch, sizes: Sizes, metric: Tensor, triangles: Tensor) -> Tensor:
    """(V,) float64 the edge lengths wanted in the metric (V, 3); arguments as in `size_field`.

    Here "boundary" continues the lengths inwards as they are, whatever number of triangles that gives.
    """
    if not isinstance(sizes, str) or sizes == "uniform":
        return size_field(batch, sizes, triangles=triangles)
    twin = batch.twin
    if sizes == "keep":
        edges = connectivity.edges(batch.triangles, twin)
        return mean_at_vertices(edges, metric_lengths(batch, edges, metric), batch)[0]
    held = torch.cat([connectivity.boundary_edges(batch.triangles, twin), batch.constrained_edges])
    length, known = mean_at_vertices(held, metric_lengths(batch, held, metric), batch)
    known = known | (connectivity.vertex_triangle_counts(batch.triangles, len(batch.points)) == 0)
    # All weights are 1, whatever the shapes.  Positive weights keep all sizes within the range of the boundary's.
    even = (length.new_ones(len(batch.triangles)),) * 3
    return harmonic_extension(batch.triangles, even, known, length[:, None], batch.point_offsets)[:, 0]


def metric_quality(batch: MeshBatch, metric: Tensor) -> Quality:
    """The quality of the batch, with inverse mean ratios measured in the metric (V, 3)."""
    ratio, offsets = target_quality(batch, MetricField(metric)), batch.triangle_offsets
    mean = segment_sum(ratio, offsets) / counts_from_offsets(offsets)
    return replace(quality(batch), inverse_mean_ratio=ratio, mean=mean, max=segment_max(ratio, offsets))


def metric_conformity(batch: MeshBatch, size: Tensor, metric: Tensor) -> SizeConformity:
    """How well the edges of each mesh follow the sizes (V,), with lengths measured in the metric (V, 3)."""
    return conformity(batch, size, lambda edges: metric_lengths(batch, edges, metric))


def unit_metric(metric: Tensor) -> Tensor:
    """(V, 3) the metric, scaled to determinant 1."""
    return metric / (metric[:, 0] * metric[:, 2] - metric[:, 1] * metric[:, 1]).sqrt()[:, None]
