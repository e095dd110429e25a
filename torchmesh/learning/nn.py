"""Layers for networks: points in, the points of the valid, smoothed mesh out, with a gradient.

    layer = tm.nn.Untangle()
    valid = layer(points, mesh)          # (V, 2) to (V, 2)

The interior x_I of what comes out minimises an energy E for the boundary x_B that went in, so
dE/dx_I (x_I, x_B) = 0 and, by the implicit function theorem,

    dx_I / dx_B = - (d2E/dx_I dx_I)^-1  d2E/dx_I dx_B

The backward pass solves one linear system with the Hessian for each mesh (conjugate gradients, no
matrix) and needs nothing of the iterations of the forward pass.  As the minimum does not depend on
where the interior started, the gradient with respect to interior points that go in is zero; it is
not zero for boundary and other fixed vertices.  Connectivity does not change.
"""

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..diagnosing.diagnosis import diagnose
from ..errors import ConvergenceError, InvalidMeshError
from ..mesh.batch import MeshBatch, put
from ..mesh.measure import upright
from ..mesh.neighbourhoods import vertex_size
from ..mesh.ragged import segment_any, segment_max, segment_sum, spread
from ..optimising.assembly import chunk_offsets, chunks_of, energy_and_forces
from ..optimising.conjugate_gradients import solve
from ..optimising.energies import InverseMeanRatio
from ..optimising.hessian import Hessian
from ..optimising.jacobian import equilateral
from ..optimising.lbfgs import BLOCK
from ..optimising.objective import Packing, pack
from ..smoothing.smoothing import SmoothOptions, smooth
from ..untangling.options import UntangleOptions
from ..untangling.untangling import untangle

_STEP_HALVINGS = 40


# A Newton step this small, in local edge lengths, is well inside the region of quadratic convergence.
_NEAR = 1e-4


# The relative residual of the first Newton step's linear system.
_ROUGHEST = 0.1


@dataclass(frozen=True)
class LayerOptions:
    """How `Smooth` and `Untangle` find their minimum and its derivative.

    smooth         the energy (power, ceiling) and the L-BFGS that goes ahead; the boundary stays and the
                   targets are equilateral
    untangle       how `Untangle` makes meshes valid; by default short, for what is trained on by the thousand
    newton_steps   Newton steps at most, which take the L-BFGS result to the minimum
    tolerance      a mesh is at its minimum when the largest move of a Newton step is below this, in
                   local edge lengths
    cg_tolerance   relative residual of the linear systems, forward and backward
    cg_iterations  products with the Hessian at most for one of them
    """

    smooth: SmoothOptions = field(default_factory=SmoothOptions)
    untangle: UntangleOptions = field(
        default_factory=lambda: UntangleOptions("regularised", max_iterations=50, max_continuations=15)
    )
    newton_steps: int = 20
    tolerance: float = 1e-9
    cg_tolerance: float = 1e-10
    cg_iterations: int = 5000

    def __post_init__(self) -> None:
        if self.smooth.boundary != "fixed" or self.smooth.targets is not None:
            raise ValueError(
                "LayerOptions.smooth must have boundary='fixed' and no targets: others have no derivative yet"
            )
        for name in ("newton_steps", "cg_iterations"):
            if getattr(self, name) < 1:
                raise ValueError(f"LayerOptions.{name} must be at least 1, not {getattr(self, name)}")
        for name in ("tolerance", "cg_tolerance"):
            if not getattr(self, name) > 0:
                raise ValueError(f"LayerOptions.{name} must be positive, not {getattr(self, name)}")


@dataclass(frozen=True, eq=False)
class LayerInfo:
    """What a layer's last forward pass did, per mesh (B,).

    valid      bool, every triangle is upright by exact sign
    converged  bool, valid, and the interior is at a minimum: its gradient is to be trusted.  The
               boundary of a mesh that is not converged gets its own gradient only
    step       the largest move of the last Newton step, in local edge lengths
    """

    valid: Tensor
    converged: Tensor
    step: Tensor


