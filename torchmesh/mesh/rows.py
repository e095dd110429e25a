"""Are the rows of triangles and quads of a batch those of vertices of their own mesh?"""

from typing import Any

import torch

from ..errors import InvalidMeshError
from .ragged import owner_of, spread


def check_rows(batch: Any) -> None:
    """Raise InvalidMeshError, naming mesh and row, unless all triangles are of vertices of their own mesh.

    `MeshBatch.from_arrays` makes sure of that; the constructor does not.
    """
    points, faces, ends, corners = batch.points, batch.triangles, batch.triangle_offsets, batch.point_offsets
    if points.ndim != 2 or points.shape[1] != 2 or points.dtype not in (torch.float32, torch.float64):
        raise InvalidMeshError(f"points must be (V, 2), float32 or float64, not {tuple(points.shape)} {points.dtype}")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype != torch.int64:
        raise InvalidMeshError(f"triangles must be (T, 3) int64, not {tuple(faces.shape)} {faces.dtype}")
    if batch.fixed.shape != points.shape[:1] or batch.fixed.dtype != torch.bool:
        raise InvalidMeshError(
            f"fixed must be ({len(points)},) bool, not {tuple(batch.fixed.shape)} {batch.fixed.dtype}"
        )
    if int(corners[-1]) != len(points) or int(ends[-1]) != len(faces) or len(corners) != len(ends):
        raise InvalidMeshError("the offsets of the batch do not fit its points and triangles")
    if len(batch.quad_offsets) != len(ends) or int(batch.quad_offsets[-1]) != len(batch.quads):
        raise InvalidMeshError("the offsets of the batch do not fit its quads")
    for name, rows, of in (("triangles", faces, ends), ("quads", batch.quads, batch.quad_offsets)):
        if not len(rows):
            continue
        if len(ends) == 2:
            # Most batches are of one mesh, and the extremes take a tenth of the time.
            low, high = rows.aminmax()
            if int(low) >= int(corners[0]) and int(high) < int(corners[1]):
                continue
        outside = ((rows < spread(corners[:-1], of)[:, None]) | (rows >= spread(corners[1:], of)[:, None])).any(1)
        if bool(outside.any()):
            row = int(outside.nonzero()[0, 0])
            b = int(owner_of(outside.nonzero()[:1, 0], of))
            low, high = corners[b : b + 2].tolist()
            raise InvalidMeshError(
                f"mesh {b}: {name} row {row} is {rows[row].tolist()}: the mesh's rows of points run from {low} to "
                f"{high - 1}"
            )
