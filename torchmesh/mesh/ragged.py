"""Ragged arithmetic: the rows of many meshes laid end to end, reduced per mesh or spread to rows.

    rows      a a a b b c c c c        (N,)
    offsets   0     3   5       9      (B+1,)

Every reduction runs over one mesh's rows in their own order, so its bits do not depend on what
else is in the batch.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from ..kernels import ragged
from .detached import loops_may_read

# Of fewer rows than this, torch takes less time than a call of a compiled loop costs.
_MANY = 1024


def true_rows(flags: Tensor) -> Tensor:
    """(N,) bool to (M,) int64: the rows whose flag is set, in their order."""
    many = flags.numel() >= _MANY and loops_may_read(flags)
    return ragged.true_rows(flags) if many else flags.nonzero().squeeze(1)


def take(values: Tensor, rows: Tensor) -> Tensor:
    """(M, ...) the `rows` (M,) int64 of `values` (N, ...); none may be negative."""
    # Single numbers are taken by torch in the same time.
    many = values.ndim > 1 and rows.numel() >= _MANY and rows.dtype == torch.int64 and loops_may_read(values)
    return ragged.take(values, rows) if many else values.index_select(0, rows)


def put_rows(values: Tensor, rows: Tensor, part: Tensor) -> Tensor:
    """(N, ...) a copy of `values` with the `rows` (M,) int64 replaced by `part` (M, ...).

    Each row is named once; none may be negative.
    """
    fits = part.dtype == values.dtype and part.shape == (rows.numel(), *values.shape[1:])
    many = rows.numel() >= _MANY and fits and loops_may_read(values)
    return ragged.put_rows(values, rows, part) if many else values.index_copy(0, rows, part)


def offsets_from_counts(counts: Tensor) -> Tensor:
    """(B,) row counts to (B+1,) int64 offsets."""
    return torch.nn.functional.pad(counts.to(torch.int64).cumsum(0), (1, 0))


def counts_from_offsets(offsets: Tensor) -> Tensor:
    """(B+1,) offsets to (B,) row counts."""
    return offsets[1:] - offsets[:-1]


def segment_ids(offsets: Tensor) -> Tensor:
    """(B+1,) offsets to (N,) int64: the mesh each row belongs to."""
    meshes = torch.arange(len(offsets) - 1, device=offsets.device)
    return meshes.repeat_interleave(counts_from_offsets(offsets))


def spread(per_mesh: Tensor, offsets: Tensor) -> Tensor:
    """(B, ...) one value a mesh to (N, ...) one value a row."""
    if len(per_mesh) == 1:
        # Most batches are of one mesh, and a copy of a number takes less time than to look for its place.
        return per_mesh.expand(int(offsets[1]), *per_mesh.shape[1:]).contiguous()
    if len(per_mesh) == len(offsets) - 1 and loops_may_read(per_mesh):
        return ragged.spread(per_mesh, offsets)
    return per_mesh.repeat_interleave(counts_from_offsets(offsets), dim=0)


def owner_of(rows: Tensor, offsets: Tensor) -> Tensor:
    """(N,) int64, for each of the `rows` (N,) int64 the mesh that it belongs to."""
    return torch.bucketize(rows.contiguous(), offsets[1:], right=True)


def rows_of(keep: Tensor, offsets: Tensor) -> Tensor:
    """(B,) bool to (N,) int64: the rows of the meshes kept, in their order."""
    return true_rows(spread(keep, offsets))


def rows_of_each(meshes: Tensor, offsets: Tensor) -> Tensor:
    """(M,) int64 to (N,) int64: the rows of the `meshes`, one mesh after the other, each as often as it is named."""
    if loops_may_read(meshes):
        return ragged.rows_of_each(meshes, offsets)
    counts = counts_from_offsets(offsets)[meshes]
    ends = offsets_from_counts(counts)
    shift = offsets[:-1][meshes] - ends[:-1]
    return torch.arange(int(ends[-1]), device=meshes.device) + shift.repeat_interleave(counts)


def shifted(numbers: Tensor, by: Tensor, offsets: Tensor) -> Tensor:
    """(N, ...) int64 the `numbers` of rows with the shift `by` (B,) of their mesh added; -1, which is none, stays."""
    if loops_may_read(numbers):
        return ragged.shifted(numbers, by, offsets)
    shift = spread(by, offsets).reshape(-1, *[1] * (numbers.ndim - 1))
    return torch.where(numbers < 0, numbers, numbers + shift)


def segment_sum(values: Tensor, offsets: Tensor) -> Tensor:
    """(N,) floating rows to their (B,) sums; 0 for a mesh without rows."""
    return torch.segment_reduce(values, "sum", offsets=offsets, initial=0.0)


def segment_max(values: Tensor, offsets: Tensor, empty: float = -torch.inf) -> Tensor:
    """(N,) floating rows to their (B,) maxima; `empty` is the floor and the empty mesh's value."""
    return torch.segment_reduce(values, "max", offsets=offsets, initial=empty)


def segment_min(values: Tensor, offsets: Tensor, empty: float = torch.inf) -> Tensor:
    """(N,) floating rows to their (B,) minima; `empty` is the ceiling and the empty mesh's value."""
    return torch.segment_reduce(values, "min", offsets=offsets, initial=empty)


def segment_count(flags: Tensor, offsets: Tensor) -> Tensor:
    """(N,) bool rows to the (B,) int64 number that are true."""
    if len(offsets) == 2:
        return flags.sum()[None]
    if loops_may_read(flags):
        return ragged.segment_count(flags, offsets)
    totals = torch.nn.functional.pad(flags.to(torch.int64).cumsum(0), (1, 0))
    return totals[offsets[1:]] - totals[offsets[:-1]]


def segment_any(flags: Tensor, offsets: Tensor) -> Tensor:
    """(N,) bool rows to (B,) bool: is any of a mesh's rows true."""
    if len(offsets) == 2:
        return flags.any()[None]
    return segment_count(flags, offsets) > 0


def percentiles(values: Tensor, offsets: Tensor, percents: Sequence[float]) -> Tensor:
    """(N,) values of the segments that `offsets` (B+1,) tells apart to (B, P) percentiles of each, linear between."""
    order = values.argsort(stable=True)
    order = order[segment_ids(offsets)[order].argsort(stable=True)]
    ranked = values[order]
    parts = torch.tensor(list(percents), dtype=values.dtype, device=values.device) / 100
    rank = parts * (counts_from_offsets(offsets)[:, None] - 1)
    below = rank.floor()
    fraction = rank - below
    low, high = (offsets[:-1, None] + p.to(torch.int64) for p in (below, rank.ceil()))
    low, high = ranked[low], ranked[high]
    # Between equal neighbours nothing is to be weighed; two infinities would give NaN.
    return torch.where((fraction == 0) | (low == high), low, low + fraction * (high - low).nan_to_num(posinf=torch.inf))