class _Layer(torch.nn.Module):
    """What `Smooth` and `Untangle` share."""

    def __init__(
        self,
        mesh: MeshBatch | None = None,
        options: LayerOptions | None = None,
        *,
        on_failure: Literal["raise", "keep"] = "raise",
    ) -> None:
        super().__init__()
        if on_failure not in ("raise", "keep"):
            raise ValueError(f"on_failure must be 'raise' or 'keep', not {on_failure!r}")
        self.mesh = mesh
        self.options = options or LayerOptions()
        self.on_failure = on_failure
        self.info: LayerInfo | None = None

    def forward(self, points: Tensor, mesh: MeshBatch | None = None) -> Tensor:
        """(V, 2) points, float32 or float64, to the minimum; `mesh` has their triangles, unless the layer has."""
        mesh = self.mesh if mesh is None else mesh
        if mesh is None:
            raise InvalidMeshError("the layer has no mesh: give one when it is made or called")
        if points.shape != mesh.points.shape:
            raise InvalidMeshError(
                f"points must be {tuple(mesh.points.shape)} as in the batch, not {tuple(points.shape)}"
            )
        bad = ~points.detach().isfinite().all(1)
        if bool(bad.any()):
            row = int(bad.nonzero()[0, 0])
            raise InvalidMeshError(f"points row {row} is {points[row].tolist()}: every coordinate must be finite")
        given = replace(mesh, points=points.detach())
        with torch.no_grad():
            start = self._valid(given)
        out, self.info = minimum(points, start, self.options)
        return out

    def _valid(self, given: MeshBatch) -> MeshBatch:
        raise NotImplementedError


class Smooth(_Layer):
    """The points of a valid mesh to those of the smoothest mesh with the same boundary and triangles.

    mesh        the batch whose triangles the points belong to; or give it with each call
    options     `LayerOptions`; the energy is the sum of q^p, q the inverse mean ratio (`smooth`)
    on_failure  "raise": InvalidMeshError when a mesh that goes in has inverted triangles; "keep": such
                a mesh passes as it is
    """

    def _valid(self, given: MeshBatch) -> MeshBatch:
        refused = segment_any(~upright(given), given.triangle_offsets)
        if self.on_failure == "raise" and bool(refused.any()):
            raise InvalidMeshError(
                f"meshes {refused.nonzero().squeeze(1).tolist()[:10]} have inverted triangles: "
                "Smooth needs valid meshes, Untangle takes any"
            )
        return smooth(given, self.options.smooth)[0]


class Untangle(_Layer):
    """Points of any kind to those of a valid, smooth mesh with the same boundary and triangles.

    Forward is `untangle` (by default the regularised functional), then `smooth`.  What is differentiated
    is the minimum that it ends in, that of the sum of q^p of the inverse mean ratio, the same as in
    `Smooth`; how the mesh was untangled leaves no trace in it.  `improve` with topology="keep" tries
    more on hard meshes, at a price no training step can pay.

    mesh, options  as for `Smooth`
    on_failure     "raise": ConvergenceError when a mesh does not come out valid, InvalidMeshError when its
                   boundary admits no valid mesh; "keep": such a mesh comes out as far as it got
    """

    def _valid(self, given: MeshBatch) -> MeshBatch:
        problems = diagnose(given)
        hopeless = torch.zeros(len(given), dtype=torch.bool, device=given.points.device)
        hopeless[[problem.mesh for problem in problems]] = True
        if self.on_failure == "raise" and problems:
            raise InvalidMeshError(f"mesh {problems[0].mesh} cannot be untangled: {problems[0].message}")
        better = given
        if not bool(hopeless.all()):
            better = put(given, ~hopeless, untangle(given.select(~hopeless), self.options.untangle)[0])
        failed = segment_any(~upright(better), better.triangle_offsets)
        if self.on_failure == "raise" and bool(failed.any()):
            raise ConvergenceError(
                f"meshes {failed.nonzero().squeeze(1).tolist()[:10]} were not untangled with these triangles; "
                "improve them first, or use on_failure='keep'"
            )
        return smooth(better, self.options.smooth)[0]


def minimum(points: Tensor, start: MeshBatch, options: LayerOptions | None = None) -> tuple[Tensor, LayerInfo]:
    """The minimum near the valid meshes of `start`, as a differentiable function of the fixed rows of `points`.

    points  (V, 2) float32 or float64; `start.points` must have the same values at fixed vertices
    """
    options = options or LayerOptions()
    with torch.no_grad():
        state, info = _minimised(start, options)
    out: Tensor = _Minimum.apply(points, state, options)
    return out, info


