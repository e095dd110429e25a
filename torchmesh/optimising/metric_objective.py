"""The smoothing energy in a metric field whose values travel with the vertices."""

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.ragged import spread
from ..mesh.triangle import SQRT3, Corners, corners, signed_area, squared_edge_lengths
from .energies import select_rows
from .objective import MeshObjective, Packing
from .targets import MetricField, Targets, _roots, _stretched, _target


def aim(objective: MeshObjective, batch: MeshBatch, packing: Packing, targets: Targets) -> MeshObjective:
    """`objective` with these targets in place of equilateral triangles."""
    scale = packing.spread_vertices(_vertex_height(batch) / spread(packing.unit, batch.point_offsets))
    if isinstance(targets, MetricField):
        roots = _roots(targets.at_vertices(batch), batch.triangles[packing.triangles])
        parts = {f.name: getattr(objective, f.name) for f in fields(objective)}
        return MetricObjective(**(parts | {"scale": scale}), roots=roots)
    return replace(objective, target=select_rows(_target(batch, targets), packing.triangles), scale=scale)


def _vertex_height(batch: MeshBatch) -> Tensor:
    """(V,) the least height of the triangles round each vertex: how far it may move before one inverts, about."""
    t = corners(batch.points.to(torch.float64), batch.triangles)
    ab, bc, ca = squared_edge_lengths(t)
    longest = torch.maximum(ab, torch.maximum(bc, ca)).sqrt()
    height = 2 * signed_area(t).abs() / torch.where(longest > 0, longest, 1.0)
    least = height.new_full((len(batch.points),), torch.inf)
    for corner in range(3):
        least.scatter_reduce_(0, batch.triangles[:, corner], height, "amin")
    return torch.where(least.isfinite(), least, 0.0)


@dataclass(frozen=True, eq=False)
class MetricObjective(MeshObjective):
    """A `MeshObjective` of triangles seen through their metric: the edges H e in place of e.

    roots  (T, 3) entries h11, h12, h22 of H for the packed triangles
    """

    roots: Tensor = None  # type: ignore[assignment]

    def __call__(self, unknowns: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
        coordinates = torch.cat([unknowns, self.anchored])
        rows = self.rows.long()
        h11, h12, h22 = self.roots.unbind(1)
        t = _stretched(Corners(*coordinates[rows]), self.roots)
        half = 4 / 3 * torch.stack([t.bx - 0.5 * t.cx, t.by - 0.5 * t.cy, t.cx - 0.5 * t.bx, t.cy - 0.5 * t.by])
        stretch = half[0] * t.bx + half[1] * t.by + half[2] * t.cx + half[3] * t.cy
        det = 2 / SQRT3 * (t.bx * t.cy - t.by * t.cx)
        phi, by_stretch, by_det = self.energy.value_and_slopes(stretch, det)
        by_stretch, by_det = 2 * by_stretch, 2 / SQRT3 * by_det
        f1x, f1y = by_stretch * half[0] + by_det * t.cy, by_stretch * half[1] - by_det * t.cx
        f2x, f2y = by_stretch * half[2] - by_det * t.by, by_stretch * half[3] + by_det * t.bx
        f1x, f1y = h11 * f1x + h12 * f1y, h12 * f1x + h22 * f1y
        f2x, f2y = h11 * f2x + h12 * f2y, h12 * f2x + h22 * f2y
        gradient = torch.zeros_like(coordinates)
        for at, part in zip(rows, (-(f1x + f2x), -(f1y + f2y), f1x, f1y, f2x, f2y), strict=True):
            gradient.index_add_(0, at, part)
        energy = torch.segment_reduce(phi, "sum", offsets=self.triangle_offsets, initial=0.0)
        return energy, gradient[: len(unknowns)], None

    def select(self, keep: Tensor) -> "MetricObjective":
        part = super().select(keep)
        parts = {f.name: getattr(part, f.name) for f in fields(part)}
        return MetricObjective(**(parts | {"roots": self.roots[spread(keep, self.triangle_offsets)]}))
