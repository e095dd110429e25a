"""What does it cost that the vertices of a valid mesh stay near?  Shapes and travel with and without the tether.

    python -m experiments.quality.travel

Three sets of valid meshes: random Delaunay meshes of squares, grids whose interior vertices were thrown about by a
third of a cell, and meshes of the nine families after a motion that left them valid.  Each is improved with
`relocate="auto"` (the default: no vertex of a valid mesh goes further than one local width), True and False.  The table
has the inverse mean ratio, mean over the meshes and worst, the least angle, and how far vertices went, in local widths.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch
from scipy.spatial import Delaunay

import torchmesh as tm
from experiments.shared import arguments, clocks, tables


def random_squares(count: int, vertices: int) -> list[tm.MeshBatch]:
    """Delaunay meshes of random points in a square whose sides are divided evenly."""
    side = int(np.sqrt(vertices))
    along = np.linspace(0, 1, side, endpoint=False)
    sides = np.concatenate([np.stack(pair, 1) for pair in (
        (along, 0 * along), (1 + 0 * along, along), (1 - along, 1 + 0 * along), (0 * along, 1 - along)
    )])  # fmt: skip
    found = []
    for seed in range(count):
        inside = np.random.default_rng(seed).uniform(0.3 / side, 1 - 0.3 / side, (vertices, 2))
        points = np.concatenate([sides, inside])
        triangles = Delaunay(points).simplices
        a, b, c = (points[triangles[:, k]] for k in range(3))
        area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        found.append(tm.MeshBatch.from_arrays(points, triangles[area > 1e-12]))
    return found


def shaken_grids(count: int, vertices: int) -> list[tm.MeshBatch]:
    """Square grids, each cell cut in two, whose interior vertices were moved by up to a third of a cell."""
    side = int(np.sqrt(vertices))
    x, y = np.meshgrid(np.arange(side + 1.0), np.arange(side + 1.0))
    points = np.stack([x.ravel(), y.ravel()], 1)
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    a, b, c, d = corner, corner + 1, corner + side + 2, corner + side + 1
    mesh = tm.MeshBatch.from_arrays(points, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))
    shaken = []
    for seed in range(count):
        generator = torch.Generator().manual_seed(seed)
        shift = (torch.rand(mesh.points.shape, generator=generator, dtype=torch.float64) - 0.5) * (2 / 3)
        shaken.append(mesh.with_points(torch.where(mesh.fixed[:, None], mesh.points, mesh.points + shift)))
    return shaken


def moved_families(count: int, triangles: int) -> list[tm.MeshBatch]:
    """Meshes of all families after their motion, those that are still valid."""
    found = tm.domains.generate(4 * count, triangles=triangles, seed=0).deformed.split()
    return [mesh for mesh in found if not int(tm.quality(mesh).inverted[0])][:count]


def row_of(name: str, relocate: Literal["auto"] | bool, meshes: list[tm.MeshBatch]) -> list[str]:
    """What becomes of a set of meshes."""
    batch = tm.join([mesh for mesh in meshes if not int(tm.quality(mesh).inverted[0])])
    after, report = tm.improve(batch, tm.ImproveOptions(relocate=relocate, workers=1))
    q, travel = report.quality, report.travel
    assert travel is not None
    assert bool(report.valid.all())
    angle = float(tm.minimum_angle(after).min())
    shapes = [f"{float(v):.3f}" for v in (q.mean.mean(), q.mean.max(), q.max.max())]
    ways = [f"{float(v):.2f}" for v in (travel.p95.mean(), travel.max.max())]
    return [name, str(len(batch)), str(relocate), *shapes, f"{angle:.1f}", *ways]


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("--count", type=int, default=12, help="meshes in a set")
    parser.add_argument("--vertices", type=int, default=500, help="about so many vertices in a mesh")
    args = arguments.parse(parser, argv)
    sets = {
        "random Delaunay": random_squares(args.count, args.vertices),
        "shaken grids": shaken_grids(args.count, args.vertices),
        "families, moved": moved_families(args.count, 2 * args.vertices),
    }
    head = ["meshes", "number", "relocate", "IMR, mean", "IMR average, worst", "IMR maximum, worst", "least angle",
            "travel, 95 %", "travel, furthest"]  # fmt: skip
    print(clocks.machine())
    print()
    ways: tuple[Literal["auto"] | bool, ...] = ("auto", True, False)
    print(tables.table(head, [row_of(name, way, found) for name, found in sets.items() for way in ways]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
