"""Measure the seven speed targets: ours against the best peer, in one run, as a ratio.

    python experiments/benchmarks/targets.py --cache /tmp/torchmesh-bench            # without the million
    python experiments/benchmarks/targets.py --cache /tmp/torchmesh-bench --only 5   # one of them
    python experiments/benchmarks/targets.py --cache /tmp/torchmesh-bench --full     # with 1,000,000 triangles

Times are minima over `--repeats` rounds in which ours and the peer take turns, one thread each.
`ratio` is of wall times; the ratio of processor times beside it is the better one on a busy machine.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

import domains
import measuring
import numpy as np
import peers
import references
import torch
import typer
from domains import Case
from measuring import Seconds, Stopwatch, in_fresh_process, interleaved, machine, one_thread

import torchmesh as tm
from torchmesh import ImproveOptions, MeshBatch


@dataclass(frozen=True)
class Row:
    """One measured ratio.  `met` takes the wall ratio and what the quality must be; None: nothing to meet."""

    target: int
    what: str
    ratio: float | None
    cpu_ratio: float | None
    goal: float | None
    met: bool | None
    details: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Setting:
    """What all targets share."""

    cache: Path
    repeats: int
    meshes: int
    small: int  # triangles of the meshes of a batch
    medium: int
    large: int
    full: bool

    @property
    def largest(self) -> int:
        """Triangles of the largest mesh that this run measures."""
        return 1_000_000 if self.full else self.large


def ratio_row(target: int, what: str, ratio: Seconds, goal: float, details: list[str], good: bool = True) -> Row:
    return Row(target, what, ratio.wall, ratio.cpu, goal, good and ratio.wall <= goal, details)


def batch(s: Setting) -> list[Row]:
    """T1: improve on a batch, per mesh, over gmsh on the same meshes one by one.

    On all processors, as improve does where torch has that many threads, and on one; and by the fast options.
    """
    cases = domains.variants(s.meshes, s.small, s.cache)
    joined = tm.join([c.mesh for c in cases])
    result: list[MeshBatch] = []
    quick: list[MeshBatch] = []
    outcomes: list[list[peers.Outcome]] = []
    seconds = interleaved(
        {
            "ours": lambda: _keep(result, joined, ImproveOptions(workers=os.cpu_count())),
            "ours on one processor": lambda: _keep(result, joined),
            "ours, fast": lambda: _keep(quick, joined, ImproveOptions.fast(workers=os.cpu_count())),
            "gmsh": lambda: _all_by_gmsh(cases, outcomes),
        },
        s.repeats,
    )
    words, good = _quality(result[-1])
    quick_words, quick_good = _quality(quick[-1])
    left = sum(bool((domains.double_areas(o.points, o.triangles) <= 0).any()) for o in outcomes[-1])
    per_mesh = {name: value * (1 / len(cases)) for name, value in seconds.items()}
    details = [
        "per mesh: " + ", ".join(f"{name} {value}" for name, value in per_mesh.items()),
        f"ours {words}; fast {quick_words}",
        f"gmsh leaves {left} of {len(cases)} meshes tangled",
    ]
    what = f"batch of {len(cases)}, per mesh / gmsh"
    names = ("ours", "ours on one processor", "ours, fast")
    ratio, on_one, fast = (seconds[name].over(seconds["gmsh"]) for name in names)
    return [
        ratio_row(1, f"{what}, on {os.cpu_count()} processors", ratio, 0.10, details, good),
        ratio_row(1, f"{what}, on {os.cpu_count()} processors, ImproveOptions.fast()", fast, 0.10, [], quick_good),
        Row(1, f"{what}, on one processor", on_one.wall, on_one.cpu, None, None),
    ]


def single(s: Setting) -> list[Row]:
    """T2: improve on one mesh, the first call in a fresh process, import torchmesh included, over gmsh."""
    ours, warm, gmsh = Seconds(0, 0), Seconds(0, 0), Seconds(0, 0)
    details, good = [], True
    for kind in domains.KINDS:
        case = domains.case(kind, s.small, 0, s.cache)
        path = s.cache / f"{kind}-{s.small}-0.npz"
        runs, theirs = [], []
        for _ in range(s.repeats):
            runs.append(in_fresh_process(measuring.FIRST_CALL, path))
            theirs.append(peers.gmsh(*case.arrays).seconds)
        times = {name: _least([Seconds(**run[name]) for run in runs]) for name in ("load", "first", "second")}
        own, peer = times["load"] + times["first"], _least(theirs)
        ours, warm, gmsh = ours + own, warm + times["second"], gmsh + peer
        last = runs[-1]
        good &= last["valid"] and last["mean"] <= 1.08 and last["max"] <= 2.5
        details.append(
            f"{kind}: import {times['load']}, first call {times['first']}, second {times['second']}, gmsh {peer}; "
            f"valid {last['valid']}, IMR {last['mean']:.3f} / {last['max']:.2f}"
        )
    return [
        ratio_row(2, "one mesh, import torchmesh and first call / gmsh", ours.over(gmsh), 1.0, details, good),
        ratio_row(2, "one mesh, second call / gmsh", warm.over(gmsh), 1.0, []),
    ]


def larger(s: Setting) -> list[Row]:
    """T3: improve on the circle with 20,000 triangles over MFEM TMOP at its best unit of length."""
    case = domains.case("circle", s.medium, 0, s.cache)
    result: list[MeshBatch] = []
    outcomes: list[peers.Outcome] = []

    def theirs() -> Seconds:
        outcomes.append(peers.mfem_best(*case.arrays))
        return outcomes[-1].seconds

    seconds = interleaved({"ours": lambda: _keep(result, case.mesh), "mfem": theirs}, s.repeats)
    words, good = _quality(result[-1])
    moved, _ = _quality(case.mesh.with_points(torch.from_numpy(outcomes[-1].points)))
    before, _ = _quality(case.mesh)
    details = [
        f"before {before}",
        f"ours {seconds['ours']}, {words}",
        f"MFEM {seconds['mfem']}, {moved}, {outcomes[-1].note}",
    ]
    return [
        ratio_row(3, f"circle of {s.medium:,} / MFEM TMOP", seconds["ours"].over(seconds["mfem"]), 0.5, details, good)
    ]


def iteration(s: Setting) -> list[Row]:
    """T4: one L-BFGS iteration of smooth over one serial compiled loop for value and gradient."""
    loop = references.serial_energy()
    size = min(2_000, s.small)
    unlike = [domains.noisy(domains.KINDS[i % 3], size, i // 3, s.cache) for i in range(30)]
    many = tm.join((unlike * 7)[: min(200, 2 * s.large // size)])
    one = domains.noisy("circle", 2 * s.large, 0, s.cache)
    rows = []
    for name, mesh in ((f"{len(many)} meshes of {size:,}", many), ("one mesh", one)):
        points, triangles = mesh.points.numpy(), mesh.triangles.numpy()
        gradient = np.empty_like(points)
        loop(points, triangles, gradient)
        short, long = 5, 35
        counts: dict[int, tm.MoveInfo] = {}
        seconds = interleaved(
            {
                "loop": lambda: loop(points, triangles, gradient) and None,  # noqa: B023
                "short": lambda: _smooth(mesh, short, counts),  # noqa: B023
                "long": lambda: _smooth(mesh, long, counts),  # noqa: B023
            },
            s.repeats,
        )
        step = (seconds["long"] - seconds["short"]) * (1 / (long - short))
        tried, accepted = counts[long].evaluations - 1, counts[long].iterations
        details = [
            f"{len(triangles):,} triangles: an iteration {step}, the loop {seconds['loop']}",
            f"set-up of smooth: {(seconds['short'] - step * short).over(step).cpu:.1f} iterations",
            f"{float(accepted.sum()) / float(tried.sum()):.2f} of the steps tried are accepted",
        ]
        rows.append(ratio_row(4, f"L-BFGS iteration / serial loop, {name}", step.over(seconds["loop"]), 6.0, details))
    return rows


def flips(s: Setting) -> list[Row]:
    """T5: flip_to_delaunay on a valid noisy mesh over libigl's intrinsic_delaunay_triangulation."""
    mesh = domains.noisy("circle", s.largest, 0, s.cache)
    points, triangles = mesh.points.numpy(), mesh.triangles.numpy()
    result: list[tuple[MeshBatch, tm.FlipInfo]] = []

    def ours() -> None:
        result[:] = [tm.flip_to_delaunay(mesh)]

    seconds = interleaved(
        {"ours": ours, "libigl": lambda: peers.libigl(points, triangles, mesh.fixed.numpy()).seconds},
        s.repeats,
    )
    flipped, info = result[0]
    made = flipped.triangles.numpy()
    before, after = references.not_delaunay(points, triangles), references.not_delaunay(points, made)
    same = len(references.interior_edges(made)) == len(references.interior_edges(triangles))
    upright = bool((domains.double_areas(points, made) > 0).all())
    details = [
        f"{len(triangles):,} triangles, {before:,} edges not Delaunay: ours {seconds['ours']},"
        f" libigl {seconds['libigl']}",
        f"{int(info.flips.sum()):,} flips; after them {after} edges not Delaunay (exact), as many interior edges:"
        f" {same},"
        f" all upright: {upright}",
    ]
    ratio = seconds["ours"].over(seconds["libigl"])
    good = after == 0 and same and upright
    return [ratio_row(5, f"flips, {len(triangles):,} triangles / libigl", ratio, 0.4, details, good)]


