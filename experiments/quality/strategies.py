"""Three strategies in one batch, of which the best mesh wins: does that better what `improve` finds alone?

    python -m experiments.quality.strategies

The members are the tangled mesh as it is, which `improve` takes through its own steps; the same mesh untangled first
with its triangles kept (the regularised functional); and the same re-triangulated first where it is tangled.  All three
go through `improve` as one batch.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

import torchmesh as tm
from experiments.shared import arguments, tables
from experiments.shared.tangles import tangle
from torchmesh.untangling.retriangulation import retriangulate_cavities

MEMBERS = ("as it is", "kept first", "re-triangulated first")
CASES = [
    ("moved", 8, 0), ("moved", 12, 0), ("moved", 4, 180), ("moved", 12, 180), ("turned", 90, 0), ("turned", 150, 0),
    ("turned", 180, 0), ("mapped", 2, 0), ("mapped", 4, 0), ("mapped", 6, 0), ("wound", 1, 0), ("wound", 2, 0),
]  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    given = arguments.sizes_and_cache(__doc__, argv, 300, 2000)
    options = tm.ImproveOptions(workers=1)
    wins, means, spent = dict.fromkeys(MEMBERS, 0), dict.fromkeys((*MEMBERS, "best"), 0.0), [0.0, 0.0]
    print(tables.head(("tangle", "triangles", *MEMBERS, "seconds, as it is", "seconds, all three")))
    for triangles in given.triangles:
        for family, value, angle in CASES:
            mesh = tangle(family, value, triangles, 0.3, 0, given.cache, angle).tangled
            started = time.process_time()
            tm.improve(mesh, options)
            alone = time.process_time() - started
            started = time.process_time()
            members = [mesh, tm.untangle(mesh)[0], retriangulate_cavities(mesh)[0]]
            report = tm.improve(tm.join(members), options)[1]
            together = time.process_time() - started
            mean = report.quality.mean.tolist()
            wins[MEMBERS[mean.index(min(mean))]] += 1
            means["best"] += min(mean)
            for name, of_member in zip(MEMBERS, mean, strict=True):
                means[name] += of_member
            spent = [spent[0] + alone, spent[1] + together]
            cells = [f"{m:.3f} / {w:.2f}" for m, w in zip(mean, report.quality.max.tolist(), strict=True)]
            case = f"{family} {value}" + (f" and {angle} degrees" if angle else "")
            print(tables.line([case, f"{triangles:,}", *cells, f"{alone:.2f}", f"{together:.2f}"]), flush=True)
    count = len(CASES) * len(given.triangles)
    averages = [f"{means[name] / count:.3f}, best {wins[name]} times" for name in MEMBERS]
    print(tables.line(["all", "", *averages, f"{spent[0]:.1f}", f"{spent[1]:.1f}"]))
    print(f"\nThe best of three: {means['best'] / count:.3f} on average, in {spent[1] / spent[0]:.1f} times the time.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
