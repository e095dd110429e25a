"""The minimum of the smoothing energy as a differentiable function of the fixed vertices.

Newton's method takes each mesh to its minimum: near it with full steps, farther away with steps that are halved until
the energy falls.  The derivative follows from the implicit function theorem, as nn.py explains.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.interfaces import holding
from ..mesh.means import vertex_size
from ..mesh.measure import upright
from ..mesh.ragged import segment_any, segment_max, segment_sum, spread
from ..mesh.triangle import Corners
from ..optimising.assembly import chunk_offsets, chunks_of, energy_and_forces
from ..optimising.blocks import BLOCK
from ..optimising.conjugate_gradients import solve
from ..optimising.hessian import Hessian
from ..optimising.jacobian import Target, equilateral, invariants
from ..optimising.objective import Packing, pack
from ..smoothing.smoothing import SmoothOptions
from ..status import Status
from ..untangling.options import UntangleOptions
from .aims import Aims
from .refusals import FirstOnly

# The part of the decrease that the slope promises which a step must reach (Armijo's condition).
_DECREASE = 1e-4

# After a full Newton step of m near the minimum (in local edge lengths) less than this times m squared, and m times
# the tolerance of the linear system, is left to move.  A tenth of it was measured on jittered squares.
_LEFT = 10.0


@dataclass(frozen=True)
class LayerOptions:
    """How `Smooth` and `Untangle` find their minimum and its derivative.

    smooth              the energy (power, ceiling) and the L-BFGS that goes ahead; the boundary stays, and targets
                        are given with each call
    untangle            how `Untangle` makes meshes valid; None: as `improve` does
    size_weight         weight of area against shape where sizes are given, between 0 and 1: the energy of a triangle is
                        (1 - w) |J|^2 / det J + w (1 / det J + det J)
    newton_steps        Newton steps at most, which take the L-BFGS result to the minimum
    tolerance           a mesh is at its minimum if what is left to move, in local edge lengths, is below this
    cg_tolerance        relative residual of the linear systems, forward and backward
    cg_iterations       products with the Hessian at most for one linear system
    first_cg_tolerance  relative residual of the first Newton step's linear system
    near                a Newton step below this, in local edge lengths, is well inside the region of quadratic
                        convergence, and is taken even if rounding hides that the energy falls
    halvings            of a longer step at most, until the energy falls
    """

    smooth: SmoothOptions = field(default_factory=SmoothOptions)
    untangle: UntangleOptions | None = None
    size_weight: float = 0.5
    newton_steps: int = 20
    tolerance: float = 1e-9
    cg_tolerance: float = 1e-10
    cg_iterations: int = 5000
    first_cg_tolerance: float = 0.01
    near: float = 1e-4
    halvings: int = 40

    def __post_init__(self) -> None:
        if self.smooth.slides or self.smooth.targets is not None:
            raise ValueError(
                "LayerOptions.smooth must have boundary='fixed' and no interfaces that slide, which have no derivative "
                "yet, and no targets: give these with each call, layer(points, targets=...)"
            )
        if not 0 < self.size_weight < 1:
            raise ValueError(f"LayerOptions.size_weight must be between 0 and 1, not {self.size_weight}")
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
    step       how far a vertex is from the minimum at most, in local edge lengths, by the last Newton step
    mesh       the batch that came out, whose triangles are others than those given where edges flipped
    """

    valid: Tensor
    converged: Tensor
    step: Tensor
    status: Tensor
    mesh: MeshBatch


def minimum(
    points: Tensor, start: MeshBatch, options: LayerOptions | None = None, aims: Aims | None = None
) -> tuple[Tensor, LayerInfo]:
    """The minimum of the energy near the valid meshes of `start`, differentiable in the fixed rows of `points`.

    points  (V, 2) float32 or float64; `start.points` must have the same values at fixed vertices
    aims    what triangles should look like, which may require gradients; None: equilateral

    Returns the points (V, 2) of the minimum and how it was reached.
    """
    options, aims = options or LayerOptions(), aims or Aims()
    coefficients = aims.coefficients(start)
    with torch.no_grad():
        state, info = _minimise(holding(start, options.smooth.interfaces), options, aims, coefficients)
    out: Tensor = _Minimum.apply(points, coefficients, state, options)
    return out, info


