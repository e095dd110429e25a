"""Factors of the symmetric sparse matrices of many meshes, compiled: the twin, to rounding, of SuperLU."""

import weakref
from collections.abc import Iterator

import numpy as np

from .library import ADDRESS, INT32, INT64, call, release, threads
from .stiffness import CompressedRows

# A call of the library factorises so many rows, a fraction of a second, so that Python sees interrupts.
_WORK = 100_000


class CompiledFactors:
    """The factors of the diagonal blocks first to last - 1 of `bounds` (M, 2); RuntimeError if one is singular."""

    def __init__(self, rows: CompressedRows, bounds: np.ndarray) -> None:
        first, last = (np.ascontiguousarray(bounds[:, k], np.int64) for k in (0, 1))
        singular = np.zeros(len(bounds), np.uint8)
        self._handle = call(
            "tm_factorise", ADDRESS, *(ADDRESS(v.ctypes.data) for v in (*rows, first, last)), INT64(len(bounds)),
            INT32(threads()), ADDRESS(singular.ctypes.data),
        )  # fmt: skip
        weakref.finalize(self, release, "tm_end_factorised", self._handle)
        if singular.any():
            raise RuntimeError("Factor is exactly singular")

    def solve(self, right: np.ndarray, out: np.ndarray) -> None:
        """Put the solutions for `right` (I, k) into the rows of the blocks in `out` (I, k)."""
        right = np.ascontiguousarray(right)
        call("tm_solve_factorised", None, ADDRESS(self._handle), ADDRESS(right.ctypes.data), INT32(right.shape[1]),
             INT32(threads()), ADDRESS(out.ctypes.data))  # fmt: skip


def factorised(rows: CompressedRows, bounds: np.ndarray) -> Iterator[CompiledFactors]:
    """The factors of the blocks `bounds` (M, 2) of a matrix, some of them at a time."""
    group = (bounds[:, 1] - bounds[:, 0]).cumsum() // _WORK
    for part in np.split(bounds, np.flatnonzero(np.diff(group)) + 1):
        if len(part):
            yield CompiledFactors(rows, part)
