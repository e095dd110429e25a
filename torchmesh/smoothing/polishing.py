"""The worst triangles of a valid mesh, each with its neighbourhood, worst first.

        bad triangles --> patches round them --> every single flip of every patch, as a batch
             ^                                    of small meshes, each smoothed for its worst
             +---- the best of each goes back, of patches in touch the worst one's ----+

Flips and smoothing by the sum over a mesh end where no single flip lowers that sum; a flip that
makes its two triangles worse, and the whole patch better once its vertices have moved, they never try.  Local
search that judges by the worst triangle does (Freitag & Ollivier-Gooch, Tetrahedral mesh improvement
using swapping and smoothing, International Journal for Numerical Methods in Engineering 40, 1997).
In place of the non-smooth maximum stands the sum of a high power of the inverse mean ratio.
"""

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..mesh import triangle
from ..mesh.batch import MeshBatch, join, triangle_mesh
from ..mesh.connectivity import next_in_triangle, touching
from ..mesh.measure import Quality, quality
from ..mesh.neighbourhoods import surroundings
from ..mesh.ragged import (
    counts_from_offsets,
    offsets_from_counts,
    owner_of,
    rows_of_each,
    segment_count,
    segment_max,
    segment_min,
    segment_sum,
    spread,
)
from ..mesh.submesh import picked, submesh
from ..mesh.triangle import SQRT3, corners, inverse_mean_ratio
from .patches import Patches, every_flip, seeds_of
from .smoothing import SmoothOptions, smooth


@dataclass(frozen=True)
class PolishOptions:
    """How `polish` works.

    angle       degrees; triangles with a smaller angle are worked on
    ratio       and those of a higher inverse mean ratio
    max_rounds  rounds at most, of one change in each patch, and as many again in wider patches
    smooth      the smoothing of each patch: a power so high that the worst triangle counts
    """

    angle: float = 25.0
    ratio: float = 1.9
    max_rounds: int = 12
    smooth: SmoothOptions = field(
        default_factory=lambda: SmoothOptions(power=12, max_iterations=18, energy_tolerance=1e-2)
    )

    def __post_init__(self) -> None:
        if not 0 <= self.angle < 60:
            raise ValueError(f"PolishOptions.angle must be in degrees from 0 to below 60, not {self.angle}")
        if not self.ratio > 1:
            raise ValueError(f"PolishOptions.ratio must be above 1, the ideal, not {self.ratio}")
        if self.max_rounds < 0:
            raise ValueError(f"PolishOptions.max_rounds must not be negative, but is {self.max_rounds}")


@dataclass(frozen=True, eq=False)
class PolishInfo:
    """What `polish` did: per mesh (B,) int64 the patches it bettered, and the edges it flipped in them."""

    patches: Tensor
    flips: Tensor


class _Level(NamedTuple):
    """How hard a patch is tried.

    rings  of free vertices in it
    flips  in a row
    near   only of edges that end at the worst triangle?
    most   bad triangles of a mesh that is worked on so hard, and as a part of its triangles, the larger of both
    """

    rings: int
    flips: int
    near: bool
    most: tuple[int, float]


_LEVELS = (_Level(2, 1, True, (8, 0.01)), _Level(3, 2, True, (6, 0.001)), _Level(3, 2, False, (2, 0.0)))


# Patches one triangle may be in that are tried at once.
_GROUPS = 6


# First flips of a patch that are followed by a second.
_FINALISTS = 2


# Degrees that a patch must win to be worth a round, and as much of the inverse mean ratio.
_GAIN, _GAIN_OF_RATIO = 0.2, 0.005


# Where the boundary sets a limit below what is asked, this part of it is enough.
_OF_LIMIT = 0.95


_MOST_IN_A_FAN = 24


# A patch has about eight free vertices.
_BLOCK = 16


# Degrees above what is asked for that count: at the threshold itself rounding would tell.
_MARGIN = 0.1


