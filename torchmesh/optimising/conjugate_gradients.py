"""Conjugate gradients for many symmetric systems at once, each with its own steps.

Hestenes & Stiefel, Methods of conjugate gradients for solving linear systems, Journal of Research of the
National Bureau of Standards 49, 1952; with the diagonal as preconditioner as in Saad, Iterative Methods for
Sparse Linear Systems, 2003, algorithm 9.1.  The result of a system does not depend on what else is solved.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from torch import Tensor

from ..mesh.ragged import segment_ids, segment_sum, take

# To ask another device whether all systems are solved takes longer than some steps that change nothing.
_STEPS_BETWEEN_LOOKS = 8


class Matrix(Protocol):
    """A symmetric matrix that is known by its products."""

    def __matmul__(self, u: Tensor) -> Tensor: ...


class SymmetricOperator(Matrix, Protocol):
    """A symmetric matrix of `size` rows that is known by its products and its diagonal, each (size,)."""

    @property
    def size(self) -> int: ...

    def diagonal(self) -> Tensor: ...


@runtime_checkable
class Solvable(Protocol):
    """A matrix for whose systems there may be a compiled solver."""

    def solved(
        self, right: Tensor, diagonal: Tensor, offsets: Tensor, tolerance: Tensor | float, max_iterations: int
    ) -> tuple[Tensor, Tensor, Tensor] | None:
        """The fields of `Solution`; None where torch is to do the work.  Arguments as those of `solve`."""
        ...


class Iterate(NamedTuple):
    """Where the systems are: vectors (N,) over all unknowns, numbers (B,) one a system.

    x          the solution so far
    residual   right-hand side minus matrix times x
    direction  in which the next step goes
    power      the residual times the preconditioned residual
    length     of the last step in units of its direction; 0 for systems that stayed where they were
    """

    x: Tensor
    residual: Tensor
    direction: Tensor
    power: Tensor
    length: Tensor


class Systems:
    """B symmetric systems side by side in one vector of N unknowns.

    matrix    its products (N,) couple no two systems
    diagonal  (N,) positive, the preconditioner; infinite for unknowns that stay
    offsets   (B+1,) the unknowns of each system
    """

    def __init__(self, matrix: Matrix, diagonal: Tensor, offsets: Tensor) -> None:
        self.matrix, self.diagonal, self.offsets = matrix, diagonal, offsets
        self.owner = segment_ids(offsets)

    def start(self, x: Tensor, residual: Tensor) -> Iterate:
        """Begin at x (N,), where the residual is `residual` (N,)."""
        direction = residual / self.diagonal
        power = self._dot(residual, direction)
        return Iterate(x, residual, direction, power, torch.zeros_like(power))

    def step(self, now: Iterate, running: Tensor | None = None) -> Iterate:
        """One step of the systems `running` (B,) bool, or of all; without one where the matrix is not positive."""
        image = self.matrix @ now.direction
        curvature = self._dot(now.direction, image)
        moves = curvature > 0 if running is None else running & (curvature > 0)
        length = torch.where(moves, now.power / curvature, 0.0)
        along = take(length, self.owner)
        # Not `torch.addcmul`, which rounds once where these round twice: `improve` promises its bits.
        x = now.x + along * now.direction
        residual = now.residual - along * image
        short = residual / self.diagonal
        power = self._dot(residual, short)
        again = take(torch.where(now.power > 0, power / now.power, 0.0), self.owner)
        return Iterate(x, residual, short + again * now.direction, power, length)

    def select(self, now: Iterate, keep: Tensor) -> Iterate:
        """Of an iterate the systems `keep` (B,) bool."""
        rows = take(keep, self.owner)
        return Iterate(now.x[rows], now.residual[rows], now.direction[rows], now.power[keep], now.length[keep])

    def _dot(self, u: Tensor, v: Tensor) -> Tensor:
        return segment_sum(u * v, self.offsets)


@dataclass(frozen=True, eq=False)
class Solution:
    """What `solve` found: x (N,), and per system (B,) the steps taken and whether it converged.

    A system whose matrix is not positive definite stops where conjugate gradients met that, unconverged.
    """

    x: Tensor
    iterations: Tensor
    converged: Tensor


def solve(
    matrix: SymmetricOperator,
    right: Tensor,
    offsets: Tensor,
    *,
    tolerance: Tensor | float = 1e-10,
    max_iterations: int = 10_000,
) -> Solution:
    """Solve A x = right for many systems at once, each with its own steps and stopping test.

    right      (N,) over the first N of the matrix's rows, those of the systems; the unknowns of the other rows
               stay zero.  Padding is where `right` and the diagonal are zero
    offsets    (B+1,) the rows of each system
    tolerance  a float or (B,): a system is done when the norm of its preconditioned residual has fallen to this
               part of what it was
    """
    diagonal = matrix.diagonal()[: len(right)].abs()
    if isinstance(matrix, Solvable):
        found = matrix.solved(right, diagonal, offsets, tolerance, max_iterations)
        if found is not None:
            return Solution(*found)
    systems = Systems(_Leading(matrix, len(right)), torch.where(diagonal > 0, diagonal, torch.inf), offsets)
    now = systems.start(torch.zeros_like(right), right)
    goal = now.power * tolerance**2
    running = now.power > 0
    converged = ~running
    iterations = torch.zeros_like(offsets[1:])
    looks = 1 if right.device.type == "cpu" else _STEPS_BETWEEN_LOOKS
    for k in range(max_iterations):
        if k % looks == 0 and not bool(running.any()):
            break
        now = systems.step(now, running)
        running = running & (now.length > 0)
        iterations += running
        converged = converged | (running & (now.power <= goal))
        running = running & ~converged
    return Solution(now.x, iterations, converged)


class _Leading:
    """The leading block of `count` rows and columns of a matrix."""

    def __init__(self, matrix: SymmetricOperator, count: int) -> None:
        self.matrix, self.count = matrix, count

    def __matmul__(self, u: Tensor) -> Tensor:
        if self.count == self.matrix.size:
            return self.matrix @ u
        return (self.matrix @ torch.cat([u, u.new_zeros(self.matrix.size - self.count)]))[: self.count]
