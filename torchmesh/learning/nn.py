"""Layers for networks: they take points and give back the points of a valid, smooth mesh, with a gradient.

    layer = tm.nn.Untangle()
    valid = layer(points, mesh)          # (V, 2) to (V, 2)

The interior x_I of the result minimises an energy E for the boundary x_B that went in, so dE/dx_I (x_I, x_B) = 0 and,
by the implicit function theorem,

    dx_I / dx_B = - (d2E/dx_I dx_I)^-1  d2E/dx_I dx_B

The backward pass solves one linear system with the Hessian for each mesh (conjugate gradients, without a matrix) and
needs nothing from the iterations of the forward pass (see minimum.py).  The minimum does not depend on where the
interior started.  So the gradient with respect to interior points that go in is zero; it is not zero for boundary and
other fixed vertices.  Connectivity does not change, or is held for the derivative where edges may flip.
"""

from dataclasses import replace
from typing import Any, Literal

import torch
from torch import Tensor

from ..diagnosing.diagnosis import diagnose
from ..errors import ConvergenceError, InvalidMeshError
from ..improving.options import ImproveOptions
from ..improving.pipeline import improve
from ..improving.step_options import Rounds
from ..mesh.batch import MeshBatch, put
from ..mesh.detached import without_autocast
from ..mesh.measure import upright
from ..mesh.quads import refuse_quads
from ..mesh.ragged import segment_any, spread
from ..mesh.rows import check_rows
from ..mesh.unfit import unfit_meshes, what_is_unfit
from ..smoothing.smoothing import SmoothOptions, smooth
from ..status import Status
from ..untangling.untangling import untangle
from ..warping.femwarp import femwarp
from .aims import Aims
from .mesh_buffers import WithMesh
from .minimum import LayerInfo, LayerOptions, minimum
from .nearby import Nearby
from .refusals import outside_graphs, refuse_transforms

__all__ = ["LayerInfo", "LayerOptions", "Smooth", "Untangle"]


def __dir__() -> list[str]:
    return __all__


