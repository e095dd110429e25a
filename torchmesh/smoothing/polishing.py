"""The worst triangles of a valid mesh, each improved together with its neighbourhood, worst first.

        bad triangles --> patches around them --> every single flip of every patch, as a batch
             ^                                     of small meshes, each smoothed for its worst
             |                                                                  |
             +-- the best of each goes back; where patches touch, only one does +

Flips and smoothing minimise the sum over a mesh and end where no single flip lowers that sum.  They never try a flip
that makes its two triangles worse although the whole patch is better once its vertices have moved.  Local search that
judges by the worst triangle does (Freitag & Ollivier-Gooch, Tetrahedral mesh improvement using swapping and smoothing,
International Journal for Numerical Methods in Engineering 40, 1997).  Instead of the maximum, which is not smooth, each
patch minimises the sum of a high power of the inverse mean ratio.
"""

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch, join, triangle_mesh
from ..mesh.connectivity import touching
from ..mesh.detached import without_autograd
from ..mesh.frozen import frozen_triangles
from ..mesh.interfaces import Interfaces, check_interfaces, holding, released
from ..mesh.measure import Quality, quality, shapes, smallest_angles
from ..mesh.neighbourhoods import surroundings
from ..mesh.quads import triangles_alone, with_triangles_alone
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
    take,
    true_rows,
)
from ..mesh.submesh import picked, submesh
from ..mesh.triangle import least_ratio
from .boundary_limits import asked_of, fan_limits
from .patches import Patches, every_flip, seeds_of
from .smoothing import SmoothOptions, smooth

# Coordinates of a patch are padded to a multiple of this: a patch has about eight free vertices.
_BLOCK = 16


class PolishLevel(NamedTuple):
    """How much work `polish` puts into a patch.

    rings     rings of free vertices around the worst triangle
    flips     flips tried one after the other
    at_worst  flip only edges that end at a corner of the worst triangle
    most      number of bad triangles above which a mesh is not worked on at this level
    share     the same as a part of the mesh's triangles; the larger of the two limits counts
    """

    rings: int
    flips: int
    at_worst: bool
    most: int
    share: float


@dataclass(frozen=True)
class PolishOptions:
    """How `polish` works.

    angle         degrees; triangles with a smaller angle are worked on
    ratio         triangles with a higher inverse mean ratio are worked on, too
    max_rounds    number of rounds per level after which polishing stops; a round changes each patch at most once
    smooth        the smoothing of each patch; its power is so high that the worst triangle counts
    levels        the levels of work, cheapest first
    groups        patches that overlap are tried in so many groups at once.  The first round tries one group, since most
                  of its patches succeed; afterwards most fail, and six groups save a third of the time on hard meshes
    finalists     of the single flips of a patch, so many are followed by a second flip
    angle_gain    degrees by which a patch must improve the smallest angle, so that rounds are not spent on less
    ratio_gain    the same for the inverse mean ratio
    limit_share   where the boundary allows less than `angle` or `ratio` ask for, this part of what it allows suffices
    angle_margin  degrees above `angle` at which a triangle counts as good, so that rounding cannot turn it bad
    interfaces    "free": the ends of constrained edges move like any vertex; otherwise they stay
    """

    angle: float = 25.0
    ratio: float = 1.9
    max_rounds: int = 12
    smooth: SmoothOptions = field(
        default_factory=lambda: SmoothOptions(power=12, max_iterations=18, energy_tolerance=1e-2)
    )
    levels: tuple[PolishLevel, ...] = (
        PolishLevel(rings=2, flips=1, at_worst=True, most=8, share=0.01),
        PolishLevel(rings=3, flips=2, at_worst=True, most=6, share=0.001),
        PolishLevel(rings=3, flips=2, at_worst=False, most=2, share=0.0),
    )
    groups: int = 6
    finalists: int = 2
    angle_gain: float = 0.2
    ratio_gain: float = 0.005
    limit_share: float = 0.95
    angle_margin: float = 0.1
    interfaces: Interfaces | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.angle < 60:
            raise ValueError(f"PolishOptions.angle must be in degrees from 0 to below 60, not {self.angle}")
        if not self.ratio > 1:
            raise ValueError(f"PolishOptions.ratio must be above 1, the ideal, not {self.ratio}")
        if not 0 < self.limit_share <= 1:
            raise ValueError(f"PolishOptions.limit_share must be above 0 and at most 1, not {self.limit_share}")
        check_interfaces(self.interfaces, "PolishOptions.interfaces")
        for name in ("groups", "finalists"):
            if getattr(self, name) < 1:
                raise ValueError(f"PolishOptions.{name} must be at least 1, not {getattr(self, name)}")
        for name in ("max_rounds", "angle_gain", "ratio_gain", "angle_margin"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"PolishOptions.{name} must not be negative, but is {getattr(self, name)}")
        if not self.levels or min(level.rings for level in self.levels) < 1:
            raise ValueError(f"PolishOptions.levels must each have at least one ring, not {self.levels}")