def polish(batch: MeshBatch, options: PolishOptions | None = None) -> tuple[MeshBatch, PolishInfo]:
    """Better the worst triangles of valid meshes by flips and moves of the vertices next to them.

    Vertices keep number and order, fixed ones their place; boundary and constrained edges stay.  Meshes without
    a triangle beyond `angle` or `ratio`, and those with inverted triangles, come back bit for bit, as do those of
    which more than one in a hundred is bad, and no fault of the boundary's: they want other means.  No
    mesh's smallest angle gets smaller, nor the number of its triangles beyond `angle` or `ratio` larger; its largest
    inverse mean ratio may grow up to `ratio`, but never beyond both that and what it was.
    """
    options = options or PolishOptions()
    none = torch.zeros(len(batch), dtype=torch.int64, device=batch.points.device)
    bad = bad_triangles(batch, quality(batch), options)
    if not bool(bad.any()):
        return batch, PolishInfo(none, none.clone())
    work = _Polishing(batch, bad, options)
    for level in _LEVELS:
        work.run(level)
    return work.whole(), PolishInfo(work.patches, work.flips)


def bad_triangles(batch: MeshBatch, q: Quality, options: PolishOptions) -> Tensor:
    """(T,) bool: the triangles of the valid meshes that are beyond what is asked; q is their quality.

    Among triangles with the angle t the isosceles one has the lowest inverse mean ratio, (2 - cos t) / (sqrt(3) sin t):
    below that no angle need be measured.
    """
    t = math.radians(options.angle)
    least = min((2 - math.cos(t)) / (SQRT3 * math.sin(t)), options.ratio) if t else options.ratio
    bad = q.inverse_mean_ratio > least
    rows = bad.nonzero().squeeze(1)
    valid = q.inverted.index_select(0, owner_of(rows, batch.triangle_offsets)) == 0
    few = corners(batch.points.to(torch.float64), batch.triangles.index_select(0, rows))
    bad[rows] = valid & _is_bad(triangle.minimum_angle(few), q.inverse_mean_ratio.index_select(0, rows), options)
    return bad


def _is_bad(angle: Tensor, ratio: Tensor, options: PolishOptions) -> Tensor:
    return (angle < options.angle * (torch.pi / 180)) | (ratio > options.ratio)


class _Polishing:
    """The surroundings of the bad triangles on their way; the rest of the batch is not looked at.

    taken     those surroundings as they were
    part      what they have become, a mesh for each of the batch's
    complete  (V',) bool, all triangles at the vertex are in `part`
    stuck     (T',) bool, the triangle was tried in vain, and nothing near it has changed since
    """

    def __init__(self, batch: MeshBatch, bad: Tensor, options: PolishOptions) -> None:
        self.batch, self.options = batch, options
        self.patches = torch.zeros(len(batch), dtype=torch.int64, device=bad.device)
        self.flips = self.patches.clone()
        # A patch may leave the next one beside it bad, and so on, so far.
        near = surroundings(batch, bad, 3 * max(level.rings for level in _LEVELS) + 1)
        self.taken = submesh(batch, touching(batch.triangles, near))
        self.complete = near[self.taken.vertices]
        self.part = replace(self.taken.mesh, fixed=self.taken.mesh.fixed | ~self.complete)
        self.stuck = torch.zeros(len(self.part.triangles), dtype=torch.bool, device=bad.device)
        self.least, self.most = _fan_limits(self.part, self.complete)

    def asked(self) -> tuple[Tensor, Tensor]:
        """(T',) radians and inverse mean ratios beyond which triangles are bad, less strict where the boundary is."""
        corner = [v.contiguous() for v in self.part.triangles.unbind(1)]
        angle = torch.stack([self.least.index_select(0, v) for v in corner]).amin(0)
        ratio = torch.stack([self.most.index_select(0, v) for v in corner]).amax(0)
        wanted = math.radians(self.options.angle)
        angle = torch.where(angle < wanted, _OF_LIMIT * angle, wanted)
        return angle, torch.where(ratio > self.options.ratio, ratio / _OF_LIMIT, self.options.ratio)

    def whole(self) -> MeshBatch:
        """The batch with what was bettered in its place."""
        return self.taken.put_back(self.batch, self.part)

    def run(self, level: _Level) -> None:
        """Rounds of this level until every bad triangle is good or was tried in vain."""
        most = (level.most[1] * counts_from_offsets(self.batch.triangle_offsets)).clamp_min(level.most[0])
        self.stuck = torch.zeros_like(self.stuck)
        for turn in range(self.options.max_rounds):
            t = corners(self.part.points.to(torch.float64), self.part.triangles)
            angle, (least, most_ratio) = triangle.minimum_angle(t), self.asked()
            bad = ((angle < least) | (inverse_mean_ratio(t) > most_ratio)) & ~self.stuck
            if not turn:
                many = segment_count(bad, self.part.triangle_offsets) > most
                self.stuck |= spread(many, self.part.triangle_offsets)
                bad &= ~self.stuck
            if not bool(bad.any()):
                break
            # What the first round leaves is tried in vain most times: patches in touch, too, at once.
            self._round(bad, angle, level, _GROUPS if turn or level is not _LEVELS[0] else 1)

    def _round(self, bad: Tensor, angle: Tensor, level: _Level, most: int) -> None:
        part, apart = self.part, 2 * level.rings
        left = bad.clone()
        groups: list[tuple[Tensor, Patches]] = []
        while bool(left.any()) and len(groups) < most:
            seeds = seeds_of(part, left, angle, apart)
            groups.append((seeds, Patches.cut_out(part, seeds, level.rings, self.complete)))
            left[seeds] = False
        seeds, patches = torch.cat([seeds for seeds, _ in groups]), Patches.together([cut for _, cut in groups])
        given = patches.mesh
        best, flips = _best_of(patches, level, self.options)
        before, after = (_Worst.of(mesh, self.options) for mesh in (given, best))
        good = after.betters(before, self.options)
        self.stuck[seeds[~good]] = True
        bettered = torch.zeros_like(bad).index_fill_(0, seeds[good], True)
        good &= torch.isin(seeds, seeds_of(part, bettered, angle, apart))
        # Back into their rows: vertices that do not move stand in more than one patch.
        rows = spread(good, given.point_offsets) & ~given.fixed
        faces = spread(good, given.triangle_offsets)
        points, triangles = part.points.clone(), part.triangles.clone()
        points[patches.vertices[rows]] = best.points[rows]
        triangles[patches.faces[faces]] = patches.vertices[best.triangles[faces]]
        self.part = replace(part, points=points, triangles=triangles)
        changed = torch.zeros_like(bad).index_fill_(0, patches.faces[faces], True)
        self.stuck &= ~touching(part.triangles, surroundings(part, changed, level.rings))
        owner = triangle_mesh(part)[seeds[good]]
        self.patches += torch.bincount(owner, minlength=len(part))
        self.flips.index_add_(0, owner, flips[good])


