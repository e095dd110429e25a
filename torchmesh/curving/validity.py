"""Which six-node triangles are valid: the sign of the Jacobian on the whole triangle, exactly.

        2               The map from the straight triangle is quadratic, so its Jacobian is a quadratic polynomial.  Its
       / \\              six Bernstein coefficients bound it from below, and those at the corners are its values there
      5   4             (Johnen, Remacle & Geuzaine, Geometrical validity of curvilinear finite elements, Journal of
     /     \\            Computational Physics 233, 2013):
    0---3---1
                        all positive             valid
                        a corner not positive    inverted
                        otherwise                by the sign of the minimum, in fractions

Node order: corners 0, 1, 2; node 3 on the side from 0 to 1, 4 from 1 to 2, 5 from 2 to 0.
"""

from fractions import Fraction

import torch
from torch import Tensor

# The sides of a triangle, by corners, in the order of their nodes.
SIDES = ((0, 1), (1, 2), (2, 0))

# An error of a coefficient, over the sum of the magnitudes of its terms: 16 roundings are possible, 64 are allowed
# for.  Below the second number products may have lost digits.
_BOUND, _UNDERFLOW = 64 * 2.0**-53, 1e-250


def coefficients(points: Tensor, six: Tensor) -> tuple[Tensor, Tensor]:
    """The Bernstein coefficients (N, 6) of the Jacobians of the triangles `six` (N, 6), and bounds (N, 6) of rounding.

    points  (V, 2)

    The order is that of the nodes: corners first.  A straight triangle has six times twice its area.
    """
    at = points.to(torch.float64)[six]
    q = at - at[:, :1]
    along, across = _derivatives(q)
    sum_along, sum_across = _derivatives(q.abs(), magnitudes=True)
    values, errors = _products(along, across, -1.0), _products(sum_along, sum_across, 1.0)
    return values, (errors * _BOUND).clamp_min(_UNDERFLOW)


def upright(points: Tensor, six: Tensor) -> Tensor:
    """(N,) bool: the Jacobian is positive everywhere on the triangle `six` (N, 6), sides and corners included; exact.

    points  (V, 2)
    """
    values, errors = coefficients(points, six)
    valid = (values > errors).all(1)
    inverted = (values[:, :3] < -errors[:, :3]).any(1) | ~points[six].isfinite().all((1, 2))
    for row in (~valid & ~inverted).nonzero().squeeze(1).tolist():
        valid[row] = exact_minimum(points[six[row]].to(torch.float64).tolist()) > 0
    return valid


def exact_minimum(nodes: list[list[float]]) -> Fraction:
    """The least Jacobian of a six-node triangle with these nodes, six pairs of floats, as a fraction."""
    p = [(Fraction(x), Fraction(y)) for x, y in nodes]

    def sum_of(*terms: tuple[int, int]) -> tuple[Fraction, Fraction]:
        return sum((k * p[i][0] for k, i in terms), Fraction(0)), sum((k * p[i][1] for k, i in terms), Fraction(0))

    along = [sum_of(*terms) for terms in _ALONG]
    across = [sum_of(*terms) for terms in _ACROSS]

    def product(i: int, j: int) -> Fraction:
        return along[i][0] * across[j][1] - along[i][1] * across[j][0]

    corner = [product(k, k) for k in range(3)]
    side = [(product(i, j) + product(j, i)) / 2 for i, j in SIDES]
    least = min(corner)
    for (i, j), middle in zip(SIDES, side, strict=True):
        bend = corner[i] - 2 * middle + corner[j]
        if bend > 0 and corner[i] > middle < corner[j]:
            least = min(least, (corner[i] * corner[j] - middle * middle) / bend)
    a, (d, f, e) = corner[0], side
    hxx, hyy, hxy = a + corner[1] - 2 * d, a + corner[2] - 2 * e, a + f - d - e
    determinant = hxx * hyy - hxy * hxy
    if hxx > 0 and determinant > 0:
        gx, gy = d - a, e - a
        x, y = gy * hxy - gx * hyy, gx * hxy - gy * hxx
        if x > 0 and y > 0 and x + y < determinant:
            least = min(least, a + (gx * x + gy * y) / determinant)
    return least


