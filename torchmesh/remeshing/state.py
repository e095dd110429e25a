"""Meshes that are being remeshed, with everything that belongs to their rows.

    RemeshState --- select(at) ---> the state of some of its meshes --- a cut, flips, smoothing ---> another state
      ^                                                                                                 |
      +------------------------------------------- put(at, ...) ----------------------------------------+

A state never changes; each step gives back another one.  `Editable` is the opposite: the short-lived form of
a state in which splits and collapses change rows in place.
"""

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ..mesh import connectivity
from ..mesh.batch import MeshBatch, vertex_mesh
from ..mesh.interfaces import Interfaces, interface_vertices
from ..mesh.kept_edges import constrained_half_edges
from ..mesh.measure import Quality, quality
from ..mesh.ragged import counts_from_offsets, offsets_from_counts, put_rows, spread, true_rows
from ..mesh.units import centre_and_unit_of_triangles
from ..mesh.vertex_map import Names, exchange
from .metric_sizing import metric_quality
from .mutable import Editable, compact
from .point_sources import PointSources

_COUNTS = ("splits", "collapses", "flips", "rounds")


@dataclass(frozen=True, eq=False)
class RemeshState:
    """B meshes, and what belongs to them and to their V vertices.

    batch      the meshes
    size       (V,) float64, the edge length wanted at each vertex, in the unit of the points; lengths in the
               metric, if there is one
    names      which vertices of the first batch these are, or between which they were inserted
    wanted     (B,) int64, how many triangles the sizes aim at
    splits, collapses, flips, rounds  (B,) int64, what was done so far
    metric     (V, 3) float64, entries m11, m12, m22 of determinant 1; None: lengths are those of the plane
    sources    the point sources from which sizes grow (condensation only)
    free_interfaces  whether the vertices on constrained edges move like any vertex; collapses spare them all the same
    """

    batch: MeshBatch
    size: Tensor
    names: Names
    wanted: Tensor
    splits: Tensor
    collapses: Tensor
    flips: Tensor
    rounds: Tensor
    metric: Tensor | None = None
    sources: PointSources | None = None
    free_interfaces: bool = False

    @classmethod
    def begin(
        cls,
        batch: MeshBatch,
        size: Tensor,
        *,
        names: Names | None = None,
        metric: Tensor | None = None,
        sources: PointSources | None = None,
        interfaces: Interfaces | None = None,
    ) -> "RemeshState":
        """The state before anything was done, with sizes that aim at as many triangles as there are.

        names       None: `batch` is where the vertex map begins
        interfaces  "free": their vertices move like any vertex; otherwise the caller holds them
        """
        names = Names.of_rows(len(batch.points), batch.points.device) if names is None else names
        wanted = counts_from_offsets(batch.triangle_offsets)
        zero = torch.zeros(len(batch), dtype=torch.int64, device=batch.points.device)
        return cls(batch, size, names, wanted, zero, zero, zero, zero, metric, sources, interfaces == "free")

    def __len__(self) -> int:
        return len(self.batch)

    @property
    def triangles(self) -> Tensor:
        """(B,) int64, how many triangles each mesh has."""
        return counts_from_offsets(self.batch.triangle_offsets)

    def every(self) -> Tensor:
        """(B,) bool, all true."""
        return torch.ones_like(self.rounds, dtype=torch.bool)

    def quality(self) -> Quality:
        """The quality of the meshes, as the metric sees it if there is one."""
        return quality(self.batch) if self.metric is None else metric_quality(self.batch, self.metric)

    def select(self, at: Tensor) -> "RemeshState":
        """The state of the meshes `at` (B,) bool."""
        if bool(at.all()):
            return self
        rows = spread(at, self.batch.point_offsets)
        return RemeshState(
            batch=self.batch.select(at),
            size=self.size[rows],
            names=self.names.select(rows),
            wanted=self.wanted[at],
            metric=None if self.metric is None else self.metric[rows],
            sources=None if self.sources is None else self.sources.select(at),
            free_interfaces=self.free_interfaces,
            **{name: getattr(self, name)[at] for name in _COUNTS},
        )

    def put(self, at: Tensor, part: "RemeshState") -> "RemeshState":
        """This state with the meshes `at` (B,) bool replaced by those of `part`, which came of `select(at)`."""
        if len(part) == len(self):
            return part
        if not len(part):
            return self
        pairs = [(self.size, part.size), (self.names.of, part.names.of)]
        if self.metric is not None and part.metric is not None:
            pairs.append((self.metric, part.metric))
        batch, size, of, *metric = exchange(self.batch, at, part.batch, pairs)
        row = true_rows(at)
        counts: dict[str, Any] = {name: put_rows(getattr(self, name), row, getattr(part, name)) for name in _COUNTS}
        return replace(
            self,
            batch=batch,
            size=size,
            names=self.names.later(part.names).renamed(of),
            metric=metric[0] if metric else None,
            **counts,
        )

    def released(self, given: MeshBatch, begun: "RemeshState") -> MeshBatch:
        """The batch as it is now, with the fixed vertices of `given`, of which `begun` had also held the interfaces.

        Vertices that halve a boundary edge are fixed, those that halve an interface are not.
        """
        if begun.batch.fixed is given.fixed:
            return self.batch
        fixed = torch.isin(self.names.of, begun.names.of[given.fixed])
        fixed |= connectivity.boundary_vertices(self.batch.triangles, self.batch.twin, len(fixed))
        return replace(self.batch, fixed=fixed)

    def taken_back(self, at: Tensor, before: "RemeshState") -> "RemeshState":
        """This state with the meshes `at` (B,) bool as they were `before`; flips and rounds still count as done."""
        if not bool(at.any()):
            return self
        names = self.names.later(before.names)
        back = replace(before.select(at), flips=self.flips[at], rounds=self.rounds[at])
        return self.put(at, replace(back, names=names.renamed(back.names.of)))


