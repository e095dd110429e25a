"""Which edges to flip: a rule looks at pairs of triangles, says which flips help, and ranks them."""

from collections.abc import Callable
from typing import Literal, NamedTuple, Protocol, runtime_checkable

import torch
from torch import Tensor

from ..mesh.predicates import incircle, orientation
from ..mesh.ragged import take, true_rows
from ..mesh.triangle import Corners, inverse_mean_ratio

# A flip must lower the energy of two triangles by more than rounding can: `shape_rule` compares the gain with this
# number, since energies of good triangles are near 1; `MetricRule` takes it as a part of the energy.
LEAST_GAIN = 1e-10


class Quads(NamedTuple):
    """The coordinates around N interior edges u-w, each (N,): s lies on their left, r on their right."""

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
    """A rule that also needs the vertices u, w, s, r (N,) of the quads."""

    def at(self, u: Tensor, w: Tensor, s: Tensor, r: Tensor) -> Rule: ...


def opposite_angle_rank(q: Quads) -> Tensor:
    """(N,) the sum of the unsigned angles at s and r, which lie opposite the edge u-w, as a number from 0 to 4.

    The number grows with the sum and is 2 where the sum is pi.  It is the angle of the product of the two corners as
    complex numbers, measured along a square instead of a circle.  This is plain arithmetic, so its bits do not
    depend on the position of an edge in a vector, as those of atan2 do.
    """
    dot_s, cross_s, dot_r, cross_r = _opposite_corners(q)
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
    """(K, N) exact signs of the triangles with these corners, computed in one call."""
    columns = [torch.cat([getattr(q, t[i] + axis) for t in triangles]) for i in range(3) for axis in "xy"]
    return orientation(*columns).view(len(triangles), -1)


def old_pair(q: Quads) -> tuple[Corners, Corners]:
    """The two triangles of the edge, uws and wur."""
    return Corners(q.ux, q.uy, q.wx, q.wy, q.sx, q.sy), Corners(q.wx, q.wy, q.ux, q.uy, q.rx, q.ry)


def new_pair(q: Quads) -> tuple[Corners, Corners]:
    """The two triangles that the flip would make, urs and rws."""
    return Corners(q.ux, q.uy, q.rx, q.ry, q.sx, q.sy), Corners(q.rx, q.ry, q.wx, q.wy, q.sx, q.sy)


def kim_rule(q: Quads) -> tuple[Tensor, Tensor]:
    """Kim 2017, Step 1: flip when the opposite angles sum to more than pi and no new triangle is inverted.

    For two upright triangles the sum is compared by the exact in-circle sign, which is the same criterion
    (Delaunay).  Edges are ranked by the sum.
    """
    total = opposite_angle_rank(q)
    # Rounding may have lowered the rank by less than 1e-12; the exact signs below decide.
    eligible = total > 2 - 1e-12
    rows = true_rows(eligible)
    few = _some(q, rows)
    left, right = old_signs(few)
    upright = (left > 0) & (right > 0)
    inside = _inside_circle(few)
    first, second = new_signs(few)
    eligible = eligible.clone()
    eligible[rows] = torch.where(upright, inside, total[rows] > 2) & (first > 0) & (second > 0)
    return eligible, total


def safe_rule(q: Quads) -> tuple[Tensor, Tensor]:
    """Flips that cannot do harm: they lower the sum of |area|, and between upright triangles they are Delaunay.

    The signed areas of a pair have the same sum before and after the flip, so its sum of |area| falls exactly when
    its inverted area does.  Neither the inverted area nor the number of inverted triangles ever grows.  At equal
    inverted area a flip may remove a flat triangle, and between two upright pairs the Delaunay one wins.
    Inverted area, number of flat triangles and the Delaunay criterion decrease in lexicographic order, so the
    rounds end.
    """
    left, right = old_signs(q)
    upright = (left > 0) & (right > 0)
    rank, rounding = _cotangent_deficit(q)
    # The deficit and the in-circle determinant have the same sign: far from zero the deficit replaces the exact sign.
    rows = true_rows(~upright | (rank > -rounding))
    few = _some(q, rows)
    delaunay = _inside_circle(few)
    signs_after = new_signs(few)
    made_upright = (signs_after[0] > 0) & (signs_after[1] > 0)
    untangles, relative_gain = _untangling(few, (left[rows], right[rows]), signs_after, made_upright)
    is_upright = upright[rows]
    eligible = torch.zeros_like(upright)
    eligible[rows] = torch.where(is_upright, delaunay & made_upright, untangles)
    # Untangling flips come before Delaunay flips, the largest relative gain first.
    rank[rows] = torch.where(is_upright, rank[rows], 1e30 * (1 + relative_gain))
    return eligible, rank


