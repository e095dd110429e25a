"""Interfaces between regions: interior edges that no flip removes, and what holds the vertices on them.

+-----------+      constrained edges, x: interior, between two regions A and B
|  A  x  B  |      their vertices are not `fixed` as such: `femwarp` and `deform` carry them along, and every
|     x     |      other function holds them, unless its options say otherwise
+-----x-----+
"""

from dataclasses import replace
from typing import Literal

import torch
from torch import Tensor

from .batch import MeshBatch
from .vertex_map import VertexMap

# "fixed": the vertices stay.  "slide": they move along the curves that the interfaces are.  "free": they move like any
# interior vertex, and the regions change their shapes.
Interfaces = Literal["fixed", "slide", "free"]


def check_interfaces(interfaces: str | None, option: str) -> None:
    """Raise ValueError, naming the option, unless `interfaces` is a known choice or None."""
    if interfaces not in (None, "fixed", "slide", "free"):
        raise ValueError(f"{option} must be 'fixed', 'slide', 'free' or None, not {interfaces!r}")


def interface_vertices(batch: MeshBatch) -> Tensor:
    """(V,) bool: the ends of constrained edges."""
    ends = torch.zeros(len(batch.points), dtype=torch.bool, device=batch.points.device)
    ends[batch.constrained_edges.reshape(-1)] = True
    return ends


def holding(batch: MeshBatch, interfaces: Interfaces | None = None) -> MeshBatch:
    """The batch with the ends of constrained edges fixed, too; under "free" the batch itself.

    For functions that move vertices: inside them, `fixed` says all that stays.  They give back the `fixed` that they
    were given (`released`).
    """
    if interfaces == "free" or not len(batch.constrained_edges):
        return batch
    return replace(batch, fixed=batch.fixed | interface_vertices(batch))


def released(after: MeshBatch, before: MeshBatch, vertex_map: VertexMap | None = None) -> MeshBatch:
    """`after` with those vertices fixed that are fixed in `before`, from which it came.

    vertex_map  which vertices of `after` come from which of `before`; None: row by row.  Inserted ones stay as they are
    """
    if after.fixed is before.fixed:
        return after
    if vertex_map is None:
        return replace(after, fixed=before.fixed)
    row = vertex_map.new_to_old
    return replace(after, fixed=torch.where(row >= 0, before.fixed[row], after.fixed))
