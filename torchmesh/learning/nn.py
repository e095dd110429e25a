"""Layers for networks: they take points and give back the points of a valid, smooth mesh, with a gradient.

    layer = tm.nn.Untangle()
    valid = layer(points, mesh)          # (V, 2) to (V, 2)

The interior x_I of the result minimises an energy E for the boundary x_B that went in, so dE/dx_I (x_I, x_B) = 0 and,
by the implicit function theorem,

    dx_I / dx_B = - (d2E/dx_I dx_I)^-1  d2E/dx_I dx_B

The backward pass solves one linear system with the Hessian for each mesh (conjugate gradients, without a matrix) and
needs nothing from the iterations of the forward pass (see minimum.py).  The minimum does not depend on where the
interior started.  So the gradient with respect to interior points that go in is zero; it is not zero for boundary and
other fixed vertices.  Connectivity does not change.
"""

from dataclasses import replace
from typing import Literal

import torch
from torch import Tensor

from ..diagnosing.diagnosis import diagnose
from ..errors import ConvergenceError, InvalidMeshError
from ..mesh.batch import MeshBatch, check_rows, put
from ..mesh.detached import without_autocast
from ..mesh.measure import upright
from ..mesh.ragged import segment_any
from ..mesh.unfit import unfit_meshes, what_is_unfit
from ..smoothing.smoothing import smooth
from ..status import Status
from ..untangling.untangling import untangle
from .minimum import LayerInfo, LayerOptions, minimum

__all__ = ["LayerInfo", "LayerOptions", "Smooth", "Untangle"]


def __dir__() -> list[str]:
    return __all__


class _Layer(torch.nn.Module):
    """The base of `Smooth` and `Untangle`, which differ in how the meshes become valid.

    info  of the last forward pass; None before the first
    """

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
        """The points (V, 2), float32 or float64, of the minimum.

        mesh  the batch whose triangles the points belong to; None: the layer's

        A mesh with a position that is not finite, or beyond 1e150, comes out as it went in if `on_failure` is "keep";
        `info.status` says so.

        Raises InvalidMeshError for points of another shape or type, for a batch whose triangles are not of its
        vertices, and, if `on_failure` is "raise", for such positions.
        """
        mesh = self.mesh if mesh is None else mesh
        if mesh is None:
            raise InvalidMeshError("the layer has no mesh: give one when it is made or called")
        if points.shape != mesh.points.shape:
            raise InvalidMeshError(
                f"points must be {tuple(mesh.points.shape)} as in the batch, not {tuple(points.shape)}"
            )
        given = replace(mesh, points=points.detach())
        check_rows(given)
        unfit = unfit_meshes(given)
        if self.on_failure == "raise" and bool(unfit.any()):
            b = int(unfit.nonzero()[0, 0])
            raise InvalidMeshError(f"mesh {b}: {what_is_unfit(given, b)[0]}")
        with without_autocast():
            with torch.no_grad():
                start, status = self._valid(given, unfit)
            out, info = minimum(points, start, self.options)
        self.info = replace(info, status=torch.where(info.valid, info.status, status))
        return out

    def _valid(self, given: MeshBatch, unfit: Tensor) -> tuple[MeshBatch, Tensor]:
        """The given meshes made valid, with the same fixed vertices, and why (B,) they are not, where they are not.

        unfit  (B,) bool, the meshes that are to stay as they are
        """
        raise NotImplementedError


class Smooth(_Layer):
    """From the points of a valid mesh to those of the smoothest mesh with the same boundary and triangles.

    mesh        the batch whose triangles the points belong to; or give it with each call
    options     `LayerOptions`; the energy is the sum of q^p, q the inverse mean ratio (`smooth`)
    on_failure  "raise": InvalidMeshError if a mesh that goes in has inverted triangles; "keep": such a mesh comes out
                as it went in
    """

    def _valid(self, given: MeshBatch, unfit: Tensor) -> tuple[MeshBatch, Tensor]:
        refused = segment_any(~upright(given), given.triangle_offsets)
        if self.on_failure == "raise" and bool(refused.any()):
            raise InvalidMeshError(
                f"meshes {refused.nonzero().squeeze(1).tolist()[:10]} have inverted triangles: "
                "Smooth needs valid meshes, Untangle takes any"
            )
        mesh, info = smooth(given, self.options.smooth)
        return mesh, info.status


class Untangle(_Layer):
    """From any points to those of a valid, smooth mesh with the same boundary and triangles.

    The forward pass is `untangle` (by default with the regularised functional), then `smooth`.  The derivative is that
    of the minimum at the end, of the sum of q^p, q the inverse mean ratio, as for `Smooth`; it does not depend on how
    the mesh was untangled.  `improve` with topology="keep" tries more on hard meshes, but takes too long for a step of
    training.

    mesh, options  as for `Smooth`
    on_failure     "raise": ConvergenceError if a mesh does not come out valid, InvalidMeshError if its boundary admits
                   no valid mesh; "keep": such a mesh comes out as far as it got
    """

    def _valid(self, given: MeshBatch, unfit: Tensor) -> tuple[MeshBatch, Tensor]:
        better = given
        if not bool(unfit.all()):
            better = put(given, ~unfit, untangle(given.select(~unfit), self.options.untangle)[0])
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
                "improve them first, or use on_failure='keep'"
            )
        status = torch.where(hopeless, int(Status.INFEASIBLE), int(Status.STALLED))
        return smooth(better, self.options.smooth)[0], torch.where(unfit, int(Status.NOT_FINITE), status)
