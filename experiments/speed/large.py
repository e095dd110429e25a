"""Does `improve` take as long for a triangle of a large mesh as of a small one, and longer than meshing anew?

    python -m experiments.speed.large                 (needs gmsh, the extra `peers`)

Circle, bar and gate of Kim 2017, deformed harder than there, with 20,000 and 200,000 triangles, and a cylinder that
moves four diameters in an O-mesh, with 20,000 and 692,000.  The options are the defaults: `topology="flip"`.
Seconds are the processor's in one thread, the least of `--repeats` runs; gmsh meshes the same boundaries anew in turn
with them.  Peak memory is that of another process, which does nothing else.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

import torchmesh as tm
from experiments.quality import variants
from experiments.shared import arguments, clocks, domains, peers, tables
from experiments.shared.cache import cached
from experiments.speed.fresh_process import GROWTH
from torchmesh.bench.stopwatch import Seconds
from torchmesh.mesh.triangle import angles, corners

TITLES = (
    "mesh", "triangles", "inverted", "seconds", "microseconds a triangle", "over those at the first size",
    "gmsh anew, seconds", "over gmsh", "gmsh's triangles", "IMR average", "maximum", "least angle", "peak memory, MB",
)  # fmt: skip
# Rings and sectors of the O-mesh, by about how many triangles that is.
RINGS = {20_000: (89, 112), 700_000: (526, 658)}


@dataclass(frozen=True)
class Large:
    """A mesh, and the file that holds it for another process."""

    mesh: tm.MeshBatch
    path: Path

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """points (V, 2), triangles (T, 3) and fixed (V,), as the peers want them."""
        return self.mesh.points.numpy(), self.mesh.triangles.numpy(), self.mesh.fixed.numpy()


def cylinder(triangles: int, cache: Path) -> Large:
    """The cylinder in an O-mesh."""
    rings, sectors = RINGS[triangles]

    def make() -> dict[str, np.ndarray]:
        before, after = (variants.cylinder(rings, sectors, distance) for distance in (0.0, 4.0))
        names = {"points": before.points, "triangles": before.triangles, "tangled": after.points}
        return {name: values.numpy() for name, values in names.items()}

    path = cache / f"cylinder-{rings}-{sectors}.npz"
    data = cached(path, make)
    undeformed = tm.MeshBatch.from_arrays(data["points"], data["triangles"])
    return Large(undeformed.with_points(torch.from_numpy(data["tangled"])), path)


def domain(kind: str) -> Callable[[int, Path], Large]:
    """What makes the variant of seed 0 of a domain of the paper."""

    def make(triangles: int, cache: Path) -> Large:
        case = domains.case(kind, triangles, 0, cache)
        return Large(case.mesh, case.path)

    return make


MESHES: dict[str, tuple[Callable[[int, Path], Large], tuple[int, int]]] = {
    **{kind: (domain(kind), (20_000, 200_000)) for kind in domains.KINDS},
    "cylinder": (cylinder, (20_000, 700_000)),
}


def row(name: str, large: Large, repeats: int, first: float | None) -> tuple[list[str], float]:
    """The row of a mesh, and its microseconds a triangle; `first` are those of the mesh of the first size."""
    made: dict[str, int] = {}
    done: list[tm.MeshBatch] = []

    def improved() -> None:
        done[:] = [tm.improve(large.mesh)[0]]

    def anew() -> Seconds:
        outcome = peers.gmsh_anew(*large.arrays)
        made["gmsh"] = len(outcome.triangles)
        return outcome.seconds

    seconds = clocks.interleaved({"improve": improved, "gmsh": anew}, repeats)
    ours, theirs, q = seconds["improve"].cpu, seconds["gmsh"].cpu, tm.quality(done[0])
    least = min(float(corner.min()) for corner in angles(corners(done[0].points, done[0].triangles)))
    count = len(large.mesh.triangles)
    each = 1e6 * ours / count
    peak = 1024 * clocks.in_fresh_process(GROWTH, large.path)["peak"]
    cells = [
        name, f"{count:,}", f"{int(tm.quality(large.mesh).inverted):,}", f"{ours:.2f}", f"{each:.1f}",
        f"{each / first:.2f}" if first else "", f"{theirs:.2f}", f"{ours / theirs:.2f}", f"{made['gmsh']:,}",
        f"{float(q.mean):.3f}", f"{float(q.max):.2f}", f"{math.degrees(least):.1f}", f"{peak:.0f}",
    ]  # fmt: skip
    return cells, each


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    arguments.add_cache(parser)
    parser.add_argument("--meshes", nargs="+", default=list(MESHES), choices=list(MESHES), help="which of the meshes")
    parser.add_argument("--repeats", type=int, default=3, help="the least time of so many runs counts")
    given = arguments.parse(parser, argv)
    found = []
    for name in given.meshes:
        make, sizes = MESHES[name]
        first: float | None = None
        for size in sizes:
            cells, each = row(name, make(size, given.cache), given.repeats, first)
            found.append(cells)
            first = first or each
    print(f"{clocks.machine()}; torch {torch.__version__}; one thread; processor seconds, least of {given.repeats}\n")
    print(tables.table(TITLES, found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
