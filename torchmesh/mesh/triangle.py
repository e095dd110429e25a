"""Formulae for one triangle, vectorised over rows: areas, edge lengths, angles and quality measures.

The coordinates are six separate contiguous vectors: on a CPU that is several times faster than one (T, 3, 2) tensor.
The corners are a, b, c; the area is positive when they run counter-clockwise.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

SQRT3 = math.sqrt(3.0)


class Corners(NamedTuple):
    """The corner coordinates of T triangles, each (T,), in the mesh's length unit."""

    ax: Tensor
    ay: Tensor
    bx: Tensor
    by: Tensor
    cx: Tensor
    cy: Tensor


def corners(points: Tensor, triangles: Tensor) -> Corners:
    """Corner coordinates of `triangles` (T, 3) over `points` (V, 2)."""
    x, y = points[:, 0].contiguous(), points[:, 1].contiguous()
    a, b, c = (v.contiguous() for v in triangles.unbind(1))
    gather = torch.index_select
    return Corners(gather(x, 0, a), gather(y, 0, a), gather(x, 0, b), gather(y, 0, b), gather(x, 0, c), gather(y, 0, c))


def signed_area(t: Corners) -> Tensor:
    """(T,) the signed area, which is positive if the corners run counter-clockwise."""
    return 0.5 * ((t.bx - t.ax) * (t.cy - t.ay) - (t.by - t.ay) * (t.cx - t.ax))


def squared_edge_lengths(t: Corners) -> tuple[Tensor, Tensor, Tensor]:
    """(T,) squared lengths of the edges ab, bc, ca."""
    return (
        (t.bx - t.ax).square() + (t.by - t.ay).square(),
        (t.cx - t.bx).square() + (t.cy - t.by).square(),
        (t.ax - t.cx).square() + (t.ay - t.cy).square(),
    )


def inverse_mean_ratio(t: Corners) -> Tensor:
    """(T,) the inverse mean ratio, which is 1 for an equilateral triangle and infinite for one without area.

    This is equation (4) of Kim 2017 with the equilateral W of equation (3), or
    (l_ab^2 + l_bc^2 + l_ca^2) / (4 sqrt(3) |area|) (Munson 2007).  An inverted triangle has the value of its mirror
    image, as in the paper.
    """
    ab, bc, ca = squared_edge_lengths(t)
    area = signed_area(t).abs()
    return torch.where(area > 0, (ab + bc + ca) / (4 * SQRT3 * torch.where(area > 0, area, 1.0)), torch.inf)


def mean_ratio(t: Corners) -> Tensor:
    """(T,) the signed mean ratio 4 sqrt(3) area / (l_ab^2 + l_bc^2 + l_ca^2), from -1 to 1.

    It is 1 for an equilateral triangle, 0 for a flat one, and negative for an inverted one (Liu & Joe, BIT 34, 1994;
    Verdict's triangle shape with a sign).  It is 0 where the three corners coincide.
    """
    ab, bc, ca = squared_edge_lengths(t)
    total = ab + bc + ca
    return 4 * SQRT3 * signed_area(t) / torch.where(total > 0, total, 1.0)


def scaled_jacobian(t: Corners) -> Tensor:
    """(T,) the scaled Jacobian: 2 / sqrt(3) times the signed sine of the smallest angle, from -1 to 1.

    The sine is det [b - a, c - a] over the product of the two longest edges (Verdict manual, triangles).  The result
    is 1 for an equilateral triangle, 0 for a flat one, and negative for an inverted one.
    """
    ab, bc, ca = edge_lengths(t)
    longest = torch.maximum(ab * bc, torch.maximum(bc * ca, ca * ab))
    return 2 * (2 / SQRT3) * signed_area(t) / torch.where(longest > 0, longest, 1.0)


def edge_lengths(t: Corners) -> tuple[Tensor, Tensor, Tensor]:
    """(T,) the lengths of the edges ab, bc, ca; the gradient of a length of 0 is 0."""
    squares = squared_edge_lengths(t)
    return tuple(torch.where(s > 0, torch.where(s > 0, s, 1.0).sqrt(), 0.0) for s in squares)  # type: ignore[return-value]


def aspect_ratio(t: Corners) -> Tensor:
    """(T,) the longest edge times the perimeter over 4 sqrt(3) |area|, at least 1 (Verdict manual, triangles)."""
    ab, bc, ca = edge_lengths(t)
    return _over_area(torch.maximum(ab, torch.maximum(bc, ca)) * (ab + bc + ca) / (4 * SQRT3), t)


