"""Do the layers of an airfoil keep their heights in a time loop, and the solution its heat?

    python -m experiments.simulation.airfoil

A NACA 0012 airfoil with 12 rows of layers, whose first triangles are 50 times as long as high, pitches up by 10
degrees and back, in 80 steps, while a bump of heat spreads round it (`experiments/simulation/heat.py`).  Each way moves
the mesh step by step.  The table has the inverted triangles at the end; the ratios of the heights of the wall's first
triangles to what they were, lowest and highest; the drift of the heat; the difference from the same simulation with the
triangles kept; the least angle outside the layers; how often the mesh was changed at rest; and the processor time of a
step in milliseconds, for meshing with transfers and for the solver.

    deform              flips and smoothing in each step; layers are found and carried along
    deform, when        the same, only where an angle outside the layers is below 10 degrees
    deform, layer       the same, with the layer of the wall named: `layer="hole:1"`
    deform, rigid       the same, with the vertices of the layers told to follow their wall rigidly: `rigid=`
    deform, keep        triangles stay
    femwarp, improve    FEMWARP, and `improve` where an angle is below 10 degrees
    elasticity, rbf     step by step (see `experiments/quality/layers.py`)
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial

import numpy as np
import torch

import torchmesh as tm
from experiments.quality import layers
from experiments.shared import arguments, clocks, tables
from experiments.simulation.runs import STEPS, Run, error, simulated
from experiments.simulation.ways import BOUND, Piece, Way, deforming, improved, moving, warping
from torchmesh.transferring.transfer import Method

ROWS, GROWTH, DEGREES = 12, 1.3, 10.0
FIRST = 2 * np.pi * 0.5 / layers.SIDES / 50 * 0.65


def pitching(mesh: tm.MeshBatch, k: int, steps: int) -> torch.Tensor:
    """(V, 2) the positions where the airfoil has turned a step further, up to the full angle and back."""
    turn = DEGREES * ((1 - abs(1 - 2 * k / steps)) - (1 - abs(1 - 2 * (k - 1) / steps)))
    return layers.turned(mesh, turn).points


def followed(layer: str | None = None, rigid: torch.Tensor | None = None) -> Way:
    """`deform` with a bound, in which a layer or vertices follow their body as they are told to."""

    def way(now: tm.MeshBatch, goal: torch.Tensor) -> tuple[list[Piece], tm.MeshBatch]:
        options = tm.DeformOptions(when=BOUND)
        after, report = tm.deform(now, goal, options=options, trail=True, layer=layer, rigid=rigid)
        report.check()
        assert report.trail is not None
        return [(p.previous, p.before, p.after, p.end - p.start) for p in report.trail[0]], after

    return way


def ways(start: tm.MeshBatch) -> dict[str, tuple[Way, Method]]:
    """The ways by name; `start` is the mesh at the start."""
    rigid = torch.zeros_like(start.fixed)
    rigid[layers.SIDES : layers.SIDES * (ROWS + 1)] = True

    return {
        "deform": (deforming(tm.DeformOptions()), "conservative"),
        "deform, when": (deforming(tm.DeformOptions(when=BOUND)), "conservative"),
        "deform, layer": (followed(layer="hole:1"), "conservative"),
        "deform, rigid": (followed(rigid=rigid), "conservative"),
        "deform, keep": (deforming(tm.DeformOptions(topology="keep", when=BOUND)), "linear"),
        "femwarp, improve": (warping(improved), "conservative"),
        "elasticity": (moving(layers.elasticity), "linear"),
        "rbf": (moving(layers.rbf), "linear"),
    }


def row_of(name: str, run: Run, start: tm.MeshBatch, kept: Run) -> list[str]:
    """The row of a way in the table."""
    if run.dead is not None:
        return [name, f"dead in step {run.dead}", *[""] * 7]
    ratio = layers.first_heights(run.mesh) / layers.first_heights(start)
    outside = (run.mesh.triangles >= (ROWS + 1) * layers.SIDES).any(1)
    angle = tm.metrics.measure(run.mesh, "minimum_angle")[outside].min()
    mean = [1e3 * float(np.mean(times)) for times in (run.meshing, run.solving)]
    return [
        name, str(int(tm.quality(run.mesh).inverted[0])), f"{np.nanmin(ratio):.4g} - {np.nanmax(ratio):.4g}",
        f"{run.drift[-1]:.1e}", f"{100 * error(run, kept):.2g} %", f"{angle:.1f}", str(run.changes), f"{mean[0]:.0f}",
        f"{mean[1]:.0f}",
    ]  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("--steps", type=int, default=STEPS, help="steps up and back")
    args = arguments.parse(parser, argv)
    start = layers.airfoil(FIRST, GROWTH, ROWS)
    run = partial(simulated, steps=args.steps, motion=pitching, hot=(1.2, 0.3, 0.2))
    runs = {name: run(start, *way) for name, way in ways(start).items()}
    print(clocks.machine())
    print(f"\n{len(start.triangles):,} triangles, {args.steps} steps\n")
    head = ["way", "inverted", "first heights", "heat drift", "differs", "least angle", "changes", "meshing, ms",
            "solver, ms"]  # fmt: skip
    print(tables.table(head, [row_of(name, run, start, runs["deform, keep"]) for name, run in runs.items()]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
