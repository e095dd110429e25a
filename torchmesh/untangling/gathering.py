"""Vertices that lie far outside their mesh, brought to its edge: no method could see anything else beside them.

Lengths are measured against the extent of a mesh.  Where a vertex is a million extents away, the steps of every method,
and the digits of its numbers, are lost on it.  No valid mesh has a vertex outside the box of the held ones.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.ragged import offsets_from_counts, segment_count, segment_max, segment_min, spread

# Free vertices further outside the box of the held ones than so many extents of that box are brought to it.
_FAR = 2.0


def gathered(batch: MeshBatch) -> MeshBatch:
    """The batch with its free vertices that lie far outside moved to the nearest point of their mesh's box.

    The box is that of the fixed vertices.  A mesh without such vertices keeps its bits.
    """
    held = offsets_from_counts(segment_count(batch.fixed, batch.point_offsets))
    fixed = batch.points[batch.fixed].to(torch.float64)
    low, high = (_per_axis(reduce, fixed, held, batch.point_offsets) for reduce in (segment_min, segment_max))
    points = batch.points.to(torch.float64)
    inside = torch.minimum(torch.maximum(points, low), high)
    extent = (high - low).amax(1)
    far = ((points - inside).abs().amax(1) > _FAR * extent) & (extent > 0) & extent.isfinite() & ~batch.fixed
    if not bool(far.any()):
        return batch
    return batch.with_points(torch.where(far[:, None], inside.to(batch.points), batch.points))


def _per_axis(reduce: Callable[[Tensor, Tensor], Tensor], fixed: Tensor, held: Tensor, offsets: Tensor) -> Tensor:
    """(V, 2) the least or greatest x and y of the fixed vertices (N, 2) of each vertex's mesh."""
    return torch.stack([spread(reduce(column.contiguous(), held), offsets) for column in fixed.unbind(1)], 1)