GROWTH = """
import json, resource, sys
import numpy as np, torch
torch.set_num_threads(1)
import torchmesh as tm
from measuring import Stopwatch
data = np.load(sys.argv[1])
mesh = tm.MeshBatch.from_arrays(data["points"], data["triangles"]).with_points(torch.from_numpy(data["tangled"]))
loaded = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
with Stopwatch() as watch:
    mesh, report = tm.improve(mesh)
q = report.quality
print(json.dumps(vars(watch.seconds) | {
    "triangles": len(mesh.triangles), "loaded": loaded / 2**20,
    "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    "inverted": int(q.inverted), "mean": float(q.mean), "max": float(q.max),
    "stages": [[step.stage, round(step.seconds, 3), step.iterations, step.inverted] for step in report.steps[0]]}))
"""


def growth(s: Setting) -> list[Row]:
    """T6: seconds per triangle and peak memory of improve as the same tangled circle grows; a small tangle."""
    base: Seconds | None = None
    rows = []
    for count, goal in ((s.medium, None), (s.large, 1.5), *([(s.largest, 2.0)] if s.full else [])):
        domains.case("circle", count, 0, s.cache)
        path = s.cache / f"circle-{count}-0.npz"
        runs = [in_fresh_process(GROWTH, path) for _ in range(s.repeats if count < 1_000_000 else 1)]
        run = runs[-1]
        each = _least([Seconds(r["wall"], r["cpu"]) for r in runs]) * (1e6 / run["triangles"])
        base = base or each
        good = run["inverted"] == 0 and run["mean"] <= 1.08 and run["max"] <= 2.5 and run["peak"] < 4
        stages: dict[str, float] = {}
        for name, seconds, _, _ in run["stages"]:
            stages[name] = stages.get(name, 0.0) + seconds
        details = [
            f"{run['triangles']:,} triangles: {each.wall:.1f} microseconds a triangle (cpu {each.cpu:.1f}), "
            f"{run['inverted']} inverted, IMR {run['mean']:.3f} / {run['max']:.2f}",
            f"peak memory {run['peak']:.2f} GiB ({run['loaded']:.2f} before improve)",
            "stages: " + ", ".join(f"{name} {seconds:.2f} s" for name, seconds in stages.items()),
        ]
        ratio = each.over(base)
        met = None if goal is None else good and ratio.wall <= goal
        what = f"seconds a triangle at {count:,} / at {s.medium:,}"
        rows.append(Row(6, what, ratio.wall, ratio.cpu, goal, met, details))
    return [*rows, small_tangle(s)]


