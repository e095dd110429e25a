"""Speed targets of the parts: an iteration of L-BFGS against a compiled loop, flips against libigl."""

from __future__ import annotations

import numpy as np

import torchmesh as tm
from experiments.shared import clocks, domains, peers
from experiments.speed import references
from experiments.speed.target_rows import Row, Setting, ratio_row
from torchmesh.bench.exact_check import inverted


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
        seconds = clocks.interleaved(
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
    result: list[tuple[tm.MeshBatch, tm.FlipInfo]] = []

    def ours() -> None:
        result[:] = [tm.flip_to_delaunay(mesh)]

    seconds = clocks.interleaved(
        {"ours": ours, "libigl": lambda: peers.libigl(points, triangles, mesh.fixed.numpy()).seconds},
        s.repeats,
    )
    flipped, info = result[0]
    made = flipped.triangles.numpy()
    before, after = references.not_delaunay(points, triangles), references.not_delaunay(points, made)
    same = len(references.interior_edges(made)) == len(references.interior_edges(triangles))
    valid = inverted(points, made) == 0
    details = [
        f"{len(triangles):,} triangles, {before:,} edges not Delaunay: ours {seconds['ours']},"
        f" libigl {seconds['libigl']}",
        f"{int(info.flips.sum()):,} flips; after them {after} edges not Delaunay (exact), as many interior edges:"
        f" {same},"
        f" all triangles valid: {valid}",
    ]
    ratio = seconds["ours"].over(seconds["libigl"])
    good = after == 0 and same and valid
    return [ratio_row(5, f"flips, {len(triangles):,} triangles / libigl", ratio, 0.4, details, good)]


def _smooth(mesh: tm.MeshBatch, steps: int, counts: dict[int, tm.MoveInfo]) -> None:
    _, counts[steps] = tm.smooth(mesh, tm.SmoothOptions(max_iterations=steps, energy_tolerance=0, gradient_tolerance=0))
