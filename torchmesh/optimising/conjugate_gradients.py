"""Conjugate gradients for many symmetric systems at once."""

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from ..mesh.ragged import segment_sum, spread


@dataclass(frozen=True, eq=False)
class Solution:
    """What `solve` found: x (N,), and per problem (B,) the products taken and whether it converged.

    A problem whose Hessian is not positive definite stops where conjugate gradients met that, unconverged.
    """

    x: Tensor
    iterations: Tensor
    converged: Tensor


class SymmetricOperator(Protocol):
    """A symmetric matrix of `size` rows that is known by its products and its diagonal, each (size,)."""

    @property
    def size(self) -> int: ...

    def __matmul__(self, u: Tensor) -> Tensor: ...

    def diagonal(self) -> Tensor: ...


def solve(
    hessian: SymmetricOperator,
    right: Tensor,
    offsets: Tensor,
    *,
    tolerance: Tensor | float = 1e-10,
    max_iterations: int = 10_000,
) -> Solution:
    """Solve H x = right for many problems at once, each with its own step and stopping test.

    right      (N',) over the first N' of the Hessian's coordinates, those of the problems; the others stay
    offsets    (B+1,) the coordinates of each problem.  Padding is where `right` and the diagonal are zero
    tolerance  a problem is done when its preconditioned residual has fallen to this part of what it was

    Conjugate gradients with the diagonal as preconditioner (Hestenes & Stiefel 1952; Saad, Iterative
    Methods for Sparse Linear Systems, 2003, algorithm 9.1).  A problem's result does not depend on
    what else is solved.
    """
    count = len(right)
    beyond = right.new_zeros(hessian.size - count)

    def product(u: Tensor) -> Tensor:
        return (hessian @ torch.cat([u, beyond]))[:count]

    def dot(u: Tensor, v: Tensor) -> Tensor:
        return segment_sum(u * v, offsets)

    def each(per_problem: Tensor) -> Tensor:
        return per_problem.index_select(0, owner)

    meshes = torch.arange(len(offsets) - 1, device=right.device)
    owner = spread(meshes, offsets)
    diagonal = hessian.diagonal()[:count].abs()
    inverse = torch.where(diagonal > 0, 1 / torch.where(diagonal > 0, diagonal, 1.0), 0.0)
    x, r = torch.zeros_like(right), right
    z = inverse * r
    p = z
    rz = dot(r, z)
    goal = rz * tolerance**2
    running = rz > 0
    converged = ~running
    iterations = torch.zeros_like(meshes)
    for _ in range(max_iterations):
        if not bool(running.any()):
            break
        hp = product(p)
        curvature = dot(p, hp)
        indefinite = running & ~(curvature > 0)
        running = running & ~indefinite
        step = torch.where(running, rz / torch.where(running, curvature, 1.0), 0.0)
        x = torch.addcmul(x, each(step), p)
        r = torch.addcmul(r, each(step), hp, value=-1)
        z = inverse * r
        new = dot(r, z)
        iterations += running
        converged = converged | (running & (new <= goal))
        beta = torch.where(running, new / torch.where(rz > 0, rz, 1.0), 0.0)
        running = running & ~converged
        p = torch.addcmul(z, each(beta), p)
        rz = torch.where(running, new, rz)
    return Solution(x, iterations, converged)
