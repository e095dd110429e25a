"""Which quads of eight or nine nodes are valid: the sign of the Jacobian on the whole quad, exactly.

    3---6---2       The map from the square is quadratic in each direction, so its Jacobian is cubic in each.  Sixteen
    |       |       Bernstein coefficients bound it from below, and those at the corners are its values there (Johnen,
    7   8   5       Remacle & Geuzaine, Geometrical validity of curvilinear finite elements, Journal of Computational
    |       |       Physics 233, 2013):
    0---4---1
                    all positive             valid
                    a corner not positive    inverted
                    otherwise                the square is divided into four, again and again, in fractions

A quad of eight nodes is one of nine whose centre lies where its sides ask for it: at half the sum of the four mid-side
nodes less a quarter of the sum of the corners.  For that centre the map is the serendipity one.
"""

import itertools
from fractions import Fraction
from math import comb

import numpy as np
import torch
from torch import Tensor

# The sides of a quad, by corners, in the order of their nodes.
QUAD_SIDES = ((0, 1), (1, 2), (2, 3), (3, 0))

# The place of each node in a grid of three by three.
_GRID = ((0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1), (1, 1))

# An error of a coefficient, over the sum of the magnitudes of its terms: some 40 roundings are possible.
_BOUND, _UNDERFLOW = 256 * 2.0**-53, 1e-250

# The division ends after so many squares.  What is undecided then has a Jacobian that comes close to zero, and counts
# as inverted.
_SQUARES = 600

# The extremes of a Jacobian are looked for on a lattice with so many steps to a side.
_LATTICE = 12


def quad_coefficients(points: Tensor, nine: Tensor) -> tuple[Tensor, Tensor]:
    """The Bernstein coefficients (N, 4, 4) of the Jacobians of quads, and bounds (N, 4, 4) of rounding.

    points  (V, 2)
    nine    (N, 9) corners, mid-side nodes and the centre, which is -1 in a quad of eight nodes
    """
    nodes = points.to(torch.float64)[nine.clamp_min(0)]
    nodes = nodes - nodes[:, :1]
    none = nine[:, 8:] < 0
    magnitudes = _jacobian(_control(nodes.abs(), none, -1.0), -1.0)
    return _jacobian(_control(nodes, none, 1.0), 1.0), magnitudes * _BOUND + _UNDERFLOW


def quads_upright(points: Tensor, nine: Tensor) -> Tensor:
    """(N,) bool: the Jacobian is positive everywhere on the quad `nine` (N, 9), sides and corners included; exact.

    points  (V, 2)
    """
    values, errors = quad_coefficients(points, nine)
    valid = (values > errors).all(2).all(1)
    at, off = values[:, ::3, ::3], errors[:, ::3, ::3]
    finite = points[nine.clamp_min(0)].isfinite().all(2).all(1)
    inverted = (at < -off).any(2).any(1) | ~finite
    for row in (~valid & ~inverted).nonzero().squeeze(1).tolist():
        rows = nine[row, : 8 + int(nine[row, 8] >= 0)]
        valid[row] = is_positive(points[rows].to(torch.float64).tolist())
    return valid & finite


def is_positive(nodes: list[list[float]]) -> bool:
    """Is the Jacobian of the quad with these eight or nine nodes positive everywhere?  In fractions."""
    x, y = ([Fraction(node[k]) for node in nodes] for k in (0, 1))
    if len(nodes) == 8:
        for values in (x, y):
            values.append(sum(values[4:], Fraction(0)) / 2 - sum(values[:4], Fraction(0)) / 4)
    squares, seen = [_exact_jacobian(_controls(x), _controls(y))], 0
    while squares:
        square = squares.pop()
        seen += 1
        if min(square[0][0], square[0][3], square[3][0], square[3][3]) <= 0 or seen > _SQUARES:
            return False
        if min(map(min, square)) <= 0:
            for half in _halves(square):
                squares += _halves(_transposed(half))
    return True


