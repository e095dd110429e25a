"""A mesh that goes back to the triangles that it had before it was deformed, where these are good.

    undeformed reference ---- FEMWARP to the boundary of today ----> good? -- yes --> taken, whatever came before
                                                                      | no
    mesh of today, beyond the bound, or with other triangles -------> improved, and so a child of all steps before

Flips and smoothing remember: after a motion there and back a mesh is another one, and after ten it may be any.  Where
the reference is good, it is taken, and what the mesh is like is a function of the boundary alone.
"""

from dataclasses import replace

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch, put
from ..mesh.connectivity import boundary_edges, keys_of
from ..mesh.frozen import frozen_triangles
from ..mesh.interfaces import holding
from ..mesh.measure import quality
from ..mesh.ragged import segment_any, true_rows
from ..smoothing.polishing import PolishOptions
from ..warping.femwarp import femwarp
from .deform_options import DeformOptions
from .needed import beyond
from .step_options import Bound
from .trail import has_rewired


def check_fits(batch: MeshBatch, reference: MeshBatch) -> None:
    """Raise InvalidMeshError unless the reference has the rows, the boundary and the constrained edges of the batch."""
    for name in ("point_offsets", "triangle_offsets"):
        if not torch.equal(getattr(batch, name), getattr(reference, name)):
            raise InvalidMeshError("DeformOptions.reference needs the numbers of vertices and triangles of the batch")
    for name, edges in (
        ("boundary", [boundary_edges(m.triangles, m.twin) for m in (batch, reference)]),
        ("constrained", [m.constrained_edges for m in (batch, reference)]),
    ):
        keys = [keys_of(e, len(batch.points)).sort().values for e in edges]
        if not torch.equal(*keys):
            raise InvalidMeshError(f"DeformOptions.reference has other {name} edges than the batch")


def towards_reference(mesh: MeshBatch, reference: MeshBatch, at: Tensor, options: DeformOptions) -> MeshBatch:
    """`mesh`, with those of the meshes `at` (B,) bool that have changed as the reference is at their boundary.

    These are the meshes that would be improved, and those whose triangles are not those of the reference.  A mesh stays
    as it is where the warped reference is not good.
    """
    bound = options.bound
    if bound is not None:
        at = at & (_beyond(mesh, bound) | has_rewired(reference, mesh))
    if not bool(at.any()):
        return mesh
    part = mesh.select(at)
    start = replace(reference.select(at), fixed=part.fixed, constrained_edges=part.constrained_edges)
    found = femwarp(start, torch.where(part.fixed[:, None], part.points, start.points))
    polish = options.improve.polish or PolishOptions()
    good = ~_beyond(found, bound or Bound(polish.angle, polish.ratio))
    if not bool(good.any()):
        return mesh
    taken = at.index_put((true_rows(at),), good)
    return put(mesh, taken, found.select(good))


def _beyond(mesh: MeshBatch, bound: Bound) -> Tensor:
    """(B,) bool: a triangle of the mesh is beyond the bound."""
    bad = beyond(mesh, quality(mesh), bound, frozen_triangles(holding(mesh)))
    return segment_any(bad, mesh.triangle_offsets)
