"""The P1 stiffness matrix of the Laplacian, and harmonic extension with it."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
import torch
from torch import Tensor

from ..kernels import cholesky, stiffness
from ..kernels.library import library_for
from ..kernels.stiffness import CompressedRows
from ..mesh.ragged import segment_sum, spread, take, true_rows
from ..mesh.triangle import Corners, corners, signed_area

if TYPE_CHECKING:
    from scipy.sparse.linalg import SuperLU

# Up to so many unknown vertices the compiled factorisation is the faster one.  Processor time on an AMD EPYC, compiled
# against SuperLU: 4.6 and 8.2 ms for 2,300 unknowns, 1.7 and 2.1 s for 116,000, 9.8 and 6.8 s for 359,000.
_SMALL = 100_000
# Areas count as if none were less than this part of the mean, nor more than so many times it, so that the matrix of a
# mesh with slivers keeps some digits.
_STIFFEST = 1e6


def cotangent_weights(t: Corners) -> tuple[Tensor, Tensor, Tensor]:
    """(T,) half cotangents of the angles at a, b, c, which are minus the stiffness of the edges bc, ca, ab.

    The stiffness of linear elements is K_ij = integral of grad phi_i . grad phi_j (any finite element text;
    Shontz & Vavasis, BIT 50, 2010).
    """
    ux, uy, vx, vy = t.bx - t.ax, t.by - t.ay, t.cx - t.ax, t.cy - t.ay
    wx, wy = t.cx - t.bx, t.cy - t.by
    quarter = 1.0 / (4.0 * signed_area(t))
    return (
        (ux * vx + uy * vy) * quarter,
        -(ux * wx + uy * wy) * quarter,
        (vx * wx + vy * wy) * quarter,
    )


def edge_stiffness(
    points: Tensor, triangles: Tensor, triangle_offsets: Tensor, stiffening: float = 0.0
) -> tuple[Tensor, Tensor, Tensor]:
    """(T,) `cotangent_weights` of triangles over points (V, 2), in float64, with small triangles stiffened.

    stiffening  the weights of a triangle are multiplied by this power of the mean area of its mesh over its own.  The
                triangles must not be inverted
    """
    if library_for(points) is not None:
        return stiffness.edge_stiffness(points, triangles, triangle_offsets, stiffening, _STIFFEST)
    places = corners(points.to(torch.float64), triangles)
    weights = cotangent_weights(places)
    if not stiffening:
        return weights
    area = signed_area(places)
    mean = segment_sum(area, triangle_offsets) / triangle_offsets.diff().clamp_min(1)
    ratio = (spread(mean, triangle_offsets) / area).clamp(1 / _STIFFEST, _STIFFEST)
    factor = ratio if stiffening == 1 else ratio**stiffening
    return factor * weights[0], factor * weights[1], factor * weights[2]


def stiffness_blocks(
    triangles: Tensor, weights: tuple[Tensor, Tensor, Tensor], known: Tensor
) -> tuple[CompressedRows, CompressedRows]:
    """The block K_II of the unknown vertices, and minus the block K_IB of their known neighbours.

    Each in compressed rows: offsets (I+1,) and columns (N,) int32, values (N,) float64.  The columns ascend in each row
    and count the unknown vertices, or the known ones; entries that are 0 are left out.  Arguments are those of
    `harmonic_extension`.
    """
    weights = weights[0].to(torch.float64), weights[1].to(torch.float64), weights[2].to(torch.float64)
    if library_for(triangles) is not None:
        return stiffness.blocks(triangles, weights, known)
    from scipy.sparse import coo_matrix, diags

    a, b, c = triangles.unbind(1)
    i, j = torch.cat([b, c, a]), torch.cat([c, a, b])
    row, column, weight = (v.cpu().numpy() for v in (i, j, torch.cat(weights)))
    count = len(known)
    coupling = coo_matrix((weight, (row, column)), shape=(count, count)).tocsr()
    coupling = coupling + coupling.T
    unknown, fixed = (np.flatnonzero(mask.cpu().numpy()) for mask in (~known, known))
    rows = coupling[unknown]
    inner = (diags(np.asarray(rows.sum(1)).ravel()) - rows[:, unknown]).tocsr()
    outer = rows[:, fixed]
    return (inner.indptr, inner.indices, inner.data), (outer.indptr, outer.indices, outer.data)


def harmonic_extension(
    triangles: Tensor,
    weights: tuple[Tensor, Tensor, Tensor],
    known: Tensor,
    values: Tensor,
    point_offsets: Tensor,
    source: Tensor | None = None,
) -> Tensor:
    """Solve K_II x_I = f_I - K_IB x_B for the unknown rows I; the known rows B keep their values.

    triangles      (T, 3) int64
    weights        three (T,): the weight of the edges opposite the corners a, b, c
    known          (V,) bool
    values         (V, k), of which only the known rows are read
    point_offsets  (B+1,) the rows of each mesh
    source         (V, k) the right-hand side f; None means zero

    Returns (V, k).  Each mesh has a sparse direct factorisation of its own: one of the whole batch would order its
    columns by all the meshes, so that the rounding of one mesh would depend on the others.  It is compiled; large
    meshes, and all where there are no compiled loops, are left to SuperLU with a minimum-degree ordering.  Raises
    RuntimeError where a mesh's matrix is singular.
    """
    system = ExtensionSystem(triangles, weights, known, point_offsets)
    return system.extended(values, source)


class ExtensionSystem:
    """The factorised system of `harmonic_extension`, for any number of right-hand sides; arguments as there."""

    def __init__(
        self, triangles: Tensor, weights: tuple[Tensor, Tensor, Tensor], known: Tensor, point_offsets: Tensor
    ) -> None:
        from scipy.sparse import csr_matrix

        self.known = known
        self.unknown, self.fixed = (np.flatnonzero(mask.cpu().numpy()) for mask in (~known, known))
        (starts, columns, values), (offsets, *outer) = stiffness_blocks(triangles, weights, known)
        self.outer = csr_matrix((outer[1], outer[0], offsets), shape=(len(self.unknown), len(self.fixed)))
        ends = np.searchsorted(self.unknown, point_offsets.cpu().numpy())
        self.factors = factorised((starts, columns, values), ends, library_for(triangles) is not None)

    def extended(self, values: Tensor, source: Tensor | None = None) -> Tensor:
        """(V, k) `values` with the unknown rows solved for, with the right-hand side `source` (V, k)."""
        given = values.to(torch.float64).cpu().numpy()
        right = self.outer @ given[self.fixed]
        if source is not None:
            right = right + source.to(torch.float64).cpu().numpy()[self.unknown]
        solution = given.copy()
        self._solve(right, solution)
        return torch.where(self.known[:, None], values, torch.from_numpy(solution).to(values))

    def adjoint(self, gradient: Tensor) -> Tensor:
        """(V, k) the gradient of the known rows, where that of the extension is `gradient` (V, k); 0 in other rows.

        With x_I = -K_II^-1 K_IB x_B and K symmetric it is g_B - K_BI K_II^-1 g_I: one solve with the same factors.
        """
        g = gradient.to(torch.float64).cpu().numpy()
        solved = np.zeros_like(g)
        self._solve(g[self.unknown], solved)
        back = np.zeros_like(g)
        back[self.fixed] = g[self.fixed] + self.outer.T @ solved[self.unknown]
        return torch.from_numpy(back).to(gradient)

    def _solve(self, right: np.ndarray, into: np.ndarray) -> None:
        """Put K_II^-1 `right` (I, k) into the unknown rows of `into`."""
        solution = np.empty_like(right)
        for factors in self.factors:
            factors.solve(right, solution)
        into[self.unknown] = solution


class Factors(Protocol):
    """The factors of some diagonal blocks of a matrix."""

    def solve(self, right: np.ndarray, out: np.ndarray) -> None:
        """Put the solutions for the right-hand sides `right` (I, k) into the rows of the blocks in `out` (I, k)."""
        ...


@dataclass(frozen=True, eq=False)
class BlockFactors:
    """The factors of the rows `first` to `last` - 1, by SuperLU."""

    first: int
    last: int
    factors: "SuperLU"

    def solve(self, right: np.ndarray, out: np.ndarray) -> None:
        out[self.first : self.last] = self.factors.solve(right[self.first : self.last])


def factorised(rows: CompressedRows, ends: np.ndarray, compiled: bool) -> list[Factors]:
    """The factors of a symmetric matrix in compressed rows, whose blocks, one a mesh, end at the rows `ends` (B+1,).

    compiled  whether the compiled factorisation takes the blocks of up to `_SMALL` rows, and not SuperLU
    """
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu

    starts, columns, values = rows
    bounds = np.stack([ends[:-1], ends[1:]], 1)
    bounds = bounds[bounds[:, 0] < bounds[:, 1]]
    small = (bounds[:, 1] - bounds[:, 0] <= _SMALL) & compiled
    factors: list[Factors] = []
    factors.extend(cholesky.factorised(rows, bounds[small]))
    for first, last in bounds[~small].tolist():
        # Slicing a sparse matrix takes time in proportion to its width, for every mesh.  The blocks of the meshes are
        # therefore cut out of its arrays.  The matrix is symmetric: its rows are its columns.
        start, end = starts[first], starts[last]
        block = values[start:end], columns[start:end] - first, starts[first : last + 1] - start
        matrix = csc_matrix(block, shape=(last - first, last - first))
        # Without pivots, as the symmetry wants it.
        options = {"SymmetricMode": True}
        lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        factors.append(BlockFactors(first, last, lu))
    return factors


@dataclass(frozen=True, eq=False)
class InnerStiffness:
    """The block K_II of the stiffness of the unknown vertices, (I, I), and the block K_IB of their known neighbours.

    The matrix is never assembled; it is known by its products with vectors.

    size   I; the unknown vertices are numbered in their order
    total  (I,) the diagonal of K_II
    inner  rows (N,), columns (N,) and weights (N,) of the entries of K_II off the diagonal; weights are minus the
           entries
    outer  rows (M,), vertices (M,) and weights (M,) of the entries of K_IB; weights are minus the entries
    """

    size: int
    total: Tensor
    inner: tuple[Tensor, Tensor, Tensor]
    outer: tuple[Tensor, Tensor, Tensor]

    @classmethod
    def of(
        cls, triangles: Tensor, twin: Tensor, weights: tuple[Tensor, Tensor, Tensor], known: Tensor
    ) -> "InnerStiffness":
        """The stiffness of the vertices that are not `known` (V,) bool.

        triangles, weights  as in `harmonic_extension`
        twin                (3T,); both ends of an edge whose twin is -1 must be known
        """
        at_a, at_b, at_c = weights
        weight = torch.stack([at_c, at_a, at_b], 1).reshape(-1)
        weight = weight + torch.where(twin >= 0, weight[twin], 0.0)
        row = (~known).cumsum(0) - 1
        # The triangles at an unknown vertex close round it, so each neighbour is the head of one half-edge from it.
        tail, head = triangles.reshape(-1), triangles.roll(-1, 1).reshape(-1)
        out = true_rows((~known)[tail])
        tail, head, weight = row[tail[out]], head[out], weight[out]
        size = int((~known).sum())
        total = weight.new_zeros(size).index_add_(0, tail, weight)
        outer = known[head]
        inner = ~outer
        return cls(
            size,
            total,
            (tail[inner], row[head[inner]], weight[inner]),
            (tail[outer], head[outer], weight[outer]),
        )

    def __matmul__(self, u: Tensor) -> Tensor:
        """(I,) the product of K_II with u (I,)."""
        row, column, weight = self.inner
        return (self.total * u).index_add_(0, row, weight * take(u, column), alpha=-1)

    def diagonal(self) -> Tensor:
        """(I,) the diagonal of K_II."""
        return self.total

    def solved(
        self, right: Tensor, diagonal: Tensor, offsets: Tensor, tolerance: Tensor | float, max_iterations: int
    ) -> tuple[Tensor, Tensor, Tensor] | None:
        """As `conjugate_gradients.Solvable` says."""
        if library_for(right) is None or isinstance(tolerance, Tensor) or len(right) != self.size:
            return None
        from ..kernels.projection import solved

        return solved(*self._compressed, diagonal, offsets, right, tolerance, max_iterations)

    @cached_property
    def _compressed(self) -> tuple[Tensor, Tensor, Tensor]:
        """Rows, columns and values of the entries of K_II off the diagonal, row by row."""
        row, column, weight = self.inner
        order = row.argsort(stable=True)
        return row[order], column[order], -weight[order]

    def load(self, values: Tensor) -> Tensor:
        """(I,) -K_IB x_B, where x_B are the known rows of `values` (V,)."""
        row, vertex, weight = self.outer
        return torch.zeros_like(self.total).index_add_(0, row, weight * take(values, vertex))