def jacobian_range(points: Tensor, six: Tensor) -> tuple[Tensor, Tensor]:
    """The least and the largest Jacobian (N,) float64 of each triangle `six` (N, 6), to rounding."""
    values, _ = coefficients(points, six)
    return _least(values), -_least(-values)


def scaled_jacobian(points: Tensor, six: Tensor) -> Tensor:
    """(N,) float64 the least Jacobian over the largest magnitude of it in the same triangle: 1 for a straight one.

    It is at most 0 for an inverted triangle, and -1 for a straight one that is inverted (Persson & Peraire, Curved mesh
    generation and mesh refinement using Lagrangian solid mechanics, AIAA 2009-949).
    """
    low, high = jacobian_range(points, six)
    largest = torch.maximum(low.abs(), high.abs())
    return torch.where(largest > 0, low / largest.clamp_min(1e-300), 0.0)


# The derivatives of the map towards corner 1 and towards corner 2 are linear: their values at the corners, as terms of
# factor and node.
_ALONG = (((4, 3), (-3, 0), (-1, 1)), ((3, 1), (1, 0), (-4, 3)), ((4, 4), (-4, 5), (1, 0), (-1, 1)))
_ACROSS = (((4, 5), (-3, 0), (-1, 2)), ((4, 4), (-4, 3), (1, 0), (-1, 2)), ((3, 2), (1, 0), (-4, 5)))


def _derivatives(nodes: Tensor, magnitudes: bool = False) -> tuple[list[Tensor], list[Tensor]]:
    """The derivatives (N, 2) at the three corners, along and across; or the sums of the magnitudes of their terms."""

    def combined(terms: tuple[tuple[int, int], ...]) -> Tensor:
        total = nodes[:, terms[0][1]] * abs(terms[0][0]) if magnitudes else nodes[:, terms[0][1]] * terms[0][0]
        for factor, node in terms[1:]:
            total = total + nodes[:, node] * (abs(factor) if magnitudes else factor)
        return total

    return [combined(terms) for terms in _ALONG], [combined(terms) for terms in _ACROSS]


def _products(along: list[Tensor], across: list[Tensor], sign: float) -> Tensor:
    """(N, 6) the coefficients of along x across; `sign` 1 adds the magnitudes of both products instead."""

    def product(i: int, j: int) -> Tensor:
        return along[i][:, 0] * across[j][:, 1] + sign * (along[i][:, 1] * across[j][:, 0])

    corners = [product(k, k) for k in range(3)]
    sides = [(product(i, j) + product(j, i)) / 2 for i, j in SIDES]
    return torch.stack([*corners, *sides], 1)


def _least(c: Tensor) -> Tensor:
    """(N,) the least value of quadratic polynomials with the Bernstein coefficients (N, 6) on the triangle."""
    least = c[:, :3].amin(1)
    for k, (i, j) in enumerate(SIDES):
        one, other, middle = c[:, i], c[:, j], c[:, 3 + k]
        inside = (middle < one) & (middle < other)
        bend = torch.where(inside, one - 2 * middle + other, 1.0)
        # In this form rounding does no harm where the polynomial is nearly constant.
        least = torch.where(inside, torch.minimum(least, one - (one - middle) ** 2 / bend), least)
    a, d, f, e = c[:, 0], c[:, 3], c[:, 4], c[:, 5]
    hxx, hyy, hxy = a + c[:, 1] - 2 * d, a + c[:, 2] - 2 * e, a + f - d - e
    determinant = hxx * hyy - hxy * hxy
    gx, gy = d - a, e - a
    x, y = gy * hxy - gx * hyy, gx * hxy - gy * hxx
    inside = (hxx > 0) & (determinant > 0) & (x > 0) & (y > 0) & (x + y < determinant)
    determinant = torch.where(inside, determinant, 1.0)
    value = a + gx * (x / determinant) + gy * (y / determinant)
    return torch.where(inside, torch.minimum(least, value), least)
