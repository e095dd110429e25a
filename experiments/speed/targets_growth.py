"""Speed targets of large meshes: how time grows with the number of triangles, and what one small tangle costs."""

from __future__ import annotations

from functools import reduce

import numpy as np
import torch

import torchmesh as tm
from experiments.shared import clocks, domains
from experiments.speed.fresh_process import GROWTH
from experiments.speed.target_rows import Row, Setting, acceptable, improve_into, judge, ratio_row
from torchmesh.bench.exact_check import double_areas
from torchmesh.bench.stopwatch import Seconds


def growth(s: Setting) -> list[Row]:
    """T6: seconds per triangle and peak memory of improve as the same tangled circle grows; a small tangle."""
    base: Seconds | None = None
    rows = []
    for count, goal in ((s.medium, None), (s.large, 1.5), *([(s.largest, 2.0)] if s.full else [])):
        path = domains.case("circle", count, 0, s.cache).path
        runs = [clocks.in_fresh_process(GROWTH, path) for _ in range(s.repeats if count < 1_000_000 else 1)]
        run = runs[-1]
        each = reduce(Seconds.least, [Seconds(r["wall"], r["cpu"]) for r in runs]) * (1e6 / run["triangles"])
        base = base or each
        good = run["inverted"] == 0 and acceptable(run["mean"], run["max"]) and run["peak"] < 4  # GiB
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
    """T6: improve on a large mesh with one small tangle over twice its quality plus the tangle's surroundings alone."""
    case = domains.case("circle", s.largest, 0, s.cache)
    points = case.valid.copy()
    faces, fixed = case.mesh.triangles.numpy(), case.mesh.fixed.numpy()
    spacing = float(np.sqrt(np.median(double_areas(points, faces))))
    distance = np.hypot(points[:, 0] - 14, points[:, 1] - 4)
    core = (distance < 4 * spacing) & ~fixed
    points[core] += 1.5 * spacing * np.random.default_rng(3).standard_normal((int(core.sum()), 2))
    whole = case.mesh.with_points(torch.from_numpy(points))
    near = (distance < 30 * spacing)[faces].all(1)
    used, local = np.unique(faces[near], return_inverse=True)
    around = tm.MeshBatch.from_arrays(case.valid[used], local.reshape(-1, 3)).with_points(
        torch.from_numpy(points[used])
    )
    result: list[tm.MeshBatch] = []
    seconds = clocks.interleaved(
        {
            "whole": lambda: improve_into(result, whole),
            "quality": lambda: tm.quality(whole) and None,
            "around": lambda: tm.improve(around) and None,
        },
        s.repeats,
    )
    words, good = judge(result[-1])
    before, _ = judge(whole)
    details = [
        f"before {before}; after {words}",
        f"improve {seconds['whole']}, quality {seconds['quality']}, improve on the {len(around.triangles):,} triangles "
        f"around alone {seconds['around']}",
    ]
    ratio = seconds["whole"].over(seconds["quality"] * 2 + seconds["around"])
    what = f"one small tangle in {len(faces):,} / (2 quality + surroundings alone)"
    return ratio_row(6, what, ratio, 1.0, details, good)