@dataclass(frozen=True, eq=False)
class _State:
    """Where the minimum is, and what its derivative needs.

    points   (V, 2) of the caller's dtype       packing  of the meshes that converged
    anchors  (A,) the vertices in packing.anchored
    hessian  at the minimum                     fixed    (V,) bool, may not move
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
        # Fixed vertices pass as they came.
        return torch.where(state.fixed[:, None], points, state.points)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        state, packing = ctx.state, ctx.state.packing
        wide = gradient.to(torch.float64)
        right = torch.zeros_like(packing.unknowns)
        right[packing.x_rows] = wide[packing.vertices, 0]
        right[packing.y_rows] = wide[packing.vertices, 1]
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


def _minimised(start: MeshBatch, options: LayerOptions) -> tuple[_State, LayerInfo]:
    """Newton's method from `start`, each mesh with its own step and stopping test."""
    offsets = start.triangle_offsets
    valid = ~segment_any(~upright(start), offsets)
    free = ~start.fixed & spread(valid, start.point_offsets)
    packing = pack(start.points, start.triangles, free, start.point_offsets, offsets)
    energy, target = InverseMeanRatio(options.smooth.power, options.smooth.ceiling), equilateral()
    size = packing.spread_vertices(vertex_size(start) / spread(packing.unit, start.point_offsets))
    size = torch.where(size > 0, size, 1.0)
    rows = packing.block_offsets * BLOCK
    chunks = chunks_of(packing.rows, energy, target, chunk_offsets(packing.triangle_offsets.tolist()))
    x, count = packing.unknowns, len(packing.unknowns)

    def energies(x: Tensor) -> Tensor:
        phi, _, det = energy_and_forces(torch.cat([x, packing.anchored]), chunks)
        total = segment_sum(phi, packing.triangle_offsets)
        return torch.where(segment_any(~(det > 0), packing.triangle_offsets), torch.inf, total)

    now = energies(x)
    running = valid.clone()
    step = torch.full_like(now, torch.inf)
    for _ in range(options.newton_steps):
        hessian = Hessian.at(torch.cat([x, packing.anchored]), packing.rows, energy, target)
        right = torch.where(spread(running, rows), -hessian.gradient()[:count], 0.0)
        # No more exact than the step is worth: convergence stays quadratic (Dembo, Eisenstat & Steihaug, Inexact
        # Newton methods, SIAM Journal on Numerical Analysis 19, 1982).
        enough = step.clamp(options.cg_tolerance, _ROUGHEST)
        newton = solve(hessian, right, rows, tolerance=enough, max_iterations=options.cg_iterations)
        move = segment_max((newton.x / size).abs(), rows, 0.0)
        step = torch.where(running, torch.where(newton.converged, move, torch.inf), step)
        # Small steps are taken unasked: what they gain is lost in the energy's rounding.
        near = running & newton.converged & (move < _NEAR)
        x = torch.where(spread(near, rows), x + newton.x, x)
        x, now, accepted = _searched(x, newton.x, right, now, running & ~near, rows, energies)
        running = (near & (move >= options.tolerance)) | accepted
        if not bool(running.any()):
            break
    converged = valid & (step < options.tolerance)
    points = packing.unpack(x, start.points)
    # Rounding to the caller's precision could flatten a sliver: such a mesh stays where it started.
    flat = segment_any(~upright(start.with_points(points)), offsets) & valid
    points = torch.where(spread(flat, start.point_offsets)[:, None], start.points, points)
    converged = converged & ~flat
    there = packing if bool(converged.all()) else pack(
        packing.unpack(x, start.points.to(torch.float64)), start.triangles,
        free & spread(converged, start.point_offsets), start.point_offsets, offsets,
    )  # fmt: skip
    x = x if there is packing else there.unknowns
    hessian = Hessian.at(torch.cat([x, there.anchored]), there.rows, energy, target)
    state = _State(points, there, _anchors(start, there), hessian, start.fixed)
    return state, LayerInfo(valid, converged, step)


def _searched(
    x: Tensor, direction: Tensor, descent: Tensor, now: Tensor, running: Tensor, rows: Tensor, energies: Any
) -> tuple[Tensor, Tensor, Tensor]:
    """One step along `direction` for the problems `running`, halved until each lowers its energy.

    Returns x, the energies, and (B,) bool which found such a step.
    """
    slope = segment_sum(direction * descent, rows)
    scale = torch.ones_like(now)
    waiting = running & (slope > 0)
    accepted = torch.zeros_like(running)
    for _ in range(_STEP_HALVINGS):
        if not bool(waiting.any()):
            break
        trial = torch.where(spread(waiting, rows), torch.addcmul(x, spread(scale, rows), direction), x)
        there = energies(trial)
        good = waiting & (there <= now - 1e-4 * scale * slope)
        x = torch.where(spread(good, rows), trial, x)
        now = torch.where(good, there, now)
        accepted, waiting = accepted | good, waiting & ~good
        scale = torch.where(waiting, 0.5 * scale, scale)
    return x, now, accepted


def _anchors(mesh: MeshBatch, packing: Packing) -> Tensor:
    """(A,) the vertices whose coordinates are packing.anchored, in its order."""
    touched = torch.zeros(len(mesh.points), dtype=torch.bool, device=mesh.points.device)
    touched[mesh.triangles[packing.triangles].reshape(-1)] = True
    touched[packing.vertices] = False
    return touched.nonzero().squeeze(1)
