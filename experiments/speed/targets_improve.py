"""Speed targets of `improve`: on a batch, on one mesh, on a larger one, and on a batch with a hard mesh in it."""

from __future__ import annotations

import os
from functools import reduce

import torch

import torchmesh as tm
from experiments.shared import clocks, domains, peers
from experiments.speed.fresh_process import FIRST_CALL
from experiments.speed.target_rows import Row, Setting, acceptable, improve_into, judge, ratio_row
from torchmesh.bench.exact_check import inverted
from torchmesh.bench.stopwatch import Seconds


def batch(s: Setting) -> list[Row]:
    """T1: improve on a batch, per mesh, over gmsh on the same meshes one by one.

    Ours runs on all processors, as `improve` does by default where torch has that many threads, then on one, and with
    the fast options.
    """
    cases = domains.variants(s.meshes, s.small, s.cache)
    joined = tm.join([c.mesh for c in cases])
    result: list[tm.MeshBatch] = []
    quick: list[tm.MeshBatch] = []
    outcomes: list[list[peers.Outcome]] = []
    seconds = clocks.interleaved(
        {
            "ours": lambda: improve_into(result, joined, tm.ImproveOptions(workers=os.cpu_count())),
            "ours on one processor": lambda: improve_into(result, joined),
            "ours, fast": lambda: improve_into(quick, joined, tm.ImproveOptions.fast(workers=os.cpu_count())),
            "gmsh": lambda: _all_by_gmsh(cases, outcomes),
        },
        s.repeats,
    )
    words, good = judge(result[-1])
    quick_words, quick_good = judge(quick[-1])
    left = sum(inverted(o.points, o.triangles) > 0 for o in outcomes[-1])
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
        runs, theirs = [], []
        for _ in range(s.repeats):
            runs.append(clocks.in_fresh_process(FIRST_CALL, case.path))
            theirs.append(peers.gmsh(*case.arrays).seconds)
        times = {
            name: reduce(Seconds.least, [Seconds(**run[name]) for run in runs]) for name in ("load", "first", "second")
        }
        own, peer = times["load"] + times["first"], reduce(Seconds.least, theirs)
        ours, warm, gmsh = ours + own, warm + times["second"], gmsh + peer
        last = runs[-1]
        good &= last["valid"] and acceptable(last["mean"], last["max"])
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
    result: list[tm.MeshBatch] = []
    outcomes: list[peers.Outcome] = []

    def theirs() -> Seconds:
        outcomes.append(peers.mfem_best(*case.arrays))
        return outcomes[-1].seconds

    seconds = clocks.interleaved({"ours": lambda: improve_into(result, case.mesh), "mfem": theirs}, s.repeats)
    words, good = judge(result[-1])
    moved, _ = judge(case.mesh.with_points(torch.from_numpy(outcomes[-1].points)))
    before, _ = judge(case.mesh)
    details = [
        f"before {before}",
        f"ours {seconds['ours']}, {words}",
        f"MFEM {seconds['mfem']}, {moved}, {outcomes[-1].note}",
    ]
    return [
        ratio_row(3, f"circle of {s.medium:,} / MFEM TMOP", seconds["ours"].over(seconds["mfem"]), 0.5, details, good)
    ]


def stragglers(s: Setting) -> list[Row]:
    """T7: improve on 200 easy meshes and a hard one together over the easy ones alone plus the hard one alone."""
    kinds = min(20, s.meshes)
    gates = [domains.case("gate", s.small, i, s.cache).mesh for i in range(kinds)]
    easy = tm.join((gates * 10)[: min(200, 10 * s.meshes)])
    bars = [domains.case("bar", s.small, i, s.cache).mesh for i in range(kinds)]
    hard = max(bars, key=lambda mesh: int(tm.quality(mesh).inverted))
    rows = []
    for name, straggler in (
        ("the bar with most inverted", hard),
        (f"a bar of {s.medium:,}", domains.case("bar", s.medium, 0, s.cache).mesh),
    ):
        both = tm.join([easy, straggler])
        seconds = clocks.interleaved(
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


def _all_by_gmsh(cases: list[domains.Case], outcomes: list[list[peers.Outcome]]) -> Seconds:
    outcomes[:] = [[peers.gmsh(*case.arrays) for case in cases]]
    return reduce(Seconds.__add__, [outcome.seconds for outcome in outcomes[0]])