@dataclass(frozen=True, eq=False)
class _State:
    """The minimum, and what its derivative needs.

    points   (V, 2) of the minimum, in the caller's dtype
    problem  the energy of the meshes that converged
    x        their unknowns at the minimum
    anchors  (A,) the vertices whose coordinates are packing.anchored, in its order
    fixed    (V,) bool, vertices that may not move
    """

    points: Tensor
    problem: "_Problem"
    x: Tensor
    anchors: Tensor
    fixed: Tensor

    @functools.cached_property
    def hessian(self) -> Hessian:
        """Of the energy at the minimum."""
        return self.problem.hessian(self.x)

    def solved(self, right: Tensor, options: LayerOptions) -> Tensor:
        """The unknowns u with H u = right, both of the length of x."""
        rows = self.problem.rows
        found = solve(self.hessian, right, rows, tolerance=options.cg_tolerance, max_iterations=options.cg_iterations)
        return found.x

    def packed(self, values: Tensor) -> Tensor:
        """Rows (V, 2) of free vertices as a vector of the length of x."""
        packing, right = self.problem.packing, torch.zeros_like(self.x)
        right[packing.x_rows] = values[packing.vertices, 0]
        right[packing.y_rows] = values[packing.vertices, 1]
        return right

    def by_coefficients(self, along: Tensor) -> Tensor:
        """(4, T) the derivative by the targets' coefficients of the product of `along` and the energy's gradient."""
        problem, packing = self.problem, self.problem.packing
        with torch.enable_grad():
            known = torch.stack(list(problem.target)).detach().requires_grad_()  # type: ignore[arg-type]
            at = torch.cat([self.x, packing.anchored]).detach().requires_grad_()
            t = Corners(*at[packing.rows.long()])
            phi = problem.energy.value(*invariants(t, Target(*known)))
            (gradient,) = torch.autograd.grad(phi.sum(), at, create_graph=True)
            (out,) = torch.autograd.grad((gradient[: len(along)] * along).sum(), known)
        # In the packing's unit of length, coefficients are larger by its square.
        unit = spread(packing.unit, packing.triangle_offsets)
        return out * unit * unit


class _Minimum(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, points: Tensor, coefficients: Tensor | None, state: _State, options: LayerOptions) -> Tensor:
        ctx.state, ctx.options = state, options
        ctx.count = None if coefficients is None else coefficients.shape[1]
        ctx.save_for_backward(points, coefficients)
        # Fixed vertices keep the points that the caller gave, so that their gradient passes.
        return torch.where(state.fixed[:, None], points, state.points)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, Tensor | None, None, None]:
        given = ctx.saved_tensors
        with torch.no_grad():
            out, of_targets = _gradients(ctx, gradient)
        if torch.is_grad_enabled():  # somebody may want to derive the gradient
            depends = [tensor for tensor in (gradient, *given) if tensor is not None]
            name = "a layer of torchmesh.nn"
            first = [None if g is None else FirstOnly.apply(name, g, *depends) for g in (out, of_targets)]
            return first[0], first[1], None, None
        return out, of_targets, None, None

    @staticmethod
    def jvp(ctx: Any, motion: Tensor | None, of_targets: Tensor | None, *_: None) -> Tensor:
        """dx_I = - H_II^-1 H_IB dx_B."""
        state = ctx.state
        if of_targets is not None:
            raise NotImplementedError("layers have no forward derivative by targets and sizes; use backward()")
        assert motion is not None
        wide = torch.where(state.fixed[:, None], motion.to(torch.float64), 0.0)
        of_anchors = torch.cat([torch.zeros_like(state.x), wide[state.anchors].T.reshape(-1)])
        right = (state.hessian @ of_anchors)[: len(state.x)]
        inside = state.solved(-right, ctx.options)
        packing = state.problem.packing
        wide[packing.vertices, 0], wide[packing.vertices, 1] = inside[packing.x_rows], inside[packing.y_rows]
        return wide.to(motion)


