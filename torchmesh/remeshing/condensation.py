"""Vertices that a coarse boundary has no room for, gathered where there is most.

A boundary's edges may be so long that the vertices inside, spread evenly, make needles along all of
it.  Sizes that grow from a few places in proportion to the distance,

    h = h0 + slope * distance,  nowhere above the boundary's own,

take up any number of vertices: away from the place they are those of the map exp, under which a lattice of
equilateral triangles keeps its angles, so that only the smallest circle has irregular vertices.  A ring of
such triangles has 2 pi / slope of them on either side.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch, put
from ..mesh.measure import quality
from ..mesh.ragged import counts_from_offsets, segment_ids, segment_max, segment_sum, spread
from ..mesh.triangle import SQRT3, corners, signed_area
from .options import RemeshOptions
from .relocation import Relocation
from .remeshing import Remeshing
from .sizing import continue_inwards, exp, log

# Above this mean of the inverse mean ratio shapes are worth more than even sizes.
_MEAN = 1.12


# How fast sizes grow with the distance: about 14 triangles to a ring.
_SLOPE = 0.45


# h0 over the boundary's size there, at least; when that is not small enough, there are more places.
_LEAST = 0.001


_MOST_PLACES = 16


# Places are so many of the boundary's sizes apart at least.
_APART = 2.0


# Sizes asked for anew where the vertices have gone.
_PASSES = 2


# Equilateral triangles in the square of their side.
_FILL = 4 / SQRT3


# A lower mean is worth a maximum that is this much higher.
_SLACK = 1.3


_BISECTIONS = 40


def gather(batch: MeshBatch, options: RemeshOptions) -> tuple[MeshBatch, Tensor]:
    """Gather vertices in the valid meshes whose boundary is too coarse for them; the batch, and the flips (B,).

    Number and order of vertices and triangles stay.  A mesh whose mean inverse mean ratio this does not lower,
    or for which the `options` ask for sizes, comes back as it was.
    """
    q = quality(batch)
    at = (q.inverted == 0) & (q.mean > _MEAN)
    flips = torch.zeros_like(q.inverted)
    asked = not (isinstance(options.sizes, str) and options.sizes == "boundary")
    if asked or not bool(at.any()):
        return batch, flips
    work = Gathering(batch.select(at), options)
    better = work.improve(torch.ones_like(at[at]))
    flips[at] = torch.where(better, work.flips, 0)
    return put(batch, at, work.batch), flips


@dataclass(frozen=True, eq=False)
class Places:
    """Where vertices gather, K places of each mesh, in its unit; those that are not needed are infinitely far.

    x, y   (B, K)
    least  (B, K) the size there, h0
    """

    x: Tensor
    y: Tensor
    least: Tensor

    def select(self, keep: Tensor) -> "Places":
        """Those of the meshes `keep` (B,) bool."""
        return Places(self.x[keep], self.y[keep], self.least[keep])

    def sizes(self, batch: MeshBatch) -> Tensor:
        """(V,) the sizes wanted, in the unit of the batch's points."""
        offsets = batch.point_offsets
        h = exp(continue_inwards(batch).logarithm)
        points = batch.points.to(torch.float64)
        for x, y, least in zip(*(v.unbind(1) for v in (self.x, self.y, self.least)), strict=True):
            far = _distance(points, spread(x, offsets), spread(y, offsets))
            h = torch.minimum(h, spread(least, offsets) + _SLOPE * far)
        return h


