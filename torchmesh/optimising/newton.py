"""Newton's method for the minimum of many meshes at once, each with its own steps and stopping test.

Near its minimum a mesh takes full steps; farther away, steps that are halved until its energy falls (Nocedal & Wright,
Numerical Optimization, 2006, algorithm 3.2).  The linear systems are solved by conjugate gradients, in the compiled
loops with the factors of a Hessian nearby as preconditioner.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from ..kernels.block_factors import BlockFactors, Orders
from ..kernels.energies import PackedTriangles
from ..kernels.library import library_for
from ..kernels.newton import MeshProblems, factorised_hessians, newton_for_meshes
from ..mesh.ragged import segment_any, segment_max, segment_sum, spread
from .assembly import Chunk, chunk_offsets, chunks_of, energy_and_forces
from .conjugate_gradients import solve
from .energies import Energy, formula_of
from .hessian import Hessian
from .jacobian import Target
from .objective import Packing

__all__ = ["BlockFactors", "NewtonOptions", "NewtonProblem", "Orders", "newton"]

# The part of the decrease that the slope promises which a step must reach (Armijo's condition).
_DECREASE = 1e-4

# After a full Newton step of length m near the minimum (in local edge lengths), the minimum is nearer than this times m
# squared, plus m times the tolerance of the linear system.  On jittered squares it was nearer than a tenth of that.
_LEFT = 10.0

# Where there are factors of a Hessian nearby, steps with it in place of the Hessian at hand are tried first, which take
# a fifth of the time (the chord method; Ortega & Rheinboldt, Iterative Solution of Nonlinear Equations in Several
# Variables, 1970, section 7.1).  The first must be shorter than this, in local edge lengths, ...
_FIRST_CHORD = 0.1
# ... and each shorter than this part of the one before; otherwise Newton's method does without them.
_CONTRACTION = 0.3


@dataclass(frozen=True, kw_only=True)
class NewtonOptions:
    """How `newton` goes to the minimum.

    newton_steps        steps at most
    tolerance           a mesh is at its minimum if what is left to move, in local edge lengths, is below this
    cg_tolerance        relative residual of the linear systems
    cg_iterations       products with the Hessian at most for one linear system
    first_cg_tolerance  relative residual of the first step's linear system
    near                a step below this, in local edge lengths, is well inside the region of quadratic convergence,
                        and is taken even if rounding hides that the energy falls
    halvings            of a longer step at most, until the energy falls
    """

    newton_steps: int = 50
    tolerance: float = 1e-9
    cg_tolerance: float = 1e-10
    cg_iterations: int = 5000
    first_cg_tolerance: float = 0.01
    near: float = 1e-4
    halvings: int = 40

    def __post_init__(self) -> None:
        for option in fields(NewtonOptions):
            value = getattr(self, option.name)
            if option.type in (int, "int") and value < 1:
                raise ValueError(f"{type(self).__name__}.{option.name} must be at least 1, not {value}")
            if not value > 0:
                raise ValueError(f"{type(self).__name__}.{option.name} must be positive, not {value}")


@dataclass(frozen=True, eq=False)
class NewtonProblem:
    """The energies of packed meshes as functions of their unknowns.

    size  (N,) the local edge length at each unknown, in the packing's unit; 1 in the padding
    rows  (B+1,) the unknowns of each mesh
    """

    packing: Packing
    energy: Energy
    target: Target
    size: Tensor
    rows: Tensor

    @functools.cached_property
    def chunks(self) -> list[Chunk]:
        """The triangles in the portions that the energy kernel works on."""
        cuts = chunk_offsets(self.packing.triangle_offsets.tolist())
        return chunks_of(self.packing.rows, self.energy, self.target, cuts)

    @property
    def compiled(self) -> PackedTriangles | None:
        """The triangles as the compiled loops take them; None where torch is to do their work."""
        formula = formula_of(self.energy)
        if library_for(self.packing.rows) is None or formula is None or not self.energy.stretches:
            return None
        return PackedTriangles(formula, self.target, self.packing.rows, None, None)

    def orders(self, known: Orders | None = None) -> Orders | None:
        """In which order the meshes' vertices are eliminated; `known` ones if they are those.

        None where torch is to do the work.
        """
        if self.compiled is None:
            return None
        of = self.packing.rows, self.rows, self.packing.triangle_offsets
        return known if known is not None and known.are_of(*of) else Orders(*of)

    def factors(self, x: Tensor, which: Tensor, orders: Orders | None) -> BlockFactors | None:
        """The factors of the Hessians at x (N,) of the meshes `which` (B,) bool, by `orders`."""
        meshes = self._meshes
        return None if meshes is None or orders is None else factorised_hessians(meshes, x, which, orders)

    @property
    def _meshes(self) -> MeshProblems | None:
        packed, packing = self.compiled, self.packing
        return packed and MeshProblems(packed, packing.anchored, self.size, self.rows, packing.triangle_offsets)

    def energies(self, x: Tensor) -> Tensor:
        """(B,) the energy of each mesh; infinite if a triangle is inverted or flat."""
        phi, _, det = energy_and_forces(torch.cat([x, self.packing.anchored]), self.chunks)
        offsets = self.packing.triangle_offsets
        return torch.where(segment_any(~(det > 0), offsets), torch.inf, segment_sum(phi, offsets))

    def hessian(self, x: Tensor, factors: BlockFactors | None = None) -> Hessian:
        """The Hessian of all energies at the unknowns x (N,), to be solved with `factors` of one nearby."""
        coordinates, packing = torch.cat([x, self.packing.anchored]), self.packing
        return Hessian.at(coordinates, packing.rows, self.energy, self.target, packing.triangle_offsets, factors)

    def largest_move(self, direction: Tensor) -> Tensor:
        """(B,) how far the vertex that moves farthest goes, in local edge lengths."""
        return segment_max((direction / self.size).abs(), self.rows, 0.0)


def newton(
    problem: NewtonProblem, x: Tensor, valid: Tensor, options: NewtonOptions, factors: BlockFactors | None = None
) -> tuple[Tensor, Tensor]:
    """Go from the unknowns x (N,) to the minimum, in the meshes `valid` (B,) bool, whose triangles are upright.

    factors  of `NewtonProblem.factors` at a point nearby, for the preconditioner

    Returns the unknowns there, and (B,) what is left to move at most after the last step, in local edge lengths:
    infinite where the linear system was not solved.
    """
    meshes = problem._meshes
    if meshes is not None:
        settings = {f.name: getattr(options, f.name) for f in fields(options)}
        settings |= {"decrease": _DECREASE, "left": _LEFT, "first_chord": _FIRST_CHORD, "contraction": _CONTRACTION}
        return newton_for_meshes(meshes, x, valid, settings, factors)
    rows = problem.rows
    energy = problem.energies(x)
    running = valid.clone()
    step = torch.full_like(energy, torch.inf)
    for _ in range(options.newton_steps):
        hessian = problem.hessian(x)
        descent = torch.where(spread(running, rows), -hessian.gradient()[: len(x)], 0.0)
        # A linear system is solved no more exactly than the step is worth: convergence stays quadratic (Dembo,
        # Eisenstat & Steihaug, Inexact Newton methods, SIAM Journal on Numerical Analysis 19, 1982).
        enough = step.clamp(options.cg_tolerance, options.first_cg_tolerance)
        found = solve(hessian, descent, rows, tolerance=enough, max_iterations=options.cg_iterations)
        move = problem.largest_move(found.x)
        near = running & found.converged & (move < options.near)
        # What is left to move after a step near the minimum: the rest of the linear system, and a square.
        left = torch.where(near, move * (_LEFT * (enough + move)).clamp_max(1.0), move)
        step = torch.where(running, torch.where(found.converged, left, torch.inf), step)
        x = torch.where(spread(near, rows), x + found.x, x)
        x, energy, accepted = _line_search(x, found.x, descent, energy, running & ~near, rows, problem.energies,
                                           options.halvings)  # fmt: skip
        running = (near & (left >= options.tolerance)) | accepted
        if not bool(running.any()):
            break
    return x, step


def _line_search(
    x: Tensor,
    direction: Tensor,
    descent: Tensor,
    energy: Tensor,
    running: Tensor,
    rows: Tensor,
    energies: Callable[[Tensor], Tensor],
    halvings: int,
) -> tuple[Tensor, Tensor, Tensor]:
    """One step along `direction` for the meshes `running` (B,), halved until each lowers its energy.

    descent  minus the gradient at x

    Returns x, the energies, and (B,) bool which meshes found such a step.
    """
    slope = segment_sum(direction * descent, rows)
    scale = torch.ones_like(energy)
    waiting = running & (slope > 0)
    accepted = torch.zeros_like(running)
    for _ in range(halvings):
        if not bool(waiting.any()):
            break
        trial = torch.where(spread(waiting, rows), torch.addcmul(x, spread(scale, rows), direction), x)
        there = energies(trial)
        good = waiting & (there <= energy - _DECREASE * scale * slope)
        x = torch.where(spread(good, rows), trial, x)
        energy = torch.where(good, there, energy)
        accepted, waiting = accepted | good, waiting & ~good
        scale = torch.where(waiting, 0.5 * scale, scale)
    return x, energy, accepted