def _gradients(ctx: Any, gradient: Tensor) -> tuple[Tensor, Tensor | None]:
    """The gradients by points (V, 2) and by the coefficients (4, T) of targets, if there are any."""
    state: _State = ctx.state
    packing = state.problem.packing
    wide = gradient.to(torch.float64)
    # The transpose of the formula above, applied to the gradient; the Hessian is symmetric.
    along = state.solved(state.packed(wide), ctx.options)
    through = (state.hessian @ torch.cat([along, along.new_zeros(state.hessian.size - len(along))]))[len(along) :]
    out = torch.where(state.fixed[:, None], wide, 0.0)
    out[state.anchors] -= through.reshape(2, -1).T
    if ctx.count is None or not ctx.needs_input_grad[1]:
        return out.to(gradient), None
    of_targets = wide.new_zeros((4, ctx.count))
    # Positions are larger than unknowns by the packing's unit of length.
    unit = spread(packing.unit, state.problem.rows)
    of_targets[:, packing.triangles] = -state.by_coefficients(along * unit)
    return out.to(gradient), of_targets


def _minimise(
    start: MeshBatch, options: LayerOptions, aims: Aims, coefficients: Tensor | None
) -> tuple[_State, LayerInfo]:
    """Newton's method from `start`, each valid mesh with its own step and stopping test."""
    valid = ~segment_any(~upright(start), start.triangle_offsets)
    packing = _packed(start, valid)
    x, step = _newton(_Problem(start, packing, options, aims, coefficients), packing.unknowns, valid)
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
    problem = _Problem(start, at, options, aims, coefficients)
    state = _State(points, problem, x, _anchors(start, at), start.fixed)
    status = torch.where(converged, int(Status.CONVERGED), torch.where(valid, int(Status.VALID), int(Status.INVERTED)))
    return state, LayerInfo(valid, converged, step, status, start.with_points(points))


def _packed(start: MeshBatch, which: Tensor, points: Tensor | None = None) -> Packing:
    """The free vertices of the meshes `which` (B,) as unknowns, at `points` (V, 2) or where they start."""
    free = ~start.fixed & spread(which, start.point_offsets)
    points = start.points if points is None else points
    return pack(points, start.triangles, free, start.point_offsets, start.triangle_offsets)


class _Problem:
    """The energies of the meshes as functions of their unknowns.

    rows  (B+1,) the unknowns of each mesh
    """

    def __init__(
        self, start: MeshBatch, packing: Packing, options: LayerOptions, aims: Aims, coefficients: Tensor | None
    ) -> None:
        self.packing, self.options = packing, options
        self.energy, self.target = aims.energy(options.smooth), equilateral()
        if coefficients is not None:
            unit = spread(packing.unit, packing.triangle_offsets)
            self.target = Target(*(coefficients.detach()[:, packing.triangles] * unit * unit))
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
        near = running & newton.converged & (move < options.near)
        # What is left to move after a step near the minimum: the rest of the linear system, and a square.
        left = torch.where(near, move * (_LEFT * (enough + move)).clamp_max(1.0), move)
        step = torch.where(running, torch.where(newton.converged, left, torch.inf), step)
        x = torch.where(spread(near, rows), x + newton.x, x)
        x, energy, accepted = _line_search(x, newton.x, descent, energy, running & ~near, rows, problem.energies,
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


def _anchors(mesh: MeshBatch, packing: Packing) -> Tensor:
    """(A,) the vertices whose coordinates are packing.anchored, in its order."""
    touched = torch.zeros(len(mesh.points), dtype=torch.bool, device=mesh.points.device)
    touched[mesh.triangles[packing.triangles].reshape(-1)] = True
    touched[packing.vertices] = False
    return touched.nonzero().squeeze(1)
