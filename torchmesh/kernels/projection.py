"""The matrices and systems of an L2 projection, compiled: the twins, to rounding, of `transferring.projection`."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from .library import ADDRESS, DOUBLE, INT32, INT64, call, pointer, threads

# Rows, columns and weights of the entries of a matrix.
Coordinates = tuple[np.ndarray, np.ndarray, np.ndarray]


def summed(entries: Coordinates, size: int) -> Coordinates:
    """The entries of a matrix of `size` rows in order, those at one position added up in the order they came in."""
    rows, columns, weights = (np.ascontiguousarray(v) for v in entries)
    assert rows.dtype == columns.dtype == np.int64
    return _summed("tm_summed_rows", (rows, columns, weights), len(rows), len(rows), size)


def _summed(name: str, given: Sequence[np.ndarray], count: int, room: int, size: int) -> Coordinates:
    """The `size` rows, with room for so many entries, that a function of the library makes of `count` rows given."""
    offsets, out = np.empty(size + 1, np.int64), (np.empty(room, np.int64), np.empty(room))
    used = call(
        name, INT64, *(ADDRESS(v.ctypes.data) for v in given), INT64(count), INT64(size),
        *(ADDRESS(v.ctypes.data) for v in (offsets, *out)),
    )  # fmt: skip
    return np.repeat(np.arange(size), np.diff(offsets)), out[0][:used].copy(), out[1][:used].copy()


def mixed_mass(
    after: tuple[np.ndarray, np.ndarray, np.ndarray],
    before: tuple[np.ndarray, np.ndarray, np.ndarray],
    pairs: tuple[np.ndarray, np.ndarray],
    moments: np.ndarray,
    sign: np.ndarray,
) -> Coordinates:
    """The entries of R, nine for each of the pairs (P,) of triangles after and before, as `summed` has them.

    after, before  x (V,), y (V,) and triangles (T, 3)
    moments, sign  (P, 6) and (P,), as in `transferring.projection.mixed_mass`
    """
    given = [np.ascontiguousarray(v) for v in (*after, *before, *pairs, moments, sign)]
    return _summed("tm_mixed_mass", given, len(sign), 9 * len(sign), len(after[0]))


def solved(
    rows: Tensor, columns: Tensor, weights: Tensor, diagonal: Tensor, offsets: Tensor, right: Tensor,
    tolerance: float, max_iterations: int,
) -> tuple[Tensor, Tensor, Tensor]:  # fmt: skip
    """`optimising.conjugate_gradients.solve` for a matrix of entries (N,) in order, beside a diagonal (V,)."""
    starts = torch.nn.functional.pad(torch.bincount(rows, minlength=len(diagonal)).cumsum(0), (1, 0))
    systems = len(offsets) - 1
    x, iterations = torch.empty_like(right), torch.empty(systems, dtype=torch.int64)
    converged = torch.empty(systems, dtype=torch.bool)
    whole = [v.contiguous() for v in (starts, columns, weights, diagonal, offsets)]
    call(
        "tm_rows_solve", None, *(ADDRESS(pointer(v)) for v in whole), INT64(systems),
        ADDRESS(pointer(right.contiguous())), DOUBLE(tolerance), INT64(max_iterations), INT32(threads()),
        *(ADDRESS(pointer(v)) for v in (x, iterations, converged)),
    )  # fmt: skip
    return x, iterations, converged
