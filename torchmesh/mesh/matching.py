"""As many points as goals, each paired with a goal near it.

+-----+-----+    Squares are halved again and again.  In each of the smallest squares points are paired with goals
| o x | x   |    as far as there are some of both, then in the squares of twice that side, and so on.  So a pair is
+-----+-----+    far apart only where there are too many points, or too few, in a large square round it.
| o   | o x |    In a square the order is that of its quarters (Morton, A computer oriented geodetic data base and
+-----+-----+    a new technique in file sequencing, IBM, 1966).
"""

import math

import torch
from torch import Tensor

from ..kernels import matching
from ..kernels.library import library_for

# Squares are numbered by so many bits in each direction.
_BITS = 26
# Squares are halved until there is one for each goal or more, and then so many times again.  After one more time, goals
# that lie evenly are in at most every fourth of the smallest squares.
_FINER = 1


def pairs_nearby(points: Tensor, goals: Tensor) -> Tensor:
    """(N,) int64 the row of `points` (N, 2) for each of the `goals` (N, 2), no row twice; both are finite float64."""
    if not len(goals):
        return torch.zeros(0, dtype=torch.int64, device=goals.device)
    both = torch.cat([points, goals])
    low = both.amin(0)
    width = (both.amax(0) - low).max().clamp_min(1e-300)
    squares = ((both - low) / width * 2.0**_BITS).clamp_max(2.0**_BITS - 1).to(torch.int64)
    level = min(_BITS, math.ceil(0.5 * math.log2(len(goals))) + _FINER)
    return pairs_of_squares(squares[: len(points)], squares[len(points) :], _BITS, level)


def pairs_of_squares(squares: Tensor, goals: Tensor, bits: int, level: int) -> Tensor:
    """(N,) int64 the same for squares (N, 2) int64 below 2^bits, from squares of 2^(bits - level) upwards."""
    if library_for(squares) is not None:
        return matching.pairs_of_squares(squares.contiguous(), goals.contiguous(), bits, level)
    found = torch.empty(len(goals), dtype=torch.int64, device=goals.device)
    (code, row), (wanted, goal) = (torch.sort(_in_order_of_quarters(s), stable=True) for s in (squares, goals))
    while len(goal):
        shift = 2 * (bits - level)
        has, asks = code >> shift, wanted >> shift
        used, served = (
            _rank(one) < torch.searchsorted(other, one, right=True) - torch.searchsorted(other, one)
            for one, other in ((has, asks), (asks, has))
        )
        found[goal[served]] = row[used]
        code, row, wanted, goal = code[~used], row[~used], wanted[~served], goal[~served]
        level -= 1
    return found


def _rank(group: Tensor) -> Tensor:
    """(N,) which one of its group each is, of groups (N,) in ascending order."""
    return torch.arange(len(group), device=group.device) - torch.searchsorted(group, group)


def _in_order_of_quarters(squares: Tensor) -> Tensor:
    """(N,) int64 the bits of both coordinates of squares (N, 2), in turn."""
    for shift, mask in ((16, 0x0000FFFF0000FFFF), (8, 0x00FF00FF00FF00FF), (4, 0x0F0F0F0F0F0F0F0F),
                        (2, 0x3333333333333333), (1, 0x5555555555555555)):  # fmt: skip
        squares = (squares | (squares << shift)) & mask
    return squares[:, 0] | (squares[:, 1] << 1)