def quad_scaled_jacobian(points: Tensor, nine: Tensor) -> Tensor:
    """(N,) float64 the least Jacobian over the largest magnitude of it in the same quad, as far as a lattice tells.

    It is at most 0 for an inverted quad, and positive for others.
    """
    if not len(nine):
        return points.new_zeros(0, dtype=torch.float64)
    values, _ = quad_coefficients(points, nine)
    t = torch.linspace(0, 1, _LATTICE + 1, dtype=torch.float64)
    basis = torch.stack([comb(3, k) * t**k * (1 - t) ** (3 - k) for k in range(4)], 1)
    values = torch.einsum("sk,nkl,rl->nsr", basis, values, basis).flatten(1)
    low, largest = values.amin(1), values.abs().amax(1)
    scaled = torch.where(largest > 0, low / largest.clamp_min(1e-300), 0.0)
    valid = quads_upright(points, nine)
    return torch.where(valid, scaled.clamp_min(1e-12), scaled.clamp_max(0.0))


def _control(nodes: Tensor, none: Tensor, sign: float) -> Tensor:
    """(N, 3, 3, 2) the control points of the map; `sign` -1 adds magnitudes."""
    corners, middles = nodes[:, :4].sum(1), nodes[:, 4:8].sum(1)
    asked = middles / 2 - sign * corners / 4
    centre = torch.where(none, asked, nodes[:, 8])
    grid = nodes.new_zeros(len(nodes), 3, 3, 2)
    for k, (i, j) in enumerate(_GRID):
        grid[:, i, j] = nodes[:, k] if k < 8 else centre
    for axis in (1, 2):
        a, m, b = grid.unbind(axis)
        grid = torch.stack([a, 2 * m - sign * (a + b) / 2, b], axis)
    return grid


def _product_weights() -> np.ndarray:
    """(2, 3, 3, 2, 4, 4) what a product of a coefficient along and one across adds to each of the Jacobian's."""
    weights = np.zeros((2, 3, 3, 2, 4, 4))
    for i, j, a, b in itertools.product(range(2), range(3), range(3), range(2)):
        weights[i, j, a, b, i + a, j + b] = comb(2, a) * comb(2, j) / (comb(3, i + a) * comb(3, j + b))
    return weights


_WEIGHTS = torch.from_numpy(_product_weights())


def _jacobian(control: Tensor, sign: float) -> Tensor:
    """(N, 4, 4) the coefficients of along x across; `sign` -1 adds the magnitudes of all terms instead."""
    along = 2 * (control[:, 1:] - sign * control[:, :-1])
    across = 2 * (control[:, :, 1:] - sign * control[:, :, :-1])
    one, other = (torch.einsum("nij,nab->nijab", along[..., k], across[..., 1 - k]) for k in (0, 1))
    products = one - sign * other
    return torch.einsum("nijab,ijabkl->nkl", products, _WEIGHTS)


_Square = list[list[Fraction]]


def _controls(values: list[Fraction]) -> _Square:
    """The control values (3, 3) of one coordinate of nine nodes."""
    grid = [[Fraction(0)] * 3 for _ in range(3)]
    for (i, j), value in zip(_GRID, values, strict=True):
        grid[i][j] = value
    for _ in range(2):
        grid = _transposed([[a, 2 * m - (a + b) / 2, b] for a, m, b in grid])
    return grid


def _exact_jacobian(x: _Square, y: _Square) -> _Square:
    """The coefficients, as those of `_jacobian`, in fractions."""
    total = [[Fraction(0)] * 4 for _ in range(4)]
    for i, j, a, b in itertools.product(range(2), range(3), range(3), range(2)):
        along = [c[i + 1][j] - c[i][j] for c in (x, y)]
        across = [c[a][b + 1] - c[a][b] for c in (x, y)]
        weight = Fraction(4 * comb(2, a) * comb(2, j), comb(3, i + a) * comb(3, j + b))
        total[i + a][j + b] += weight * (along[0] * across[1] - along[1] * across[0])
    return total


def _halves(square: _Square) -> tuple[_Square, _Square]:
    """The coefficients on the two halves, divided along the first direction (de Casteljau)."""
    rows, first, second = square, [square[0]], [square[3]]
    while len(rows) > 1:
        rows = [[(x + y) / 2 for x, y in zip(one, two, strict=True)] for one, two in itertools.pairwise(rows)]
        first.append(rows[0])
        second.append(rows[-1])
    return first, second[::-1]


def _transposed(square: _Square) -> _Square:
    return [list(row) for row in zip(*square, strict=True)]
