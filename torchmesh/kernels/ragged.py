"""Rows found, taken, put, spread and counted, compiled: the twins, to the bit, of `mesh.ragged` and of its callers.

torch takes five to ten times as long for many rows of two or three numbers, and for the rows whose flag is set.
"""

import torch
from torch import Tensor

from .library import ADDRESS, BOOL, INT64, function


def true_rows(flags: Tensor) -> Tensor:
    """(M,) int64 `mesh.ragged.true_rows` of flags (N,) bool."""
    flags = flags.contiguous()
    at, size = flags.data_ptr(), flags.numel()
    count = function("tm_count_true", INT64, ADDRESS, INT64)(at, size)
    rows = torch.empty(count + 1, dtype=torch.int64)
    function("tm_true_rows", None, ADDRESS, INT64, ADDRESS)(at, size, rows.data_ptr())
    return rows[:count]


def take(values: Tensor, rows: Tensor) -> Tensor:
    """(M, ...) the `rows` (M,) int64 of values (N, ...); raises IndexError if one is not there."""
    values, rows = values.contiguous(), rows.contiguous()
    out = torch.empty((rows.numel(), *values.shape[1:]), dtype=values.dtype)
    _checked("tm_take", values, rows, out)
    return out


def put_rows(values: Tensor, rows: Tensor, part: Tensor) -> Tensor:
    """(N, ...) a copy of values with the `rows` (M,) int64 replaced by part (M, ...); raises IndexError as `take`."""
    out = values.clone(memory_format=torch.contiguous_format)
    _checked("tm_put", out, rows.contiguous(), part.contiguous())
    return out


def spread(per_mesh: Tensor, offsets: Tensor) -> Tensor:
    """(N, ...) `mesh.ragged.spread`."""
    per_mesh, offsets = per_mesh.contiguous(), offsets.contiguous()
    out = torch.empty((int(offsets[-1]), *per_mesh.shape[1:]), dtype=per_mesh.dtype)
    function("tm_spread", None, ADDRESS, INT64, ADDRESS, INT64, ADDRESS)(
        per_mesh.data_ptr(), _row_bytes(per_mesh), offsets.data_ptr(), per_mesh.size(0), out.data_ptr()
    )
    return out


def segment_count(flags: Tensor, offsets: Tensor) -> Tensor:
    """(B,) int64 `mesh.ragged.segment_count`."""
    flags, offsets = flags.contiguous(), offsets.contiguous()
    out = torch.empty(offsets.numel() - 1, dtype=torch.int64)
    function("tm_segment_count", None, ADDRESS, ADDRESS, INT64, ADDRESS)(
        flags.data_ptr(), offsets.data_ptr(), out.numel(), out.data_ptr()
    )
    return out


def rows_of_each(meshes: Tensor, offsets: Tensor) -> Tensor:
    """(N,) int64 `mesh.ragged.rows_of_each`."""
    meshes, offsets = meshes.contiguous(), offsets.contiguous()
    given = meshes.data_ptr(), meshes.numel(), offsets.data_ptr()
    out = torch.empty(function("tm_count_of_each", INT64, ADDRESS, INT64, ADDRESS)(*given), dtype=torch.int64)
    function("tm_rows_of_each", None, ADDRESS, INT64, ADDRESS, ADDRESS)(*given, out.data_ptr())
    return out


def shifted(numbers: Tensor, by: Tensor, offsets: Tensor) -> Tensor:
    """(N, ...) int64 `mesh.ragged.shifted`."""
    numbers, by, offsets = numbers.contiguous(), by.contiguous(), offsets.contiguous()
    out = torch.empty_like(numbers)
    function("tm_shifted", None, ADDRESS, INT64, ADDRESS, ADDRESS, INT64, ADDRESS)(
        numbers.data_ptr(), numbers.stride(0), by.data_ptr(), offsets.data_ptr(), by.numel(), out.data_ptr()
    )
    return out


def touching(triangles: Tensor, vertices: Tensor) -> Tensor:
    """(T,) bool `mesh.connectivity.touching`."""
    triangles, vertices = triangles.contiguous(), vertices.contiguous()
    out = torch.empty(triangles.size(0), dtype=torch.bool)
    function("tm_touching", None, ADDRESS, INT64, ADDRESS, ADDRESS)(
        triangles.data_ptr(), out.numel(), vertices.data_ptr(), out.data_ptr()
    )
    return out


def corners_of(triangles: Tensor, these: Tensor, vertices: int) -> Tensor:
    """(V,) bool `mesh.connectivity.corners_of`."""
    triangles, these = triangles.contiguous(), these.contiguous()
    out = torch.zeros(vertices, dtype=torch.bool)
    function("tm_corners_of", None, ADDRESS, INT64, ADDRESS, ADDRESS)(
        triangles.data_ptr(), triangles.size(0), these.data_ptr(), out.data_ptr()
    )
    return out


def means_of_corners(triangles: Tensor, values: Tensor) -> Tensor:
    """(T,) `mesh.means.Means.of_corners` of triangles (T, 3) and values (V,) float64, both contiguous."""
    out = torch.empty(triangles.size(0), dtype=torch.float64)
    function("tm_means_of_corners", None, ADDRESS, INT64, ADDRESS, ADDRESS)(
        triangles.data_ptr(), out.numel(), values.data_ptr(), out.data_ptr()
    )
    return out


def means_round_vertices(triangles: Tensor, values: Tensor, count: Tensor) -> Tensor:
    """(V,) `mesh.means.Means.round_vertices` of values (T,) float64; count (V,) int64 of triangles, at least 1."""
    out = torch.empty(count.numel(), dtype=torch.float64)
    function("tm_means_round_vertices", None, ADDRESS, INT64, ADDRESS, ADDRESS, INT64, ADDRESS)(
        triangles.data_ptr(), triangles.size(0), values.data_ptr(), count.data_ptr(), out.numel(), out.data_ptr()
    )
    return out


def _row_bytes(values: Tensor) -> int:
    """Of a contiguous tensor; a row without numbers has none."""
    return values.stride(0) * values.element_size() if values.numel() else 0


def _checked(name: str, values: Tensor, rows: Tensor, part: Tensor) -> None:
    there = function(name, BOOL, ADDRESS, INT64, INT64, ADDRESS, INT64, ADDRESS)(
        values.data_ptr(), values.size(0), _row_bytes(values), rows.data_ptr(), rows.numel(), part.data_ptr()
    )
    if not there:
        raise IndexError(f"rows must be from 0 to {values.size(0) - 1}")
