"""Processor seconds that fields take from one mesh to another, with compiled loops and without.

    python -m experiments.speed.transfer

A structured mesh of the unit square is jittered twice, so that every vertex inside has moved.  Values at vertices are
interpolated, values in triangles averaged over exact overlaps; the integral is that of values in triangles.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

import torch

import torchmesh as tm
from experiments.shared import arguments, tables
from torchmesh.kernels import library


def jittered(triangles: int, seed: int) -> tm.MeshBatch:
    """About so many triangles; every vertex inside has moved by up to a quarter of a cell."""
    side = round((triangles / 2) ** 0.5)
    line = torch.linspace(0, 1, side + 1, dtype=torch.float64)
    points = torch.cartesian_prod(line, line)
    corner = torch.arange(side * (side + 1)).reshape(side, side + 1)[:, :-1].reshape(-1)
    low, right, top, up = corner, corner + side + 1, corner + side + 2, corner + 1
    faces = torch.cat([torch.stack([low, right, top], 1), torch.stack([low, top, up], 1)])
    mesh = tm.MeshBatch.from_arrays(points, faces)
    way = torch.rand(points.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) - 0.5
    return mesh.with_points(points + torch.where(mesh.fixed[:, None], 0.0, 0.5 * way / side))


def main(argv: Sequence[str] | None = None) -> int:
    options = arguments.parser(__doc__)
    arguments.add_sizes(options, 100_000)
    options.add_argument("--repeats", type=int, default=3, help="the least of so many runs counts")
    given = arguments.parse(options, argv)
    print(tables.head(("triangles", "loops", "values at vertices", "values in triangles", "error of the integral")))
    for triangles in given.triangles:
        before, after = jittered(triangles, 0), jittered(triangles, 1)
        for loops in ("compiled", "torch") if library.built() else ("torch",):
            with library.using(loops):
                cells = [f"{len(before.triangles):,}", loops]
                for where, rows in (("points", len(before.points)), ("triangles", len(before.triangles))):
                    values = torch.rand(rows, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
                    seconds = []
                    for _ in range(given.repeats):
                        start = time.process_time()
                        out = tm.transfer(before, after, values, where)
                        seconds.append(time.process_time() - start)
                    cells.append(f"{min(seconds):.2f}")
                integrals = [float((tm.quality(m).area * v).sum()) for m, v in ((before, values), (after, out))]
                print(tables.line([*cells, f"{abs(integrals[1] / integrals[0] - 1):.0e}"]), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
