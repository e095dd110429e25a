"""How good a mesh is: areas, shapes, angles, per triangle, per quad and per mesh."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..kernels import geometry
from ..kernels.library import library_for
from ..kernels.signs import triangle_signs
from . import connectivity, quadrilateral, triangle
from .batch import MeshBatch
from .predicates import orientation, orientation_by_products
from .quadrilateral import quad_corners
from .quads import HALVES, has_quads, inverted_quads
from .ragged import (
    counts_from_offsets,
    owner_of,
    put_rows,
    segment_count,
    segment_max,
    segment_min,
    segment_sum,
    take,
    true_rows,
)
from .triangle import angles, corners
from .typed import typed

# What a batch without quads has for them, once for all.
_NO_NUMBERS, _NO_FLAGS = torch.zeros(0, dtype=torch.float64), torch.zeros(0, dtype=torch.bool)


@dataclass(frozen=True, eq=False)
class Quality:
    """The quality of a batch; (T,) per triangle, (Q,) per quad, (B,) per mesh.

    area                (T,) signed, in the mesh's unit squared
    inverse_mean_ratio  (T,) 1 for an equilateral triangle, infinite for a flat one
    upright             (T,) bool, area positive by exact sign
    mean, max           (B,) of the inverse mean ratio, over all triangles and quads
    inverted            (B,) int64, triangles and quads that are not upright
    quad_area           (Q,) signed, as for triangles
    quad_inverse_mean_ratio  (Q,) of the worst corner, 1 for a square: one over Verdict's shape of a quad
    quad_upright        (Q,) bool, all four corners are upright by exact sign
    """

    area: Tensor
    inverse_mean_ratio: Tensor
    upright: Tensor
    mean: Tensor
    max: Tensor
    inverted: Tensor
    quad_area: Tensor = _NO_NUMBERS
    quad_inverse_mean_ratio: Tensor = _NO_NUMBERS
    quad_upright: Tensor = _NO_FLAGS


@typed
def quality(batch: MeshBatch, known: tuple[MeshBatch, Quality] | None = None) -> Quality:
    """Measure a batch; inverted triangles and corners count with the shape of their mirror image (Kim 2017).

    known  the batch as it was, and its quality then: only what changed since is measured

    The result carries no gradient, whatever the points require; `metrics.evaluate` and `losses` have one.
    """
    batch = _detached(batch)
    rows = None if known is None or len(batch.quads) or _is_soon_measured(batch) else _changed(known[0], batch)
    if known is None or rows is None or 2 * len(rows) > len(batch.triangles):
        area, ratio, upright = _measure(batch.points, batch.triangles)
    else:
        some = _measure(batch.points, take(batch.triangles, rows))
        whole = known[1].area, known[1].inverse_mean_ratio, known[1].upright
        area, ratio, upright = (put_rows(old, rows, new) for old, new in zip(whole, some, strict=True))
    offsets = batch.triangle_offsets
    if len(batch.quads):
        return _with_quads(batch, area, ratio, upright)
    return Quality(
        area=area,
        inverse_mean_ratio=ratio,
        upright=upright,
        mean=segment_sum(ratio, offsets) / counts_from_offsets(offsets),
        max=segment_max(ratio, offsets),
        inverted=segment_count(~upright, offsets),
    )


def _detached(batch: MeshBatch) -> MeshBatch:
    """The batch without the graph of autograd: compiled loops measure it, or torch does, with the same result."""
    return batch.with_points(batch.points.detach()) if batch.points.requires_grad else batch


def _with_quads(batch: MeshBatch, area: Tensor, ratio: Tensor, upright: Tensor) -> Quality:
    """The quality of a batch with quads, of whose triangles area, ratio and signs (T,) are known.

    Triangles that stand for a quad get its numbers, but not its area, and are counted with it.
    """
    q = quad_corners(batch.points.to(torch.float64), batch.quads)
    quad_ratio, quad_upright = quadrilateral.inverse_mean_ratio(q), ~inverted_quads(batch.points, batch.quads)
    of_triangles, offsets, ends = (ratio, upright), batch.triangle_offsets, batch.quad_offsets
    if batch.rows_per_quad:
        rows, each = batch.of_quads, batch.rows_per_quad
        of_triangles, offsets = (ratio[~rows], upright[~rows]), offsets - each * ends
        ratio, upright = ratio.clone(), upright.clone()
        ratio[rows], upright[rows] = quad_ratio.repeat_interleave(each), quad_upright.repeat_interleave(each)
    count = counts_from_offsets(offsets) + counts_from_offsets(ends)
    return Quality(
        area=area,
        inverse_mean_ratio=ratio,
        upright=upright,
        mean=(segment_sum(of_triangles[0], offsets) + segment_sum(quad_ratio, ends)) / count,
        max=torch.maximum(segment_max(of_triangles[0], offsets), segment_max(quad_ratio, ends)),
        inverted=segment_count(~of_triangles[1], offsets) + segment_count(~quad_upright, ends),
        quad_area=quadrilateral.signed_area(q),
        quad_inverse_mean_ratio=quad_ratio,
        quad_upright=quad_upright,
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


# The compiled loop measures so many triangles in the time that it takes to find those that changed.
_FEW = 16_384


def _is_soon_measured(batch: MeshBatch) -> bool:
    return len(batch.triangles) <= _FEW and library_for(batch.points) is not None


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
    return true_rows(changed)


def shapes(batch: MeshBatch) -> tuple[Tensor, Tensor]:
    """(T,) the smallest unsigned angle in radians, 0 for a flat triangle, and the inverse mean ratio.

    Triangles that stand for a quad have its ratio, and the angle of `smallest_angles`.
    """
    if batch.rows_per_quad == HALVES:
        return smallest_angles(batch), quality(batch).inverse_mean_ratio
    return _shapes(batch.points, batch.triangles)


def _shapes(points: Tensor, triangles: Tensor) -> tuple[Tensor, Tensor]:
    if library_for(points) is not None:
        return geometry.shapes(points.to(torch.float64), triangles)
    t = corners(points.to(torch.float64), triangles)
    return triangle.minimum_angle(t), triangle.inverse_mean_ratio(t)


def smallest_angles(batch: MeshBatch, rows: Tensor | None = None) -> Tensor:
    """(T,) the smallest unsigned angle of each triangle in radians, 0 for a flat one; or (N,) of the `rows` (N,).

    A triangle that stands for a quad has two thirds of how near a corner of it comes to 0 or 180 degrees, so that it
    has 60 degrees at best, as any triangle does.
    """
    faces = batch.triangles if rows is None else take(batch.triangles, rows)
    angle = _shapes(batch.points, faces)[0]
    if batch.rows_per_quad != HALVES:
        return angle
    own = quadrilateral.narrowest(quad_corners(batch.points.to(torch.float64), batch.quads)) * (2 / 3)
    every = angle.new_empty(len(batch.triangles))
    every[batch.of_quads] = own.repeat_interleave(HALVES)
    mask = batch.of_quads if rows is None else batch.of_quads[rows]
    return torch.where(mask, every if rows is None else every[rows], angle)


def upright(batch: MeshBatch) -> Tensor:
    """(T,) bool: the triangle's area is positive, by exact sign; where it stands for a quad, so are its corners'."""
    if library_for(batch.points) is not None:
        positive = triangle_signs(batch.points.to(torch.float64), batch.triangles) > 0
    else:
        positive = orientation(*corners(batch.points, batch.triangles)) > 0
    if batch.rows_per_quad == HALVES:
        positive[batch.of_quads] = ~inverted_quads(batch.points, batch.quads).repeat_interleave(HALVES)
    return positive


def refuse_inverted(batch: MeshBatch, why: str) -> None:
    """Raise InvalidMeshError if an element is not upright: its mesh, its row in the batch, and `why` that matters."""
    folded = inverted_quads(batch.points, batch.quads) if len(batch.quads) else _NO_FLAGS
    if bool(folded.any()):
        row = folded.nonzero()[0]
        b = int(owner_of(row, batch.quad_offsets))
        raise InvalidMeshError(f"mesh {b}: quads row {int(row)} is inverted{why}")
    inverted = ~upright(batch)
    if bool(inverted.any()):
        row = inverted.nonzero()[0]
        b = int(owner_of(row, batch.triangle_offsets))
        raise InvalidMeshError(f"mesh {b}: triangles row {int(row)} is inverted{why}")


@typed
def minimum_angle(batch: MeshBatch) -> Tensor:
    """(B,) smallest unsigned angle of each mesh, in degrees, over the corners of triangles and quads.

    The result carries no gradient; `metrics.evaluate` has one.
    """
    batch = _detached(batch)
    least = segment_min(shapes(batch)[0], batch.triangle_offsets)
    if has_quads(batch):
        own = quadrilateral.minimum_angle(quad_corners(batch.points.to(torch.float64), batch.quads))
        least = torch.minimum(least, segment_min(own, batch.quad_offsets))
    return least * (180 / math.pi)


def signed_minimum_angles(mesh: MeshBatch, quality: Quality) -> np.ndarray:
    """(T,) float64 smallest angle of each triangle in degrees, negative where it is not upright."""
    at = angles(corners(mesh.points.detach().to(torch.float64), mesh.triangles))
    smallest = torch.rad2deg(torch.minimum(torch.minimum(at[0], at[1]), at[2]))
    return torch.where(quality.upright, smallest, -smallest).clamp(-60.0, 60.0).cpu().numpy()


def signed_narrowest_angles(mesh: MeshBatch, quality: Quality) -> np.ndarray:
    """(Q,) float64 how near a corner of each quad comes to 0 or 180 degrees, negative where the quad is inverted."""
    own = quadrilateral.narrowest(quad_corners(mesh.points.detach().to(torch.float64), mesh.quads)) * (180 / math.pi)
    return torch.where(quality.quad_upright, own, -own).clamp(-90.0, 90.0).cpu().numpy()