def small_tangle(s: Setting) -> Row:
    """T6: a large valid mesh with one small tangle over twice a look at its quality plus the tangle's surroundings."""
    case = domains.case("circle", s.largest, 0, s.cache)
    points = case.valid.copy()
    faces, fixed = case.mesh.triangles.numpy(), case.mesh.fixed.numpy()
    spacing = float(np.sqrt(np.median(domains.double_areas(points, faces))))
    distance = np.hypot(points[:, 0] - 14, points[:, 1] - 4)
    core = (distance < 4 * spacing) & ~fixed
    points[core] += 1.5 * spacing * np.random.default_rng(3).standard_normal((int(core.sum()), 2))
    whole = case.mesh.with_points(torch.from_numpy(points))
    near = (distance < 30 * spacing)[faces].all(1)
    used, local = np.unique(faces[near], return_inverse=True)
    around = MeshBatch.from_arrays(case.valid[used], local.reshape(-1, 3)).with_points(torch.from_numpy(points[used]))
    result: list[MeshBatch] = []
    seconds = interleaved(
        {
            "whole": lambda: _keep(result, whole),
            "quality": lambda: tm.quality(whole) and None,
            "around": lambda: tm.improve(around) and None,
        },
        s.repeats,
    )
    words, good = _quality(result[-1])
    before, _ = _quality(whole)
    details = [
        f"before {before}; after {words}",
        f"improve {seconds['whole']}, quality {seconds['quality']}, improve on the {len(around.triangles):,} triangles "
        f"around alone {seconds['around']}",
    ]
    ratio = seconds["whole"].over(seconds["quality"] * 2 + seconds["around"])
    what = f"one small tangle in {len(faces):,} / (2 quality + surroundings alone)"
    return ratio_row(6, what, ratio, 1.0, details, good)


