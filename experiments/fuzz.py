"""Small random domains with holes and constrained edges, their free vertices anywhere: is each made valid?

    python experiments/fuzz.py --count 2000 --seed 0

A domain is a piece of a random Delaunay triangulation with some triangles taken out, so that its
outline is ragged, holes may share vertices with it, and constrained edges hang anywhere.  Prints
what failed, with the seed that makes it again, and exits 1 if anything did.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
import torch
from scipy.spatial import Delaunay

import torchmesh as tm
from torchmesh import connectivity

Array = np.ndarray


def domain(rng: np.random.Generator) -> tm.MeshBatch | None:
    """A random valid mesh, ragged, with holes and constrained edges; None when too little is left."""
    count = int(rng.integers(8, 60))
    points = rng.uniform(-1, 1, (count, 2))
    if rng.uniform() < 0.3:
        points = np.round(points * 6) / 6  # many in one line, many circles of four
        points = np.unique(points, axis=0)
    triangles = Delaunay(points).simplices.astype(np.int64)
    a, b, c = points[triangles].transpose(1, 0, 2)
    twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
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
    """The same mesh, its free vertices anywhere."""
    points = mesh.points.numpy().copy()
    free = np.flatnonzero(~mesh.fixed.numpy())
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
    """The valid mesh and the scattered one, both in the same unit."""
    rng = np.random.default_rng(seed)
    mesh = domain(rng)
    return None if mesh is None else (mesh, scatter(mesh, rng))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--topology", choices=["flip", "full"], default="flip")
    arguments = parser.parse_args()
    options = tm.ImproveOptions(topology=arguments.topology)
    torch.set_num_threads(1)
    started, failed, done, refused = time.perf_counter(), 0, 0, 0
    for seed in range(arguments.seed, arguments.seed + arguments.count):
        made = case(seed)
        if made is None:
            continue
        done += 1
        try:
            _, report = tm.improve(made[1], options)
        except Exception as error:
            failed += 1
            print(f"seed {seed}: {type(error).__name__}: {error}")
            continue
        if not bool(report.valid.all()):
            # The shift may round two boundary vertices together; then the diagnosis says so.
            if int(report.status) == tm.Status.INFEASIBLE:
                refused += 1
                continue
            failed += 1
            print(f"seed {seed}: {report.messages[0]} ({int(report.quality.inverted)} inverted)")
        elif not bool(report.certified.all()):
            failed += 1
            print(f"seed {seed}: valid but not certified")
    seconds = time.perf_counter() - started
    print(f"{done} meshes, {failed} failed, {refused} said to be impossible, {seconds:.0f} s")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
