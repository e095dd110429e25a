"""Batches made of rows of another batch: of some of its triangles, or of some of its meshes, each as often as named.

    . . . . . . .     A submesh has the triangles that were asked for and their corners, in the order of the batch.
    . s s s . . .     Whoever takes it fixes the vertices that triangles outside have, too, before anything moves,
    . s s s . . .     and puts its rows back where they were.
    . . . . . . .

Whole meshes are narrowed by `MeshBatch.select`.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from . import connectivity
from .batch import MeshBatch, constraint_owner
from .ragged import counts_from_offsets, offsets_from_counts, put_rows, rows_of_each, spread, take, true_rows


@dataclass(frozen=True, eq=False)
class Submesh:
    """Some triangles of a batch with their vertices, as a batch of as many meshes.

    mesh       the batch of these triangles; a mesh without any of them is empty
    vertices   (V',) int64, ascending: the rows of its vertices in the batch that it was taken from
    triangles  (T',) int64, ascending: likewise for its triangles
    """

    mesh: MeshBatch
    vertices: Tensor
    triangles: Tensor

    def put_back(self, batch: MeshBatch, part: MeshBatch) -> MeshBatch:
        """`batch`, from which the submesh was taken, with the rows of `part`, which `mesh` has become."""
        return replace(
            batch,
            points=put_rows(batch.points, self.vertices, part.points),
            triangles=put_rows(batch.triangles, self.triangles, self.vertices[part.triangles]),
        )


def submesh(batch: MeshBatch, triangles: Tensor, vertices: Tensor | None = None) -> Submesh:
    """The `triangles` (T,) bool of a batch with their vertices, renumbered.

    vertices  (V,) bool, which vertices to take along: the corners of the triangles are among them;
              None: the corners alone

    Constrained edges stay where both of their ends do; `fixed` is that of the batch.  Of a batch with quads as halves,
    both halves of a quad are taken where one is asked for.
    """
    kept = None
    if len(batch.quads):
        triangles, kept = with_both_halves(batch, triangles)
    if vertices is None:
        vertices = connectivity.corners_of(batch.triangles, triangles, len(batch.points))
    rows, faces = true_rows(vertices), true_rows(triangles)
    new_row, new_face = offsets_from_counts(vertices), offsets_from_counts(triangles)
    mesh = MeshBatch(
        take(batch.points, rows),
        new_row[take(batch.triangles, faces)],
        take(batch.fixed, rows),
        new_row[batch.constrained_edges[vertices[batch.constrained_edges].all(1)]],
        new_row[batch.point_offsets],
        new_face[batch.triangle_offsets],
        batch.frames,
        quads=None if kept is None else new_row[batch.quads[kept]],  # type: ignore[arg-type]
        quad_offsets=None if kept is None else offsets_from_counts(kept)[batch.quad_offsets],  # type: ignore[arg-type]
        _rows_per_quad=0 if kept is None else batch.rows_per_quad,
    )
    return Submesh(mesh, rows, faces)


def with_both_halves(batch: MeshBatch, triangles: Tensor) -> tuple[Tensor, Tensor]:
    """The `triangles` (T,) bool with both halves of quads of which one is among them, and (Q,) bool these quads."""
    rows = true_rows(batch.of_quads).reshape(-1, batch.rows_per_quad)
    kept = triangles[rows].any(1)
    return triangles.index_put((rows.reshape(-1),), kept.repeat_interleave(batch.rows_per_quad)), kept


def repeated(batch: MeshBatch, meshes: Tensor) -> MeshBatch:
    """The `meshes` (M,) int64 of the batch, each as often as it is named."""
    vertices = rows_of_each(meshes, batch.point_offsets)
    faces = rows_of_each(meshes, batch.triangle_offsets)
    point_offsets = offsets_from_counts(counts_from_offsets(batch.point_offsets)[meshes])
    triangle_offsets = offsets_from_counts(counts_from_offsets(batch.triangle_offsets)[meshes])
    shift = point_offsets[:-1] - batch.point_offsets[:-1][meshes]
    owner = constraint_owner(batch)
    order = owner.argsort(stable=True)
    edge_offsets = offsets_from_counts(torch.bincount(owner, minlength=len(batch)))
    edges = rows_of_each(meshes, edge_offsets)
    edge_shift = shift.repeat_interleave(counts_from_offsets(edge_offsets)[meshes])
    return MeshBatch(
        batch.points[vertices],
        batch.triangles[faces] + spread(shift, triangle_offsets)[:, None],
        batch.fixed[vertices],
        batch.constrained_edges[order][edges] + edge_shift[:, None],
        point_offsets,
        triangle_offsets,
        batch.frames[meshes],
    )


def picked(batch: MeshBatch, meshes: Tensor, like: MeshBatch) -> MeshBatch:
    """The `meshes` (P,) int64 of the batch, one for each mesh of `like`, whose numbers of rows they have."""
    points = batch.points[rows_of_each(meshes, batch.point_offsets)]
    faces = rows_of_each(meshes, batch.triangle_offsets)
    shift = like.point_offsets[:-1] - batch.point_offsets[:-1][meshes]
    triangles = batch.triangles[faces] + spread(shift, like.triangle_offsets)[:, None]
    return replace(like, points=points, triangles=triangles)
