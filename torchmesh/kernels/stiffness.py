"""What a harmonic extension is made of, compiled: weights of edges, blocks of the stiffness matrix, and an affine fit.

Each function is the twin, to the bit, of the one that its docstring names; powers of areas other than 0 and 1 may
differ in the last bit.
"""

import numpy as np
import torch
from torch import Tensor

from .library import ADDRESS, DOUBLE, INT64, call, function, pointer

# Row offsets, columns and values of a matrix in compressed rows.
CompressedRows = tuple[np.ndarray, np.ndarray, np.ndarray]


def edge_stiffness(
    points: Tensor, triangles: Tensor, triangle_offsets: Tensor, power: float, stiffest: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Three (T,) float64 `optimising.laplacian.edge_stiffness`."""
    whole = points.to(torch.float64).contiguous(), triangles.contiguous(), triangle_offsets.contiguous()
    at_a, at_b, at_c, area = torch.empty((4, len(triangles)), dtype=torch.float64)
    function("tm_edge_stiffness", None, ADDRESS, ADDRESS, ADDRESS, INT64, DOUBLE, DOUBLE, *[ADDRESS] * 4)(
        *(v.data_ptr() for v in whole), len(triangle_offsets) - 1, power, stiffest,
        *(v.data_ptr() for v in (at_a, at_b, at_c, area)),
    )  # fmt: skip
    return at_a, at_b, at_c


def affine_fit(points: Tensor, fixed: Tensor, displacement: Tensor, offsets: Tensor, on_a_line: float) -> Tensor:
    """(V, 2) `warping.stiffened.affine_fit`."""
    whole = [v.contiguous() for v in (points, fixed, displacement, offsets)]
    out = torch.empty_like(whole[0])
    function("tm_affine_fit", None, *[ADDRESS] * 4, INT64, DOUBLE, ADDRESS)(
        *(v.data_ptr() for v in whole), len(offsets) - 1, on_a_line, out.data_ptr()
    )
    return out


def blocks(
    triangles: Tensor, weights: tuple[Tensor, Tensor, Tensor], known: Tensor
) -> tuple[CompressedRows, CompressedRows]:
    """`optimising.laplacian.stiffness_blocks`, on the processor."""
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
