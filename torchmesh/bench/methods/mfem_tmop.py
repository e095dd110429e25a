"""MFEM's TMOP."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from .. import boundary, exact_check
from ..stopwatch import Stopwatch
from .outcome import Outcome, need

Array = np.ndarray


def mfem(points: Array, triangles: Array, fixed: Array, size: float = 0.25, quads: Array | None = None) -> Outcome:
    """MFEM's TMOP through PyMFEM: shape metric 4 with a shifted barrier, Newton with MINRES.

    quads  (Q, 4) beside the triangles; None: there are none.  Their corners are the points of integration
    size  the length of the mean triangle in units of the target's edge.  The method has absolute constants, so the
          unit of the mesh decides how fast it is and whether it ends at all; `mfem_best` tries 1, 0.5, 0.25 and
          0.125.
    """
    need("mfem")
    import mfem.ser as fem
    from mfem._ser import cpointers, tmop, tmop_tools

    quads = np.zeros((0, 4), np.int64) if quads is None else quads
    corners = np.concatenate([np.stack([quads[:, k - 1], quads[:, k], quads[:, (k + 1) % 4]], 1) for k in range(4)])
    area = 0.5 * exact_check.double_areas(points, triangles)
    doubled = exact_check.double_areas(points, corners)
    # The mean of what the areas of elements are of those of their targets, which have edges of length 1.
    share = np.concatenate([np.abs(area) / (np.sqrt(3) / 4), np.abs(doubled)])
    scale = size * float(np.sqrt(1 / share.mean()))
    with tempfile.TemporaryDirectory() as folder, _quiet():
        path = str(Path(folder) / "tangled.mesh")
        _write_mfem(path, points * scale, triangles, quads)
        # The last argument keeps it from turning inverted triangles round.
        mesh = fem.Mesh(path, 1, 1, False)
    with Stopwatch() as watch:
        collection = fem.H1_FECollection(1, 2)
        space = fem.FiniteElementSpace(mesh, collection, 2)
        mesh.SetNodalFESpace(space)
        x = fem.GridFunction(space)
        mesh.SetNodalGridFunction(x)
        x.SetTrueVector()
        start = fem.GridFunction(space)
        start.Assign(x)
        # The barrier starts a little below the smallest determinant, counted in target triangles.
        lowest = float(np.concatenate([2 * area / (np.sqrt(3) / 2), doubled]).min() * scale**2)
        barrier = cpointers.doublep()
        barrier.assign(lowest - 0.01 * size if lowest < 0 else lowest)
        kind = tmop.TMOP_WorstCaseUntangleOptimizer_Metric
        shape = tmop.TMOP_Metric_004()
        metric = kind(shape, 2, 1.5, 0.001, 0.001, kind.BarrierType_Shifted, kind.WorstCaseType__None)
        target = tmop.TargetConstructor(tmop.TargetConstructor.IDEAL_SHAPE_UNIT_SIZE)
        target.SetNodes(start)
        integrator = tmop.TMOP_Integrator(metric, target)
        rules = fem.IntegrationRules(0, fem.Quadrature1D.GaussLobatto)
        integrator.SetIntegrationRules(rules, 1)  # one point: J is constant in a triangle
        integrator.ComputeUntangleMetricQuantiles(x, space)
        form = fem.NonlinearForm(space)
        form.AddDomainIntegrator(integrator)
        form.SetEssentialBC(fem.intArray([1] * mesh.bdr_attributes.Max()))
        linear = fem.MINRESSolver()
        linear.SetMaxIter(100)
        linear.SetRelTol(1e-12)
        linear.SetAbsTol(0.0)
        linear.SetPrintLevel(-1)
        jacobi = fem.DSmoother(0, 1.0, 1)
        jacobi.SetPositiveDiagonal(True)
        linear.SetPreconditioner(jacobi)
        newton = tmop_tools.TMOPNewtonSolver(rules.Get(space.GetFE(0).GetGeomType(), 1), 0)
        newton.SetIntegrationRules(rules, 1)
        newton.SetPreconditioner(linear)
        newton.SetOperator(form)
        newton.SetMinDetPtr(barrier.cast())
        newton.SetMaxIter(400)
        newton.SetRelTol(1e-3)
        newton.SetAbsTol(0.0)
        newton.SetPrintLevel(-1)
        with _quiet():
            newton.Mult(fem.Vector(0), x.GetTrueVector())
        x.SetFromTrueVector()
    moved = np.where(fixed[:, None], points, x.GetDataArray().reshape(2, -1).T / scale)
    return Outcome(moved, triangles, watch.seconds, f"{newton.GetNumIterations()} Newton steps, size {size}")


def mfem_best(points: Array, triangles: Array, fixed: Array) -> Outcome:
    """The fastest of `mfem` in four units of length among those that leave the fewest inverted triangles."""
    tries = [mfem(points, triangles, fixed, size) for size in (0.125, 0.25, 0.5, 1.0)]
    return min(tries, key=lambda t: (exact_check.inverted(t.points, triangles), t.seconds.cpu))


def _write_mfem(path: str, points: Array, triangles: Array, quads: Array) -> None:
    halves = np.concatenate([triangles, quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    edges = boundary.edges(torch.from_numpy(halves)).numpy()
    with open(path, "w") as out:
        out.write("MFEM mesh v1.0\n\ndimension\n2\n")
        for name, blocks in (("elements", ((triangles, 2), (quads, 3))), ("boundary", ((edges, 1),))):
            out.write(f"\n{name}\n{sum(len(corners) for corners, _ in blocks)}\n")
            for corners, shape in blocks:
                np.savetxt(out, np.insert(corners, 0, [[1], [shape]], 1), fmt="%d")
        out.write(f"\nvertices\n{len(points)}\n2\n")
        np.savetxt(out, points, fmt="%.17g")


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Send what C++ prints to nowhere."""
    saved = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)
        os.close(nowhere)
