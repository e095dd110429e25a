"""Which edges to flip: a rule looks at pairs of triangles and says which flips help, and how much."""

from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from torch import Tensor

from ..mesh.predicates import incircle, orientation
from ..mesh.triangle import Corners, inverse_mean_ratio


class Quads(NamedTuple):
    """The coordinates round N interior edges u-w, each (N,): s on their left, r on their right."""

    ux: Tensor
    uy: Tensor
    wx: Tensor
    wy: Tensor
    sx: Tensor
    sy: Tensor
    rx: Tensor
    ry: Tensor


# What a rule says of the edges in question: which to flip (N,) bool, and their rank (N,), higher first.
Rule = Callable[[Quads], tuple[Tensor, Tensor]]


@runtime_checkable
class VertexRule(Protocol):
    """A rule that must know the vertices u, w, s, r (N,) of the quads, too."""

    def at(self, u: Tensor, w: Tensor, s: Tensor, r: Tensor) -> Rule: ...


def opposite_angle_rank(q: Quads) -> Tensor:
    """(N,) the sum of the unsigned angles at s and r, which see the edge u-w, as a number from 0 to 4.

    It grows with the sum and is 2 where that is pi: the angle of the product of the two corners as
    complex numbers, measured along a square instead of a circle.  Plain arithmetic, so its bits
    do not depend on where in a vector an edge stands, as those of atan2 do.
    """
    dot_s = (q.ux - q.sx) * (q.wx - q.sx) + (q.uy - q.sy) * (q.wy - q.sy)
    dot_r = (q.ux - q.rx) * (q.wx - q.rx) + (q.uy - q.ry) * (q.wy - q.ry)
    cross_s = _double_area(q.ux, q.uy, q.wx, q.wy, q.sx, q.sy).abs()
    cross_r = _double_area(q.wx, q.wy, q.ux, q.uy, q.rx, q.ry).abs()
    real, imaginary = dot_s * dot_r - cross_s * cross_r, dot_s * cross_r + cross_s * dot_r
    size = real.abs() + imaginary.abs()
    slope = real / torch.where(size > 0, size, 1.0)
    return torch.where(imaginary >= 0, 1 - slope, 3 + slope)


def new_signs(q: Quads) -> tuple[Tensor, Tensor]:
    """(N,) exact signs of the two triangles that the flip would make, urs and rws."""
    first, second = _signs(q, "urs", "rws")
    return first, second


def old_signs(q: Quads) -> tuple[Tensor, Tensor]:
    """(N,) exact signs of the two triangles of the edge, uws and wur."""
    first, second = _signs(q, "uws", "wur")
    return first, second


def _signs(q: Quads, *triangles: str) -> Tensor:
    """(K, N) exact signs of the triangles of these corners, in one go."""
    columns = [torch.cat([getattr(q, t[i] + axis) for t in triangles]) for i in range(3) for axis in "xy"]
    return orientation(*columns).view(len(triangles), -1)


def kim_rule(q: Quads) -> tuple[Tensor, Tensor]:
    """Kim 2017, Step 1: flip when the opposite angles sum to more than pi and no new triangle inverts.

    For two upright triangles the sum is compared by the exact in-circle sign, which is the same
    criterion (Delaunay); ranked by the sum.
    """
    total = opposite_angle_rank(q)
    eligible = total > 2 - 1e-12
    rows = eligible.nonzero().squeeze(1)
    few = _some(q, rows)
    left, right = old_signs(few)
    upright = (left > 0) & (right > 0)
    inside = incircle(few.ux, few.uy, few.wx, few.wy, few.sx, few.sy, few.rx, few.ry) > 0
    first, second = new_signs(few)
    eligible = eligible.clone()
    eligible[rows] = torch.where(upright, inside, total[rows] > 2) & (first > 0) & (second > 0)
    return eligible, total