@dataclass(frozen=True, eq=False)
class PolishInfo:
    """What `polish` did.

    patches  (B,) int64 number of patches improved in each mesh
    flips    (B,) int64 number of edges flipped in these patches
    """

    patches: Tensor
    flips: Tensor


@without_autograd
def polish(batch: MeshBatch, options: PolishOptions | None = None) -> tuple[MeshBatch, PolishInfo]:
    """Improve the worst triangles of valid meshes by flips and moves of the vertices near them.

    Quads stay as they are, with their vertices.

    Vertices keep number and order; fixed vertices, boundary edges and constrained edges stay.  Some meshes come back
    bit for bit: those without a triangle beyond `angle` or `ratio`, those with inverted triangles, and those with more
    than 8 bad triangles that are also more than 1 % of all (see `levels`); triangles that the boundary forces to be bad
    do not count.  No mesh gets a smaller smallest angle, or more triangles beyond `angle` or `ratio`.  Its largest
    inverse mean ratio may grow up to `ratio`, but never beyond both that and what it was.

    The result carries no gradient, whatever the points require; `nn`, `losses`, `metrics` and `femwarp` have one.
    """
    options = options or PolishOptions()
    if len(batch.quads):
        alone, info = polish(triangles_alone(batch), options)
        return with_triangles_alone(batch, alone), info
    none = torch.zeros(len(batch), dtype=torch.int64, device=batch.points.device)
    bad = bad_triangles(batch, quality(batch), options)
    # Within, `fixed` says all that stays.
    held = holding(batch, options.interfaces)
    if bool(bad.any()):
        bad = bad & ~frozen_triangles(held)
    if not bool(bad.any()):
        return batch, PolishInfo(none, none.clone())
    free = replace(options, smooth=replace(options.smooth, interfaces="free"))
    work = _Polishing(held, bad, free)
    for level in options.levels:
        work.run(level)
    return released(work.whole(), batch), PolishInfo(work.patches, work.flips)


def bad_triangles(batch: MeshBatch, q: Quality, options: PolishOptions) -> Tensor:
    """(T,) bool: the triangles of the valid meshes beyond `angle` or `ratio`, not those that stand for quads.

    q  the batch's quality
    """
    t = math.radians(options.angle)
    # In triangles of a lower ratio than any with that angle has, no angle need be measured.
    least = min(least_ratio(t), options.ratio) if t else options.ratio
    bad = q.inverse_mean_ratio > least
    rows = true_rows(bad)
    valid = take(q.inverted, owner_of(rows, batch.triangle_offsets)) == 0
    few = smallest_angles(batch, rows)
    bad[rows] = valid & _is_bad(few, take(q.inverse_mean_ratio, rows), options)
    return bad & ~batch.of_quads if len(batch.quads) else bad


def _is_bad(angle: Tensor, ratio: Tensor, options: PolishOptions) -> Tensor:
    return (angle < options.angle * (torch.pi / 180)) | (ratio > options.ratio)