def _fan_limits(part: MeshBatch, complete: Tensor) -> tuple[Tensor, Tensor]:
    """(V,) radians and (V,) ratios: no triangulation has all angles at the boundary vertex above, or all inverse mean
    ratios below these; infinite and 1 elsewhere.

    A fan of k triangles fills the angle alpha between boundary edges of lengths a and b.  Its triangles have angles
    t and ratios r of sides, and none below theta where t >= theta and |log r| <= log(sin(t + theta) / sin(theta)),
    a convex set in (t, log r); so the best fan is the one of equal triangles, and its k is the best of all.  The same
    holds for the inverse mean ratio (r + 1 / r - cos t) / (sqrt(3) sin t), the cosh of a hyperbolic distance.
    complete  (V,) bool, all triangles at the vertex are there
    """
    limit = torch.full((len(part.points),), torch.inf, dtype=torch.float64, device=complete.device)
    round_limit = torch.ones_like(limit)
    twin = part.twin
    out = (twin < 0).nonzero().squeeze(1)
    vertex = part.triangles.reshape(-1)
    number = torch.bincount(vertex[out], minlength=len(limit))
    onto = torch.zeros_like(number)
    onto[vertex[next_in_triangle(out)]] = vertex[out]
    out = out[(complete & (number == 1))[vertex[out]]]
    here = vertex[out]
    points = part.points.to(torch.float64).cpu().numpy()
    p, q, o = (points[v.cpu().numpy()] for v in (vertex[next_in_triangle(out)], onto[here], here))
    # Of numpy, where the bits of a result do not depend on its place in the vector.
    (ux, uy), (vx, vy) = (p - o).T, (q - o).T
    turn = np.arctan2(ux * vy - uy * vx, ux * vx + uy * vy)
    alpha = np.where(turn > 0, turn, turn + 2 * np.pi)[:, None]
    ratio = 0.5 * np.abs(np.log(ux * ux + uy * uy) - np.log(vx * vx + vy * vy))[:, None]
    k = np.arange(1, _MOST_IN_A_FAN + 1)
    t = alpha / k
    r = np.exp(ratio / k)
    angle = np.where(t < np.pi, np.minimum(t, np.arctan2(np.sin(t), r - np.cos(t))), 0.0)
    limit[here] = torch.from_numpy(angle.max(1, initial=0.0)).to(limit.device)
    shape = np.where(t < np.pi, (r + 1 / r - np.cos(t)) / (SQRT3 * np.where(t < np.pi, np.sin(t), 1.0)), np.inf)
    round_limit[here] = torch.from_numpy(shape.min(1, initial=np.inf)).to(limit.device)
    return limit, round_limit