def safe_rule(q: Quads) -> tuple[Tensor, Tensor]:
    """Flips that cannot do harm: towards a lower sum of |area|; among upright pairs, Delaunay.

    A pair's signed areas sum to the same before and after, so its sum of |area| falls exactly when
    its inverted area does.  Inverted area never grows, nor the count of inverted triangles; at
    equal inverted area flat triangles go, and between two upright pairs the Delaunay one wins.
    The three together strictly decrease in lexicographic order: rounds cannot cycle.
    """
    left, right = old_signs(q)
    upright = (left > 0) & (right > 0)
    rank, rounding = _cotangent_deficit(q)
    # The deficit is positive where the in-circle sign is: far from zero it saves asking for that sign.
    rows = (~upright | (rank > -rounding)).nonzero().squeeze(1)
    few = _some(q, rows)
    delaunay = incircle(few.ux, few.uy, few.wx, few.wy, few.sx, few.sy, few.rx, few.ry) > 0
    first, second = new_signs(few)
    made_upright = (first > 0) & (second > 0)
    before = [_double_area(few.ux, few.uy, few.wx, few.wy, few.sx, few.sy)]
    before.append(_double_area(few.wx, few.wy, few.ux, few.uy, few.rx, few.ry))
    after = [_double_area(few.ux, few.uy, few.rx, few.ry, few.sx, few.sy)]
    after.append(_double_area(few.rx, few.ry, few.wx, few.wy, few.sx, few.sy))
    gain = _inverted_area(before) - _inverted_area(after)
    smallest = 1e-14 * torch.stack(before + after).abs().sum(0)
    old_left, old_right = left[rows], right[rows]
    count_before = (old_left < 0).to(torch.int8) + (old_right < 0)
    count_after = (first < 0).to(torch.int8) + (second < 0)
    lower = (gain > smallest) & (count_after <= count_before)
    unflattened = (old_left >= 0) & (old_right >= 0) & made_upright
    is_upright = upright[rows]
    eligible = torch.zeros_like(upright)
    eligible[rows] = torch.where(is_upright, delaunay & made_upright, lower | unflattened)
    # Untangling flips come before Delaunay flips, the largest relative gain first.
    rank[rows] = torch.where(is_upright, rank[rows], 1e30 * (1 + gain / smallest.clamp_min(1e-300)))
    return eligible, rank


def shape_rule(q: Quads) -> tuple[Tensor, Tensor]:
    """Flip between upright pairs when the sum of squared inverse mean ratios falls: the smoother's energy.

    Only edges that are nearly not Delaunay are asked: the longer diagonal of two good triangles.
    """
    near = _cotangent_deficit(q)[0] > -0.5
    rows = near.nonzero().squeeze(1)
    few = _some(q, rows)
    gain = _pair_energy(few, False) - _pair_energy(few, True)
    wins = (gain > 1e-10).nonzero().squeeze(1)
    fewer = _some(few, wins)
    legal = _signs(fewer, "uws", "wur", "urs", "rws").amin(0) > 0
    eligible = torch.zeros_like(near)
    eligible[rows[wins[legal]]] = True
    rank = torch.zeros_like(q.ux)
    rank[rows] = gain
    return eligible, rank


def _some(q: Quads, rows: Tensor) -> Quads:
    return Quads(*(v.index_select(0, rows) for v in q))


def _pair_energy(q: Quads, flipped: bool) -> Tensor:
    if flipped:
        first, second = Corners(q.ux, q.uy, q.rx, q.ry, q.sx, q.sy), Corners(q.rx, q.ry, q.wx, q.wy, q.sx, q.sy)
    else:
        first, second = Corners(q.ux, q.uy, q.wx, q.wy, q.sx, q.sy), Corners(q.wx, q.wy, q.ux, q.uy, q.rx, q.ry)
    # A flat triangle's infinity must not meet another in a difference.
    return inverse_mean_ratio(first).clamp_max(1e30).square() + inverse_mean_ratio(second).clamp_max(1e30).square()


def _double_area(ax: Tensor, ay: Tensor, bx: Tensor, by: Tensor, cx: Tensor, cy: Tensor) -> Tensor:
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def _inverted_area(double_areas: list[Tensor]) -> Tensor:
    return torch.stack(double_areas).clamp_max(0).sum(0).neg()


def _cotangent_deficit(q: Quads) -> tuple[Tensor, Tensor]:
    """(N,) minus the sum of the cotangents of the opposite angles: positive when they exceed pi.

    And (N,) more than rounding may have added to it or taken from it.
    """
    dot_s = (q.ux - q.sx) * (q.wx - q.sx) + (q.uy - q.sy) * (q.wy - q.sy)
    dot_r = (q.ux - q.rx) * (q.wx - q.rx) + (q.uy - q.ry) * (q.wy - q.ry)
    cross_s = _double_area(q.ux, q.uy, q.wx, q.wy, q.sx, q.sy).abs().clamp_min(1e-300)
    cross_r = _double_area(q.wx, q.wy, q.ux, q.uy, q.rx, q.ry).abs().clamp_min(1e-300)
    cot_s, cot_r = dot_s / cross_s, dot_r / cross_r
    # A cross product is off by some last digits of its terms, which are at most 1 + |cot| times as large.
    rounding = 1e-13 * ((1 + cot_s.abs()).square_() + (1 + cot_r.abs()).square_())
    rounding.masked_fill_(torch.minimum(cross_s, cross_r) < 1e-290, torch.inf)
    return -(cot_s + cot_r).clamp(-1e29, 1e29), rounding