class _Polishing:
    """The surroundings of the bad triangles while they are worked on; the rest of the batch is not looked at.

    taken     these surroundings as they were
    mesh      what they have become; its outermost vertices are fixed
    complete  (V',) bool, all triangles at the vertex are in it
    stuck     (T',) bool, the triangle was tried in vain, and nothing near it has changed since
    frozen    (T',) bool, nothing can change the triangle
    """

    def __init__(self, batch: MeshBatch, bad: Tensor, options: PolishOptions) -> None:
        self.batch, self.options = batch, options
        self.patches = torch.zeros(len(batch), dtype=torch.int64, device=bad.device)
        self.flips = self.patches.clone()
        # A patch may leave the next one beside it bad, and that one the next again: there is room for three in a row.
        near = surroundings(batch, bad, 3 * max(level.rings for level in options.levels) + 1)
        self.taken = submesh(batch, touching(batch.triangles, near))
        self.complete = near[self.taken.vertices]
        self.mesh = replace(self.taken.mesh, fixed=self.taken.mesh.fixed | ~self.complete)
        self.stuck = torch.zeros(len(self.mesh.triangles), dtype=torch.bool, device=bad.device)
        self.limits = fan_limits(self.mesh, self.complete)
        self.frozen = frozen_triangles(batch)[self.taken.triangles]

    def asked(self) -> tuple[Tensor, Tensor]:
        """(T',) radians and inverse mean ratios beyond which triangles are bad, less strict where the boundary is."""
        options = self.options
        return asked_of(self.mesh, self.limits, math.radians(options.angle), options.ratio, options.limit_share)

    def whole(self) -> MeshBatch:
        """The batch with what was improved."""
        return self.taken.put_back(self.batch, self.mesh)

    def run(self, level: PolishLevel) -> None:
        """Rounds of this level until every bad triangle is good or was tried in vain."""
        most = (level.share * counts_from_offsets(self.batch.triangle_offsets)).clamp_min(level.most)
        self.stuck = self.frozen.clone()
        for turn in range(self.options.max_rounds):
            mesh = self.mesh
            (angle, ratio), (least, most_ratio) = shapes(mesh), self.asked()
            bad = ((angle < least) | (ratio > most_ratio)) & ~self.stuck
            if not turn:
                many = segment_count(bad, mesh.triangle_offsets) > most
                self.stuck |= spread(many, mesh.triangle_offsets)
                bad &= ~self.stuck
            if not bool(bad.any()):
                break
            first = not turn and level is self.options.levels[0]
            self._round(bad, angle, level, 1 if first else self.options.groups)

    def _round(self, bad: Tensor, angle: Tensor, level: PolishLevel, groups: int) -> None:
        """Try a patch around each of the worst triangles `bad` (T',) bool; the best goes back where it is better."""
        mesh, apart = self.mesh, 2 * level.rings
        seeds, patches = self._cut(bad, angle, level, groups)
        best, flips = _best_of(patches, level, self.options)
        before, after = (_Worst.of(m, self.options) for m in (patches.mesh, best))
        good = after.betters(before, self.options)
        self.stuck[seeds[~good]] = True
        # Of better patches that touch, the one with the worst triangle goes back.
        better = torch.zeros_like(bad).index_fill_(0, seeds[good], True)
        good &= torch.isin(seeds, seeds_of(mesh, better, angle, apart))
        changed = self._put(patches, best, good)
        self.stuck &= ~touching(mesh.triangles, surroundings(mesh, changed, level.rings)) | self.frozen
        owner = triangle_mesh(mesh)[seeds[good]]
        self.patches += torch.bincount(owner, minlength=len(mesh))
        self.flips.index_add_(0, owner, flips[good])

    def _cut(self, bad: Tensor, angle: Tensor, level: PolishLevel, groups: int) -> tuple[Tensor, Patches]:
        """(P,) the triangles to work on, and the patches around them; only patches of different groups touch."""
        mesh, left = self.mesh, bad.clone()
        cut: list[tuple[Tensor, Patches]] = []
        while bool(left.any()) and len(cut) < groups:
            seeds = seeds_of(mesh, left, angle, 2 * level.rings)
            cut.append((seeds, Patches.cut_out(mesh, seeds, level.rings, self.complete)))
            left[seeds] = False
        return torch.cat([seeds for seeds, _ in cut]), Patches.together([patches for _, patches in cut])

    def _put(self, patches: Patches, best: MeshBatch, good: Tensor) -> Tensor:
        """Put the meshes `good` (P,) bool of `best` into the rows of their patches; (T',) bool, their triangles."""
        given, mesh = patches.mesh, self.mesh
        # Only free vertices are written: the others stand in several patches.
        rows = spread(good, given.point_offsets) & ~given.fixed
        faces = spread(good, given.triangle_offsets)
        points, triangles = mesh.points.clone(), mesh.triangles.clone()
        points[patches.vertices[rows]] = best.points[rows]
        triangles[patches.faces[faces]] = patches.vertices[best.triangles[faces]]
        self.mesh = replace(mesh, points=points, triangles=triangles)
        changed = torch.zeros(len(triangles), dtype=torch.bool, device=good.device)
        return changed.index_fill_(0, patches.faces[faces], True)