def stragglers(s: Setting) -> list[Row]:
    """T7: 200 easy meshes and a hard one together over the easy ones alone plus the hard one alone."""
    gates = [domains.case("gate", s.small, i, s.cache).mesh for i in range(20)]
    easy = tm.join((gates * 10)[: min(200, 10 * s.meshes)])
    bars = [domains.case("bar", s.small, i, s.cache).mesh for i in range(20)]
    hard = max(bars, key=lambda mesh: int(tm.quality(mesh).inverted))
    rows = []
    for name, straggler in (
        ("the bar with most inverted", hard),
        (f"a bar of {s.medium:,}", domains.case("bar", s.medium, 0, s.cache).mesh),
    ):
        both = tm.join([easy, straggler])
        seconds = interleaved(
            {
                "easy": lambda: tm.improve(easy) and None,
                "hard": lambda: tm.improve(straggler) and None,  # noqa: B023
                "both": lambda: tm.improve(both) and None,  # noqa: B023
            },
            s.repeats,
        )
        details = [f"easy {seconds['easy']}, hard {seconds['hard']}, together {seconds['both']}"]
        ratio = seconds["both"].over(seconds["easy"] + seconds["hard"])
        rows.append(ratio_row(7, f"{len(easy)} easy and {name} / each alone", ratio, 1.2, details))
    return rows


TARGETS: dict[int, Callable[[Setting], list[Row]]] = {
    1: batch,
    2: single,
    3: larger,
    4: iteration,
    5: flips,
    6: growth,
    7: stragglers,
}


def _keep(result: list[MeshBatch], mesh: MeshBatch, options: ImproveOptions | None = None) -> None:
    result[:] = [tm.improve(mesh, options)[0]]


