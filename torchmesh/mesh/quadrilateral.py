"""Formulae for one quad, vectorised over rows, with the names of the Verdict manual.

    d --l2-- c      l0 = ab, l1 = bc, l2 = cd, l3 = da; alpha_k is the Jacobian at corner k, twice the signed area of
    l3       l1     the triangle of the corner and its neighbours; X1 = (b - a) + (c - d) and X2 = (c - b) + (d - a)
    a --l0-- b      are the principal axes

Source: Stimpson, Ernst, Knupp, Pebay & Thompson, The Verdict Geometric Quality Library, SAND2007-1751, where quads
stand in space.  In the plane a corner has a sign, and so have what is called signed here; everything else is that of
the mirror image at an inverted corner, and infinite at a flat one.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from .triangle import angle_at


class QuadCorners(NamedTuple):
    """The corner coordinates of Q quads, each (Q,), in the mesh's length unit."""

    ax: Tensor
    ay: Tensor
    bx: Tensor
    by: Tensor
    cx: Tensor
    cy: Tensor
    dx: Tensor
    dy: Tensor


def quad_corners(points: Tensor, quads: Tensor) -> QuadCorners:
    """Corner coordinates of `quads` (Q, 4) over `points` (V, 2)."""
    xy = points[quads]
    return QuadCorners(*(xy[:, k, i] for k in range(4) for i in range(2)))


def _edges(q: QuadCorners) -> list[tuple[Tensor, Tensor]]:
    """The vectors ab, bc, cd, da."""
    corner = _corners(q)
    return [(v[0] - u[0], v[1] - u[1]) for u, v in zip(corner, corner[1:] + corner[:1], strict=True)]


def _corners(q: QuadCorners) -> list[tuple[Tensor, Tensor]]:
    return [(q.ax, q.ay), (q.bx, q.by), (q.cx, q.cy), (q.dx, q.dy)]


def corner_jacobians(q: QuadCorners) -> Tensor:
    """(Q, 4) alpha_k at the corners a, b, c, d: the cross product of the edge into the corner and that out of it."""
    e = _edges(q)
    return torch.stack([e[k - 1][0] * e[k][1] - e[k - 1][1] * e[k][0] for k in range(4)], 1)


def squared_lengths(q: QuadCorners) -> Tensor:
    """(Q, 4) squared lengths of ab, bc, cd, da."""
    return torch.stack([x * x + y * y for x, y in _edges(q)], 1)


def edge_lengths(q: QuadCorners) -> Tensor:
    """(Q, 4) lengths of ab, bc, cd, da; the gradient of a length of 0 is 0."""
    square = squared_lengths(q)
    return torch.where(square > 0, torch.where(square > 0, square, 1.0).sqrt(), 0.0)


def signed_area(q: QuadCorners) -> Tensor:
    """(Q,) the signed area, positive if the corners run counter-clockwise: a quarter of the sum of the alphas."""
    return 0.5 * ((q.cx - q.ax) * (q.dy - q.by) - (q.cy - q.ay) * (q.dx - q.bx))


def _corner_ratios(q: QuadCorners) -> Tensor:
    """(Q, 4) alpha_k over the mean of the squares of the edges at the corner: 1 at a corner of a square; signed."""
    square = squared_lengths(q)
    total = square + square.roll(1, 1)
    return 2 * corner_jacobians(q) / torch.where(total > 0, total, 1.0)


def shape(q: QuadCorners) -> Tensor:
    """(Q,) 2 min_k alpha_k / (l_k-1^2 + l_k^2), but never below 0; 1 for a square (Verdict, after Knupp 2001)."""
    return _corner_ratios(q).amin(1).clamp_min(0)


def signed_shape(q: QuadCorners) -> Tensor:
    """(Q,) the shape, negative for an inverted quad: the mean ratio of its worst corner, from -1 to 1."""
    return _corner_ratios(q).amin(1)


def condition(q: QuadCorners) -> Tensor:
    """(Q,) the greatest condition number of the corners, (l_k-1^2 + l_k^2) / (2 |alpha_k|), 1 for a square."""
    square, alpha = squared_lengths(q), corner_jacobians(q).abs()
    total = square + square.roll(1, 1)
    return torch.where(alpha > 0, total / (2 * torch.where(alpha > 0, alpha, 1.0)), torch.inf).amax(1)


# The inverse mean ratio towards the square, of the worst corner: with W = I it is ||J||^2 / (2 |det J|) at a corner,
# which is its condition number (Knupp, Algebraic mesh quality metrics, SIAM Journal on Scientific Computing 23, 2001).
inverse_mean_ratio = condition


def scaled_jacobian(q: QuadCorners) -> Tensor:
    """(Q,) the least alpha_k over the lengths of its edges, the sine of its angle; signed, 1 for a rectangle."""
    length = edge_lengths(q)
    product = length * length.roll(1, 1)
    return (corner_jacobians(q) / torch.where(product > 0, product, 1.0)).amin(1)


def jacobian(q: QuadCorners) -> Tensor:
    """(Q,) the least alpha_k, signed, in the unit of length squared."""
    return corner_jacobians(q).amin(1)


