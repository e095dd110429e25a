"""The walk that finds layers, compiled."""

import ctypes

import torch
from torch import Tensor

from .library import ADDRESS, INT64, function

_SIX = ctypes.c_double * 6


def walk(
    mesh: tuple[Tensor, Tensor, Tensor, Tensor, Tensor],
    limits: tuple[float, ...],
    rows: int,
    walls: Tensor,
    lengths: Tensor,
) -> tuple[tuple[Tensor, ...], int]:
    """The quadrilaterals that `layering.layers._rows` finds; of their heights the last bit may differ.

    mesh     points (V, 2) float64, half-edges' vertices (3T,) and twins (3T,) int64, blocked (3T,) and free (T,) bool
    limits   the six of `LayerOptions`: first, height, lean, turn, shrink, alike
    rows     in so many rows, quadrilaterals must stand side by side
    walls    (S,) int64, the half-edges from which the walk goes out, of these `lengths` (S,) float64

    Returns the fields of `Layers`, N rows each, and how many of these are in the first row.
    """
    # These tensors outlive the call, and so do the copies that are made of those that are not contiguous.
    given = [v.contiguous() for v in (*mesh, walls, lengths)]
    start, faces = [v.data_ptr() for v in given], len(mesh[4])
    # A quadrilateral takes two triangles.
    wall, row = torch.empty((2, faces // 2 + 1), dtype=torch.int64)
    corners, ends, pair = (torch.empty((faces // 2 + 1, width), dtype=torch.int64) for width in (4, 2, 2))
    height = torch.empty(faces // 2 + 1, dtype=torch.float64)
    six, begun = _SIX(*limits), ctypes.c_int64()
    fields = wall, row, corners, ends, pair, height
    call = function(
        "tm_walk_layers", INT64, *[ADDRESS] * 5, INT64, ADDRESS, INT64, ADDRESS, ADDRESS, INT64, *[ADDRESS] * 7
    )
    found = call(
        *start[:5], faces, ctypes.addressof(six), rows, *start[5:], len(walls),
        *(v.data_ptr() for v in fields), ctypes.addressof(begun),
    )  # fmt: skip
    return tuple(v[:found].clone() for v in fields), begun.value
