"""Meshes with positions that one cannot compute with: not finite, or so large that areas overflow.

`MeshBatch.from_arrays` refuses them, but `with_points` takes whatever a network has made.  Functions over a batch leave
such a mesh as it is and say so of it alone; the others come out as they would without it.
"""

import torch
from torch import Tensor

from .batch import MeshBatch
from .ragged import owner_of, spread, true_rows
from .validation import fit_on_the_whole, fit_positions


def unfit_vertices(batch: MeshBatch) -> Tensor:
    """(V,) bool: a coordinate of the vertex is not finite, or larger than 1e150."""
    return ~fit_positions(batch.points)


def unfit_meshes(batch: MeshBatch) -> Tensor:
    """(B,) bool: a corner of some triangle or quad is an unfit vertex.  Vertices without either do not count."""
    unfit = torch.zeros(len(batch), dtype=torch.bool, device=batch.points.device)
    if not fit_on_the_whole(batch.points):
        vertices = unfit_vertices(batch)
        for faces in (batch.triangles, batch.quads):
            unfit[owner_of(faces[vertices[faces]], batch.point_offsets)] = True
    return unfit


def what_is_unfit(batch: MeshBatch, b: int) -> tuple[str, int]:
    """What is to be said of the unfit mesh `b`, and its first unfit vertex, numbered within the mesh."""
    start, end = batch.point_offsets[b : b + 2].tolist()
    rows = true_rows(unfit_vertices(batch)[start:end])
    row = int(rows[0])
    position = batch.points[start + row].tolist()
    if bool(batch.points[start + rows].isfinite().all()):
        return f"points row {row} is {position}: areas beyond 1e150 squared overflow; rescale", row
    return f"points row {row} is {position}: every coordinate must be finite ({len(rows)} rows are not)", row


def on_a_line(batch: MeshBatch, unfit: Tensor) -> tuple[MeshBatch, Tensor]:
    """The batch with positions one can compute with, and the rows (R,) of the vertices that are elsewhere for that.

    The vertices of a mesh that is `unfit` (B,) lie side by side on a line, so that it has no upright triangle; a single
    unfit vertex without triangles lies on the first one of its mesh that has some.
    """
    points = batch.points
    starts = batch.point_offsets[:-1]
    in_line = torch.arange(len(points), device=points.device) - spread(starts, batch.point_offsets)
    flat = torch.stack([in_line, torch.zeros_like(in_line)], 1).to(points)
    corner = points[batch.triangles[batch.triangle_offsets[:-1], 0]]
    whole = spread(unfit, batch.point_offsets)
    single = unfit_vertices(batch) & ~whole
    points = torch.where(whole[:, None], flat, points)
    points = torch.where(single[:, None], spread(corner, batch.point_offsets), points)
    return batch.with_points(points), true_rows(whole | single)