def unit_of(batch: MeshBatch) -> Tensor:
    """(B,) the unit of length in which `editable` has each mesh."""
    # A power of two changes no sign and keeps every square in range.
    return centre_and_unit_of_triangles(batch.points, batch.triangles, batch.point_offsets)[1]


def editable(state: RemeshState) -> Editable:
    """The meshes in the form in which splits and collapses change them."""
    batch = state.batch
    unit = spread(unit_of(batch), batch.point_offsets)
    points = batch.points.to(torch.float64) / unit[:, None]
    return Editable(
        x=points[:, 0].contiguous(),
        y=points[:, 1].contiguous(),
        size=state.size / unit,
        fixed=batch.fixed | interface_vertices(batch),
        mesh=vertex_mesh(batch),
        origin=state.names.of.clone(),
        vertex=batch.triangles.reshape(-1).clone(),
        twin=batch.twin.clone(),
        locked=constrained_half_edges(batch),
        alive=torch.ones_like(batch.fixed),
        dtype=batch.points.dtype,
        fresh=state.names.fresh,
        births=list(state.names.births),
        meshes=len(batch),
        metric=None if state.metric is None else state.metric.clone(),
    )


def rebuilt(state: RemeshState, e: Editable) -> RemeshState:
    """The state of the meshes that `e`, which was made of `state`, has become; the counts stay as they were."""
    kept, faces, locked, vertices, triangles = compact(e)
    unit = unit_of(state.batch)[e.mesh[kept]]
    points = (torch.stack([e.x[kept], e.y[kept]], 1) * unit[:, None]).to(state.batch.points)
    fixed = e.fixed[kept]
    if state.free_interfaces:
        # What `editable` held for the edits is free again, and so is what halves an edge between such vertices.
        there, count = kept < len(state.batch.fixed), len(kept)
        on_boundary = connectivity.boundary_vertices(faces, connectivity.twins(faces), count)
        fixed = torch.where(there, state.batch.fixed[kept.clamp_max(len(state.batch.fixed) - 1)], on_boundary)
    batch = MeshBatch(
        points,
        faces,
        fixed,
        locked,
        offsets_from_counts(vertices),
        offsets_from_counts(triangles),
        state.batch.frames,
    )
    return replace(
        state,
        batch=batch,
        size=e.size[kept] * unit,
        names=state.names.renamed(e.origin[kept], e.fresh, tuple(e.births)),
        metric=None if e.metric is None else e.metric[kept],
    )