def places_of(batch: MeshBatch) -> Places:
    """As few places as take up the surplus of each mesh: where the half width is largest in units of the size."""
    offsets, points = batch.point_offsets, batch.points.to(torch.float64)
    inward = continue_inwards(batch)
    size, room = exp(inward.logarithm), torch.where(inward.known, -torch.inf, inward.bend)
    area = signed_area(corners(points, batch.triangles))
    here = size[batch.triangles].mean(1)
    missing = counts_from_offsets(batch.triangle_offsets) - _FILL * segment_sum(
        area / here / here, batch.triangle_offsets
    )
    rows = torch.arange(len(points), device=points.device)
    found: list[tuple[Tensor, ...]] = []
    for _ in range(_MOST_PLACES):
        best = segment_max(room, offsets)
        first = torch.where(room == spread(best, offsets), rows, len(rows))
        at = torch.full_like(offsets[1:], len(rows)).scatter_reduce_(0, segment_ids(offsets), first, "amin")
        there = best > 0
        at = torch.where(there, at, 0)
        x, y, h = (torch.where(there, v[at], torch.inf) for v in (points[:, 0], points[:, 1], size))
        # The cone reaches up to the boundary's size, or to the boundary and a little round its corners.
        reach = torch.where(there, (2 * (2 * best).sqrt()).clamp_max(1 / _SLOPE), 0.0)
        found.append((x, y, h, reach))
        near = _distance(points, spread(x, offsets), spread(y, offsets)) < _APART * spread(h, offsets)
        room = torch.where(near, -torch.inf, room)
    x, y, h, reach = (torch.stack(v, 1) for v in zip(*found, strict=True))
    # So many places as can take up what is missing with the least size allowed.
    capacity = _held(torch.full_like(missing, _LEAST), reach).cumsum(1)
    enough = (capacity < missing[:, None]).sum(1, keepdim=True)
    used = torch.arange(_MOST_PLACES, device=points.device)[None] <= enough
    reach = torch.where(used, reach, 0.0)
    low, high = torch.full_like(missing, math.log(_LEAST)), torch.zeros_like(missing)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        many = _held(exp(middle), reach).sum(1) > missing
        low, high = torch.where(many, middle, low), torch.where(many, high, middle)
    least = torch.where(used & h.isfinite(), exp(high)[:, None] * h, torch.inf)
    return Places(torch.where(used, x, torch.inf), torch.where(used, y, torch.inf), least)


def _held(part: Tensor, reach: Tensor) -> Tensor:
    """(B, K) the triangles round places of h0 = part (B,) that reach so far (B, K), in units of the boundary's size.

    The integral of 2 pi r / h^2 over triangles of area sqrt(3) / 4 h^2.
    """
    ratio = 1 + _SLOPE * reach / part[:, None]
    return _FILL * 2 * math.pi / _SLOPE**2 * (log(ratio.reshape(-1)).reshape(ratio.shape) - 1 + 1 / ratio)


def _distance(points: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """(V,) of the points (V, 2) from x, y (V,), which may be infinite."""
    dx, dy = points[:, 0] - x, points[:, 1] - y
    return (dx * dx + dy * dy).sqrt()


class Gathering(Relocation):
    """`Relocation` towards sizes that grow from a few places, as thorough as `Remeshing`: such meshes are few."""

    rest = Remeshing.rest
    waits = 0.0
    looser = 1

    def improve(self, going: Tensor) -> Tensor:
        """Gather in the meshes `going` (B,) bool, which must be valid, as often as it helps; those bettered (B,)."""
        self.places = places_of(self.batch)
        better = torch.zeros_like(going)
        for _ in range(_PASSES):
            before = quality(self.batch)
            self.size = self._sizes(going)
            given = self._state()
            self._remesh(going)
            after = quality(self.batch)
            good = (after.mean < before.mean) & (after.max <= _SLACK * before.max) & (after.inverted == 0)
            self._restore(going & ~good, given)
            going = going & good
            better = better | going
            if not bool(going.any()):
                break
        return better

    def _sizes(self, going: Tensor) -> Tensor:
        size = self.batch.points.new_ones(len(self.batch.points), dtype=torch.float64)
        part, rows = self.batch.select(going), spread(going, self.batch.point_offsets)
        size[rows] = self._scaled(part, self.places.select(going).sizes(part))
        return size

    def _renew(self, going: Tensor, before: MeshBatch, after: MeshBatch) -> None:
        super()._renew(going, before, after)
        assert self.size is not None
        size = self.size.clone()
        size[spread(going, self.batch.point_offsets)] = self._scaled(after, self.places.select(going).sizes(after))
        self.size = size
