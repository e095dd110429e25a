"""Measure the seven speed targets: ours against the best peer, in one run, as a ratio.

    python -m experiments.speed.targets            # without the million
    python -m experiments.speed.targets --only 5   # one of them
    python -m experiments.speed.targets --full     # with 1,000,000 triangles

Times are minima over `--repeats` rounds in which ours and the peer take turns, one thread each.
`ratio` is of wall times; the ratio of processor times beside it is the better one on a busy machine.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from experiments.shared import arguments, clocks, peers, tables
from experiments.speed.target_rows import Row, Setting
from experiments.speed.targets_growth import growth
from experiments.speed.targets_improve import batch, larger, single, stragglers
from experiments.speed.targets_kernels import flips, iteration

TARGETS: dict[int, Callable[[Setting], list[Row]]] = {
    1: batch,
    2: single,
    3: larger,
    4: iteration,
    5: flips,
    6: growth,
    7: stragglers,
}


def table(rows: list[Row]) -> str:
    """Markdown."""
    lines = []
    for row in rows:
        shown = [f"{x:.3g}" if x is not None else "-" for x in (row.ratio, row.cpu_ratio, row.goal)]
        met = {True: "yes", False: "**no**", None: "-"}[row.met]
        lines.append([f"T{row.target}", row.what, *shown, met])
    return tables.table(("target", "what", "ratio", "cpu ratio", "goal", "met"), lines)


def measured(number: int, setting: Setting) -> list[Row]:
    """The rows of a target; one row that says why where a peer is missing."""
    try:
        return TARGETS[number](setting)
    except peers.Missing as missing:
        return [Row(number, str(missing), None, None, None, None)]


def options() -> argparse.ArgumentParser:
    parser = arguments.parser(__doc__)
    arguments.add_cache(parser)
    parser.add_argument("--only", type=int, nargs="+", choices=list(TARGETS), help="measure these targets only")
    parser.add_argument("--repeats", type=int, default=3, help="rounds to take minima over")
    parser.add_argument("--meshes", type=int, default=60, help="meshes in the batch of T1")
    parser.add_argument("--small", type=int, default=2_200, help="triangles of the meshes of T1, T2, T7")
    parser.add_argument("--medium", type=int, default=20_000, help="triangles of T3, and where T6 starts")
    parser.add_argument("--large", type=int, default=200_000, help="triangles of T5 and T6, half of those in T4")
    parser.add_argument("--full", action="store_true", help="1,000,000 triangles in T5 and T6")
    parser.add_argument("--out", type=Path, help="a JSON file for the rows")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    given = arguments.parse(options(), argv)
    setting = Setting(given.cache, given.repeats, given.meshes, given.small, given.medium, given.large, given.full)
    rows: list[Row] = []
    print(clocks.machine())
    for number in given.only or list(TARGETS):
        print(f"\n{TARGETS[number].__doc__}", flush=True)
        with clocks.Stopwatch() as watch:
            found = measured(number, setting)
        for row in found:
            print("\n".join(f"    {line}" for line in row.details))
            if row.ratio is not None:
                verdict = {True: "met", False: "NOT met", None: "the measure of the others"}[row.met]
                print(f"  {row.what}: {row.ratio:.3g} (cpu {row.cpu_ratio:.3g}), goal {row.goal}: {verdict}")
        print(f"  measured in {watch.seconds.wall:.0f} s; {clocks.machine()}", flush=True)
        rows += found
    print(f"\n{table(rows)}")
    if given.out is not None:
        given.out.write_text(json.dumps({"machine": clocks.machine(), "rows": [asdict(row) for row in rows]}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
