"""Competing strategies in one batch, the best mesh wins: does that better what the escalation of `improve` finds?

    python experiments/strategies.py

Members: the tangled mesh as it is, which `improve` takes through its escalation; the same untangled first with the
triangles kept (the regularised functional); and re-triangulated first where it is tangled (pockets).  All three go
through `improve` as one batch.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import torch
from tangles import tangle

import torchmesh as tm
from torchmesh.untangling.retriangulation import retriangulate_cavities

MEMBERS = ("escalation", "kept first", "pockets first")
CASES = [
    ("moved", 8, 0), ("moved", 12, 0), ("moved", 4, 180), ("moved", 12, 180), ("turned", 90, 0), ("turned", 150, 0),
    ("turned", 180, 0), ("mapped", 2, 0), ("mapped", 4, 0), ("mapped", 6, 0), ("wound", 1, 0), ("wound", 2, 0),
]  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--triangles", type=int, nargs="+", default=[300, 2000])
    parser.add_argument("--cache", type=Path, default=Path("out/cache"))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    options = tm.ImproveOptions(workers=1)
    wins, means, spent = dict.fromkeys(MEMBERS, 0), dict.fromkeys((*MEMBERS, "best"), 0.0), [0.0, 0.0]
    print("| tangle | triangles | " + " | ".join(MEMBERS) + " | seconds, escalation | seconds, all three |")
    print("|---" * (len(MEMBERS) + 4) + "|")
    for triangles in arguments.triangles:
        for family, value, angle in CASES:
            mesh = tangle(family, value, triangles, 0.3, 0, arguments.cache, angle).tangled
            started = time.process_time()
            tm.improve(mesh, options)
            alone = time.process_time() - started
            started = time.process_time()
            members = [mesh, tm.untangle(mesh)[0], retriangulate_cavities(mesh)[0]]
            report = tm.improve(tm.join(members), options)[1]
            together = time.process_time() - started
            mean = report.quality.mean.tolist()
            best = MEMBERS[min(range(len(MEMBERS)), key=mean.__getitem__)]
            wins[best] += 1
            means["best"] += min(mean)
            for name, value_ in zip(MEMBERS, mean, strict=True):
                means[name] += value_
            spent = [spent[0] + alone, spent[1] + together]
            cells = [f"{m:.3f} / {w:.2f}" for m, w in zip(mean, report.quality.max.tolist(), strict=True)]
            turned = f" and {angle} degrees" if angle else ""
            print(
                f"| {family} {value}{turned} | {triangles:,} | {' | '.join(cells)} | {alone:.2f} | {together:.2f} |",
                flush=True,
            )
    count = len(CASES) * len(arguments.triangles)
    averages = [f"{means[name] / count:.3f}, best {wins[name]} times" for name in MEMBERS]
    print(f"| all | | {' | '.join(averages)} | {spent[0]:.1f} | {spent[1]:.1f} |")
    print(f"\nThe best of three: {means['best'] / count:.3f} on average, in {spent[1] / spent[0]:.1f} times the time.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