def radius_ratio(t: Corners) -> Tensor:
    """(T,) the radius of the circumcircle over twice that of the incircle, which is at least 1.

    It is l_ab l_bc l_ca (l_ab + l_bc + l_ca) / (16 area^2) (Verdict manual, triangles).
    """
    ab, bc, ca = edge_lengths(t)
    # The product of two factors: a fourth power of lengths could overflow.
    return _over_area(ab * bc, t) * _over_area(ca * (ab + bc + ca), t) / 16


def edge_ratio(t: Corners) -> Tensor:
    """(T,) the longest edge over the shortest, at least 1; infinite where two corners coincide (Verdict manual)."""
    ab, bc, ca = edge_lengths(t)
    shortest = torch.minimum(ab, torch.minimum(bc, ca))
    ratio = torch.maximum(ab, torch.maximum(bc, ca)) / torch.where(shortest > 0, shortest, 1.0)
    return torch.where(shortest > 0, ratio, torch.inf)


def _over_area(value: Tensor, t: Corners) -> Tensor:
    """(T,) value / |area|; for a flat triangle it is infinite, and its gradient is 0."""
    area = signed_area(t).abs()
    return torch.where(area > 0, value / torch.where(area > 0, area, 1.0), torch.inf)


def minimum_angle(t: Corners) -> Tensor:
    """(T,) the smallest unsigned angle in radians, from 0 for a flat triangle to pi / 3."""
    a, b, c = angles(t)
    return torch.where(signed_area(t) == 0, 0.0, torch.minimum(a, torch.minimum(b, c)))


def maximum_angle(t: Corners) -> Tensor:
    """(T,) the largest unsigned angle in radians, from pi / 3 to pi for a flat triangle."""
    a, b, c = angles(t)
    return torch.where(signed_area(t) == 0, math.pi, torch.maximum(a, torch.maximum(b, c)))


def angle_at(px: Tensor, py: Tensor, qx: Tensor, qy: Tensor, rx: Tensor, ry: Tensor) -> Tensor:
    """(T,) the unsigned angle at p between the rays to q and to r, in [0, pi] radians; 0 where a ray has no length."""
    ux, uy, vx, vy = qx - px, qy - py, rx - px, ry - py
    return arctangent((ux * vy - uy * vx).abs(), ux * vx + uy * vy)


def angles(t: Corners) -> tuple[Tensor, Tensor, Tensor]:
    """(T,) the unsigned angles at the corners a, b, c, in radians."""
    return (
        angle_at(t.ax, t.ay, t.bx, t.by, t.cx, t.cy),
        angle_at(t.bx, t.by, t.cx, t.cy, t.ax, t.ay),
        angle_at(t.cx, t.cy, t.ax, t.ay, t.bx, t.by),
    )


def least_ratio(angle: float) -> float:
    """The lowest inverse mean ratio of a triangle with this angle in radians, that of the isosceles one.

    It is (2 - cos t) / (sqrt(3) sin t): among triangles with a lower ratio none has so small an angle.
    """
    return (2 - math.cos(angle)) / (SQRT3 * math.sin(angle))


# So many terms of 1 - x / 3 + x^2 / 5 - ..., x = t^2, give arctan(t) / t to 1e-17 for t <= tan(pi / 16).
_TERMS = 12


def arctangent(y: Tensor, x: Tensor) -> Tensor:
    """(T,) atan2(y, x) for y >= 0, in [0, pi]; 0 at the origin.

    The angle is halved until a short part of its Taylor series is enough.  Everything is plain arithmetic: the bits
    of `torch.atan2` depend on where in the tensor a row stands, and these do not.
    """
    size = torch.maximum(x.abs(), y)
    zero = size == 0
    size = torch.where(zero, 1.0, size)
    across, along = y / size, torch.where(zero, 1.0, x.abs() / size)
    tangent = across / (along + (across * across + along * along).sqrt())
    for _ in range(2):
        tangent = tangent / (1 + (1 + tangent * tangent).sqrt())
    square = tangent * tangent
    series = torch.zeros_like(square)
    for k in reversed(range(_TERMS)):
        series = (1 if k % 2 == 0 else -1) / (2 * k + 1) + square * series
    angle = 8 * tangent * series
    return torch.where(x < 0, math.pi - angle, angle)
