"""The minimum of the smoothing energy as a differentiable function of the fixed vertices.

Newton's method takes each mesh to its minimum (optimising/newton.py).  The derivative follows from the implicit
function theorem, as nn.py explains.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.interfaces import holding
from ..mesh.measure import upright
from ..mesh.ragged import segment_any, spread
from ..mesh.triangle import Corners
from ..optimising.conjugate_gradients import solve
from ..optimising.hessian import Hessian
from ..optimising.jacobian import Target, invariants
from ..optimising.newton import NewtonOptions, NewtonProblem, newton
from ..smoothing.smoothing import SmoothOptions
from ..status import Status
from ..untangling.options import UntangleOptions
from .aims import Aims
from .nearby import Nearby, Posed, packed
from .refusals import FirstOnly


@dataclass(frozen=True)
class LayerOptions(NewtonOptions):
    """How `Smooth` and `Untangle` find their minimum and its derivative.

    smooth              the energy (power, ceiling) and the L-BFGS that goes ahead; the boundary stays, and targets
                        are given with each call
    untangle            how `Untangle` makes meshes valid; None: as `improve` does
    size_weight         weight of area against shape where sizes are given, between 0 and 1: the energy of a triangle is
                        (1 - w) |J|^2 / det J + w (1 / det J + det J)
    newton_steps        Newton steps at most, which take the L-BFGS result to the minimum
    tolerance           a mesh is at its minimum if what is left to move, in local edge lengths, is below this
    cg_tolerance        relative residual of the linear systems, forward and backward
    cg_iterations, first_cg_tolerance, near, halvings
                        of Newton's method, see `optimising.newton.NewtonOptions`
    """

    smooth: SmoothOptions = field(default_factory=SmoothOptions)
    untangle: UntangleOptions | None = None
    size_weight: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.smooth.slides or self.smooth.targets is not None:
            raise ValueError(
                "LayerOptions.smooth must have boundary='fixed' and no interfaces that slide, which have no derivative "
                "yet, and no targets: give these with each call, layer(points, targets=...)"
            )
        if not 0 < self.size_weight < 1:
            raise ValueError(f"LayerOptions.size_weight must be between 0 and 1, not {self.size_weight}")


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
    points: Tensor,
    start: MeshBatch,
    options: LayerOptions | None = None,
    aims: Aims | None = None,
    near: Tensor | None = None,
    known: Sequence[Nearby] = (),
) -> tuple[Tensor, LayerInfo, tuple[Nearby, ...]]:
    """The minimum of the energy near the valid meshes of `start`, differentiable in the fixed rows of `points`.

    points  (V, 2) float32 or float64; `start.points` must have the same values at fixed vertices
    aims    what triangles should look like, which may require gradients; None: equilateral
    near    (V, 2) points at whose Hessians the linear systems of Newton's method are preconditioned; None: the start
    known   what another call has returned, so that it need not be computed again

    Returns the points (V, 2) of the minimum, how it was reached, and the Hessians there and at `near`.
    """
    options, aims = options or LayerOptions(), aims or Aims()
    coefficients = aims.coefficients(start)
    posed = Posed(aims.energy(options.smooth), None if coefficients is None else coefficients.detach())
    held = holding(start, options.smooth.interfaces)
    with torch.no_grad():
        at = held if near is None else held.with_points(near)
        state, info, begun = _minimise(held, options, posed, at, known)
        if near is None:
            # A call from nothing, which takes long, prepares for the backward pass and for a call that starts from it.
            state.nearby.factors  # noqa: B018
    out: Tensor = _Minimum.apply(points, coefficients, state, options)
    return out, info, (state.nearby,) if near is None else (state.nearby, begun)


@dataclass(frozen=True, eq=False)
class _State:
    """The minimum, and what its derivative needs.

    points   (V, 2) of the minimum, in the caller's dtype
    problem  the energy of the meshes that converged
    x        their unknowns at the minimum
    start    the batch from which Newton's method went
    nearby   the Hessians at `points`
    """

    points: Tensor
    problem: NewtonProblem
    x: Tensor
    start: MeshBatch
    nearby: Nearby

    @property
    def fixed(self) -> Tensor:
        """(V,) bool, vertices that may not move."""
        return self.start.fixed

    @functools.cached_property
    def anchors(self) -> Tensor:
        """(A,) the vertices whose coordinates are packing.anchored, in its order."""
        packing, triangles = self.problem.packing, self.start.triangles
        touched = torch.zeros_like(self.fixed)
        touched[triangles[packing.triangles].reshape(-1)] = True
        touched[packing.vertices] = False
        return touched.nonzero().squeeze(1)

    @functools.cached_property
    def hessian(self) -> Hessian:
        """Of the energy at the minimum."""
        return self.problem.hessian(self.x, self.nearby.factors)

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
    start: MeshBatch, options: LayerOptions, posed: Posed, near: MeshBatch, known: Sequence[Nearby]
) -> tuple[_State, LayerInfo, Nearby]:
    """Newton's method from `start`, each valid mesh with its own step and stopping test; the Hessians at `near`."""
    valid = ~segment_any(~upright(start), start.triangle_offsets)
    packing = packed(start, valid)
    problem = posed.over(start, packing)
    orders = problem.orders(known[0].orders if known else None)
    begun = Nearby(near, valid, posed, orders)
    begun = next((one for one in known if one.is_at(near, valid, posed)), begun)
    x, step = newton(problem, packing.unknowns, valid, options, begun.factors)
    points = packing.unpack(x, start.points)
    # Rounding to the caller's precision could flatten a sliver: such a mesh stays where it started.
    flat = segment_any(~upright(start.with_points(points)), start.triangle_offsets) & valid
    points = torch.where(spread(flat, start.point_offsets)[:, None], start.points, points)
    converged = valid & (step < options.tolerance) & ~flat
    if not bool(converged.all()):
        # Only meshes at a minimum have a derivative.
        at = packed(start, converged, packing.unpack(x, start.points.to(torch.float64)))
        x = at.unknowns
        problem = posed.over(start, at)
    there = start.with_points(points)
    state = _State(points, problem, x, start, Nearby(there, converged, posed, orders))
    status = torch.where(converged, int(Status.CONVERGED), torch.where(valid, int(Status.VALID), int(Status.INVERTED)))
    return state, LayerInfo(valid, converged, step, status, there), begun
