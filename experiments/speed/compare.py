"""torchmesh and the peers that are installed, side by side on the same tangled meshes, as a Markdown table.

    python -m pip install '.[peers]' && python -m experiments.speed.compare

With several numbers of triangles the plot shows how the cost grows:

    python -m experiments.speed.compare --triangles 2200 20000 200000 --out out/compare

It writes compare.md, compare.json and compare.png there.  The tools take turns on every mesh.  Times are the least of
`--repeats` rounds, with one thread each; of a peer only the optimiser's own call is timed.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

import torchmesh as tm
from experiments.shared import arguments, clocks, domains, peers
from experiments.speed.comparison import Row, table
from experiments.speed.fresh_process import FIRST_CALL
from torchmesh.bench.stopwatch import Seconds, Stopwatch

KEPT = "of the vertices kept"
OURS, FULL = "torchmesh", "torchmesh, vertices come and go"
# Foldover-free maps is left out: this implementation of it was not made for speed.
PEERS = {name: peer for name, peer in peers.PEERS.items() if name != "foldover-free maps"}


def compare(case: domains.Case, repeats: int, patience: float, tired: set[str]) -> list[Row]:
    """A row for each tool; a peer slower than `patience` seconds joins `tired`, which get a note only."""
    head = case.name, len(case.mesh.triangles), int(tm.quality(case.mesh).inverted)
    rows = [Row(*head, name, note="too slow on a smaller mesh") for name in PEERS if name in tired]
    tools: dict[str, Callable[[], peers.Outcome]] = {OURS: lambda: _improve(case), FULL: lambda: _remeshed(case)}
    tools |= {name: _calling(tool, case) for name, tool in PEERS.items() if name not in tired}
    best: dict[str, peers.Outcome] = {}
    for turn in range(repeats):
        for name, tool in list(tools.items()):
            if turn and name in tired:
                continue
            try:
                outcome = tool()
            except (peers.Missing, peers.Refused) as why:
                rows.append(Row(*head, name, note=str(why)))
                del tools[name]
                continue
            if name not in best or outcome.seconds.wall < best[name].seconds.wall:
                best[name] = outcome
            if name not in (OURS, FULL) and outcome.seconds.wall > patience:
                tired.add(name)
    rows += [_row(head, name, outcome, case) for name, outcome in best.items()]
    order = [OURS, FULL, *PEERS]
    return sorted(rows, key=lambda row: order.index(row.tool))


def batch_row(cases: list[domains.Case], repeats: int, workers: int, fast: bool = False) -> Row:
    """torchmesh on all the cases as one batch, shared among `workers` processes; the seconds are those of one mesh."""
    options = (tm.ImproveOptions.fast if fast else tm.ImproveOptions)(workers=workers)
    joined = tm.join([case.mesh for case in cases])
    better = joined

    def work() -> None:
        nonlocal better
        better = tm.improve(joined, options)[0]

    seconds = clocks.interleaved({OURS: work}, repeats)[OURS] * (1 / len(cases))
    q = tm.quality(better)
    return Row(
        f"batch of {len(cases)}, a mesh", len(joined.triangles) // len(cases),
        int(tm.quality(joined).inverted.sum()) // len(cases),
        OURS + (f", {workers} processes" if workers > 1 else "") + (", fast" if fast else ""),
        seconds.wall, seconds.cpu,
        int(q.inverted.sum()), 1.0, float(q.mean.mean()), float(q.max.max()),
    )  # fmt: skip


def first_call_row(case: domains.Case, repeats: int) -> Row:
    """torchmesh on one mesh in a fresh process, where torch is loaded and torchmesh is not."""
    runs = [clocks.in_fresh_process(FIRST_CALL, case.path) for _ in range(repeats)]
    run = min(runs, key=lambda r: r["load"]["wall"] + r["first"]["wall"])
    seconds = Seconds(**run["load"]) + Seconds(**run["first"])
    return Row(
        case.name, len(case.mesh.triangles), int(tm.quality(case.mesh).inverted), f"{OURS}, import and first call",
        seconds.wall, seconds.cpu, run["inverted"], 1.0, run["mean"], run["max"],
    )  # fmt: skip


def options() -> argparse.ArgumentParser:
    parser = arguments.parser(__doc__)
    arguments.add_cache(parser)
    arguments.add_sizes(parser, 2200)
    parser.add_argument("--batch", type=int, default=30, help="meshes in the batch row, of the first size; 0: no row")
    parser.add_argument("--repeats", type=int, default=3, help="the least time of so many runs counts")
    parser.add_argument(
        "--patience", type=float, default=60.0, help="a peer slower than this (s) is not asked on larger meshes"
    )
    parser.add_argument("--first-call", action="store_true", help="also rows for a first call in a fresh process")
    parser.add_argument("--out", type=Path, help="folder for compare.md, .json and .png")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    given = arguments.parse(options(), argv)
    sizes = sorted(given.triangles)
    rows: list[Row] = []
    tired: set[str] = set()
    for count in sizes:
        for case in domains.variants(3, count, given.cache):
            rows += compare(case, given.repeats, given.patience, tired)
            if given.first_call and count == sizes[0]:
                rows.append(first_call_row(case, given.repeats))
    if given.batch:
        cases = domains.variants(given.batch, sizes[0], given.cache)
        processors = os.cpu_count() or 1
        rows += [batch_row(cases, given.repeats, workers) for workers in sorted({1, processors})]
        rows.append(batch_row(cases, given.repeats, processors, fast=True))
    text = f"{clocks.machine()}; one thread; least of {given.repeats} runs\n\n{table(rows)}"
    print(text)
    if given.out is not None:
        from experiments.speed.cost_plot import plot

        given.out.mkdir(parents=True, exist_ok=True)
        (given.out / "compare.md").write_text(text + "\n")
        record = {"machine": clocks.machine(), "repeats": given.repeats, "rows": [asdict(row) for row in rows]}
        (given.out / "compare.json").write_text(json.dumps(record, indent=1))
        plot(rows, [OURS, *PEERS], given.out / "compare.png")
    return 0


def _improve(case: domains.Case) -> peers.Outcome:
    with Stopwatch() as watch:
        better, _ = tm.improve(case.mesh)
    return peers.Outcome(better.points.numpy(), better.triangles.numpy(), watch.seconds)


def _remeshed(case: domains.Case) -> peers.Outcome:
    with Stopwatch() as watch:
        better, report = tm.improve(case.mesh, tm.ImproveOptions(topology="full"))
    assert report.vertex_map is not None
    kept = float((report.vertex_map.old_to_new >= 0).double().mean())
    return peers.Outcome(better.points.numpy(), better.triangles.numpy(), watch.seconds, f"{kept:.0%} {KEPT}")


def _calling(tool: Callable[..., peers.Outcome], case: domains.Case) -> Callable[[], peers.Outcome]:
    return lambda: tool(*case.arrays)


def _row(head: tuple[str, int, int], name: str, outcome: peers.Outcome, case: domains.Case) -> Row:
    count, made = len(case.mesh.points), np.ascontiguousarray(outcome.triangles)
    # Where a tool makes vertices of its own, those of the boundary are kept, unless it says more.
    kept = 1.0 if len(outcome.points) == count and "new" not in outcome.note else float(case.mesh.fixed.sum()) / count
    kept = float(outcome.note.split("%")[0]) / 100 if outcome.note.endswith(KEPT) else kept
    # Some tools make another number of triangles, which `with_triangles` of a batch does not take.
    mesh = tm.MeshBatch(
        torch.from_numpy(outcome.points), torch.from_numpy(made), case.mesh.fixed, case.mesh.constrained_edges,
        torch.tensor([0, len(outcome.points)]), torch.tensor([0, len(made)]), case.mesh.frames,
    )  # fmt: skip
    q = tm.quality(mesh)
    return Row(
        *head, name, outcome.seconds.wall, outcome.seconds.cpu, int(q.inverted), kept, float(q.mean), float(q.max),
        outcome.note,
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