class _Worst(NamedTuple):
    """Per mesh (B,): smallest angle in radians, largest inverse mean ratio, sum of squared ratios, bad triangles."""

    angle: Tensor
    ratio: Tensor
    energy: Tensor
    bad: Tensor

    @classmethod
    def of(cls, batch: MeshBatch, options: PolishOptions) -> "_Worst":
        (angle, ratio), offsets = shapes(batch), batch.triangle_offsets
        return cls(
            segment_min(angle, offsets),
            segment_max(ratio, offsets),
            segment_sum(ratio.square(), offsets),
            segment_count(_is_bad(angle, ratio, options), offsets),
        )

    def lack(self, options: PolishOptions) -> Tensor:
        """(B,) how far the worst triangle is beyond `angle` and `ratio`, as parts of these; 0 if it is not."""
        angle = (options.angle + options.angle_margin) * (torch.pi / 180)
        return ((angle - self.angle) / angle).clamp_min(0) + (self.ratio / options.ratio - 1).clamp_min(0)

    def betters(self, before: "_Worst", options: PolishOptions) -> Tensor:
        """(B,) bool: angle or ratio has improved, and none of angle, ratio and number of bad triangles is worse.

        The ratio may be worse, but not beyond `ratio`, where all angles have become as large as asked for.
        """
        wider = self.angle - before.angle > options.angle_gain * (torch.pi / 180)
        rounder = (before.ratio > options.ratio) & (before.ratio - self.ratio > options.ratio_gain)
        no_worse = (self.angle >= before.angle) & (self.ratio <= before.ratio) & (self.bad <= before.bad)
        return ((wider | rounder) & no_worse) | (wider & (self.lack(options) == 0))


def _best_of(patches: Patches, level: PolishLevel, options: PolishOptions) -> tuple[MeshBatch, Tensor]:
    """Each patch (P,) after the best flips found, smoothed; and the number (P,) of these flips."""
    given = patches.mesh
    start, of_start = given, torch.arange(len(given), device=patches.seed.device)
    found, of_found, flips_of_found = [], [], []
    for depth in range(level.flips):
        complete, seed = (v[rows_of_each(of_start, given.point_offsets)] for v in (patches.complete, patches.seed))
        members, of_member, flipped = every_flip(start, complete, seed if level.at_worst else None)
        patch = of_start[of_member]
        members, _ = smooth(members, options.smooth, block=_BLOCK)
        few = _first_of_each(patch, _Worst.of(members, options), len(given), options.finalists, options)
        start, of_start = members.select(few), patch[few]
        found.append(start)
        of_found.append(of_start)
        flips_of_found.append(depth + flipped[few].long())
    every, owner, flips = join(found), torch.cat(of_found), torch.cat(flips_of_found)
    chosen = true_rows(_first_of_each(owner, _Worst.of(every, options), len(given), 1, options))
    chosen = chosen[owner[chosen].argsort(stable=True)]
    return picked(every, chosen, given), flips[chosen]


def _first_of_each(owner: Tensor, worst: _Worst, count: int, number: int, options: PolishOptions) -> Tensor:
    """(N,) bool: the best `number` of the rows of each owner: least lack, then least energy, then first."""
    order = worst.energy.argsort(stable=True)
    order = order[worst.lack(options)[order].argsort(stable=True)]
    order = order[owner[order].argsort(stable=True)]
    first = offsets_from_counts(torch.bincount(owner, minlength=count))[:-1]
    rank = torch.arange(len(owner), device=owner.device) - first[owner[order]]
    chosen = torch.zeros(len(owner), dtype=torch.bool, device=owner.device)
    chosen[order] = rank < number
    return chosen
