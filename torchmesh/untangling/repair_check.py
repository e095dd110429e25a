"""Is a re-triangulated mesh a repair of the one before?"""

import numpy as np
import torch
from torch import Tensor

from ..mesh import connectivity
from ..mesh.batch import MeshBatch
from ..mesh.interfaces import holding
from ..triangulating.arrays import signs


def why_not_certified(before: MeshBatch, after: MeshBatch, rows: Tensor) -> str:
    """What is wrong with `after` as a repair of `before` in the triangles `rows` (T,) bool; "" if nothing.

    Checked are: the exact sign of every triangle of `rows`; that each edge belongs to two triangles, which run along it
    in opposite directions, or to the same boundary as before; that constrained edges, their ends and fixed vertices are
    there; and that the same vertices are used by as many triangles, so that the Euler number is the same.
    """
    triangles = after.triangles
    sign = signs(after.points.detach().to("cpu", torch.float64).numpy(), *triangles.cpu().numpy().T)
    bad = np.flatnonzero((sign <= 0) & rows.cpu().numpy())
    if len(bad):
        return f"triangles row {bad[0]} {triangles[int(bad[0])].tolist()} is inverted or flat ({len(bad)} rows are)"
    count = len(after.points)
    there = connectivity.tails(triangles) * count + connectivity.heads(triangles)
    if len(there.unique()) < len(there):
        return "two triangles run along one edge the same way"
    # The new twins are computed: a check does not rely on what the work has handed on.
    twin, old_twin = connectivity.twins(triangles), before.twin
    boundaries = [connectivity.boundary_edges(t, w) for t, w in ((triangles, twin), (before.triangles, old_twin))]
    new, old = ((edges[:, 0] * count + edges[:, 1]).sort().values for edges in boundaries)
    if not torch.equal(new, old):
        return "the boundary edges changed"
    present = connectivity.edges(triangles, twin)
    missing = ~torch.isin(*(connectivity.keys_of(edges, count) for edges in (after.constrained_edges, present)))
    if bool(missing.any()):
        return f"the constrained edge {after.constrained_edges[missing][0].tolist()} is gone"
    fixed = holding(before).fixed
    if not torch.equal(after.points[fixed], before.points[fixed]):
        return "a fixed vertex moved"
    # With the same boundary and number of triangles this is the Euler number.
    used, once = triangles.unique(), before.triangles.unique()
    if len(triangles) != len(before.triangles) or not torch.equal(used, once):
        return f"{len(used)} vertices are in {len(triangles)} triangles, not {len(once)} in {len(before.triangles)}"
    return ""
