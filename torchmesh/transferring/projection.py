"""Projection of a piecewise linear function onto another mesh: the integral of the function is kept.

Farrell & Maddison, Conservative interpolation between volume meshes by local Galerkin projection, Computer Methods in
Applied Mechanics and Engineering 200, 2011: solve M u = R v, where M is the mass matrix of the mesh after, and R holds
the integrals of a hat function of the one mesh times a hat function of the other.  Both are piecewise quadratic on the
overlaps of the triangles, so that R is exact.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..errors import ConvergenceError, InvalidMeshError
from ..kernels import projection
from ..kernels.library import library
from ..mesh.ragged import owner_of, segment_ids, take, true_rows
from ..optimising.conjugate_gradients import solve
from .overlaps import Overlaps, signed_areas
from .pairs import Side
from .sparse_rows import Entries, SparseRows

# The residual may fall to this part of what it was.  The mass matrix over its diagonal has a condition number of at
# most 4 (Wathen, Realistic eigenvalue bounds for the Galerkin mass matrix, 1987), so that some 30 steps do.
_TOLERANCE = 1e-15


@dataclass(frozen=True, eq=False)
class MassMatrix:
    """The consistent mass matrix of P1 elements, in units of `Side`; vertices of no triangle have a one.

    rows     its off-diagonal entries
    total    (V,) its diagonal
    offsets  (B+1,) the vertices of each mesh
    """

    rows: SparseRows
    total: Tensor
    offsets: Tensor

    @classmethod
    def of(cls, side: Side, offsets: Tensor) -> "MassMatrix":
        """Entries A / 6 on the diagonal and A / 12 beside it for each triangle of area A."""
        count, area = len(side.x), signed_areas(side)
        total = np.bincount(side.triangles.reshape(-1), np.repeat(area / 6, 3), count)
        total[np.bincount(side.triangles.reshape(-1), minlength=count) == 0] = 1.0
        i = side.triangles[:, [0, 1, 2, 1, 2, 0]].reshape(-1)
        j = side.triangles[:, [1, 2, 0, 0, 1, 2]].reshape(-1)
        rows = SparseRows.summed([Entries(i, j, np.repeat(area / 12, 6))], (count, count))
        return cls(rows, torch.from_numpy(total), offsets)

    @property
    def size(self) -> int:
        return len(self.total)

    def diagonal(self) -> Tensor:
        return self.total

    def __matmul__(self, u: Tensor) -> Tensor:
        r = self.rows
        return (self.total * u).index_add(0, r.rows, r.weights * take(u, r.columns))

    def solved(
        self, right: Tensor, diagonal: Tensor, offsets: Tensor, tolerance: Tensor | float, max_iterations: int
    ) -> tuple[Tensor, Tensor, Tensor] | None:
        """What the compiled solver finds, as in `conjugate_gradients.solve`; None where torch is to do the work."""
        if library() is None:
            return None
        r = self.rows
        return projection.solved(
            r.rows, r.columns, r.weights, diagonal, offsets, right, float(tolerance), max_iterations
        )

    def unknowns(self, right: Tensor) -> Tensor:
        """(V, C) the solution for each column of `right` (V, C).

        Raises InvalidMeshError for a right-hand side that is not finite, and ConvergenceError.
        """
        bad = true_rows(~right.isfinite().all(1))
        if len(bad):
            b = int(owner_of(bad[:1], self.offsets))
            raise InvalidMeshError(
                f"mesh {b}: its values are not all finite, and a projection spreads each over the mesh"
            )
        columns = []
        for column in right.unbind(1):
            found = solve(self, column.contiguous(), self.offsets, tolerance=_TOLERANCE, max_iterations=500)
            rest = (column - self @ found.x).abs()
            scale = torch.zeros(len(self.offsets) - 1, dtype=rest.dtype)
            scale = scale.scatter_reduce(0, segment_ids(self.offsets), column.abs(), "amax")
            if not bool((rest <= 1e-11 * scale[segment_ids(self.offsets)]).all()):
                raise ConvergenceError("the projection did not converge")
            columns.append(found.x)
        return torch.stack(columns, 1) if columns else right


def mixed_mass(before: Side, after: Side, shared: Overlaps, sign: np.ndarray) -> SparseRows:
    """R (V', V) of the overlaps, which have moments; `sign` (P,) is -1 where the triangle before is inverted."""
    assert shared.moments is not None
    shape = (len(after.x), len(before.x))
    if library() is not None:
        here, there = ((side.x, side.y, side.triangles) for side in (after, before))
        made = projection.mixed_mass(here, there, (shared.after, shared.before), shared.moments, sign)
        row, column, weight = (torch.from_numpy(v) for v in made)
        return SparseRows(row, column, weight, shape)
    origin = before.triangles[shared.before, 0]
    hats = [_hats(side, rows, origin, before) for side, rows in ((after, shared.after), (before, shared.before))]
    m1, mx, my, mxx, mxy, myy = shared.moments.T * sign
    entries = []
    for p in range(3):
        for q in range(3):
            (f, fx, fy), (g, gx, gy) = hats[0][p], hats[1][q]
            value = (
                f * g * m1 + (f * gx + fx * g) * mx + (f * gy + fy * g) * my
                + fx * gx * mxx + (fx * gy + fy * gx) * mxy + fy * gy * myy
            )  # fmt: skip
            i, j = after.triangles[shared.after, p], before.triangles[shared.before, q]
            entries.append(Entries(i, j, value))
    return SparseRows.summed(entries, shape)


def _hats(
    side: Side, rows: np.ndarray, origin: np.ndarray, before: Side
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """For each corner the constant, x and y coefficients (P,) of its hat function, about the vertices `origin`."""
    x = [side.x[side.triangles[rows, k]] - before.x[origin] for k in range(3)]
    y = [side.y[side.triangles[rows, k]] - before.y[origin] for k in range(3)]
    double = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
    hats = []
    for k in range(3):
        b, c = (k + 1) % 3, (k + 2) % 3
        hats.append(((x[b] * y[c] - y[b] * x[c]) / double, (y[b] - y[c]) / double, (x[c] - x[b]) / double))
    return hats