class _Layer(WithMesh):
    """The base of `Smooth` and `Untangle`, which differ in how the meshes become valid.

    mesh  its tensors are buffers: they move with `.to`, and are in the `state_dict`
    info  of the last forward pass; None before the first
    """

    def __init__(
        self,
        mesh: MeshBatch | None = None,
        options: LayerOptions | None = None,
        *,
        on_failure: Literal["raise", "keep"] = "raise",
    ) -> None:
        super().__init__(mesh)
        if on_failure not in ("raise", "keep"):
            raise ValueError(f"on_failure must be 'raise' or 'keep', not {on_failure!r}")
        self.options = options or LayerOptions()
        self.on_failure = on_failure
        self.info: LayerInfo | None = None
        self._nearby: tuple[Nearby, ...] = ()
        self._checked: MeshBatch | None = None

    def __getstate__(self) -> dict[str, Any]:
        # What is remembered of the last pass belongs to this process.
        return self.__dict__ | {"_nearby": (), "_checked": None}

    def extra_repr(self) -> str:
        return f"{self.mesh}, on_failure={self.on_failure!r}"

    @outside_graphs
    def forward(
        self,
        points: Tensor,
        mesh: MeshBatch | None = None,
        *,
        start: "Tensor | MeshBatch | None" = None,
        targets: Tensor | None = None,
        sizes: Tensor | None = None,
    ) -> Tensor:
        """The points (V, 2), float32 or float64, of the minimum.

        mesh     the batch whose triangles the points belong to; None: the layer's
        start    (V, 2) or a batch, a result for nearly the same points, as the last output: where its interior leads to
                 a valid mesh, Newton's method goes on from there, which takes a small part of the time.  Where it is
                 the last output of this layer, which was not valid, untangling goes on from it with bounded work.  A
                 batch, `info.mesh`, also brings the triangles of a layer that flips
        targets  (T, 2, 2) the target matrix of each triangle, a shape; None: equilateral (`SmoothOptions.targets`)
        sizes    (T,) or (V,) edge lengths that triangles should have; None: shapes alone count.
                 `LayerOptions.size_weight` is their weight

        A mesh with a position that is not finite, or beyond 1e150, comes out as it went in if `on_failure` is "keep";
        `info.status` says so.

        The result is differentiable in the fixed vertices of `points`, in `targets` and in `sizes`, once: backwards,
        and in points also forwards (torch.autograd.forward_ad).

        Raises InvalidMeshError for points of another shape or type, for a batch whose triangles are not of its
        vertices, for targets that are none, and, if `on_failure` is "raise", for such positions; NotImplementedError
        inside torch.vmap and torch.func.
        """
        refuse_transforms(f"nn.{type(self).__name__}")
        mesh = self.mesh if mesh is None else mesh
        if mesh is None:
            raise InvalidMeshError("the layer has no mesh: give one when it is made or called")
        if points.shape != mesh.points.shape:
            raise InvalidMeshError(
                f"points must be {tuple(mesh.points.shape)} as in the batch, not {tuple(points.shape)}"
            )
        refuse_quads(mesh, f"nn.{type(self).__name__}")
        given = replace(mesh, points=points.detach())
        if mesh is not self._checked or points.dtype != mesh.points.dtype:
            check_rows(given)
        self._checked = mesh
        unfit = unfit_meshes(given)
        if self.on_failure == "raise" and bool(unfit.any()):
            b = int(unfit.nonzero()[0, 0])
            raise InvalidMeshError(f"mesh {b}: {what_is_unfit(given, b)[0]}")
        aims = Aims.of(given, targets, sizes, self.options.size_weight)
        with without_autocast():
            with torch.no_grad():
                found, status, near = self._found(given, unfit, start, aims)
            out, info, self._nearby = minimum(points, found, self.options, aims, near, self._nearby)
        self.info = replace(info, status=torch.where(info.valid, info.status, status))
        return out

    def _found(
        self, given: MeshBatch, unfit: Tensor, start: "Tensor | MeshBatch | None", aims: Aims
    ) -> tuple[MeshBatch, Tensor, Tensor | None]:
        """Valid meshes where there are such, from `start` or from nothing, and why (B,) the others are not valid.

        Then the points (V, 2) of `start` where it served, and those of the meshes elsewhere; None without `start`.
        """
        status = torch.full((len(given),), int(Status.INVERTED), device=given.points.device)
        if start is None:
            return *self._valid(given, unfit, aims), None
        warm, tangled, before = started(given, start, unfit)
        cold = tangled | unfit
        if not bool(cold.any()):
            return warm, status, before
        again = cold & ~unfit & self._stuck(given, start)
        again &= segment_any(~upright(given), given.triangle_offsets)
        found = warm
        for at, come_from, resumed in ((cold & ~again, given, False), (again, warm, True)):
            if bool(at.any()):
                part, why = self._valid(come_from.select(at), unfit[at], aims.select(given, at), resumed=resumed)
                status[at] = why
                found = put(found, at, part)
        return found, status, torch.where(spread(cold, given.point_offsets)[:, None], found.points, before)

    def _stuck(self, given: MeshBatch, start: "Tensor | MeshBatch") -> Tensor:
        """(B,) bool: the meshes of `start` that this layer has just tried in vain to make valid, and may go on with."""
        return torch.zeros(len(given), dtype=torch.bool, device=given.points.device)

    def _valid(self, given: MeshBatch, unfit: Tensor, aims: Aims, *, resumed: bool = False) -> tuple[MeshBatch, Tensor]:
        """The given meshes made valid, with the same fixed vertices, and why (B,) they are not, where they are not.

        unfit    (B,) bool, the meshes that are to stay as they are
        resumed  whether they have been worked on before, so that little is to be hoped for
        """
        raise NotImplementedError

    def _smoothed(self, mesh: MeshBatch, aims: Aims) -> tuple[MeshBatch, Tensor]:
        """The mesh smoothed towards the targets, and the status (B,) of that."""
        options = self.options.smooth
        if aims.targets is not None:
            options = replace(options, targets=aims.targets.detach())
        better, info = smooth(mesh, options)
        return better, info.status


def started(given: MeshBatch, start: "Tensor | MeshBatch", unfit: Tensor) -> tuple[MeshBatch, Tensor, Tensor]:
    """The given meshes with the interior of `start`, carried along with the boundary where that is needed and helps.

    Returns them, (B,) bool which of them have inverted triangles, and the points (V, 2) of `start`.
    """
    points = start.points if isinstance(start, MeshBatch) else start
    triangles, twin = (start.triangles, start._twin) if isinstance(start, MeshBatch) else (given.triangles, given._twin)
    if points.shape != given.points.shape or triangles.shape != given.triangles.shape:
        raise InvalidMeshError(
            f"start must have the {len(given.points)} points and {len(given.triangles)} triangles of the batch, not "
            f"{len(points)} and {len(triangles)}"
        )
    before = replace(given, points=points.detach().to(given.points), triangles=triangles, _twin=twin)
    fixed = given.fixed[:, None]
    warm = before.with_points(torch.where(fixed, given.points, before.points))
    tangled = segment_any(~upright(warm), warm.triangle_offsets)
    bad = tangled & ~unfit
    if bool(bad.any()):
        bad &= ~segment_any(~upright(before), before.triangle_offsets)
    if bool(bad.any()):
        part = before.select(bad)
        warm = put(warm, bad, femwarp(part, given.points[spread(bad, given.point_offsets)]))
        tangled = segment_any(~upright(warm), warm.triangle_offsets)
    return warm, tangled, before.points


def _same_meshes(one: MeshBatch, other: MeshBatch) -> bool:
    """Whether the vertices of both batches are as many, mesh by mesh, on one device."""
    return one.points.device == other.points.device and torch.equal(one.point_offsets, other.point_offsets)


