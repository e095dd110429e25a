"""What untangles with the triangles kept: regularised with which sizes, total lifted content, or untangle-beta?

    python -m experiments.robustness.untangling_methods --triangles 600

Every method has the same L-BFGS and thousands of steps.  Prints for each tangle how many triangles stay inverted, or
the IMR average, and the seconds of the processor; the last line counts what each method solved.  With 600 triangles the
regularised functional solves 14 of 14 with each size field.  Total lifted content with alpha 1e-2 and one size solves
11 of 14, in a fifth of the time where it succeeds, but to averages twice as high; with 1e-4 it solves 13 of 14, and
with local sizes 5 of 14.  untangle-beta solves 9 of 14.  Therefore `untangle` begins with the regularised functional;
total lifted content is one of the second-order ways for what that leaves (torchmesh/untangling/persisting.py).

Regularised is the functional of foldover-free maps (Garanzha, Kaporin, Kudryavtseva, Protais, Ray & Sokolov 2021) with
its theta and its rule for epsilon.  It differs from the authors' program, which is in no package registry, in this:

- The targets are equilateral triangles of a local size, averaged from the tangled mesh, or the triangles of a
  reference.  The authors' targets are the triangles of a rest mesh, or of one size without one.
- Three such size fields are tried in turn.
- A mesh is done as soon as no triangle is inverted, and is then smoothed by the inverse mean ratio.  The authors go on
  to the least value of the functional.
- No constant depends on the unit of length; the authors scale the mesh to a box of side 10.
- Inner minimisations are shorter (500 steps), since the next epsilon makes up for it.

The program as published, with targets of one size, is the way "foldover-free maps" of never_give_up.py.  There
topology="keep" solves every case that it, gmsh or MFEM solve with the triangles kept.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence

import torch

import torchmesh as tm
from experiments.shared import arguments, tables
from experiments.shared.tangles import tangle
from torchmesh.mesh.ragged import spread
from torchmesh.optimising.energies import TotalLiftedContent
from torchmesh.optimising.jacobian import equilateral
from torchmesh.optimising.lbfgs import minimise
from torchmesh.optimising.lbfgs_options import LbfgsOptions
from torchmesh.optimising.objective import MeshObjective, pack
from torchmesh.untangling.local_size import local_size

CASES = [
    ("moved", 6), ("moved", 8), ("moved", 10), ("moved", 12), ("turned", 15), ("turned", 90), ("turned", 150),
    ("turned", 180), ("mapped", 1), ("mapped", 2), ("mapped", 3), ("mapped", 4), ("jittered", 0.5), ("scrambled", 1),
]  # fmt: skip


def lifted(mesh: tm.MeshBatch, alpha: float, uniform: bool) -> tm.MeshBatch:
    """Du et al. 2020 with equilateral rest triangles, of local or of one size, until no triangle is inverted."""
    packing = pack(mesh.points, mesh.triangles, ~mesh.fixed, mesh.point_offsets, mesh.triangle_offsets)
    size = local_size(mesh) / spread(packing.unit, mesh.point_offsets)
    if uniform:
        size = torch.full_like(size, float(size.square().mean().sqrt()))
    objective = MeshObjective(
        TotalLiftedContent(alpha), equilateral(size[mesh.triangles].mean(1)[packing.triangles]), packing.rows,
        packing.anchored, packing.block_offsets, packing.triangle_offsets, packing.spread_vertices(size), enough=0.0,
    )  # fmt: skip
    settings = LbfgsOptions(max_iterations=3000, gradient_tolerance=1e-12, energy_tolerance=1e-9)
    return mesh.with_points(packing.unpack(minimise(objective, packing.unknowns, settings).unknowns, mesh.points))


def regularised(*sweeps: int) -> Callable[[tm.MeshBatch], tm.MeshBatch]:
    """`untangle` with size fields averaged over so many sweeps."""
    return lambda mesh: tm.untangle(mesh, tm.UntangleOptions(size_sweeps=sweeps, newton=None))[0]


METHODS: dict[str, Callable[[tm.MeshBatch], tm.MeshBatch]] = {
    "regularised, 20 sweeps": regularised(20),
    "100": regularised(100),
    "1000": regularised(1000),
    "default": lambda mesh: tm.untangle(mesh)[0],
    "TLC 1e-2, one size": lambda mesh: lifted(mesh, 1e-2, True),
    "TLC 1e-4, one size": lambda mesh: lifted(mesh, 1e-4, True),
    "TLC 1e-2, local": lambda mesh: lifted(mesh, 1e-2, False),
    "untangle-beta": lambda mesh: tm.untangle(mesh, tm.UntangleOptions("beta", max_iterations=3000))[0],
}


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("--triangles", type=int, default=600, help="triangles of a mesh, about")
    parser.add_argument("--grading", type=float, default=0.3, help="mesh size at the body as a part of that far away")
    arguments.add_cache(parser)
    given = arguments.parse(parser, argv)
    solved, spent = dict.fromkeys(METHODS, 0), dict.fromkeys(METHODS, 0.0)
    print(tables.head(("tangle", *METHODS)))
    for family, value in CASES:
        mesh = tangle(family, value, given.triangles, given.grading, 0, given.cache).tangled
        cells = []
        for name, method in METHODS.items():
            started = time.process_time()
            q = tm.quality(method(mesh))
            seconds = time.process_time() - started
            left = int(q.inverted)
            solved[name] += left == 0
            spent[name] += seconds
            cells.append(f"{left} left, {seconds:.2f} s" if left else f"{float(q.mean):.2f}, {seconds:.2f} s")
        print(tables.line([f"{family} {value:g}", *cells]), flush=True)
    print(tables.line(["solved", *(f"{solved[n]} of {len(CASES)}, {spent[n]:.1f} s" for n in METHODS)]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
