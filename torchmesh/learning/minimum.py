"""The minimum of the smoothing energy as a differentiable function of the fixed vertices.

Newton's method takes each mesh to its minimum: near it with full steps, farther away with steps that are halved until
the energy falls.  The derivative follows from the implicit function theorem, as nn.py explains.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..mesh.batch import MeshBatch
from ..mesh.interfaces import holding
from ..mesh.means import vertex_size
from ..mesh.measure import upright
from ..mesh.ragged import segment_any, segment_max, segment_sum, spread
from ..optimising.assembly import chunk_offsets, chunks_of, energy_and_forces
from ..optimising.blocks import BLOCK
from ..optimising.conjugate_gradients import solve
from ..optimising.hessian import Hessian
from ..optimising.jacobian import equilateral
from ..optimising.objective import Packing, pack
from ..smoothing.smoothing import SmoothOptions
from ..status import Status
from ..untangling.options import UntangleOptions

# The part of the decrease that the slope promises which a step must reach (Armijo's condition).
_DECREASE = 1e-4


@dataclass(frozen=True)
class LayerOptions:
    """How `Smooth` and `Untangle` find their minimum and its derivative.

    smooth              the energy (power, ceiling) and the L-BFGS that goes ahead; the boundary stays and the targets
                        are equilateral
    untangle            how `Untangle` makes meshes valid; short by default, because networks train on thousands
    newton_steps        Newton steps at most, which take the L-BFGS result to the minimum
    tolerance           a mesh is at its minimum if the largest move of a Newton step, in local edge lengths, is below
                        this
    cg_tolerance        relative residual of the linear systems, forward and backward
    cg_iterations       products with the Hessian at most for one linear system
    first_cg_tolerance  relative residual of the first Newton step's linear system
    near                a Newton step below this, in local edge lengths, is well inside the region of quadratic
                        convergence, and is taken even if rounding hides that the energy falls
    halvings            of a longer step at most, until the energy falls
    """

    smooth: SmoothOptions = field(default_factory=SmoothOptions)
    untangle: UntangleOptions = field(
        default_factory=lambda: UntangleOptions("regularised", max_iterations=50, max_continuations=15)
    )
    newton_steps: int = 20
    tolerance: float = 1e-9
    cg_tolerance: float = 1e-10
    cg_iterations: int = 5000
    first_cg_tolerance: float = 0.1
    near: float = 1e-4
    halvings: int = 40

    def __post_init__(self) -> None:
        if self.smooth.slides or self.smooth.targets is not None:
            raise ValueError(
                "LayerOptions.smooth must have boundary='fixed' and no targets, and no interfaces that slide: others "
                "have no derivative yet"
            )
        for name in ("newton_steps", "cg_iterations", "halvings"):
            if getattr(self, name) < 1:
                raise ValueError(f"LayerOptions.{name} must be at least 1, not {getattr(self, name)}")
        for name in ("tolerance", "cg_tolerance", "first_cg_tolerance", "near"):
            if not getattr(self, name) > 0:
                raise ValueError(f"LayerOptions.{name} must be positive, not {getattr(self, name)}")


@dataclass(frozen=True, eq=False)
class LayerInfo:
    """How a layer's last forward pass ended, per mesh (B,).

    status     int64 `Status`: CONVERGED; VALID, but not converged; or why the mesh is not valid: INVERTED (`Smooth` was
               given it so), STALLED (`Untangle` did not solve it), INFEASIBLE, NOT_FINITE
    valid      bool, every triangle is upright by exact sign
    converged  bool, valid, and the interior is at a minimum, so that the gradient is right.  In a mesh that is not
               converged, fixed vertices get their own gradient only
    step       the largest move of the last Newton step, in local edge lengths
    """

    valid: Tensor
    converged: Tensor
    step: Tensor
    status: Tensor


def minimum(points: Tensor, start: MeshBatch, options: LayerOptions | None = None) -> tuple[Tensor, LayerInfo]:
    """The minimum of the energy near the valid meshes of `start`, differentiable in the fixed rows of `points`.

    points  (V, 2) float32 or float64; `start.points` must have the same values at fixed vertices

    Returns the points (V, 2) of the minimum and how it was reached.
    """
    options = options or LayerOptions()
    with torch.no_grad():
        state, info = _minimise(holding(start, options.smooth.interfaces), options)
    out: Tensor = _Minimum.apply(points, state, options)
    return out, info


@dataclass(frozen=True, eq=False)
class _State:
    """The minimum, and what its derivative needs.

    points   (V, 2) of the minimum, in the caller's dtype
    packing  of the meshes that converged
    anchors  (A,) the vertices whose coordinates are packing.anchored, in its order
    hessian  of the energy at the minimum
    fixed    (V,) bool, vertices that may not move
    """

    points: Tensor
    packing: Packing
    anchors: Tensor
    hessian: Hessian
    fixed: Tensor


class _Minimum(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, points: Tensor, state: _State, options: LayerOptions) -> Tensor:
        ctx.state, ctx.options = state, options
        # Fixed vertices keep the points that the caller gave, so that their gradient passes.
        return torch.where(state.fixed[:, None], points, state.points)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        state, packing = ctx.state, ctx.state.packing
        wide = gradient.to(torch.float64)
        right = torch.zeros_like(packing.unknowns)
        right[packing.x_rows] = wide[packing.vertices, 0]
        right[packing.y_rows] = wide[packing.vertices, 1]
        # The transpose of the formula above, applied to the gradient; the Hessian is symmetric.
        solution = solve(
            state.hessian,
            right,
            packing.block_offsets * BLOCK,
            tolerance=ctx.options.cg_tolerance,
            max_iterations=ctx.options.cg_iterations,
        )
        beyond = state.hessian.size - len(right)
        through = (state.hessian @ torch.cat([solution.x, right.new_zeros(beyond)]))[len(right) :]
        out = torch.where(state.fixed[:, None], wide, 0.0)
        out[state.anchors] -= through.reshape(2, -1).T
        return out.to(gradient), None, None


def _minimise(start: MeshBatch, options: LayerOptions) -> tuple[_State, LayerInfo]:
    """Newton's method from `start`, each valid mesh with its own step and stopping test."""
    valid = ~segment_any(~upright(start), start.triangle_offsets)
    packing = _packed(start, valid)
    x, step = _newton(_Problem(start, packing, options), packing.unknowns, valid)
    points = packing.unpack(x, start.points)
    # Rounding to the caller's precision could flatten a sliver: such a mesh stays where it started.
    flat = segment_any(~upright(start.with_points(points)), start.triangle_offsets) & valid
    points = torch.where(spread(flat, start.point_offsets)[:, None], start.points, points)
    converged = valid & (step < options.tolerance) & ~flat
    at = packing
    if not bool(converged.all()):
        # Only meshes at a minimum have a derivative.
        at = _packed(start, converged, packing.unpack(x, start.points.to(torch.float64)))
        x = at.unknowns
    state = _State(points, at, _anchors(start, at), _Problem(start, at, options).hessian(x), start.fixed)
    status = torch.where(converged, int(Status.CONVERGED), torch.where(valid, int(Status.VALID), int(Status.INVERTED)))
    return state, LayerInfo(valid, converged, step, status)


