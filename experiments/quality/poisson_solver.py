"""Poisson's equation with a known solution on one mesh, by linear elements of scikit-fem.

-laplace u = f with u = sin(k x) sin(k y) on the boundary, and f such that this is the solution everywhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse.linalg
import skfem
import skfem.helpers

# Degree of the polynomials that the quadrature of errors integrates exactly.
QUADRATURE = 8
# At which conjugate gradients stop, relative to the right side.
RESIDUAL = 1e-8


@dataclass(frozen=True)
class Solution:
    """What `solve` finds.

    condition    number of the interior stiffness matrix
    cg           iterations of conjugate gradients to the RESIDUAL, and cg_diagonal with the diagonal as preconditioner
    l2_error     relative to the norm of the exact solution, as is h1_error, in the H1 seminorm
    """

    condition: float
    cg: int
    cg_diagonal: int
    l2_error: float
    h1_error: float


def solve(points: np.ndarray, triangles: np.ndarray, k: float) -> Solution:
    """Solve on the mesh of `points` (V, 2) and `triangles` (T, 3), of which none may be inverted."""
    basis = skfem.Basis(
        skfem.MeshTri(np.ascontiguousarray(points.T), np.ascontiguousarray(triangles.T)),
        skfem.ElementTriP1(),
        intorder=QUADRATURE,
    )

    @skfem.BilinearForm
    def stiffness(u, v, w):
        return skfem.helpers.dot(u.grad, v.grad)

    @skfem.LinearForm
    def load(v, w):
        x, y = w.x
        return 2 * k * k * np.sin(k * x) * np.sin(k * y) * v

    @skfem.Functional
    def squares(w):
        """The squares of the error, of the solution, and of the gradients of both."""
        x, y = w.x
        exact = np.sin(k * x) * np.sin(k * y)
        slope = k * np.stack([np.cos(k * x) * np.sin(k * y), np.sin(k * x) * np.cos(k * y)])
        return np.stack([(w["u"] - exact) ** 2, exact**2, ((w["u"].grad - slope) ** 2).sum(0), (slope**2).sum(0)])

    matrix, right = stiffness.assemble(basis), load.assemble(basis)
    x, y = basis.doflocs
    u = np.sin(k * x) * np.sin(k * y)
    inner = basis.complement_dofs(basis.get_dofs())
    u[inner] = 0
    a = matrix[inner][:, inner].tocsr()
    b = right[inner] - (matrix @ u)[inner]
    spectrum = scipy.linalg.eigvalsh(a.toarray())
    diagonal = scipy.sparse.diags(1 / a.diagonal())
    counts = []
    for preconditioner in (None, diagonal):
        count = 0

        def counting(_):
            nonlocal count
            count += 1

        u[inner], info = scipy.sparse.linalg.cg(a, b, rtol=RESIDUAL, M=preconditioner, callback=counting)
        if info:
            raise RuntimeError(f"conjugate gradients stopped after {info} iterations without converging")
        counts.append(count)
    error2, size2, slope_error2, slope2 = squares.assemble(basis, u=basis.interpolate(u))
    return Solution(
        float(spectrum[-1] / spectrum[0]),
        counts[0],
        counts[1],
        math.sqrt(error2 / size2),
        math.sqrt(slope_error2 / slope2),
    )
