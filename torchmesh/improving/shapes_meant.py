"""The shapes that are meant at each place, and which triangles are damaged beside them."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.means import Means
from ..optimising.median_metric import median_metric, usual_ratio
from ..optimising.metric_field import MetricField
from ..optimising.targets import Targets, target_from, target_quality
from .needed import beyond, limits_of
from .options import ImproveOptions
from .parts import Parts, Pasted
from .state import State


@dataclass(frozen=True, eq=False)
class Meant:
    """The shapes that are meant.

    targets    a metric, with one row a vertex or as a function of positions, or matrices (T, 2, 2) of triangles
    usual      (V,) by how much the triangles nearby miss these shapes on the mean, as inverse mean ratios; None: what
               is meant was asked for
    reference  (T, 2, 2) the shapes of undeformed triangles, which count where the triangles are still the same
    triangles  (T, 3) int64, these triangles; -1 for others
    points     (V, 2) where the vertices of the reference are
    """

    targets: Targets
    usual: Tensor | None = None
    reference: Tensor | None = None
    triangles: Tensor | None = None
    points: Tensor | None = None

    @classmethod
    def of(cls, state: State) -> "Meant":
        """Those of the targets, if there are any; else the local median, and the reference where there is one."""
        if state.targets is not None:
            targets = state.targets
            if isinstance(targets, MetricField) and isinstance(targets.values, Tensor):
                targets = MetricField(targets.at_vertices(state.mesh))
            return cls(targets)
        upright = state.quality.upright
        median = median_metric(state.mesh, upright)
        usual = usual_ratio(state.mesh, median, upright)
        if state.reference is None:
            return cls(MetricField(median), usual)
        reference = state.reference
        return cls(MetricField(median), usual, target_from(reference), reference.triangles, reference.points)

    @property
    def of_vertices(self) -> Tensor | None:
        """(V, 3) the metric that moves with the vertices; None: there is none."""
        metric = self.targets.values if isinstance(self.targets, MetricField) else None
        return metric if isinstance(metric, Tensor) else None

    def ratio(self, mesh: MeshBatch) -> Tensor:
        """(T,) the inverse mean ratios of the triangles as the shapes meant see them, over what is usual nearby."""
        ratio = target_quality(mesh, self.targets)
        if self.usual is not None:
            ratio = ratio / Means(mesh).of_corners(self.usual)
        if self.reference is None or self.triangles is None or self.triangles.shape != mesh.triangles.shape:
            return ratio
        same = (mesh.triangles == self.triangles).all(1)
        return torch.where(same, target_quality(mesh, self.reference), ratio)

    def narrowed(self, parts: Parts) -> "Meant":
        """The same for the parts as they were cut out."""
        if isinstance(self.targets, Tensor):
            return Meant(self.targets[parts.triangles])
        usual = None if self.usual is None else self.usual[parts.vertices]
        targets = self.targets if self.of_vertices is None else MetricField(self.of_vertices[parts.vertices])
        if self.reference is None or self.triangles is None or len(self.triangles) != len(parts.batch.triangles):
            return Meant(targets, usual)
        same = (parts.batch.triangles == self.triangles).all(1)[parts.triangles]
        triangles = torch.where(same[:, None], parts.mesh.triangles, -1)
        if self.points is None or not len(parts.batch.quads):
            return Meant(targets, usual, self.reference[parts.triangles], triangles)
        # With quads there are more targets than rows of triangles.
        points = self.points[parts.vertices]
        return Meant(targets, usual, target_from(replace(parts.mesh, points=points)), triangles, points)

    def pasted(self, made: Pasted, there: "Meant", rows: Tensor) -> "Meant":
        """The same for other vertices; for inserted ones what is meant `there`, in the rows (V',) bool of parts."""
        assert self.of_vertices is not None
        assert there.of_vertices is not None
        metric = MetricField(made.by_vertex(self.of_vertices, there.of_vertices[rows]))
        if self.usual is None or there.usual is None:
            return Meant(metric)
        return Meant(metric, made.by_vertex(self.usual, there.usual[rows]))


def damaged(state: State, meant: Meant, options: ImproveOptions, spared: "Spared | None" = None) -> Tensor:
    """(T,) bool: the triangles that are inverted, or much worse than the shape that is meant at their place.

    With `options.when` they are those beyond the bound, and where targets are given, also beyond it as these see it.

    spared  what does not count as damage where `options.when` says what does; None: what is true of `state` itself
    """
    if options.when is None:
        return ~state.quality.upright | (meant.ratio(state.mesh) > options.damage.worse)
    spared = spared or Spared.of(state)
    bad = beyond(state.mesh, state.quality, options.when, spared.triangles, spared.limits)
    if state.targets is None or not bool(bad.any()):
        return bad
    # What is as the targets have it is not damaged, whatever its angles are.
    worse = meant.ratio(state.mesh) > min(options.when.ratio, options.damage.worse)
    return bad & (~state.quality.upright | worse)


@dataclass(frozen=True, eq=False)
class Spared:
    """What cannot be better, and is no damage for that.

    triangles  (T,) bool, those that nothing can change; None: there are none
    limits     what the boundary allows at each vertex, (V,) radians and (V,) inverse mean ratios
    """

    triangles: Tensor | None
    limits: tuple[Tensor, Tensor]

    @classmethod
    def of(cls, state: State) -> "Spared":
        """What is spared in whole meshes."""
        return cls(state.unchangeable, limits_of(state.mesh))

    def narrowed(self, parts: Parts, after: State) -> "Spared":
        """The same for the parts, that were cut out of these meshes, as they are in `after`."""
        angle, ratio = (limit[parts.vertices] for limit in self.limits)
        if after.names is not None:
            onward = after.vertex_names.vertex_map()
            return Spared(after.unchangeable, (onward.carry(angle), onward.carry(ratio)))
        return Spared(None if self.triangles is None else self.triangles[parts.triangles], (angle, ratio))
