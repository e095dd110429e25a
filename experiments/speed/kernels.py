"""What do the compiled loops bring?  The same work by them and by torch alone, in turn, on one thread.

    python -m experiments.speed.kernels

The meshes are circle, bar and gate of Kim 2017, deformed harder than there, no two alike; the layer untangles squares
whose vertices were moved at random.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Sequence

import torch

import torchmesh as tm
from experiments.shared import arguments, clocks, domains, tables
from torchmesh.kernels import library

Work = Callable[[], object]


def squares(count: int, cells: int = 10) -> tuple[tm.nn.Untangle, torch.Tensor]:
    """The layer of `count` squares, and positions for it that tangle them."""
    at = torch.linspace(0, 1, cells + 1, dtype=torch.float64)
    points = torch.cartesian_prod(at, at)
    row = torch.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = (v.reshape(-1) for v in (row[:-1, :-1], row[1:, :-1], row[1:, 1:], row[:-1, 1:]))
    faces = torch.cat([torch.stack([a, b, c], 1), torch.stack([a, c, d], 1)])
    mesh = tm.join([tm.MeshBatch.from_arrays(points, faces)] * count)
    noise = (
        0.8 / cells * torch.randn(mesh.points.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    )
    return tm.nn.Untangle(mesh), mesh.points + noise * ~mesh.fixed[:, None]


def train(layer: tm.nn.Untangle, positions: torch.Tensor) -> None:
    """Forward and backward of a layer."""
    layer(positions.clone().requires_grad_()).square().sum().backward()


def works(given: object) -> dict[str, Work]:
    """What is measured, by name."""
    cases = domains.variants(given.meshes, given.triangles[0], given.cache)
    one, many = cases[0].mesh, tm.join([case.mesh for case in cases])
    alone, kept = tm.ImproveOptions(workers=1), tm.ImproveOptions(topology="keep", workers=1)
    large = domains.noisy("circle", 100 * given.triangles[0], 0, given.cache)
    better, _ = tm.improve(many, alone)
    layer, positions = squares(given.layers)
    sheared = better.points + 0.1 * better.points.flip(1)
    before, after = better[0], tm.improve(one, tm.ImproveOptions.fast())[0]
    steps = tm.SmoothOptions(energy_tolerance=0, gradient_tolerance=0, max_iterations=30)
    f = functools.partial
    return {
        f"improve one mesh of {len(one.triangles):,} triangles": f(tm.improve, one, alone),
        f"improve {len(many)} such meshes": f(tm.improve, many, alone),
        f"improve {len(many)} such meshes, triangles kept": f(tm.improve, many, kept),
        f"30 steps of smooth on {len(many)} such meshes": f(tm.smooth, better, steps),
        f"femwarp of {len(many)} such meshes": f(tm.femwarp, better, sheared),
        "conservative transfer between two such meshes": f(
            tm.transfer, before, after, before.points[:, 0], method="conservative"
        ),
        f"flip_to_delaunay, {len(large.triangles):,} triangles": f(tm.flip_to_delaunay, large),
        f"nn.Untangle of {given.layers} meshes of 200 triangles, forward and backward": f(train, layer, positions),
    }


def by(choice: str, work: Work) -> None:
    with library.using(choice):
        work()


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    arguments.add_cache(parser)
    arguments.add_sizes(parser, 2200)
    parser.add_argument("--meshes", type=int, default=60, help="meshes of the batch")
    parser.add_argument("--layers", type=int, default=256, help="meshes of the layer")
    parser.add_argument("--repeats", type=int, default=3, help="runs of which the fastest counts")
    given = arguments.parse(parser, argv)
    rows = []
    for name, work in works(given).items():
        runs = {choice: functools.partial(by, choice, work) for choice in ("torch", "compiled")}
        seconds = clocks.interleaved(runs, given.repeats)
        ratio = seconds["torch"].over(seconds["compiled"])
        rows.append([name, f"{seconds['torch'].cpu:.3g}", f"{seconds['compiled'].cpu:.3g}", f"{ratio.cpu:.1f}"])
    print(tables.table(["work", "torch, seconds", "compiled, seconds", "times as fast"], rows))
    print(f"\n{clocks.machine()}; torch {torch.__version__}; one thread, processor time")
    return 0


if __name__ == "__main__":
    sys.exit(main())
