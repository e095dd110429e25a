"""torchmesh and the peers that are installed, side by side on the same tangled meshes, as a Markdown table.

    python -m pip install '.[peers]' && python experiments/benchmarks/compare.py --cache out/benchmarks

With `--triangles` given several times the plot shows how cost grows:

    python experiments/benchmarks/compare.py --triangles 2200 --triangles 20000 --triangles 200000 --out out/compare

writes compare.md, compare.json and compare.png there.  Tools take turns on every mesh; times are
the least of `--repeats` rounds, one thread each; of a peer only the optimiser's own call is timed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import domains
import measuring
import numpy as np
import peers
import torch
import typer
from measuring import Seconds, Stopwatch

import torchmesh as tm

PEERS: dict[str, Callable[..., peers.Outcome]] = {
    "gmsh": peers.gmsh,
    "MFEM TMOP": peers.mfem,
    "mouette": peers.mouette,
    "libigl (flips)": peers.libigl,
    "scipy (Delaunay of the points)": peers.scipy_delaunay,
}
OURS = "torchmesh"


@dataclass(frozen=True)
class Row:
    """One tool on one domain; without seconds, `note` says why."""

    domain: str
    triangles: int
    inverted: int
    tool: str
    seconds: float | None = None
    cpu_seconds: float | None = None
    inverted_left: int | None = None
    mean: float | None = None
    max: float | None = None
    note: str = ""


def compare(case: domains.Case, repeats: int, patience: float, tired: set[str]) -> list[Row]:
    """A row for torchmesh and for every peer, but for those in `tired`, where a peer slower than `patience` goes."""
    mesh = case.mesh
    head = case.name, len(mesh.triangles), int(tm.quality(mesh).inverted)
    rows = [Row(*head, name, note="too slow on a smaller mesh") for name in PEERS if name in tired]
    tools: dict[str, Callable[[], peers.Outcome]] = {OURS: lambda: _improve(case)}
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
            if name != OURS and outcome.seconds.wall > patience:
                tired.add(name)
    rows += [_row(head, name, outcome, case) for name, outcome in best.items()]
    order = [OURS, *PEERS]
    return sorted(rows, key=lambda row: order.index(row.tool))


def batch_row(cases: list[domains.Case], repeats: int, workers: int, fast: bool = False) -> Row:
    """torchmesh on all the cases as one batch, shared among `workers` processes, a mesh of it."""
    options = (tm.ImproveOptions.fast if fast else tm.ImproveOptions)(workers=workers)
    joined = tm.join([case.mesh for case in cases])
    better = joined

    def work() -> None:
        nonlocal better
        better = tm.improve(joined, options)[0]

    seconds = measuring.interleaved({OURS: work}, repeats)[OURS] * (1 / len(cases))
    q = tm.quality(better)
    return Row(
        f"batch of {len(cases)}, a mesh", len(joined.triangles) // len(cases),
        int(tm.quality(joined).inverted.sum()) // len(cases),
        OURS + (f", {workers} processes" if workers > 1 else "") + (", fast" if fast else ""),
        seconds.wall, seconds.cpu,
        int(q.inverted.sum()), float(q.mean.mean()), float(q.max.max()),
    )  # fmt: skip


def first_call_row(case: domains.Case, path: Path, repeats: int) -> Row:
    """torchmesh on one mesh in a fresh process, where torch is loaded and torchmesh is not."""
    runs = [measuring.in_fresh_process(measuring.FIRST_CALL, path) for _ in range(repeats)]
    run = min(runs, key=lambda r: r["load"]["wall"] + r["first"]["wall"])
    seconds = Seconds(**run["load"]) + Seconds(**run["first"])
    return Row(
        case.name, len(case.mesh.triangles), int(tm.quality(case.mesh).inverted), f"{OURS}, import and first call",
        seconds.wall, seconds.cpu, run["inverted"], run["mean"], run["max"],
    )  # fmt: skip


def table(rows: list[Row]) -> str:
    """Markdown, of rows that have seconds."""
    lines = [
        "| domain | triangles | inverted | tool | seconds | inverted left | IMR average | IMR maximum | note |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        cells = [f"{row.seconds:.3f}", str(row.inverted_left), f"{row.mean:.3f}", f"{row.max:.2f}", row.note]
        lines.append(f"| {row.domain} | {row.triangles:,} | {row.inverted:,} | {row.tool} | {' | '.join(cells)} |")
    return "\n".join(lines)


def plot(rows: list[Row], path: Path) -> None:
    """Seconds against triangles for every tool, both logarithmic; hollow where inverted triangles are left."""
    from matplotlib.figure import Figure

    # Okabe & Ito's colours, told apart with any colour vision; shapes tell them apart in print.
    looks = dict(zip([OURS, *PEERS], zip(("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"),
                                         "os^vDP", strict=True), strict=True))  # fmt: skip
    figure = Figure(figsize=(7, 5), layout="constrained")
    axes = figure.add_subplot()
    for tool, (colour, marker) in looks.items():
        done = sorted((r for r in rows if r.tool == tool and r.seconds and "batch" not in r.domain),
                      key=lambda r: r.triangles)  # fmt: skip
        for kind in sorted({r.domain for r in done}):
            line = [r for r in done if r.domain == kind]
            axes.plot([r.triangles for r in line], [r.seconds for r in line], color=colour, linewidth=1)
        for valid, face in ((True, colour), (False, "none")):
            some = [r for r in done if (r.inverted_left == 0) == valid]
            axes.scatter([r.triangles for r in some], [r.seconds or 0 for r in some], marker=marker, facecolors=face,
                         edgecolors=colour)  # fmt: skip
        if done:
            axes.plot([], [], color=colour, marker=marker, label=tool)
    each = [r for r in rows if "batch" in r.domain]
    if each:
        axes.scatter([r.triangles for r in each], [r.seconds or 0 for r in each], marker="*", s=120, color="black",
                     label=f"{OURS}, {each[0].domain}")  # fmt: skip
    axes.set(xscale="log", yscale="log", xlabel="triangles", ylabel="time [s], one thread")
    axes.set_title("Untangling circle, bar and gate; hollow: inverted triangles are left", fontsize=10)
    axes.grid(True, which="both", alpha=0.25)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    figure.savefig(path, dpi=150)


def main(
    cache: Annotated[Path, typer.Option(help="Where the generated meshes are kept.")] = Path("out/benchmarks"),
    triangles: Annotated[list[int] | None, typer.Option(help="About this many triangles a mesh [2200].")] = None,
    batch: Annotated[int, typer.Option(help="Meshes in the batch row, of the first size; 0: none.")] = 30,
    repeats: Annotated[int, typer.Option(help="The least time of so many runs.")] = 3,
    patience: Annotated[float, typer.Option(help="A peer slower than this (s) is not asked on larger meshes.")] = 60.0,
    first_call: Annotated[bool, typer.Option(help="Rows for import and first call in a fresh process, too.")] = False,
    out: Annotated[Path | None, typer.Option(help="Directory for compare.md, .json and .png.")] = None,
) -> None:
    """Print a row for every domain and tool: seconds, inverted triangles left, inverse mean ratio."""
    measuring.one_thread()
    sizes = sorted(triangles or [2200])
    rows: list[Row] = []
    tired: set[str] = set()
    for count in sizes:
        for case in domains.variants(3, count, cache):
            rows += compare(case, repeats, patience, tired)
            if first_call and count == sizes[0]:
                rows.append(first_call_row(case, cache / f"{case.name.split()[0]}-{count}-0.npz", repeats))
    if batch:
        cases = domains.variants(batch, sizes[0], cache)
        rows += [batch_row(cases, repeats, workers) for workers in sorted({1, os.cpu_count() or 1})]
        rows.append(batch_row(cases, repeats, os.cpu_count() or 1, fast=True))
    # The same reason for the same tool is said once, under the table.
    measured = [row for row in rows if row.seconds is not None]
    left_out: dict[str, list[str]] = {}
    for row in rows:
        if row.seconds is None:
            left_out.setdefault(f"{row.tool}: {row.note}", []).append(f"{row.domain} ({row.triangles:,})")
    text = "\n".join(
        [
            f"{measuring.machine()}; one thread; least of {repeats} runs\n",
            table(measured),
            *(f"\n{reason}: {', '.join(where)}." for reason, where in left_out.items()),
        ]
    )
    print(text)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "compare.md").write_text(text + "\n")
        record = {"machine": measuring.machine(), "repeats": repeats, "rows": [asdict(row) for row in rows]}
        (out / "compare.json").write_text(json.dumps(record, indent=1))
        plot(rows, out / "compare.png")


def _improve(case: domains.Case) -> peers.Outcome:
    with Stopwatch() as watch:
        better, _ = tm.improve(case.mesh)
    return peers.Outcome(better.points.numpy(), better.triangles.numpy(), watch.seconds)


def _calling(tool: Callable[..., peers.Outcome], case: domains.Case) -> Callable[[], peers.Outcome]:
    return lambda: tool(*case.arrays)


def _row(head: tuple[str, int, int], name: str, outcome: peers.Outcome, case: domains.Case) -> Row:
    made = np.ascontiguousarray(outcome.triangles)
    # scipy's triangles are another number of them: not a batch's `with_triangles`, but one mesh all the same.
    mesh = tm.MeshBatch(
        torch.from_numpy(outcome.points), torch.from_numpy(made), case.mesh.fixed, case.mesh.constrained_edges,
        case.mesh.point_offsets, torch.tensor([0, len(made)]), case.mesh.frames,
    )  # fmt: skip
    q = tm.quality(mesh)
    return Row(
        *head, name, outcome.seconds.wall, outcome.seconds.cpu, int(q.inverted), float(q.mean), float(q.max),
        outcome.note,
    )  # fmt: skip


if __name__ == "__main__":
    typer.run(main)
