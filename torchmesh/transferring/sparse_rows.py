"""A linear map from the values of one mesh to those of another, as a sparse matrix row by row."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..kernels import projection
from ..kernels.library import library
from ..mesh.ragged import put_rows, take

# Far above the rounding of a sum of weights.
_ROUNDING = 1e-12


class Entries(NamedTuple):
    """Entries (N,) of a sparse matrix in any order: rows, columns and weights."""

    rows: np.ndarray
    columns: np.ndarray
    weights: np.ndarray

    @classmethod
    def joined(cls, parts: "Sequence[Entries]") -> "Entries":
        """The entries of all parts."""
        if len(parts) == 1:
            return parts[0]
        rows, columns, weights = (np.concatenate([part[k] for part in parts]) for k in range(3))
        return cls(rows, columns, weights)


@dataclass(frozen=True, eq=False)
class SparseRows:
    """The entries of a sparse matrix, in ascending order of rows and then of columns.

    rows, columns, weights  (N,) int64, int64 and float64
    shape                   the numbers of rows and of columns
    """

    rows: Tensor
    columns: Tensor
    weights: Tensor
    shape: tuple[int, int]

    @classmethod
    def of(cls, parts: Sequence[Entries], shape: tuple[int, int]) -> "SparseRows":
        """From entries in any order; entries of zero are left out."""
        entries = Entries.joined(parts)
        there = np.flatnonzero(entries.weights)
        order = there[
            np.argsort(entries.rows[there] * np.int64(max(shape[1], 1)) + entries.columns[there], kind="stable")
        ]
        rows, columns, weights = (torch.from_numpy(column[order]) for column in entries)
        return cls(rows, columns, weights, shape)

    @classmethod
    def summed(cls, parts: Sequence[Entries], shape: tuple[int, int]) -> "SparseRows":
        """From entries in any order, of which those at one position add up: assembled, as matrices of elements are."""
        from scipy.sparse import coo_matrix

        entries = Entries.joined(parts)
        if library() is not None:
            row, column, weight = (torch.from_numpy(v) for v in projection.summed(entries, shape[0]))
            return cls(row, column, weight, shape)
        # Rows are gathered by counting and sorted one by one: their sums do not depend on other rows.
        found = coo_matrix((entries.weights, (entries.rows, entries.columns)), shape=shape).tocsr()
        found.sum_duplicates()
        rows = np.repeat(np.arange(shape[0]), np.diff(found.indptr))
        columns = found.indices.astype(np.int64)
        return cls(torch.from_numpy(rows), torch.from_numpy(columns), torch.from_numpy(found.data), shape)

    def matrix(self) -> Tensor:
        """The sparse COO tensor, float64."""
        return torch.sparse_coo_tensor(
            torch.stack([self.rows, self.columns]), self.weights, self.shape, check_invariants=False
        ).coalesce()

    def __matmul__(self, values: Tensor) -> Tensor:
        """(N, ...) the products with values (M, ...), in the dtype of the values and differentiable in them.

        Every row is summed in the order of its entries.  A row of a single one copies its value, bit for bit, and a row
        whose weights are all positive and sum to 1 gives nothing beyond the values that it takes from.
        """
        rows, columns, weights = (v.to(values.device) for v in (self.rows, self.columns, self.weights))
        count = torch.bincount(rows, minlength=self.shape[0])
        alone = (count[rows] == 1) & (weights == 1)
        if not (values.is_floating_point() or values.is_complex()):
            if not bool(alone.all()):
                raise InvalidMeshError(f"values are {values.dtype}: only method 'nearest' copies them, or use floats")
            if len(rows) == self.shape[0]:  # each row once: torch takes rows of any type, but puts not all of them
                return values[columns]
            return put_rows(values.new_zeros((self.shape[0], *values.shape[1:])), rows, values[columns])
        exact = torch.promote_types(values.dtype, torch.float64)
        flat = values.reshape(len(values), math.prod(values.shape[1:]))
        several = ~alone
        parts = take(flat, columns[several]).to(exact) * weights[several, None]
        out = torch.zeros((self.shape[0], flat.shape[1]), dtype=exact, device=values.device)
        out = out.index_add(0, rows[several], parts)
        if not values.is_complex():
            out = self._within(out, flat.detach().to(exact), rows, columns, weights)
        out = out.to(values.dtype)
        out = put_rows(out, rows[alone], take(flat, columns[alone]))
        return out.reshape(self.shape[0], *values.shape[1:])

    def _within(self, out: Tensor, given: Tensor, rows: Tensor, columns: Tensor, weights: Tensor) -> Tensor:
        """`out` (N, C) without what rounding adds beyond the values (M, C) `given`, in rows that are means of them."""
        total = torch.zeros(self.shape[0], dtype=weights.dtype, device=rows.device).index_add(0, rows, weights)
        negative = torch.bincount(rows[weights < 0], minlength=self.shape[0]) > 0
        mean = ((total - 1).abs() < _ROUNDING) & ~negative
        if not bool(mean.any()):
            return out
        low, high = self.range_of(given)
        inside = torch.minimum(torch.maximum(out.detach(), low), high)
        # The difference is a constant, so that gradients stay those of the sum.  Of two infinite values it is NaN.
        beyond = mean[:, None] & (inside != out.detach())
        return out + torch.where(beyond, inside - out.detach(), 0.0)

    def range_of(self, values: Tensor) -> tuple[Tensor, Tensor]:
        """(N, C) the least and the greatest of the values (M, C) that each row takes from; infinite without any."""
        ends = []
        for how, start in (("amin", torch.inf), ("amax", -torch.inf)):
            empty = torch.full((self.shape[0], values.shape[1]), start, dtype=values.dtype, device=values.device)
            index = self.rows.to(values.device)[:, None].expand(-1, values.shape[1])
            ends.append(empty.scatter_reduce(0, index, values[self.columns.to(values.device)], how))
        return ends[0], ends[1]
