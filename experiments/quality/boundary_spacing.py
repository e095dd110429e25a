"""Does the boundary's spacing set the limit of maps onto letters and spirals? A Markdown table.

    python -m experiments.quality.boundary_spacing

*fewest* is the least IMR average of any triangulation of the boundary without a vertex inside.  Where boundary edges
are longer than an arm is wide, there is no room for more.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import torchmesh as tm
from experiments.quality.limits import least_mean_without_interior
from experiments.shared import arguments, tables
from experiments.shared.tangles import tangle
from torchmesh.bench import boundary

CASES = [("mapped", 3), ("mapped", 4), ("mapped", 6), ("mapped", 8), ("wound", 1), ("wound", 2)]
TITLES = (
    "map", "triangles", "boundary edges", "fewest", "IMR average, flip", "maximum", "full", "maximum", "vertices, full",
)  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    given = arguments.sizes_and_cache(__doc__, argv, 300, 2000)
    print(tables.head(TITLES))
    for triangles in given.triangles:
        for family, value in CASES:
            mesh = tangle(family, value, triangles, 0.3, 0, given.cache).tangled
            loop = boundary.loops(mesh.triangles)[0]
            fewest = least_mean_without_interior(mesh.points[loop].numpy())
            cells = [f"{family} {value}", f"{len(mesh.triangles):,}", str(len(loop)), f"{fewest:.3f}"]
            for topology in ("flip", "full"):
                after, report = tm.improve(mesh, tm.ImproveOptions(topology=topology, workers=1))
                cells += [f"{float(report.quality.mean):.3f}", f"{float(report.quality.max):.2f}"]
            print(tables.line([*cells, f"{len(after.points):,}"]), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
