"""Small random domains with holes and constrained edges, their free vertices anywhere: is each made valid?

    python -m experiments.robustness.fuzz --count 2000 --seed 0
    python -m experiments.robustness.fuzz --count 300 --seed 0 --cross

A domain is a part of a random Delaunay triangulation with some triangles taken out, so that its outline is ragged,
holes may share vertices with it, and constrained edges hang anywhere.  With --cross each case has options of its own:
topology, boundary, targets, sizes, reference, workers, precision, and other meshes in its batch.  The result is judged
apart from the report: signs in exact arithmetic, fixed vertices, the given mesh, and for every second case the mesh in
a batch against the mesh alone.  Prints what failed, with the seed that makes it again; the exit status is 1 if anything
failed.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from scipy.spatial import Delaunay

import torchmesh as tm
from experiments.shared import arguments
from torchmesh.bench.exact_check import double_areas, inverted
from torchmesh.mesh import connectivity
from torchmesh.mesh.interfaces import holding

Array = np.ndarray
# How meshes end of whose boundary, or of what is fixed in them, something is wrong.
AT_FAULT = (tm.Status.INFEASIBLE, tm.Status.PARTLY)


def domain(rng: np.random.Generator) -> tm.MeshBatch | None:
    """A random valid mesh with a ragged boundary, holes and constrained edges; None when too little is left."""
    count = int(rng.integers(8, 60))
    points = rng.uniform(-1, 1, (count, 2))
    if rng.uniform() < 0.3:
        points = np.round(points * 6) / 6  # many points on one line, many on one circle
        points = np.unique(points, axis=0)
    triangles = Delaunay(points).simplices.astype(np.int64)
    twice = double_areas(points, triangles)
    triangles[twice < 0] = triangles[twice < 0, ::-1]
    triangles = triangles[np.abs(twice) > 1e-12]
    triangles = triangles[rng.uniform(size=len(triangles)) > rng.choice([0.0, 0.1, 0.3])]
    if len(triangles) < 2:
        return None
    faces = torch.from_numpy(triangles)
    label = connectivity.triangle_components(faces, connectivity.twins(faces)).numpy()
    triangles = triangles[label == np.bincount(label).argmax()]
    used, triangles = np.unique(triangles, return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    faces = torch.from_numpy(triangles)
    twin = connectivity.twins(faces)
    edges = connectivity.edges(faces, twin).numpy()
    wanted = edges[rng.uniform(size=len(edges)) < rng.choice([0.0, 0.05, 0.2])]
    fixed = rng.uniform(size=len(used)) < rng.choice([0.0, 0.1])
    return tm.MeshBatch.from_arrays(points[used], triangles, fixed, wanted if len(wanted) else None)


def scatter(mesh: tm.MeshBatch, rng: np.random.Generator) -> tm.MeshBatch:
    """The same mesh with its free vertices anywhere."""
    points = mesh.points.numpy().copy()
    free = np.flatnonzero(~holding(mesh).fixed.numpy())
    kind = rng.integers(6)
    if kind == 0:
        points[free] = rng.normal(size=(len(free), 2)) * rng.choice([0.1, 1.0, 100.0])
    elif kind == 1:
        points[free] = rng.normal(size=2)
    elif kind == 2:
        points[free] = points[rng.permutation(free)]
    elif kind == 3 and len(free):
        points[free] = points[rng.integers(len(points), size=len(free))]  # on other vertices
    elif kind == 4:
        edge = points[mesh.triangles.numpy()[rng.integers(len(mesh.triangles), size=len(free))]]
        points[free] = 0.5 * (edge[:, 0] + edge[:, 1])  # on edges
    else:
        points[free] *= rng.choice([-1.0, 1e-9, 1e9])
    scale, shift = rng.choice([1.0, 1e-140, 1e140, 1e-3]), rng.choice([0.0, 0.0, 1e5])
    return mesh.with_points(torch.from_numpy((points + shift) * scale))


def case(seed: int) -> tuple[tm.MeshBatch, tm.MeshBatch] | None:
    """The valid mesh, and the scattered one, which may be scaled and shifted; None when too little is left."""
    rng = np.random.default_rng(seed)
    mesh = domain(rng)
    return None if mesh is None else (mesh, scatter(mesh, rng))


def crossed(seed: int, mesh: tm.MeshBatch, tangled: tm.MeshBatch) -> tm.ImproveOptions:
    """Options drawn for a case, of those that go together."""
    rng = np.random.default_rng([seed, 1])
    topology = str(rng.choice(["keep", "flip", "flip", "full", "full"]))
    options: dict[str, Any] = {"topology": topology, "workers": int(rng.integers(1, 3))}
    if rng.uniform() < 0.3:
        options["reference"] = mesh
    if topology != "full" and rng.uniform() < 0.3:
        options["boundary"] = "slide"
    elif topology != "full" and rng.uniform() < 0.4:
        targets = tm.target_from(mesh) if topology == "keep" else tm.metric_from(mesh)
        options["smooth"] = tm.SmoothOptions(targets=targets)
    if topology != "keep" and "smooth" not in options:
        extent = float((tangled.points[tangled.fixed].amax(0) - tangled.points[tangled.fixed].amin(0)).max())
        lengths = torch.full((len(mesh.points),), 0.2 * extent, dtype=torch.float64)
        sizes: list[Any] = ["boundary", "boundary", "keep", "uniform", lengths]
        options["remesh"] = tm.RemeshOptions(sizes=sizes[rng.integers(len(sizes))], split_boundary=topology == "full")
    if rng.uniform() < 0.3 and not (topology == "full" and "remesh" in options):
        options["scope"] = "damage"
    if rng.uniform() < 0.3:
        options["interfaces"] = "free"
    return tm.ImproveOptions(**options)


def judge(given: tm.MeshBatch, after: tm.MeshBatch, report: tm.Report, options: tm.ImproveOptions) -> str:
    """What is wrong with the outcome of one mesh; "" if nothing is."""
    valid, status = bool(report.valid), int(report.status)
    if not bool(after.points.isfinite().all()):
        return "coordinates that are not finite"
    left = inverted(after.points.double().numpy(), after.triangles.numpy())
    if valid != (left == 0):
        return f"said to be {'valid' if valid else 'tangled'}, and {left} triangles are inverted or flat"
    if not valid:
        if options.topology == "keep":
            return "" if status in (tm.Status.STALLED, *AT_FAULT) else f"status {status}"
        # The shift may round two boundary vertices to one position; then the diagnosis says so.
        return "" if status in AT_FAULT else f"{report.messages[0]} ({int(report.quality.inverted)} left)"
    if not bool(report.certified):
        return "valid but not certified"
    if options.topology == "keep" and not torch.equal(after.triangles, given.triangles):
        return "the triangles changed"
    if options.topology == "flip" and after.points.shape != given.points.shape:
        return "the number of vertices changed"
    new = torch.arange(len(given.points)) if report.vertex_map is None else report.vertex_map.old_to_new
    held = holding(given, options.at_interfaces).fixed.nonzero().squeeze(1)
    if options.slides:
        return ""
    if bool((new[held] < 0).any()) or not torch.equal(after.points[new[held]], given.points[held]):
        return "a fixed vertex moved or is gone"
    return ""


def run(seed: int, cross: bool, topology: str) -> str | None:
    """What went wrong with a case: "" if nothing did, "impossible" if the mesh was refused, None without a case."""
    made = case(seed)
    if made is None:
        return None
    mesh, tangled = made
    options = crossed(seed, mesh, tangled) if cross else tm.ImproveOptions(topology=topology)
    if cross and seed % 5 == 0 and options.reference is None and options.smooth.targets is None:
        try:
            tangled = tangled.to(torch.float32)
            tm.MeshBatch.from_arrays(tangled.points, tangled.triangles)
        except tm.InvalidMeshError:
            return "impossible"
    after, report = tm.improve(tangled, options)
    wrong = judge(tangled, after, report, options)
    alone = options.separable and seed % 2 == 0
    if cross and not wrong and alone:
        other = case(seed + 1) or made
        both, _ = tm.improve(tm.join([other[1].to(tangled.points.dtype), tangled]), options)
        last = both.split()[1]
        if not torch.equal(last.points, after.points) or not torch.equal(last.triangles, after.triangles):
            return "another result in a batch than alone"
    return wrong or ("impossible" if int(report.status) in AT_FAULT else "")


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("--count", type=int, default=500, help="number of seeds")
    parser.add_argument("--seed", type=int, default=0, help="the first of them")
    parser.add_argument("--topology", choices=["flip", "full"], default="flip", help="unless options are drawn")
    parser.add_argument("--cross", action="store_true", help="draw options for each case")
    given = arguments.parse(parser, argv)
    started, failed, done, refused = time.perf_counter(), 0, 0, 0
    for seed in range(given.seed, given.seed + given.count):
        try:
            wrong = run(seed, given.cross, given.topology)
        except Exception as error:
            wrong = f"{type(error).__name__}: {error}"
        if wrong is None:
            continue
        done += 1
        refused += wrong == "impossible"
        if wrong and wrong != "impossible":
            failed += 1
            print(f"seed {seed}: {wrong}", flush=True)
    seconds = time.perf_counter() - started
    print(f"{done} meshes, {failed} failed, {refused} said to be impossible, {seconds:.0f} s")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
