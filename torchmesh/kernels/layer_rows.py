"""The next row of the walk that finds layers, compiled."""

import ctypes

import torch
from torch import Tensor

from .library import ADDRESS, INT32, INT64, function

_SIX = ctypes.c_double * 6


def next_row(
    mesh: tuple[Tensor, Tensor, Tensor, Tensor, Tensor],
    limits: tuple[float, ...],
    first: bool,
    front: tuple[Tensor, Tensor, Tensor],
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """The quadrilaterals of `layering.layers._Walk.next_row`; of their heights the last bit may differ.

    mesh    points (V, 2) float64, half-edges' vertices (3T,) and twins (3T,) int64, blocked (3T,) and free (T,) bool
    limits  the six of `LayerOptions`: first, height, lean, turn, shrink, alike
    first   whether the row is the one next to the wall
    front   (S,) the half-edges at the upper ends, the lengths of their walls, and the heights of the rows below

    Returns their rows in the front (N,), corners (N, 4), ends of diagonals (N, 2), triangles (N, 2) and heights (N,).
    """
    # The caller's tensors outlive the call, and so do the copies that are made of those that are not contiguous.
    given = [v.contiguous() for v in (*mesh, *front)]
    start = [v.data_ptr() for v in given]
    count = len(front[0])
    whole = [torch.empty((count, width), dtype=torch.int64) for width in (1, 4, 2, 2)]
    height = torch.empty(count, dtype=torch.float64)
    six = _SIX(*limits)
    call = function("tm_next_row", INT64, *[ADDRESS] * 5, INT64, ADDRESS, INT32, *[ADDRESS] * 3, INT64, *[ADDRESS] * 5)
    found = call(
        *start[:5], len(mesh[4]), ctypes.addressof(six), int(first), *start[5:], count,
        *(v.data_ptr() for v in (*whole, height)),
    )  # fmt: skip
    place, corners, ends, pair = (v[:found] for v in whole)
    return place[:, 0], corners, ends, pair, height[:found]
