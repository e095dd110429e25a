"""The regions of a mesh, which boundary and constrained edges enclose, and how their areas change.

+-----+-----+        +-----+-----+
|  A  |  B  |  ---> |  A   |  B  |      triangles flip and interfaces move, but the half-edges on the frame of a
+-----+-----+        +-----+-----+      region stay on its frame: by them it is found again
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from . import connectivity
from .batch import MeshBatch, triangle_mesh
from .kept_edges import constrained_half_edges
from .ragged import true_rows
from .triangle import corners, signed_area
from .vertex_map import VertexMap


@dataclass(frozen=True, eq=False)
class RegionAreas:
    """The signed areas of R regions of a batch, in the unit of length squared.

    mesh    (R,) int64, the mesh that each region belongs to
    before  (R,) float64; of a tangled mesh, what the frame of the region encloses
    after   (R,) float64; NaN for a region that is not found again
    """

    mesh: Tensor
    before: Tensor
    after: Tensor

    @property
    def change(self) -> Tensor:
        """(R,) by what part of itself each region has grown; NaN where it had no area."""
        some = self.before != 0
        ratio = self.after / torch.where(some, self.before, 1.0)
        return torch.where(some, ratio - 1, torch.nan)

    def record(self, b: int) -> list[dict[str, float]]:
        """The areas of the regions of mesh `b`, in the order of their first triangles as given."""
        rows = true_rows(self.mesh == b).tolist()
        return [{"before": float(self.before[r]), "after": float(self.after[r])} for r in rows]


def region_areas(before: MeshBatch, after: MeshBatch, vertex_map: VertexMap | None = None) -> RegionAreas:
    """The areas of the regions of `before` (numbered by their first triangles), and of the same regions in `after`.

    vertex_map  which vertices of `after` come from which of `before`; None: row by row
    """
    region, at, keys = _frame(before, None)
    count = int(region.max()) + 1 if len(region) else 0
    first = torch.full((count,), len(region), device=region.device)
    first.scatter_reduce_(0, region, torch.arange(len(region), device=region.device), "amin")
    component, now_at, now_keys = _frame(after, vertex_map)
    order = keys.argsort()
    place = torch.searchsorted(keys[order], now_keys).clamp_max(max(len(keys) - 1, 0))
    found = keys[order][place] == now_keys
    # The region of each component of `after`; that of its first half-edge which was there before.
    of_component = torch.full((int(component.max()) + 1 if len(component) else 0,), count, device=region.device)
    of_component.scatter_reduce_(0, component[now_at[found]], region[at[order][place[found]]], "amin")
    nowhere = torch.full((1,), torch.nan, dtype=torch.float64, device=region.device)
    now = _sums(after, of_component[component], count + 1)[:count]
    there = torch.zeros(count + 1, dtype=torch.bool, device=region.device).index_fill_(0, of_component, True)[:count]
    return RegionAreas(triangle_mesh(before)[first], _sums(before, region, count), torch.where(there, now, nowhere))


def _frame(mesh: MeshBatch, vertex_map: VertexMap | None) -> tuple[Tensor, Tensor, Tensor]:
    """(T,) the region of each triangle, (H,) the triangles on frames, and (H,) keys of their half-edges there.

    Keys are of the vertices before; a half-edge whose tail was inserted is left out, and one whose head was leads on
    to the other end of the edge that was halved.
    """
    locked = constrained_half_edges(mesh) & (mesh.twin >= 0)
    region = connectivity.triangle_components(mesh.triangles, mesh.twin, locked)
    h = true_rows(locked | (mesh.twin < 0))
    tail, head = connectivity.tails(mesh.triangles)[h], connectivity.heads(mesh.triangles)[h]
    count = len(mesh.points)
    if vertex_map is not None:
        count = len(vertex_map.old_to_new)
        # An inserted vertex has the ends of the edge that it halved as its sources.
        ends = torch.zeros_like(vertex_map.new_to_old).index_add_(0, vertex_map.rows, vertex_map.sources)
        old = vertex_map.new_to_old
        known = old[tail] >= 0
        h, tail, head = h[known], tail[known], head[known]
        tail, head = old[tail], torch.where(old[head] >= 0, old[head], ends[head] - old[tail])
    return region, h // 3, tail * count + head


def _sums(mesh: MeshBatch, region: Tensor, count: int) -> Tensor:
    """(count,) float64 the signed areas of the regions (T,) of the triangles."""
    area = signed_area(corners(mesh.points.to(torch.float64), mesh.triangles))
    return area.new_zeros(count).index_add_(0, region, area)
