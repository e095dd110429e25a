"""Other tools on the same mesh, each as it is called from Python: (points, triangles, fixed) to an `Outcome`.

Only the optimiser's own call is timed, not the mesh's way into the tool's data structures: that
favours the peers.  Names of extras are in `Missing`, which a table row can show.
"""

from __future__ import annotations

import contextlib
import importlib.util
import itertools
import os
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from domains import double_areas
from measuring import Seconds, Stopwatch

from torchmesh.mesh import connectivity

Array = np.ndarray


@dataclass(frozen=True)
class Outcome:
    """The mesh after a peer has been at it: points (V, 2), triangles (T, 3), the time, what to know of it."""

    points: Array
    triangles: Array
    seconds: Seconds
    note: str = ""


class Missing(Exception):
    """The peer is not installed."""


class Refused(Exception):
    """The peer says that it cannot take this mesh."""


def gmsh(points: Array, triangles: Array, fixed: Array) -> Outcome:
    """gmsh's UntangleMeshGeometry (a Winslow functional), one call, on plane entities.

    On discrete entities it silently does nothing: so every boundary vertex becomes a point and
    every boundary edge a line of a plane surface.  gmsh numbers nodes anew; they are read back
    entity by entity, where their order is kept.
    """
    _need("gmsh")
    import gmsh as api

    loops = [loop.tolist() for loop in connectivity.boundary_loops(torch.from_numpy(_rim(triangles)))]
    # The outer loop comes first; it has the largest area.
    loops.sort(key=lambda loop: -abs(_polygon_area(points[loop])))
    xyz = np.pad(points, ((0, 0), (0, 1)))
    api.initialize(interruptible=False)
    try:
        api.option.setNumber("General.Terminal", 0)
        api.option.setNumber("General.NumThreads", 1)
        place = {v: api.model.geo.addPoint(*xyz[v]) for loop in loops for v in loop}
        lines = {}
        curves = []
        for loop in loops:
            sides = list(zip(loop, loop[1:] + loop[:1], strict=True))
            for u, v in sides:
                lines[u, v] = api.model.geo.addLine(place[u], place[v])
            curves.append(api.model.geo.addCurveLoop([lines[side] for side in sides]))
        surface = api.model.geo.addPlaneSurface(curves)
        api.model.geo.synchronize()
        mesh = api.model.mesh
        for v, entity in place.items():
            mesh.addNodes(0, entity, [v + 1], xyz[v])
            mesh.addElementsByType(entity, 15, [], [v + 1])
        for (u, v), line in lines.items():
            mesh.addElementsByType(line, 1, [], [u + 1, v + 1])
        inner = np.setdiff1d(np.arange(len(points)), list(place))
        mesh.addNodes(2, surface, inner + 1, xyz[inner].ravel())
        mesh.addElementsByType(surface, 2, [], triangles.ravel() + 1)
        with Stopwatch() as watch:
            mesh.optimize("UntangleMeshGeometry")
        moved = points.copy()
        moved[inner] = mesh.getNodes(2, surface)[1].reshape(-1, 3)[:, :2]
    finally:
        api.finalize()
    return Outcome(moved, triangles, watch.seconds)


def mfem(points: Array, triangles: Array, fixed: Array, size: float = 0.25) -> Outcome:
    """MFEM's TMOP through PyMFEM: shape metric 4 with a shifted barrier, Newton with MINRES.

    size  of the mean triangle, as a length in units of the target's edge.  The method has absolute
          constants, so the mesh's own unit decides how fast it is and whether it ends at all;
          1, 0.5, 0.25 and 0.125 are worth a try (`mfem_best`).
    """
    _need("mfem")
    import mfem.ser as fem
    from mfem._ser import cpointers, tmop, tmop_tools

    area = 0.5 * double_areas(points, triangles)
    scale = size * float(np.sqrt(np.sqrt(3) / 4 / np.abs(area).mean()))
    with tempfile.TemporaryDirectory() as folder, _quiet():
        path = str(Path(folder) / "tangled.mesh")
        _write_mfem(path, points * scale, triangles)
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
        lowest = float((2 * area * scale**2).min() / (np.sqrt(3) / 2))
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
    """The fastest of `mfem` in four units of length that ends with no inverted triangle, if any does."""
    tries = [mfem(points, triangles, fixed, size) for size in (0.125, 0.25, 0.5, 1.0)]
    return min(tries, key=lambda t: (int((double_areas(t.points, triangles) <= 0).sum()), t.seconds.cpu))


