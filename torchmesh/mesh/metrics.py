"""Shape metrics under the names people know them by, per triangle, per quad and summed up per mesh.

Names, formulae and ranges are those of the Verdict manual (Stimpson, Ernst, Knupp, Pebay &
Thompson, The Verdict Geometric Quality Library, SAND2007-1751), whose triangles stand in space and
have no sign.  Here a triangle has one, and this is what becomes of it:

- `area`, `mean_ratio` and `scaled_jacobian` carry the sign: negative for an inverted triangle, 0 for
  a flat one, smooth where one becomes the other.  `shape` is the mean ratio, but never below 0.
- All others, `equiangle_skew` of later versions of VTK among them, are those of the mirror image.
  For a flat triangle ratios are infinite (`edge_ratio` only where two corners coincide), angles 0 and
  180 degrees, the skew 1.

Those of quads are `QUAD_METRICS`.  There `area`, `mean_ratio`, `scaled_jacobian` and `jacobian` carry the sign, and an
angle at a corner that turns inwards is above 180 degrees.

Gradients flow to the points.  They are exact where the metric is smooth, those of one branch where
two edges or angles tie, and 0 for a flat triangle's infinite ratio: finite everywhere.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from . import quadrilateral, triangle
from .batch import MeshBatch
from .quadrilateral import quad_corners
from .quads import quad_mesh
from .ragged import (
    counts_from_offsets,
    offsets_from_counts,
    percentiles,
    segment_ids,
    segment_max,
    segment_min,
    segment_sum,
)
from .triangle import corners
from .typed import typed

__all__ = ["METRICS", "QUAD_METRICS", "Metric", "Summary", "evaluate", "measure", "measure_quads", "percentiles"]


def __dir__() -> list[str]:
    return __all__


@dataclass(frozen=True)
class Metric:
    """One shape metric.

    name      as in `METRICS` or `QUAD_METRICS`
    formula   corners of T triangles to (T,), or of Q quads to (Q,)
    ideal     its value for an equilateral triangle or a square; None: a size, which has none
    lowest, highest  its range over all triangles or quads, inverted and flat ones included
    unit      "degrees", "length^2" or "" for a pure number
    verdict   what the Verdict manual calls it, if it has it
    """

    name: str
    formula: Callable[[Any], Tensor]
    ideal: float | None
    lowest: float
    highest: float
    unit: str = ""
    verdict: str | None = None


def _degrees(formula: Callable[[Any], Tensor]) -> Callable[[Any], Tensor]:
    return lambda t: formula(t) * (180 / math.pi)


def _shape(t: triangle.Corners) -> Tensor:
    """(T,) the algebraic shape metric (Knupp, Algebraic mesh quality metrics, SIAM J. Sci. Comput. 23, 2001)."""
    return triangle.mean_ratio(t).clamp_min(0)


def _equiangle_skew(t: triangle.Corners) -> Tensor:
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

QUAD_METRICS: dict[str, Metric] = {
    metric.name: metric
    for metric in (
        Metric("area", quadrilateral.signed_area, None, -math.inf, math.inf, "length^2", "signed area"),
        Metric("inverse_mean_ratio", quadrilateral.inverse_mean_ratio, 1, 1, math.inf),
        Metric("mean_ratio", quadrilateral.signed_shape, 1, -1, 1),
        Metric("shape", quadrilateral.shape, 1, 0, 1, "", "shape"),
        Metric("scaled_jacobian", quadrilateral.scaled_jacobian, 1, -1, 1, "", "scaled Jacobian"),
        Metric("jacobian", quadrilateral.jacobian, None, -math.inf, math.inf, "length^2", "Jacobian"),
        Metric("condition", quadrilateral.condition, 1, 1, math.inf, "", "condition"),
        Metric("aspect_ratio", quadrilateral.aspect_ratio, 1, 1, math.inf, "", "aspect ratio"),
        Metric("radius_ratio", quadrilateral.radius_ratio, 1, 1, math.inf, "", "radius ratio"),
        Metric("edge_ratio", quadrilateral.edge_ratio, 1, 1, math.inf, "", "edge ratio"),
        Metric("skew", quadrilateral.skew, 0, 0, 1, "", "skew"),
        Metric("taper", quadrilateral.taper, 0, 0, math.inf, "", "taper"),
        Metric("stretch", quadrilateral.stretch, 1, 0, math.inf, "", "stretch"),
        Metric("warpage", quadrilateral.warpage, 0, 0, 0, "", "warpage"),
        Metric("minimum_angle", _degrees(quadrilateral.minimum_angle), 90, 0, 90, "degrees", "minimum included angle"),
        Metric("maximum_angle", _degrees(quadrilateral.maximum_angle), 90, 0, 360, "degrees", "maximum included angle"),
        Metric("equiangle_skew", quadrilateral.equiangle_skew, 0, 0, 1),
    )
}
"""The metrics of quads by name.  Shape and condition are of the worst corner; the inverse mean ratio is the latter."""


@typed
def measure(batch: MeshBatch, name: str) -> Tensor:
    """(T,) float64, the metric `name` of every triangle, differentiable with respect to `batch.points`.

    Raises ValueError for a name that is not in `METRICS`.
    """
    return _metric(name, METRICS).formula(corners(batch.points.to(torch.float64), batch.triangles))


@typed
def measure_quads(batch: MeshBatch, name: str) -> Tensor:
    """(Q,) float64, the metric `name` of every quad, differentiable with respect to `batch.points`.

    Raises ValueError for a name that is not in `QUAD_METRICS`.
    """
    return _metric(name, QUAD_METRICS).formula(quad_corners(batch.points.to(torch.float64), batch.quads))


@dataclass(frozen=True, eq=False)
class Summary:
    """How a metric is spread over the triangles and quads of each mesh.

    metric       what was measured; that of quads where only they have it
    values       (T,) of every triangle; empty where only quads have the metric
    min, mean, max  (B,) per mesh, NaN where it has no element with the metric
    percents     the P percentages asked for
    percentiles  (B, P) the values below which that percentage of a mesh's elements lies, linear
                 between neighbours in order (numpy's default)
    quad_values  (Q,) of every quad; empty where only triangles have the metric
    """

    metric: Metric
    values: Tensor
    min: Tensor
    mean: Tensor
    max: Tensor
    percents: tuple[float, ...]
    percentiles: Tensor
    quad_values: Tensor

    def records(self) -> list[dict[str, Any]]:
        """One plain record a mesh: min, mean, max and p5, p50, ... as numbers."""
        rows = torch.cat([torch.stack([self.min, self.mean, self.max], 1), self.percentiles], 1).tolist()
        names = ["min", "mean", "max", *(f"p{percent:g}" for percent in self.percents)]
        return [dict(zip(names, row, strict=True)) for row in rows]


@typed
def evaluate(
    batch: MeshBatch, names: Sequence[str] | None = None, percents: Sequence[float] = (5, 50, 95)
) -> dict[str, Summary]:
    """Measure a batch by the metrics `names`, all that its elements have by default.

    What triangles and quads both have is summed up over both.

    percents  percentages from 0 to 100, the percentiles to take of each mesh

    Raises ValueError for a name that is in neither `METRICS` nor `QUAD_METRICS`, or a percentage outside 0 to 100.
    """
    if isinstance(names, str):
        raise ValueError(f"names must be a list of metric names; for one, write [{names!r}]")
    known = known_metrics(batch)
    wanted = [_metric(name, known) for name in (known if names is None else names)]
    for percent in percents:
        if not 0 <= percent <= 100:
            raise ValueError(f"percents must lie between 0 and 100, not {percent}")
    t = corners(batch.points.to(torch.float64), batch.triangles)
    if not len(batch.quads):
        offsets, nothing = batch.triangle_offsets, batch.points.new_zeros(0, dtype=torch.float64)
        of_triangles = ((metric, metric.formula(t)) for metric in wanted)
        return {m.name: _summary(m, values, nothing, values, offsets, percents) for m, values in of_triangles}
    q = quad_corners(batch.points.to(torch.float64), batch.quads)
    owners = segment_ids(batch.triangle_offsets), quad_mesh(batch)
    summaries = {}
    for metric in wanted:
        values, own = (
            table[metric.name].formula(rows) if metric.name in table else batch.points.new_zeros(0, dtype=torch.float64)
            for table, rows in ((METRICS, t), (QUAD_METRICS, q))
        )
        # Rows mesh by mesh, triangles before quads.
        owner = torch.cat([of if len(v) else of[:0] for of, v in zip(owners, (values, own), strict=True)])
        order = owner.argsort(stable=True)
        offsets = offsets_from_counts(torch.bincount(owner, minlength=len(batch)))
        both = torch.cat([values, own])[order]
        summaries[metric.name] = _summary(metric, values, own, both, offsets, percents)
    return summaries


def known_metrics(batch: MeshBatch) -> dict[str, Metric]:
    """The metrics that the elements of the batch have; those of quads only where there are quads."""
    return {**METRICS, **QUAD_METRICS, **METRICS} if len(batch.quads) else METRICS


def _summary(
    metric: Metric, values: Tensor, quads: Tensor, both: Tensor, offsets: Tensor, percents: Sequence[float]
) -> Summary:
    """The summary of the values `both` (N,) of the elements, mesh by mesh."""
    some = counts_from_offsets(offsets) > 0
    ends, nothing = offsets, None
    if not bool(some.all()):
        ends = offsets_from_counts(counts_from_offsets(offsets)[some])
        nothing = both.new_full((len(some), 3 + len(percents)), torch.nan)
    least, most = segment_min(both, ends), segment_max(both, ends)
    mean = segment_sum(both, ends) / counts_from_offsets(ends)
    parts = percentiles(both, ends, percents)
    if nothing is not None:
        nothing[some] = torch.cat([torch.stack([least, mean, most], 1), parts], 1)
        least, mean, most, parts = nothing[:, 0], nothing[:, 1], nothing[:, 2], nothing[:, 3:]
    return Summary(metric, values, least, mean, most, tuple(percents), parts, quads)


def _metric(name: str, known: dict[str, Metric]) -> Metric:
    if name not in known:
        raise ValueError(f"there is no metric {name!r}; there are {', '.join(known)}")
    return known[name]