def _axes(q: QuadCorners) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """x and y of the principal axes X1 and X2."""
    e = _edges(q)
    return e[0][0] - e[2][0], e[0][1] - e[2][1], e[1][0] - e[3][0], e[1][1] - e[3][1]


def skew(q: QuadCorners) -> Tensor:
    """(Q,) |cos| of the angle between the principal axes, 0 for a rectangle; 0 where an axis has no length."""
    x1, y1, x2, y2 = _axes(q)
    square = (x1 * x1 + y1 * y1) * (x2 * x2 + y2 * y2)
    return torch.where(square > 0, (x1 * x2 + y1 * y2).abs() / torch.where(square > 0, square, 1.0).sqrt(), 0.0)


def taper(q: QuadCorners) -> Tensor:
    """(Q,) the length of X12 = (a - b) + (c - d) over the shorter principal axis, 0 for a parallelogram."""
    x1, y1, x2, y2 = _axes(q)
    x, y = (q.ax - q.bx) + (q.cx - q.dx), (q.ay - q.by) + (q.cy - q.dy)
    least = torch.minimum(x1 * x1 + y1 * y1, x2 * x2 + y2 * y2)
    square = (x * x + y * y) / torch.where(least > 0, least, 1.0)
    root = torch.where(square > 0, torch.where(square > 0, square, 1.0).sqrt(), 0.0)
    return torch.where(least > 0, root, torch.inf)


def stretch(q: QuadCorners) -> Tensor:
    """(Q,) sqrt(2) times the shortest edge over the longest diagonal, 1 for a square."""
    longest = torch.maximum(
        (q.cx - q.ax).square() + (q.cy - q.ay).square(), (q.dx - q.bx).square() + (q.dy - q.by).square()
    )
    square = 2 * squared_lengths(q).amin(1) / torch.where(longest > 0, longest, 1.0)
    return torch.where(square > 0, torch.where(square > 0, square, 1.0).sqrt(), 0.0)


def warpage(q: QuadCorners) -> Tensor:
    """(Q,) 0: in the plane no quad is warped."""
    return torch.zeros_like(q.ax)


def aspect_ratio(q: QuadCorners) -> Tensor:
    """(Q,) the longest edge times the perimeter over 4 |area|, 1 for a square."""
    length, area = edge_lengths(q), signed_area(q).abs()
    value = length.amax(1) * length.sum(1) / 4
    return torch.where(area > 0, value / torch.where(area > 0, area, 1.0), torch.inf)


def radius_ratio(q: QuadCorners) -> Tensor:
    """(Q,) sqrt(l_0^2 + ... + l_3^2) h_max / (sqrt(8) min |alpha_k|), 1 for a square.

    h_max is the longest of the edges and diagonals; Verdict's radius ratio (Pebay, Planar quadrangle quality measures,
    Engineering with Computers 20, 2004).
    """
    square, alpha = squared_lengths(q), corner_jacobians(q).abs().amin(1)
    ac, bd = (q.cx - q.ax).square() + (q.cy - q.ay).square(), (q.dx - q.bx).square() + (q.dy - q.by).square()
    longest = torch.maximum(square.amax(1), torch.maximum(ac, bd))
    root = square.sum(1) * longest / 8
    root = torch.where(root > 0, torch.where(root > 0, root, 1.0).sqrt(), 0.0)
    return torch.where(alpha > 0, root / torch.where(alpha > 0, alpha, 1.0), torch.inf)


def edge_ratio(q: QuadCorners) -> Tensor:
    """(Q,) the longest edge over the shortest; infinite where two neighbours coincide."""
    length = edge_lengths(q)
    shortest = length.amin(1)
    return torch.where(shortest > 0, length.amax(1) / torch.where(shortest > 0, shortest, 1.0), torch.inf)


def angles(q: QuadCorners) -> Tensor:
    """(Q, 4) the angles at a, b, c, d in radians: above pi at a corner that turns the other way than the quad does."""
    corner = _corners(q)
    unsigned = torch.stack([angle_at(*corner[k], *corner[(k + 1) % 4], *corner[k - 1]) for k in range(4)], 1)
    alpha, area = corner_jacobians(q), signed_area(q)
    return torch.where((alpha < 0) == (area < 0)[:, None], unsigned, 2 * math.pi - unsigned)


def minimum_angle(q: QuadCorners) -> Tensor:
    """(Q,) the smallest angle in radians, pi / 2 for a rectangle."""
    return angles(q).amin(1)


def maximum_angle(q: QuadCorners) -> Tensor:
    """(Q,) the largest angle in radians, above pi for a quad with a corner that turns inwards."""
    return angles(q).amax(1)


def equiangle_skew(q: QuadCorners) -> Tensor:
    """(Q,) how far the worst angle is from 90 degrees, as a part of how far it can be; 1 from 180 degrees on."""
    quarter = math.pi / 2
    widest, narrowest_ = maximum_angle(q), minimum_angle(q)
    return torch.maximum((widest - quarter) / quarter, (quarter - narrowest_) / quarter).clamp_max(1)


def narrowest(q: QuadCorners) -> Tensor:
    """(Q,) how near a corner comes to 0 or to pi, in radians: pi / 2 for a rectangle, 0 from pi on."""
    every = angles(q)
    return torch.minimum(every.amin(1), (math.pi - every.amax(1)).clamp_min(0))
