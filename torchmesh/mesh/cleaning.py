"""Input that needs a wipe: arrays of which no mesh can be made, mended where it is plain what was meant.

    o-----o o-----o          vertices that are there twice become one
    |   / | |   / |          triangles that are there twice, or have a corner twice, go
    | /   | | /   |          a vertex that hangs in the side of a triangle divides that triangle
    o-----o o--o--o          neighbours are wound alike

No vertex moves, and a crack stays open: vertices in one position whose triangles are joined by edges elsewhere are the
two sides of a slit, and become one only if that is asked for.
"""

from typing import Any

import numpy as np
import torch

from ..errors import InvalidMeshError
from .clean_log import NOTHING, CleanLog
from .faces import Faces
from .merging import merged_vertices
from .validation import checked_faces, checked_points


def clean(
    points: Any, triangles: Any, quads: Any = None, tolerance: float = 0.0, *, sew: bool = False, keep: Any = None
) -> tuple[Any, Any, Any, CleanLog]:
    """Arrays of a mesh, mended where it is plain what was meant.

    points     (V, 2) or (V, 3), numpy, torch or lists
    triangles  (T, 3) integers, rows of points
    quads      (Q, 4) integers; None: there are none
    tolerance  vertices no farther apart than this, in the unit of the points, are in one position; 0: exactly
    sew        close slits, too: all vertices in one position become one
    keep       (V,) bool: vertices to keep although no triangle or quad has them; None: none

    Vertices in one position become one where their triangles are not joined by edges already, or an edge of the
    boundary joins them.  Triangles and quads that are there twice or have a corner twice are removed, and so are flat
    triangles on the boundary.  A vertex that hangs in the side of a triangle or quad divides it.  Neighbours are wound
    alike, and, in the plane, counter-clockwise.  Vertices of no triangle or quad are dropped.

    Returns points, triangles and quads (None if none were given), torch tensors if `points` is one, else numpy arrays;
    and the log.  Raises InvalidMeshError for what is not an array of such a shape, for rows that do not exist, and for
    coordinates of a triangle's corner that are not finite.
    """
    if not (np.isfinite(tolerance) and tolerance >= 0):
        raise InvalidMeshError(f"tolerance must be a length, not {tolerance}")
    xyz = checked_points(points)
    given = xyz.detach().cpu().numpy()
    tri = checked_faces(triangles, len(given), 3, "triangles").cpu().numpy()
    none = np.zeros((0, 4), np.int64)
    quad = none if quads is None else checked_faces(quads, len(given), 4, "quads").cpu().numpy()
    if not len(tri) and not len(quad):
        raise InvalidMeshError("the mesh is empty: it has no triangles")
    used = _corners(len(given), tri, quad)
    bad = used & ~np.isfinite(given).all(1)
    if bad.any():
        row = int(bad.argmax())
        raise InvalidMeshError(f"points row {row} is {given[row].tolist()}: it has triangles, so it must be finite")
    log = CleanLog()
    work = Faces(np.where(used[:, None], given, 0.0).astype(np.float64), tri, quad)
    work.drop_degenerate(log)
    merged = merged_vertices(work, tolerance, sew, log)
    work = work.renamed(merged)
    work.drop_degenerate(log)
    work.drop_repeated(log)
    work.drop_flat_on_boundary(log)
    work.divide_hanging(merged, tolerance, sew, log)
    work.wind(log)
    stays = _corners(len(given), work.tri, work.quad)
    if keep is not None:
        stays[merged[np.asarray(keep, bool)]] = True
    log.did(
        int((~used & ~stays & (merged == np.arange(len(merged)))).sum()),
        "vertex of no triangle was dropped",
        "vertices of no triangle were dropped",
    )
    lost = int((used & ~stays & (merged == np.arange(len(merged)))).sum())
    log.did(lost, "vertex lost its triangles and was dropped", "vertices lost their triangles and were dropped")
    new_row = np.cumsum(stays) - 1
    log.old_vertex = np.flatnonzero(stays)
    log.new_vertex = np.where(stays[merged], new_row[merged], -1)
    log.old_triangle, log.old_quad = work.of_tri, work.of_quad
    if not log.changed:
        log.lines.append(NOTHING)
    work.tell_what_there_is(log)

    def as_given(array: np.ndarray) -> Any:
        return torch.from_numpy(array).to(points.device) if isinstance(points, torch.Tensor) else array

    left = None if quads is None else as_given(new_row[work.quad])
    return as_given(given[stays]), as_given(new_row[work.tri]), left, log


def _corners(vertices: int, *faces: np.ndarray) -> np.ndarray:
    """(vertices,) bool: is the vertex a corner of one of the faces?"""
    corners = np.zeros(vertices, bool)
    for of in faces:
        corners[of] = True
    return corners
