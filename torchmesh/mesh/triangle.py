"""Formulae on one triangle, vectorised over rows: areas, lengths, shape.

Coordinates travel as six separate contiguous vectors: on a CPU that is several times faster than
one (T, 3, 2) tensor.  Corner order is a, b, c; area is positive when it runs counter-clockwise.
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
    """(T,) signed area, positive counter-clockwise."""
    return 0.5 * ((t.bx - t.ax) * (t.cy - t.ay) - (t.by - t.ay) * (t.cx - t.ax))


def squared_edge_lengths(t: Corners) -> tuple[Tensor, Tensor, Tensor]:
    """(T,) squared lengths of the edges ab, bc, ca."""
    return (
        (t.bx - t.ax).square() + (t.by - t.ay).square(),
        (t.cx - t.bx).square() + (t.cy - t.by).square(),
        (t.ax - t.cx).square() + (t.ay - t.cy).square(),
    )


def inverse_mean_ratio(t: Corners) -> Tensor:
    """(T,) inverse mean ratio, 1 for an equilateral triangle, infinite for one of no area.

    Kim 2017 equation (4) with the equilateral W of equation (3), which is
    (l_ab^2 + l_bc^2 + l_ca^2) / (4 sqrt(3) |area|) (Munson 2007).  An inverted triangle has the
    value of its mirror image, as printed.
    """
    ab, bc, ca = squared_edge_lengths(t)
    area = signed_area(t).abs()
    return torch.where(area > 0, (ab + bc + ca) / (4 * SQRT3 * torch.where(area > 0, area, 1.0)), torch.inf)


def mean_ratio(t: Corners) -> Tensor:
    """(T,) signed mean ratio 4 sqrt(3) area / (l_ab^2 + l_bc^2 + l_ca^2), from -1 to 1.

    1 for an equilateral triangle, 0 for a flat one, negative for an inverted one (Liu & Joe, BIT 34,
    1994; Verdict's triangle shape, to which this gives a sign).  0 where the three corners are one point.
    """
    ab, bc, ca = squared_edge_lengths(t)
    total = ab + bc + ca
    return 4 * SQRT3 * signed_area(t) / torch.where(total > 0, total, 1.0)


def scaled_jacobian(t: Corners) -> Tensor:
    """(T,) 2 / sqrt(3) times the signed sine of the smallest angle, from -1 to 1.

    det [b - a, c - a] over the product of the two longest edges (Verdict manual, triangles); 1 for
    an equilateral triangle, 0 for a flat one, negative for an inverted one.
    """
    ab, bc, ca = edge_lengths(t)
    longest = torch.maximum(ab * bc, torch.maximum(bc * ca, ca * ab))
    return 2 * (2 / SQRT3) * signed_area(t) / torch.where(longest > 0, longest, 1.0)


def edge_lengths(t: Corners) -> tuple[Tensor, Tensor, Tensor]:
    """(T,) lengths of the edges ab, bc, ca; where one is 0 its gradient is 0."""
    squares = squared_edge_lengths(t)
    return tuple(torch.where(s > 0, torch.where(s > 0, s, 1.0).sqrt(), 0.0) for s in squares)  # type: ignore[return-value]


def aspect_ratio(t: Corners) -> Tensor:
    """(T,) longest edge times perimeter over 4 sqrt(3) |area|, from 1 (Verdict manual, triangles)."""
    ab, bc, ca = edge_lengths(t)
    return _over_area(torch.maximum(ab, torch.maximum(bc, ca)) * (ab + bc + ca) / (4 * SQRT3), t)


def radius_ratio(t: Corners) -> Tensor:
    """(T,) radius of the circle round the triangle over twice that of the circle in it, from 1.

    l_ab l_bc l_ca (l_ab + l_bc + l_ca) / (16 area^2) (Verdict manual, triangles).
    """
    ab, bc, ca = edge_lengths(t)
    # In two factors, since a fourth power of lengths would overflow.
    return _over_area(ab * bc, t) * _over_area(ca * (ab + bc + ca), t) / 16


def edge_ratio(t: Corners) -> Tensor:
    """(T,) longest edge over shortest, from 1; infinite where two corners coincide (Verdict manual, triangles)."""
    ab, bc, ca = edge_lengths(t)
    shortest = torch.minimum(ab, torch.minimum(bc, ca))
    ratio = torch.maximum(ab, torch.maximum(bc, ca)) / torch.where(shortest > 0, shortest, 1.0)
    return torch.where(shortest > 0, ratio, torch.inf)


def _over_area(value: Tensor, t: Corners) -> Tensor:
    """(T,) value / |area|, infinite for a flat triangle, whose gradient is then 0."""
    area = signed_area(t).abs()
    return torch.where(area > 0, value / torch.where(area > 0, area, 1.0), torch.inf)


def minimum_angle(t: Corners) -> Tensor:
    """(T,) smallest unsigned angle in radians, from 0 for a flat triangle to pi / 3."""
    a, b, c = angles(t)
    return torch.where(signed_area(t) == 0, 0.0, torch.minimum(a, torch.minimum(b, c)))


def maximum_angle(t: Corners) -> Tensor:
    """(T,) largest unsigned angle in radians, from pi / 3 to pi for a flat triangle."""
    a, b, c = angles(t)
    return torch.where(signed_area(t) == 0, math.pi, torch.maximum(a, torch.maximum(b, c)))


def angle_at(px: Tensor, py: Tensor, qx: Tensor, qy: Tensor, rx: Tensor, ry: Tensor) -> Tensor:
    """(T,) unsigned angle in radians at p between the rays to q and to r, in [0, pi]; 0 where a ray has no length."""
    ux, uy, vx, vy = qx - px, qy - py, rx - px, ry - py
    return arctangent((ux * vy - uy * vx).abs(), ux * vx + uy * vy)


def angles(t: Corners) -> tuple[Tensor, Tensor, Tensor]:
    """(T,) unsigned angles in radians at the corners a, b, c."""
    return (
        angle_at(t.ax, t.ay, t.bx, t.by, t.cx, t.cy),
        angle_at(t.bx, t.by, t.cx, t.cy, t.ax, t.ay),
        angle_at(t.cx, t.cy, t.ax, t.ay, t.bx, t.by),
    )


# 1 - x / 3 + x^2 / 5 - ... up to here tells arctan(t) / t for t <= tan(pi / 16), x = t^2, to 1e-17.
_TERMS = 12


def arctangent(y: Tensor, x: Tensor) -> Tensor:
    """(T,) atan2(y, x) for y >= 0, in [0, pi]; 0 at the origin.

    The angle is halved until Taylor's series is short.  Plain arithmetic, so that a row's bits do
    not depend on where in the tensor it stands, as those of `torch.atan2` do.
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
