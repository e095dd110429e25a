"""Sizes that grow from a few points in proportion to the distance, below those of the boundary:

    h = h0 + slope * distance,  nowhere above the boundary's own.

Away from the point these are the sizes of the map exp, under which a lattice of equilateral triangles keeps its
angles, so that only the smallest circle has irregular vertices.  A ring of such triangles round the point has
2 pi / slope of them on either side.  With a small h0, such sizes take up any number of triangles.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.ragged import counts_from_offsets, segment_ids, segment_max, segment_sum, spread
from ..mesh.triangle import SQRT3, corners, signed_area
from .sizing import continue_inwards, exp, log

# An equilateral triangle of side 1 has the area 1 / _PER_AREA.
_PER_AREA = 4 / SQRT3

# So many halvings of an interval of logarithms leave less than rounding does.
_BISECTIONS = 40


@dataclass(frozen=True, eq=False)
class PointSources:
    """K points of each mesh from which sizes grow, in the mesh's unit; those not needed are infinitely far away.

    x, y   (B, K) float64, where they are
    size   (B, K) float64, the size there, h0
    slope  how fast sizes grow with the distance
    """

    x: Tensor
    y: Tensor
    size: Tensor
    slope: float

    def select(self, keep: Tensor) -> "PointSources":
        """Those of the meshes `keep` (B,) bool."""
        return PointSources(self.x[keep], self.y[keep], self.size[keep], self.slope)

    def sizes(self, batch: MeshBatch) -> Tensor:
        """(V,) float64 the sizes wanted at the vertices, in the unit of the batch's points."""
        offsets = batch.point_offsets
        h = exp(continue_inwards(batch).logarithm)
        points = batch.points.to(torch.float64)
        for x, y, size in zip(*(v.unbind(1) for v in (self.x, self.y, self.size)), strict=True):
            distance = _distance(points, spread(x, offsets), spread(y, offsets))
            h = torch.minimum(h, spread(size, offsets) + self.slope * distance)
        return h


@dataclass(frozen=True)
class SourceOptions:
    """How `place_sources` works.

    slope     how fast sizes grow with the distance, length over length; 0.45 means about 14 triangles to a ring
    least     h0 over the boundary's size at that point is at least this; where one source of that size does not
              take up all triangles, there are more sources
    number    sources of a mesh at most
    distance  two sources are at least this many of the boundary's sizes apart
    """

    slope: float = 0.45
    least: float = 0.001
    number: int = 16
    distance: float = 2.0


def place_sources(batch: MeshBatch, options: SourceOptions | None = None) -> PointSources:
    """As few sources as take up the triangles for which the sizes of the boundary have no room.

    They stand where the half width of the domain is largest in units of the boundary's size.  All sources of a
    mesh have the same h0 relative to the boundary's size there: the one with which the triangles fit.
    """
    options = options or SourceOptions()
    offsets, points = batch.point_offsets, batch.points.to(torch.float64)
    inward = continue_inwards(batch)
    size = exp(inward.logarithm)
    x, y, h, reach = _candidates(points, offsets, size, torch.where(inward.known, -torch.inf, inward.bend), options)
    surplus = counts_from_offsets(batch.triangle_offsets) - _fitting(batch, size)
    # So many sources as can take up the surplus with the least size allowed.
    capacity = triangles_round(torch.full_like(surplus, options.least), reach, options.slope).cumsum(1)
    enough = (capacity < surplus[:, None]).sum(1, keepdim=True)
    used = torch.arange(options.number, device=points.device)[None] <= enough
    part = _fitting_part(surplus, torch.where(used, reach, 0.0), options)
    least = torch.where(used & h.isfinite(), part[:, None] * h, torch.inf)
    return PointSources(torch.where(used, x, torch.inf), torch.where(used, y, torch.inf), least, options.slope)


def share_with_room(batch: MeshBatch) -> Tensor:
    """(B,) float64 the triangles for which the sizes of the boundary have room, as a part of those that there are."""
    return _fitting(batch, exp(continue_inwards(batch).logarithm)) / counts_from_offsets(batch.triangle_offsets)


def _fitting(batch: MeshBatch, size: Tensor) -> Tensor:
    """(B,) float64 how many equilateral triangles of the sizes (V,) fill each mesh."""
    area = signed_area(corners(batch.points.to(torch.float64), batch.triangles))
    here = size[batch.triangles].mean(1)
    return _PER_AREA * segment_sum(area / here / here, batch.triangle_offsets)


def _candidates(
    points: Tensor, offsets: Tensor, size: Tensor, bend: Tensor, options: SourceOptions
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """(B, K) each, best first: x and y, the boundary's size there, and how far a source there would reach.

    size  (V,) the boundary's sizes, continued inwards
    bend  (V,) half the square of the half width, in units of the size; -inf where no source may stand

    Reaches are in units of the size.  Where a mesh has fewer candidates, the others are at infinity and reach 0.
    """
    rows = torch.arange(len(points), device=points.device)
    found: list[tuple[Tensor, ...]] = []
    for _ in range(options.number):
        best = segment_max(bend, offsets)
        first = torch.where(bend == spread(best, offsets), rows, len(rows))
        at = torch.full_like(offsets[1:], len(rows)).scatter_reduce_(0, segment_ids(offsets), first, "amin")
        there = best > 0
        at = torch.where(there, at, 0)
        x, y, h = (torch.where(there, v[at], torch.inf) for v in (points[:, 0], points[:, 1], size))
        # Sizes grow up to the boundary's size, or up to the boundary and a little round its corners.
        reach = torch.where(there, (2 * (2 * best).sqrt()).clamp_max(1 / options.slope), 0.0)
        found.append((x, y, h, reach))
        near = _distance(points, spread(x, offsets), spread(y, offsets)) < options.distance * spread(h, offsets)
        bend = torch.where(near, -torch.inf, bend)
    x, y, h, reach = (torch.stack(v, 1) for v in zip(*found, strict=True))
    return x, y, h, reach


def _fitting_part(surplus: Tensor, reach: Tensor, options: SourceOptions) -> Tensor:
    """(B,) h0 over the boundary's size with which sources that reach so far (B, K) take up the surplus (B,)."""
    low, high = torch.full_like(surplus, math.log(options.least)), torch.zeros_like(surplus)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        many = triangles_round(exp(middle), reach, options.slope).sum(1) > surplus
        low, high = torch.where(many, middle, low), torch.where(many, high, middle)
    return exp(high)


def triangles_round(part: Tensor, reach: Tensor, slope: float) -> Tensor:
    """(B, K) how many triangles lie round sources of h0 = part (B,) that reach so far (B, K).

    Lengths are in units of the boundary's size.  This is the integral of 2 pi r / h^2 over r, times the number of
    equilateral triangles of side 1 that fill a unit of area.
    """
    ratio = 1 + slope * reach / part[:, None]
    return _PER_AREA * 2 * math.pi / slope**2 * (log(ratio.reshape(-1)).reshape(ratio.shape) - 1 + 1 / ratio)


def _distance(points: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """(V,) the distance of the points (V, 2) from x, y (V,), which may be infinite."""
    dx, dy = points[:, 0] - x, points[:, 1] - y
    return (dx * dx + dy * dy).sqrt()