def _untangling(
    q: Quads, signs_before: tuple[Tensor, Tensor], signs_after: tuple[Tensor, Tensor], made_upright: Tensor
) -> tuple[Tensor, Tensor]:
    """(N,) bool: does the flip lower the inverted area, or remove flat triangles at equal inverted area?

    And (N,) the inverted area that it takes away, in units of what rounding could feign.
    """
    (left, right), (first, second) = signs_before, signs_after
    before, after = ([_double_area(*t) for t in pair] for pair in (old_pair(q), new_pair(q)))
    gain = _inverted_area(before) - _inverted_area(after)
    smallest = 1e-14 * torch.stack(before + after).abs().sum(0)
    count_before = (left < 0).to(torch.int8) + (right < 0)
    count_after = (first < 0).to(torch.int8) + (second < 0)
    lower = (gain > smallest) & (count_after <= count_before)
    unflattened = (left >= 0) & (right >= 0) & made_upright
    return lower | unflattened, gain / smallest.clamp_min(1e-300)


# `shape_rule` asks about edges whose cotangent deficit is above this.  Zero is the Delaunay criterion; among better
# edges a flip can only help where the edge is the longer diagonal of two good triangles.
_NEARLY_NOT_DELAUNAY = -0.5


def shape_rule(q: Quads) -> tuple[Tensor, Tensor]:
    """Flip between upright pairs when the sum of squared inverse mean ratios falls: the smoother's energy.

    Only edges that are nearly not Delaunay are asked about.
    """
    near = _cotangent_deficit(q)[0] > _NEARLY_NOT_DELAUNAY
    rows = true_rows(near)
    few = _some(q, rows)
    gain = _pair_energy(old_pair(few)) - _pair_energy(new_pair(few))
    wins = true_rows(gain > LEAST_GAIN)
    fewer = _some(few, wins)
    legal = _signs(fewer, "uws", "wur", "urs", "rws").amin(0) > 0
    eligible = torch.zeros_like(near)
    eligible[rows[wins[legal]]] = True
    rank = torch.zeros_like(q.ux)
    rank[rows] = gain
    return eligible, rank


def _some(q: Quads, rows: Tensor) -> Quads:
    return Quads(*(take(v, rows) for v in q))


def _inside_circle(q: Quads) -> Tensor:
    """(N,) bool, exact: r lies inside the circle through u, w and s."""
    return incircle(q.ux, q.uy, q.wx, q.wy, q.sx, q.sy, q.rx, q.ry) > 0


def _pair_energy(pair: tuple[Corners, Corners]) -> Tensor:
    first, second = pair
    return finite_energy(first) + finite_energy(second)


def finite_energy(t: Corners) -> Tensor:
    """(N,) the squared inverse mean ratio; finite also for flat triangles, so that differences are numbers."""
    return inverse_mean_ratio(t).clamp_max(1e30).square()


def _double_area(ax: Tensor, ay: Tensor, bx: Tensor, by: Tensor, cx: Tensor, cy: Tensor) -> Tensor:
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def _inverted_area(double_areas: list[Tensor]) -> Tensor:
    return torch.stack(double_areas).clamp_max(0).sum(0).neg()


def _opposite_corners(q: Quads) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """(N,) dot product and |cross product| of the two sides that meet at s, then the same at r."""
    dot_s = (q.ux - q.sx) * (q.wx - q.sx) + (q.uy - q.sy) * (q.wy - q.sy)
    dot_r = (q.ux - q.rx) * (q.wx - q.rx) + (q.uy - q.ry) * (q.wy - q.ry)
    uws, wur = old_pair(q)
    return dot_s, _double_area(*uws).abs(), dot_r, _double_area(*wur).abs()


def _cotangent_deficit(q: Quads) -> tuple[Tensor, Tensor]:
    """(N,) minus the sum of the cotangents of the opposite angles: positive where these sum to more than pi.

    And (N,) a bound on the error that rounding has made in it.
    """
    dot_s, cross_s, dot_r, cross_r = _opposite_corners(q)
    cross_s, cross_r = cross_s.clamp_min(1e-300), cross_r.clamp_min(1e-300)
    cot_s, cot_r = dot_s / cross_s, dot_r / cross_r
    # The last digits of a cross product's terms are lost, and these terms are at most 1 + |cot| times as large as it.
    rounding = 1e-13 * ((1 + cot_s.abs()).square_() + (1 + cot_r.abs()).square_())
    rounding.masked_fill_(torch.minimum(cross_s, cross_r) < 1e-290, torch.inf)
    return -(cot_s + cot_r).clamp(-1e29, 1e29), rounding


# The rules by the names that `FlipOptions.rule` takes; a new one is listed here.
RuleName = Literal["safe", "kim", "shape"]
RULES = {"safe": safe_rule, "kim": kim_rule, "shape": shape_rule}
