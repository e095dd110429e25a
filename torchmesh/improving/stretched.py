"""Meshes that were meant to be stretched: valid ones whose triangles are long in a direction that varies smoothly.

Such a mesh aims at the shapes that it has: at triangles that are equilateral in its own metric, averaged over a few
rings, so that single poor triangles do not count.  Where triangles are long by chance, as in a tangle or after a
deformation, directions cancel in the average.
"""

from dataclasses import dataclass, replace
from functools import partial

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.ragged import counts_from_offsets, segment_count, spread, true_rows
from ..optimising.metric_field import MetricField, mean_at_vertices
from ..optimising.targets import metric_from
from .options import ImproveOptions
from .runner import Job, Log
from .state import State
from .strategies import improve_batch


@dataclass(frozen=True)
class StretchOptions:
    """What counts as stretched throughout.

    aspect  how many times as long as wide triangles are: the root of the ratio of the metric's eigenvalues
    share   this part of the vertices of a mesh, and of its triangles, is stretched at least so much
    sweeps  how often the metric is averaged over neighbours first
    thin    a mesh with a triangle of a higher inverse mean ratio has no shapes to keep: in double precision the metric
            of such a triangle is no longer positive definite for certain
    """

    aspect: float = 2.0
    share: float = 0.9
    sweeps: int = 2
    thin: float = 1e6

    @property
    def ratio(self) -> float:
        """The inverse mean ratio of an equilateral triangle after a stretch by `aspect`."""
        return 0.5 * (self.aspect + 1 / self.aspect)


def keeping_stretch(job: Job, options: ImproveOptions, limits: StretchOptions | None = None) -> Job:
    """The job that does `job`, but has meshes that are stretched throughout aim at their own shapes."""
    limits = limits or StretchOptions()

    def keep(state: State, log: Log) -> State:
        metric = own_metric(state, limits)
        if metric is None:
            return job(state, log)
        field, at = metric
        done = state
        if not bool(at.all()):
            done = done.put(~at, job(state.select(~at), log.of_meshes(done.mesh, ~at)))
        part = state.select(at).naming_after(done)
        rows = spread(at, state.mesh.point_offsets)
        towards = MetricField(field[rows])
        aiming = replace(options, smooth=replace(options.smooth, targets=towards))
        stretched = partial(improve_batch, options=aiming)
        note = dict.fromkeys(range(len(part)), "; a mesh stretched throughout: its own shapes were the aim")
        found = stretched(replace(part, targets=towards).noted(note), log.of_meshes(done.mesh, at))
        return done.put(at, replace(found, targets=None))

    return keep


def own_metric(state: State, limits: StretchOptions) -> tuple[Tensor, Tensor] | None:
    """(V, 3) the metric of the meshes, and (B,) bool which are stretched throughout; None if none is."""
    offsets = state.mesh.triangle_offsets
    long = segment_count(state.quality.inverse_mean_ratio >= limits.ratio, offsets)
    at = state.valid & (state.quality.max <= limits.thin) & (long >= limits.share * counts_from_offsets(offsets))
    if not bool(at.any()):
        return None
    # Only these meshes are valid for certain.
    few = state.mesh.select(at)
    metric = _averaged(few, metric_from(few).at_vertices(few), limits.sweeps)
    used = torch.zeros(len(few.points), dtype=torch.bool, device=at.device)
    used[few.triangles.reshape(-1)] = True
    stretched = segment_count(used & (_aspect(metric) >= limits.aspect), few.point_offsets)
    enough = stretched >= limits.share * segment_count(used, few.point_offsets)
    whole = metric.new_tensor([1.0, 0.0, 1.0]).repeat(len(state.mesh.points), 1)
    whole[spread(at, state.mesh.point_offsets)] = metric
    at = at.index_put((true_rows(at),), enough)
    return (whole, at) if bool(at.any()) else None


def _averaged(mesh: MeshBatch, metric: Tensor, sweeps: int) -> Tensor:
    """(V, 3) the metric, averaged so often over the triangles round each vertex and their corners."""
    for _ in range(sweeps):
        of_triangles = metric[mesh.triangles].sum(1)
        det = of_triangles[:, 0] * of_triangles[:, 2] - of_triangles[:, 1] * of_triangles[:, 1]
        metric = MetricField(mean_at_vertices(mesh, of_triangles / det.sqrt()[:, None])).at_vertices(mesh)
    return metric


def _aspect(metric: Tensor) -> Tensor:
    """(V,) the root of the ratio of the eigenvalues of a metric of determinant 1."""
    half = 0.5 * (metric[:, 0] + metric[:, 2])
    return half + (half * half - 1).clamp_min(0).sqrt()