def _smooth(mesh: MeshBatch, steps: int, counts: dict[int, tm.MoveInfo]) -> None:
    _, counts[steps] = tm.smooth(mesh, tm.SmoothOptions(max_iterations=steps, energy_tolerance=0, gradient_tolerance=0))


def _all_by_gmsh(cases: list[Case], outcomes: list[list[peers.Outcome]]) -> Seconds:
    outcomes[:] = [[peers.gmsh(*case.arrays) for case in cases]]
    total = Seconds(0, 0)
    for outcome in outcomes[0]:
        total += outcome.seconds
    return total


def _least(seconds: list[Seconds]) -> Seconds:
    best = seconds[0]
    for other in seconds[1:]:
        best = best.least(other)
    return best


def _quality(mesh: MeshBatch) -> tuple[str, bool]:
    """In words, and whether it is what the targets ask for: valid, IMR average <= 1.08, maximum <= 2.5."""
    q = tm.quality(mesh)
    bad = int((q.inverted > 0).sum())
    mean, worst = float(q.mean.max()), float(q.max.max())
    words = f"{int(q.inverted.sum())} inverted in {bad} of {len(mesh)} meshes, IMR at worst {mean:.3f} / {worst:.2f}"
    return words, bad == 0 and mean <= 1.08 and worst <= 2.5


def table(rows: list[Row]) -> str:
    lines = ["| target | what | ratio | cpu ratio | goal | met |", "|---|---|---|---|---|---|"]
    for row in rows:
        shown = [f"{x:.3g}" if x is not None else "-" for x in (row.ratio, row.cpu_ratio, row.goal)]
        met = {True: "yes", False: "**no**", None: "-"}[row.met]
        lines.append(f"| T{row.target} | {row.what} | {' | '.join(shown)} | {met} |")
    return "\n".join(lines)


def main(
    cache: Annotated[Path, typer.Option(help="Directory where the meshes are kept.")],
    only: Annotated[list[int] | None, typer.Option(help="Measure this target only; may be repeated.")] = None,
    repeats: Annotated[int, typer.Option(help="Rounds to take minima over.")] = 3,
    meshes: Annotated[int, typer.Option(help="Meshes in the batch of T1.")] = 60,
    small: Annotated[int, typer.Option(help="Triangles of the meshes of T1, T2, T7.")] = 2_200,
    medium: Annotated[int, typer.Option(help="Triangles of T3, and where T6 starts.")] = 20_000,
    large: Annotated[int, typer.Option(help="Triangles of T5 and T6, half of those in T4.")] = 200_000,
    full: Annotated[bool, typer.Option(help="1,000,000 triangles in T5 and T6.")] = False,
    out: Annotated[Path | None, typer.Option(help="Write the rows here as JSON, too.")] = None,
) -> None:
    """Print the measured ratio of every target beside its goal, and how it was measured."""
    one_thread()
    setting = Setting(cache, repeats, meshes, small, medium, large, full)
    rows: list[Row] = []
    typer.echo(machine())
    for number in only or list(TARGETS):
        measure = TARGETS[number]
        typer.echo(f"\n{measure.__doc__}")
        with Stopwatch() as watch:
            try:
                found = measure(setting)
            except peers.Missing as missing:
                found = [Row(number, str(missing), None, None, None, None)]
        for row in found:
            typer.echo("\n".join(f"    {line}" for line in row.details))
            if row.ratio is not None:
                verdict = {True: "met", False: "NOT met", None: "the measure of the others"}[row.met]
                typer.echo(f"  {row.what}: {row.ratio:.3g} (cpu {row.cpu_ratio:.3g}), goal {row.goal}: {verdict}")
        typer.echo(f"  measured in {watch.seconds.wall:.0f} s; {machine()}")
        rows += found
    typer.echo(f"\n{table(rows)}")
    if out is not None:
        out.write_text(json.dumps({"machine": machine(), "rows": [asdict(row) for row in rows]}, indent=1))


if __name__ == "__main__":
    typer.run(main)