class Smooth(_Layer):
    """From the points of a valid mesh to those of the smoothest mesh with the same boundary and triangles.

    mesh        the batch whose triangles the points belong to; or give it with each call
    options     `LayerOptions`; the energy is the sum of q^p, q the inverse mean ratio (`smooth`)
    on_failure  "raise": InvalidMeshError if a mesh that goes in has inverted triangles; "keep": such a mesh comes out
                as it went in
    """

    def _valid(self, given: MeshBatch, unfit: Tensor, aims: Aims, *, resumed: bool = False) -> tuple[MeshBatch, Tensor]:
        refused = segment_any(~upright(given), given.triangle_offsets)
        if self.on_failure == "raise" and bool(refused.any()):
            raise InvalidMeshError(
                f"meshes {refused.nonzero().squeeze(1).tolist()[:10]} have inverted triangles: "
                "Smooth needs valid meshes, Untangle takes any"
            )
        return self._smoothed(given, aims)


class Untangle(_Layer):
    """From any points to those of a valid, smooth mesh with the same boundary and, unless they may flip, triangles.

    The forward pass makes meshes valid as `improve` does, then smooths them to the minimum.  The derivative is that of
    the minimum at the end, of the sum of q^p, q the inverse mean ratio, as for `Smooth`; it does not depend on how the
    mesh was untangled.

    mesh, options  as for `Smooth`
    on_failure     "raise": ConvergenceError if a mesh does not come out valid, InvalidMeshError if its boundary admits
                   no valid mesh; "keep": such a mesh comes out as far as it got
    topology       "keep": the triangles stay; "flip": edges may flip, as in `improve`, which untangles where no motion
                   of vertices can.  `info.mesh` then has the triangles of the result, to which its gradient belongs:
                   triangles are held for the derivative
    """

    def __init__(
        self,
        mesh: MeshBatch | None = None,
        options: LayerOptions | None = None,
        *,
        on_failure: Literal["raise", "keep"] = "raise",
        topology: Literal["keep", "flip"] = "keep",
    ) -> None:
        super().__init__(mesh, options, on_failure=on_failure)
        if topology not in ("keep", "flip"):
            raise ValueError(f"topology must be 'keep' or 'flip', not {topology!r}")
        self.topology = topology

    def extra_repr(self) -> str:
        return f"{super().extra_repr()}, topology={self.topology!r}"

    def _stuck(self, given: MeshBatch, start: "Tensor | MeshBatch") -> Tensor:
        info = self.info
        if info is None or self.topology == "flip" or not _same_meshes(info.mesh, given):
            return super()._stuck(given, start)
        points = start.points if isinstance(start, MeshBatch) else start
        other = (points.detach().to(info.mesh.points) != info.mesh.points).any(1)
        return ~info.valid & ~segment_any(other, given.point_offsets)

    def _valid(self, given: MeshBatch, unfit: Tensor, aims: Aims, *, resumed: bool = False) -> tuple[MeshBatch, Tensor]:
        if aims.targets is not None and self.topology == "flip":
            raise InvalidMeshError("targets belong to triangles, which do not last when edges flip: topology='keep'")
        if aims.of_triangles and self.topology == "flip":
            raise InvalidMeshError("sizes (T,) belong to triangles that may flip: give them at vertices, (V,)")
        better = given
        if not bool(unfit.all()):
            better = put(given, ~unfit, self._untangled(given.select(~unfit), resumed))
        failed = segment_any(~upright(better), better.triangle_offsets)
        # Why a mesh stays tangled is asked of the few that do.
        problems = diagnose(given.select(failed)) if bool(failed.any()) else []
        hopeless = unfit.clone()
        hopeless[failed.nonzero().squeeze(1)[[problem.mesh for problem in problems]]] = True
        if self.on_failure == "raise" and problems:
            b = int(failed.nonzero()[problems[0].mesh])
            raise InvalidMeshError(f"mesh {b} cannot be untangled: {problems[0].message}")
        if self.on_failure == "raise" and bool(failed.any()):
            raise ConvergenceError(
                f"meshes {failed.nonzero().squeeze(1).tolist()[:10]} were not untangled with these triangles; "
                "improve them first, or use topology='flip' or on_failure='keep'"
            )
        status = torch.where(hopeless, int(Status.INFEASIBLE), int(Status.STALLED))
        return self._smoothed(better, aims)[0], torch.where(unfit, int(Status.NOT_FINITE), status)

    def _untangled(self, given: MeshBatch, resumed: bool) -> MeshBatch:
        """The meshes made valid: as `improve` does, or by the one method that the options name."""
        if self.options.untangle is not None:
            return untangle(given, self.options.untangle)[0]
        interfaces = self.options.smooth.interfaces
        if resumed:
            return untangle(given, replace(Rounds().last_untangling, interfaces=interfaces))[0]
        smoothing = SmoothOptions(ceiling=1.5, max_iterations=20, energy_tolerance=1e-2, single=True)
        options = ImproveOptions(
            topology=self.topology, shapes="equilateral", smooth=smoothing, smooth_rounds=3, polish=None,
            relocate=False, least_gain=None, interfaces=interfaces, rounds=Rounds(tells_flips=False),
        )  # fmt: skip
        return improve(given, options)[0]