def mouette(points: Array, triangles: Array, fixed: Array) -> Outcome:
    """mouette's WinslowInjectiveEmbedding (Garanzha et al. 2021), discs only."""
    _need("mouette")
    import mouette as M

    euler = len(points) - len(connectivity.edges(*_with_twins(triangles))) + len(triangles)
    if euler != 1:
        raise Refused("refused: not a disc")

    def run(at: Array, faces: Array) -> tuple[Array, Seconds]:
        data = M.mesh.RawMeshData()
        data.vertices += list(np.pad(at, ((0, 0), (0, 1))))
        data.faces += [tuple(row) for row in faces.tolist()]
        surface = M.mesh.SurfaceMesh(data)
        # An equilateral reference triangle for each: what all the others aim at.
        ideal = np.linalg.inv(np.array([[1.0, 0.5], [0.0, np.sqrt(3) / 2]]))
        solver = M.parametrization.WinslowInjectiveEmbedding(
            surface, at, ref_jacs=np.tile(ideal, (len(faces), 1, 1)), verbose=False
        )
        with Stopwatch() as watch:
            solver.run()
        return np.array([solver.uvs[v] for v in surface.id_vertices]), watch.seconds

    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.4, 0.6]])
    run(square, np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]))  # numba compiles
    moved, seconds = run(points, triangles)
    return Outcome(np.where(fixed[:, None], points, moved), triangles, seconds, "two threads")


def foldover_free(points: Array, triangles: Array, fixed: Array) -> Outcome:
    """Foldover-free maps (Garanzha, Kaporin, Kudryavtseva, Protais, Ray & Sokolov 2021), plainly, with scipy's L-BFGS.

    The authors' program is in no package registry; this is their section 3 with its constants: theta = 1/128,
    epsilon from 1 by the ratio of energies, inner minimisations until the gradient is below 1e-4 or 10,000
    steps are done, in a box of side 10.  As nothing is known of an undeformed mesh, every target is equilateral and
    all have one size, the domain's area over the number of triangles.
    """
    from scipy.optimize import minimize

    free = np.flatnonzero(~fixed)
    low, high = points.min(0), points.max(0)
    unit = 10.0 / (high - low).max()
    where = (points - low) * unit
    side = np.sqrt(0.5 * double_areas(where, triangles).sum() / len(triangles) * 4 / np.sqrt(3))
    # Rows of (b - a, c - a) times the inverse of the target, as coefficients of the three corners.
    inverse = np.linalg.inv(side * np.array([[1.0, 0.5], [0.0, np.sqrt(3) / 2]]))
    corner = np.concatenate([-inverse.sum(0, keepdims=True), inverse])
    weight, theta = np.sqrt(3) / 4 * side**2, 1 / 128

    def energy(unknowns: Array, eps: float) -> tuple[float, Array, float]:
        where[free] = unknowns.reshape(-1, 2)
        j = np.einsum("tvd,vk->tdk", where[triangles], corner)
        det = j[:, 0, 0] * j[:, 1, 1] - j[:, 0, 1] * j[:, 1, 0]
        root = np.hypot(eps, det)
        chi = np.where(det > 0, 0.5 * (det + root), 0.5 * eps**2 / np.where(det > 0, 1.0, root - det))
        slope = 0.5 + 0.5 * det / root
        shape, area = (j**2).sum((1, 2)) / chi, (1 + det**2) / chi
        cofactor = np.stack([j[:, 1, 1], -j[:, 1, 0], -j[:, 0, 1], j[:, 0, 0]], 1).reshape(-1, 2, 2)
        by_det = (theta * (2 * det - area * slope) - (1 - theta) * shape * slope) / chi
        by_j = (1 - theta) * 2 * j / chi[:, None, None] + by_det[:, None, None] * cofactor
        force = np.einsum("tdk,vk->tvd", by_j, corner).reshape(-1, 2) * weight
        gradient = np.stack([np.bincount(triangles.ravel(), force[:, d], len(points)) for d in (0, 1)], 1)
        return float(((1 - theta) * shape + theta * area).sum() * weight), gradient[free].ravel(), float(det.min())

    unknowns, eps = where[free].ravel().copy(), 1.0
    with Stopwatch() as watch:
        for rounds in itertools.count(1):
            before = energy(unknowns, eps)[0]
            unknowns = minimize(
                lambda u, eps=eps: energy(u, eps)[:2], unknowns, jac=True, method="L-BFGS-B",
                options={"maxiter": 10_000, "maxfun": 20_000, "gtol": 1e-4, "ftol": 1e-9},
            ).x  # fmt: skip
            after, _, lowest = energy(unknowns, eps)
            sigma = max(1 - after / before, 0.1)
            root = np.hypot(eps, lowest)
            chi = 0.5 * (lowest + root) if lowest > 0 else 0.5 * eps**2 / (root - lowest)
            mu = (1 - sigma) * chi
            still = eps
            eps = max(1e-9, 2 * float(np.sqrt(mu * (mu - lowest)))) if lowest < mu else 1e-9
            settled = abs(before - after) < 1e-5 * after if lowest > 0 else eps >= still
            if settled or rounds == 100:
                break
    moved = points.copy()
    moved[free] = unknowns.reshape(-1, 2) / unit + low
    return Outcome(moved, triangles, watch.seconds, f"{rounds} values of epsilon")


