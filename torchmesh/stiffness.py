"""The P1 stiffness matrix of the Laplacian, and harmonic extension with it."""

import numpy as np
import torch
from torch import Tensor

from .triangle import Corners, signed_area


def cotangent_weights(t: Corners) -> tuple[Tensor, Tensor, Tensor]:
    """(T,) half cotangents of the angles at a, b, c: minus the stiffness of the edges bc, ca, ab.

    For the linear element K_ij = integral of grad phi_i . grad phi_j (any finite element text;
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


def harmonic_extension(
    triangles: Tensor, weights: tuple[Tensor, Tensor, Tensor], known: Tensor, values: Tensor
) -> Tensor:
    """Solve K_II x_I = -K_IB x_B for the unknown rows; the known ones keep their values.

    triangles  (T, 3) int64
    weights    three (T,): the weight of the edges opposite the corners a, b, c
    known      (V,) bool
    values     (V, k) the known rows count

    One sparse direct factorisation of all meshes at once (scipy, SuperLU with a minimum-degree
    ordering): the matrix of a batch is block diagonal.  Raises RuntimeError where it is singular.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import splu

    a, b, c = triangles.unbind(1)
    i, j = torch.cat([b, c, a]), torch.cat([c, a, b])
    w = torch.cat(weights).to(torch.float64)
    row, column, weight = (v.cpu().numpy() for v in (i, j, w))
    count = len(known)
    coupling = coo_matrix((weight, (row, column)), shape=(count, count)).tocsr()
    coupling = coupling + coupling.T
    unknown = np.flatnonzero(~known.cpu().numpy())
    if not len(unknown):
        return values.clone()
    fixed = np.flatnonzero(known.cpu().numpy())
    rows = coupling[unknown]
    inner = -rows[:, unknown]
    inner.setdiag(np.asarray(rows.sum(1)).ravel())
    right = rows[:, fixed] @ values.to(torch.float64).cpu().numpy()[fixed]
    solution = splu(inner.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
                    options={"SymmetricMode": True}).solve(right)  # fmt: skip
    out = values.clone()
    out[torch.from_numpy(unknown).to(values.device)] = torch.from_numpy(solution).to(values)
    return out
