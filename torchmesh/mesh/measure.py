"""How good a mesh is: areas, shapes, angles, per triangle and per mesh."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..kernels import geometry
from ..kernels.library import library_for
from ..kernels.signs import triangle_signs
from . import connectivity, triangle
from .batch import MeshBatch
from .predicates import orientation, orientation_by_products
from .ragged import counts_from_offsets, owner_of, segment_count, segment_max, segment_min, segment_sum
from .triangle import angles, corners


@dataclass(frozen=True, eq=False)
class Quality:
    """The quality of a batch; (T,) per triangle, (B,) per mesh.

    area                (T,) signed, in the mesh's unit squared
    inverse_mean_ratio  (T,) 1 for an equilateral triangle, infinite for a flat one
    upright             (T,) bool, area positive by exact sign
    mean, max           (B,) of the inverse mean ratio, over all triangles
    inverted            (B,) int64, triangles that are not upright: area negative or zero
    """

    area: Tensor
    inverse_mean_ratio: Tensor
    upright: Tensor
    mean: Tensor
    max: Tensor
    inverted: Tensor


def quality(batch: MeshBatch, known: tuple[MeshBatch, Quality] | None = None) -> Quality:
    """Measure a batch; inverted triangles count with the shape of their mirror image (Kim 2017).

    known  the batch as it was, and its quality then: only what changed since is measured
    """
    rows = None if known is None else _changed(known[0], batch)
    if known is None or rows is None or 2 * len(rows) > len(batch.triangles):
        area, ratio, upright = _measure(batch.points, batch.triangles)
    else:
        some = _measure(batch.points, batch.triangles.index_select(0, rows))
        whole = known[1].area, known[1].inverse_mean_ratio, known[1].upright
        area, ratio, upright = (old.index_copy(0, rows, new) for old, new in zip(whole, some, strict=True))
    offsets = batch.triangle_offsets
    return Quality(
        area=area,
        inverse_mean_ratio=ratio,
        upright=upright,
        mean=segment_sum(ratio, offsets) / counts_from_offsets(offsets),
        max=segment_max(ratio, offsets),
        inverted=segment_count(~upright, offsets),
    )


def _measure(points: Tensor, triangles: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(T,) area, inverse mean ratio, and whether upright by exact sign.

    As `signed_area`, `inverse_mean_ratio` and `orientation` have them, to the bit: what they share is computed once.
    """
    if library_for(points) is not None:
        return geometry.measured(points.to(torch.float64), triangles)
    t = corners(points.to(torch.float64), triangles)
    abx, aby, acx, acy = t.bx - t.ax, t.by - t.ay, t.cx - t.ax, t.cy - t.ay
    left, right = abx * acy, aby * acx
    area = 0.5 * (left - right)
    size = area.abs()
    squares = abx.square().add_(aby.square()).add_((t.cx - t.bx).square().add_((t.cy - t.by).square()))
    squares.add_(acx.square().add_(acy.square()))
    ratio = torch.where(size > 0, squares / (4 * triangle.SQRT3 * torch.where(size > 0, size, 1.0)), torch.inf)
    return area, ratio, orientation_by_products(left, right, t) > 0


def _changed(before: MeshBatch, after: MeshBatch) -> Tensor | None:
    """The triangles that have other corners than before, or whose corners moved; None: most, or others altogether."""
    for old, new in ((before.point_offsets, after.point_offsets), (before.triangle_offsets, after.triangle_offsets)):
        if old is not new and not torch.equal(old, new):
            return None
    changed = torch.zeros(len(after.triangles), dtype=torch.bool, device=after.triangles.device)
    if after.points is not before.points:
        moved = (before.points[:, 0] != after.points[:, 0]) | (before.points[:, 1] != after.points[:, 1])
        if 2 * int(moved.sum()) > len(moved):
            return None
        changed |= connectivity.touching(after.triangles, moved)
    if after.triangles is not before.triangles:
        for old, new in zip(before.triangles.unbind(1), after.triangles.unbind(1), strict=True):
            changed |= old != new
    return changed.nonzero().squeeze(1)


def shapes(batch: MeshBatch) -> tuple[Tensor, Tensor]:
    """(T,) the smallest unsigned angle in radians, 0 for a flat triangle, and the inverse mean ratio."""
    return _shapes(batch.points, batch.triangles)


def smallest_angles(batch: MeshBatch, rows: Tensor) -> Tensor:
    """(N,) the smallest unsigned angles in radians of the triangles in these `rows` (N,) int64."""
    return _shapes(batch.points, batch.triangles.index_select(0, rows))[0]


def _shapes(points: Tensor, triangles: Tensor) -> tuple[Tensor, Tensor]:
    if library_for(points) is not None:
        return geometry.shapes(points.to(torch.float64), triangles)
    t = corners(points.to(torch.float64), triangles)
    return triangle.minimum_angle(t), triangle.inverse_mean_ratio(t)


def upright(batch: MeshBatch) -> Tensor:
    """(T,) bool: the triangle's area is positive, by exact sign."""
    if library_for(batch.points) is not None:
        return triangle_signs(batch.points.to(torch.float64), batch.triangles) > 0
    return orientation(*corners(batch.points, batch.triangles)) > 0


def refuse_inverted(batch: MeshBatch, why: str) -> None:
    """Raise InvalidMeshError if a triangle is not upright: its mesh, its row in the batch, and `why` that matters."""
    inverted = ~upright(batch)
    if bool(inverted.any()):
        row = inverted.nonzero()[0]
        b = int(owner_of(row, batch.triangle_offsets))
        raise InvalidMeshError(f"mesh {b}: triangles row {int(row)} is inverted{why}")


def minimum_angle(batch: MeshBatch) -> Tensor:
    """(B,) smallest unsigned angle of each mesh, in degrees."""
    return segment_min(shapes(batch)[0], batch.triangle_offsets) * (180 / math.pi)


def signed_minimum_angles(mesh: MeshBatch, quality: Quality) -> np.ndarray:
    """(T,) float64 smallest angle of each triangle in degrees, negative where it is not upright."""
    at = angles(corners(mesh.points.detach().to(torch.float64), mesh.triangles))
    smallest = torch.rad2deg(torch.minimum(torch.minimum(at[0], at[1]), at[2]))
    return torch.where(quality.upright, smallest, -smallest).clamp(-60.0, 60.0).cpu().numpy()