def libigl(points: Array, triangles: Array, fixed: Array) -> Outcome:
    """libigl's intrinsic Delaunay flips; no vertex moves, so it is for valid meshes."""
    _need("igl")
    import igl

    lengths = igl.edge_lengths(points, triangles)
    with Stopwatch() as watch:
        result = igl.intrinsic_delaunay_triangulation(lengths, triangles)
    return Outcome(points, result[1], watch.seconds, "flips only")


def scipy_delaunay(points: Array, triangles: Array, fixed: Array) -> Outcome:
    """scipy's Delaunay of the points from nothing: a mesh of their hull, no boundary kept."""
    _need("scipy")
    from scipy.spatial import Delaunay

    with Stopwatch() as watch:
        simplices = Delaunay(points).simplices
    made = simplices.astype(np.int64)
    clockwise = double_areas(points, made) < 0
    made[clockwise] = made[clockwise, ::-1]
    lost = len(np.setdiff1d(_edge_keys(_rim(triangles), len(points)), _edge_keys(_sides(made), len(points))))
    return Outcome(points, made, watch.seconds, f"hull of the points; {lost} boundary edges lost")


PEERS: dict[str, Callable[[Array, Array, Array], Outcome]] = {
    "gmsh UntangleMeshGeometry": gmsh,
    "MFEM TMOP": mfem_best,
    "mouette": mouette,
    "libigl intrinsic Delaunay": libigl,
    "scipy Delaunay": scipy_delaunay,
}


def _need(module: str) -> None:
    if importlib.util.find_spec(module) is None:
        raise Missing(f"not installed: pip install 'torchmesh-untangle[peers]' ({module})")


def _with_twins(triangles: Array) -> tuple[torch.Tensor, torch.Tensor]:
    faces = torch.from_numpy(triangles)
    return faces, connectivity.twins(faces)


def _rim(triangles: Array) -> Array:
    """(E, 2) the boundary edges, the mesh on their left."""
    return connectivity.boundary_edges(*_with_twins(triangles)).numpy()


def _sides(triangles: Array) -> Array:
    return np.stack([triangles.ravel(), np.roll(triangles, -1, 1).ravel()], 1)


def _edge_keys(edges: Array, vertices: int) -> Array:
    return edges.min(1) * vertices + edges.max(1)


def _polygon_area(polygon: Array) -> float:
    x, y = polygon.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _write_mfem(path: str, points: Array, triangles: Array) -> None:
    rim = _rim(triangles)
    with open(path, "w") as out:
        for name, corners, shape in (("elements", triangles, 2), ("boundary", rim, 1)):
            head = "MFEM mesh v1.0\n\ndimension\n2\n" if name == "elements" else ""
            out.write(f"{head}\n{name}\n{len(corners)}\n")
            np.savetxt(out, np.insert(corners, 0, [[1], [shape]], 1), fmt="%d")
        out.write(f"\nvertices\n{len(points)}\n2\n")
        np.savetxt(out, points, fmt="%.17g")


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep what C++ prints from the terminal."""
    saved = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)
        os.close(nowhere)