def _packed(start: MeshBatch, which: Tensor, points: Tensor | None = None) -> Packing:
    """The free vertices of the meshes `which` (B,) as unknowns, at `points` (V, 2) or where they start."""
    free = ~start.fixed & spread(which, start.point_offsets)
    points = start.points if points is None else points
    return pack(points, start.triangles, free, start.point_offsets, start.triangle_offsets)


class _Problem:
    """The energies of the meshes as functions of their unknowns.

    rows  (B+1,) the unknowns of each mesh
    """

    def __init__(self, start: MeshBatch, packing: Packing, options: LayerOptions) -> None:
        self.packing, self.options = packing, options
        self.energy, self.target = options.smooth.energy, equilateral()
        self.rows = packing.block_offsets * BLOCK
        size = packing.spread_vertices(vertex_size(start) / spread(packing.unit, start.point_offsets))
        self.size = torch.where(size > 0, size, 1.0)
        cuts = chunk_offsets(packing.triangle_offsets.tolist())
        self.chunks = chunks_of(packing.rows, self.energy, self.target, cuts)

    def energies(self, x: Tensor) -> Tensor:
        """(B,) the energy of each mesh; infinite if a triangle is inverted or flat."""
        phi, _, det = energy_and_forces(torch.cat([x, self.packing.anchored]), self.chunks)
        offsets = self.packing.triangle_offsets
        return torch.where(segment_any(~(det > 0), offsets), torch.inf, segment_sum(phi, offsets))

    def hessian(self, x: Tensor) -> Hessian:
        coordinates, packing = torch.cat([x, self.packing.anchored]), self.packing
        return Hessian.at(coordinates, packing.rows, self.energy, self.target, packing.triangle_offsets)

    def largest_move(self, direction: Tensor) -> Tensor:
        """(B,) how far the vertex that moves farthest goes, in local edge lengths."""
        return segment_max((direction / self.size).abs(), self.rows, 0.0)


def _newton(problem: _Problem, x: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """The unknowns at the minimum, and (B,) the largest move of each mesh's last step; infinite where CG failed."""
    options, rows = problem.options, problem.rows
    energy = problem.energies(x)
    running = valid.clone()
    step = torch.full_like(energy, torch.inf)
    for _ in range(options.newton_steps):
        hessian = problem.hessian(x)
        descent = torch.where(spread(running, rows), -hessian.gradient()[: len(x)], 0.0)
        # A linear system is solved no more exactly than the step is worth: convergence stays quadratic (Dembo,
        # Eisenstat & Steihaug, Inexact Newton methods, SIAM Journal on Numerical Analysis 19, 1982).
        enough = step.clamp(options.cg_tolerance, options.first_cg_tolerance)
        newton = solve(hessian, descent, rows, tolerance=enough, max_iterations=options.cg_iterations)
        move = problem.largest_move(newton.x)
        step = torch.where(running, torch.where(newton.converged, move, torch.inf), step)
        near = running & newton.converged & (move < options.near)
        x = torch.where(spread(near, rows), x + newton.x, x)
        x, energy, accepted = _line_search(x, newton.x, descent, energy, running & ~near, rows, problem.energies,
                                           options.halvings)  # fmt: skip
        running = (near & (move >= options.tolerance)) | accepted
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


def _anchors(mesh: MeshBatch, packing: Packing) -> Tensor:
    """(A,) the vertices whose coordinates are packing.anchored, in its order."""
    touched = torch.zeros(len(mesh.points), dtype=torch.bool, device=mesh.points.device)
    touched[mesh.triangles[packing.triangles].reshape(-1)] = True
    touched[packing.vertices] = False
    return touched.nonzero().squeeze(1)
