"""The blocks of a stiffness matrix, compiled: the twin, to the bit, of `optimising.laplacian.stiffness_blocks`."""

import numpy as np
from torch import Tensor

from .library import ADDRESS, INT64, call, pointer

# Row offsets, columns and values of a matrix in compressed rows.
CompressedRows = tuple[np.ndarray, np.ndarray, np.ndarray]


def blocks(
    triangles: Tensor, weights: tuple[Tensor, Tensor, Tensor], known: Tensor
) -> tuple[CompressedRows, CompressedRows]:
    """K_II and -K_IB; arguments are those of `stiffness_blocks`, on the processor."""
    size, room = int((~known).sum()), 2 * triangles.numel()
    triangles, known = triangles.contiguous(), known.contiguous()
    columns = [weight.contiguous() for weight in weights]
    offsets, column, value = _rows(size, room)
    given = (ADDRESS(pointer(v)) for v in (triangles, *columns, known))
    start, *three, mask = given
    used = call(
        "tm_edge_weights", INT64, start, INT64(len(triangles)), *three, mask, INT64(len(known)),
        *(ADDRESS(v.ctypes.data) for v in (offsets, column, value)),
    )  # fmt: skip
    value = value[:used]
    total = np.zeros(size)
    some = np.flatnonzero(np.diff(offsets))
    if len(some):
        # numpy adds up the entries of a row in an order of its own, which is that of scipy's matrices.
        total[some] = np.add.reduceat(value, offsets[some])
    inner, outer = _rows(size, used + size), _rows(size, used)
    call(
        "tm_split_stiffness", None, *(ADDRESS(v.ctypes.data) for v in (offsets, column, value)), INT64(size),
        ADDRESS(total.ctypes.data), mask, INT64(len(known)), *(ADDRESS(v.ctypes.data) for v in (*inner, *outer)),
    )  # fmt: skip
    return _cut(inner), _cut(outer)


def _rows(size: int, room: int) -> CompressedRows:
    """Unwritten compressed rows with room for so many entries."""
    return np.empty(size + 1, np.int32), np.empty(room, np.int32), np.empty(room)


def _cut(rows: CompressedRows) -> CompressedRows:
    """The rows without the room that was not needed."""
    offsets, column, value = rows
    return offsets, column[: offsets[-1]], value[: offsets[-1]]
