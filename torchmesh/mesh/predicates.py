"""Signs that are facts: orientation and in-circle, exact for every finite input.

A floating-point filter (Shewchuk, Adaptive Precision Floating-Point Arithmetic and Fast Robust
Geometric Predicates, 1997) decides nearly all rows; the few it cannot decide are computed in
integers of any length.
"""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from ..kernels.library import library_for
from ..kernels.signs import incircle_signs, orientation_signs
from .ragged import true_rows

_EPSILON = 2.0**-53


_ORIENTATION_BOUND = (3 + 16 * _EPSILON) * _EPSILON


_INCIRCLE_BOUND = (10 + 96 * _EPSILON) * _EPSILON


# In sums below this a product may have lost bits to underflow, and the filter's bound does not hold.
_UNDERFLOW = 1e-270


def orientation(ax: Tensor, ay: Tensor, bx: Tensor, by: Tensor, cx: Tensor, cy: Tensor) -> Tensor:
    """(N,) int8 sign of twice the signed area of abc: 1 counter-clockwise, -1 clockwise, 0 flat."""
    rows = [v.to(torch.float64) for v in (ax, ay, bx, by, cx, cy)]
    if library_for(ax) is not None:
        return orientation_signs(rows)
    ax, ay, bx, by, cx, cy = rows
    return orientation_by_products((bx - ax) * (cy - ay), (by - ay) * (cx - ax), rows)


def orientation_by_products(left: Tensor, right: Tensor, rows: Sequence[Tensor]) -> Tensor:
    """As `orientation` of `rows`, float64, where (bx - ax) (cy - ay) and (by - ay) (cx - ax) are at hand."""
    return _decide(left - right, left.abs().add_(right.abs()), _ORIENTATION_BOUND, rows, _exact_orientation)


def incircle(ax: Tensor, ay: Tensor, bx: Tensor, by: Tensor, cx: Tensor, cy: Tensor, dx: Tensor, dy: Tensor) -> Tensor:
    """(N,) int8 sign: 1 when d lies inside the circle through the counter-clockwise abc."""
    rows = [v.to(torch.float64) for v in (ax, ay, bx, by, cx, cy, dx, dy)]
    if library_for(ax) is not None:
        return incircle_signs(rows)
    ax, ay, bx, by, cx, cy, dx, dy = rows
    ax, ay, bx, by, cx, cy = ax - dx, ay - dy, bx - dx, by - dy, cx - dx, cy - dy
    bc_l, bc_r = bx * cy, by * cx
    ca_l, ca_r = cx * ay, cy * ax
    ab_l, ab_r = ax * by, ay * bx
    a2, b2, c2 = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    determinant = a2 * (bc_l - bc_r) + b2 * (ca_l - ca_r) + c2 * (ab_l - ab_r)
    magnitude = a2 * (bc_l.abs() + bc_r.abs()) + b2 * (ca_l.abs() + ca_r.abs()) + c2 * (ab_l.abs() + ab_r.abs())
    return _decide(determinant, magnitude, _INCIRCLE_BOUND, rows, _exact_incircle)


def _decide(
    determinant: Tensor,
    magnitude: Tensor,
    bound: float,
    rows: Sequence[Tensor],
    exact: Callable[[list[Tensor]], Tensor],
) -> Tensor:
    """(N,) int8 sign of the determinant: its own where rounding cannot change it, else that of `exact`.

    It is 0 where a coordinate is not finite, so that a triangle with such a corner is not upright.
    """
    # Not where anything has overflowed, as no number is above infinity; NaN is above none.
    sure = determinant.abs() > (magnitude * bound).clamp_min_(_UNDERFLOW)
    sign = determinant.sign().to(torch.int8)
    unsure = true_rows(~sure)
    if len(unsure):
        few = [r[unsure] for r in rows]
        finite = torch.stack(few).isfinite().all(0)
        if bool(finite.all()):
            sign[unsure] = exact(few)
        else:
            sign[unsure] = 0
            sign[unsure[finite]] = exact([r[finite] for r in few])
    return sign


def _exact_orientation(rows: list[Tensor]) -> Tensor:
    ax, ay, bx, by, cx, cy = rows
    # Rounding keeps the sign of a difference, so products of unlike sign need no further digits.
    left, right = (bx - ax).sign() * (cy - ay).sign(), (by - ay).sign() * (cx - ax).sign()
    sign = (left - right).sign().to(torch.int8)
    alike = true_rows((left == right) & (left != 0))
    if len(alike):
        iax, iay, ibx, iby, icx, icy = _integers([r[alike] for r in rows])
        sign[alike] = _signs((ibx - iax) * (icy - iay) - (iby - iay) * (icx - iax)).to(sign.device)
    return sign


def _exact_incircle(rows: list[Tensor]) -> Tensor:
    ax, ay, bx, by, cx, cy, dx, dy = _integers(rows)
    ax, ay, bx, by, cx, cy = ax - dx, ay - dy, bx - dx, by - dy, cx - dx, cy - dy
    return _signs(
        (ax * ax + ay * ay) * (bx * cy - by * cx)
        + (bx * bx + by * by) * (cx * ay - cy * ax)
        + (cx * cx + cy * cy) * (ax * by - ay * bx)
    ).to(rows[0].device)


def _integers(columns: list[Tensor]) -> list[np.ndarray]:
    """(N,) float columns to object columns of Python integers, each row times one power of two."""
    values = torch.stack(columns, 1).detach().cpu().numpy()
    mantissa, exponent = np.frexp(values)
    exponent = np.where(mantissa == 0, np.iinfo(exponent.dtype).max, exponent)
    shift = np.where(mantissa == 0, 0, exponent - exponent.min(1, keepdims=True))
    whole = (mantissa * 2.0**53).astype(np.int64).astype(object) * (2 ** shift.astype(object))
    return list(whole.T)


def _signs(values: np.ndarray) -> Tensor:
    return torch.from_numpy((values > 0).astype(np.int8) - (values < 0).astype(np.int8))