class _Worst(NamedTuple):
    """Per mesh (B,): smallest angle in radians, largest inverse mean ratio, sum of their squares, bad triangles."""

    angle: Tensor
    ratio: Tensor
    energy: Tensor
    bad: Tensor

    @classmethod
    def of(cls, batch: MeshBatch, options: PolishOptions) -> "_Worst":
        t, offsets = corners(batch.points.to(torch.float64), batch.triangles), batch.triangle_offsets
        angle, ratio = triangle.minimum_angle(t), inverse_mean_ratio(t)
        return cls(
            segment_min(angle, offsets),
            segment_max(ratio, offsets),
            segment_sum(ratio.square(), offsets),
            segment_count(_is_bad(angle, ratio, options), offsets),
        )

    def lack(self, options: PolishOptions) -> Tensor:
        """(B,) how far the worst is beyond what is asked, 0 if it is not: parts of the angle and of the ratio."""
        angle = (options.angle + _MARGIN) * (torch.pi / 180)
        return ((angle - self.angle) / angle).clamp_min(0) + (self.ratio / options.ratio - 1).clamp_min(0)

    def betters(self, before: "_Worst", options: PolishOptions) -> Tensor:
        """(B,) bool: no worse in angle, ratio or number of bad triangles, and nearer in one to what is asked.

        For all that is asked of angles the ratio may be what is asked of ratios.
        """
        wider = self.angle - before.angle > _GAIN * (torch.pi / 180)
        rounder = (before.ratio > options.ratio) & (before.ratio - self.ratio > _GAIN_OF_RATIO)
        no_worse = (self.angle >= before.angle) & (self.ratio <= before.ratio) & (self.bad <= before.bad)
        return ((wider | rounder) & no_worse) | (wider & (self.lack(options) == 0))


def _best_of(patches: Patches, level: _Level, options: PolishOptions) -> tuple[MeshBatch, Tensor]:
    """Each patch (P,) after the best flips found, smoothed; and how many flips those are (P,)."""
    given = patches.mesh
    start, of_start = given, torch.arange(len(given), device=patches.seed.device)
    found, of_found, flips_of_found = [], [], []
    for depth in range(level.flips):
        complete, seed = (v[rows_of_each(of_start, given.point_offsets)] for v in (patches.complete, patches.seed))
        members, of_member, flipped = every_flip(start, complete, seed if level.near else None)
        patch = of_start[of_member]
        members, _ = smooth(members, options.smooth, block=_BLOCK)
        few = _first_of_each(patch, _Worst.of(members, options), len(given), _FINALISTS, options)
        start, of_start = members.select(few), patch[few]
        found.append(start)
        of_found.append(of_start)
        flips_of_found.append(depth + flipped[few].long())
    every, owner, flips = join(found), torch.cat(of_found), torch.cat(flips_of_found)
    chosen = _first_of_each(owner, _Worst.of(every, options), len(given), 1, options).nonzero().squeeze(1)
    chosen = chosen[owner[chosen].argsort(stable=True)]
    return picked(every, chosen, given), flips[chosen]


def _first_of_each(owner: Tensor, worst: _Worst, count: int, number: int, options: PolishOptions) -> Tensor:
    """(N,) bool: the best `number` of the rows of each owner: least lack, then least energy, then first."""
    order = worst.energy.argsort(stable=True)
    order = order[worst.lack(options)[order].argsort(stable=True)]
    order = order[owner[order].argsort(stable=True)]
    first = offsets_from_counts(torch.bincount(owner, minlength=count))[:-1]
    place = torch.arange(len(owner), device=owner.device) - first[owner[order]]
    chosen = torch.zeros(len(owner), dtype=torch.bool, device=owner.device)
    chosen[order] = place < number
    return chosen
