"""Shape metrics under the names people know them by, per triangle and summed up per mesh.

Names, formulae and ranges are those of the Verdict manual (Stimpson, Ernst, Knupp, Pebay &
Thompson, The Verdict Geometric Quality Library, SAND2007-1751), whose triangles stand in space and
have no sign.  Here a triangle has one, and this is what becomes of it:

- `area`, `mean_ratio` and `scaled_jacobian` carry the sign: negative for an inverted triangle, 0 for
  a flat one, smooth where one becomes the other.  `shape` is the mean ratio, but never below 0.
- All others, `equiangle_skew` of later versions of VTK among them, are those of the mirror image.
  For a flat triangle ratios are infinite (`edge_ratio` only where two corners coincide), angles 0 and
  180 degrees, the skew 1.

Gradients flow to the points.  They are exact where the metric is smooth, those of one branch where
two edges or angles tie, and 0 for a flat triangle's infinite ratio: finite everywhere.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from . import triangle
from .batch import MeshBatch
from .ragged import counts_from_offsets, percentiles, segment_max, segment_min, segment_sum
from .triangle import Corners, corners

__all__ = ["METRICS", "Metric", "Summary", "evaluate", "measure", "percentiles"]


def __dir__() -> list[str]:
    return __all__


@dataclass(frozen=True)
class Metric:
    """One shape metric.

    name      as in `METRICS`
    formula   corners of T triangles to (T,)
    ideal     its value for an equilateral triangle; None: a size, which has none
    lowest, highest  its range over all triangles, inverted and flat ones included
    unit      "degrees", "length^2" or "" for a pure number
    verdict   what the Verdict manual calls it, if it has it
    """

    name: str
    formula: Callable[[Corners], Tensor]
    ideal: float | None
    lowest: float
    highest: float
    unit: str = ""
    verdict: str | None = None


def _degrees(formula: Callable[[Corners], Tensor]) -> Callable[[Corners], Tensor]:
    return lambda t: formula(t) * (180 / math.pi)


def _shape(t: Corners) -> Tensor:
    """(T,) the algebraic shape metric (Knupp, Algebraic mesh quality metrics, SIAM J. Sci. Comput. 23, 2001)."""
    return triangle.mean_ratio(t).clamp_min(0)


def _equiangle_skew(t: Corners) -> Tensor:
    """(T,) how far the worst angle is from 60 degrees, as a part of how far it can be."""
    third = math.pi / 3
    widest, narrowest = triangle.maximum_angle(t), triangle.minimum_angle(t)
    return torch.maximum((widest - third) / (math.pi - third), (third - narrowest) / third)


METRICS: dict[str, Metric] = {
    metric.name: metric
    for metric in (
        Metric("area", triangle.signed_area, None, -math.inf, math.inf, "length^2", "area"),
        Metric("inverse_mean_ratio", triangle.inverse_mean_ratio, 1, 1, math.inf, "", "aspect Frobenius"),
        Metric("mean_ratio", triangle.mean_ratio, 1, -1, 1),
        Metric("shape", _shape, 1, 0, 1, "", "shape"),
        Metric("scaled_jacobian", triangle.scaled_jacobian, 1, -1, 1, "", "scaled Jacobian"),
        Metric("condition", triangle.inverse_mean_ratio, 1, 1, math.inf, "", "condition"),
        Metric("aspect_ratio", triangle.aspect_ratio, 1, 1, math.inf, "", "aspect ratio"),
        Metric("radius_ratio", triangle.radius_ratio, 1, 1, math.inf, "", "radius ratio"),
        Metric("edge_ratio", triangle.edge_ratio, 1, 1, math.inf, "", "edge ratio"),
        Metric("minimum_angle", _degrees(triangle.minimum_angle), 60, 0, 60, "degrees", "minimum angle"),
        Metric("maximum_angle", _degrees(triangle.maximum_angle), 60, 60, 180, "degrees", "maximum included angle"),
        Metric("equiangle_skew", _equiangle_skew, 0, 0, 1),
    )
}


"""The metrics by name.  Of triangles, Verdict's condition number and aspect Frobenius are the inverse mean ratio."""


def measure(batch: MeshBatch, name: str) -> Tensor:
    """(T,) float64, the metric `name` of every triangle, differentiable with respect to `batch.points`.

    Raises ValueError for a name that is not in `METRICS`.
    """
    return _metric(name).formula(corners(batch.points.to(torch.float64), batch.triangles))


@dataclass(frozen=True, eq=False)
class Summary:
    """How a metric is spread over the triangles of each mesh.

    metric       what was measured
    values       (T,) of every triangle
    min, mean, max  (B,) per mesh
    percents     the P percentages asked for
    percentiles  (B, P) the values below which that percentage of a mesh's triangles lies, linear
                 between neighbours in order (numpy's default)
    """

    metric: Metric
    values: Tensor
    min: Tensor
    mean: Tensor
    max: Tensor
    percents: tuple[float, ...]
    percentiles: Tensor

    def records(self) -> list[dict[str, Any]]:
        """One plain record a mesh: min, mean, max and p5, p50, ... as numbers."""
        rows = torch.cat([torch.stack([self.min, self.mean, self.max], 1), self.percentiles], 1).tolist()
        names = ["min", "mean", "max", *(f"p{percent:g}" for percent in self.percents)]
        return [dict(zip(names, row, strict=True)) for row in rows]


def evaluate(
    batch: MeshBatch, names: Sequence[str] | None = None, percents: Sequence[float] = (5, 50, 95)
) -> dict[str, Summary]:
    """Measure a batch by the metrics `names`, all of `METRICS` by default.

    percents  percentages from 0 to 100, the percentiles to take of each mesh

    Raises ValueError for a name that is not in `METRICS`, or a percentage outside 0 to 100.
    """
    if isinstance(names, str):
        raise ValueError(f"names must be a list of metric names; for one, write [{names!r}]")
    wanted = [_metric(name) for name in (METRICS if names is None else names)]
    for percent in percents:
        if not 0 <= percent <= 100:
            raise ValueError(f"percents must lie between 0 and 100, not {percent}")
    offsets = batch.triangle_offsets
    t = corners(batch.points.to(torch.float64), batch.triangles)
    summaries = {}
    for metric in wanted:
        values = metric.formula(t)
        summaries[metric.name] = Summary(
            metric,
            values,
            segment_min(values, offsets),
            segment_sum(values, offsets) / counts_from_offsets(offsets),
            segment_max(values, offsets),
            tuple(percents),
            percentiles(values, offsets, percents),
        )
    return summaries


def _metric(name: str) -> Metric:
    if name not in METRICS:
        raise ValueError(f"there is no metric {name!r}; there are {', '.join(METRICS)}")
    return METRICS[name]
