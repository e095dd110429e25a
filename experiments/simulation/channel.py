"""Which way to move the mesh keeps the solution right in the time loop of a simulation, and what does it cost?

    python -m experiments.simulation.channel

A disc travels four diameters through a channel and back, in 80 steps; a bump of heat spreads round it, conservatively,
in coordinates that move with the mesh (`experiments/simulation/heat.py`).  Each way moves the mesh step by step.  The
table has the drift of the heat; the error at the end, in the L2 norm, against a mesh of about four times as many
triangles on which the triangles are kept; the least angle; how often the mesh was changed at rest; and the processor
time of a step in milliseconds, for meshing with transfers and for the solver.  The plots have drift, least angle and
meshing over time.

    deform, when        beyond 10 degrees flips and smoothing; L2 projection.  The way of the guide
    deform              flips and smoothing in each step; L2 projection, or interpolation
    deform, left        the same, values left on vertices that were moved
    deform, keep        triangles stay: ALE alone
    femwarp, improve    as deform, when, by hand
    femwarp, gmsh       beyond 10 degrees the inside is meshed anew, with the same boundary; L2 projection
    elasticity, rbf     step by step (see `experiments/quality/layers.py`): ALE alone
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

import torchmesh as tm
from experiments.shared import arguments, clocks, tables
from experiments.simulation.pictures import draw, film
from experiments.simulation.runs import STEPS, Run, error, simulated
from experiments.simulation.ways import WAYS, channel, deforming


def row_of(name: str, run: Run, fine: Run) -> list[str]:
    """The row of a way in the table."""
    if run.dead is not None:
        return [name, f"dead in step {run.dead}", "", f"{min(run.angle, default=0):.1f}", "", "", ""]
    mean = [1e3 * float(np.mean(times)) for times in (run.meshing, run.solving)]
    return [name, f"{run.drift[-1]:.1e}", f"{100 * error(run, fine):.1f} %", f"{min(run.angle):.1f}", str(run.changes),
            f"{mean[0]:.0f}", f"{mean[1]:.0f}"]  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("--size", type=float, default=0.085, help="length of edges at the walls")
    parser.add_argument("--steps", type=int, default=STEPS, help="steps there and back")
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS), help="the ways to compare")
    parser.add_argument("--film", action="store_true", help="make a film of the way of the guide, too")
    arguments.add_out(parser, "simulation")
    args = arguments.parse(parser, argv)
    args.out.mkdir(parents=True, exist_ok=True)
    mesh = channel(args.size)
    keep = tm.DeformOptions(topology="keep", when=tm.Bound(angle=2.0))
    fine = simulated(channel(args.size / 2), deforming(keep), "linear", args.steps)
    runs = {name: simulated(mesh, *WAYS[name], args.steps) for name in args.ways}
    print(clocks.machine())
    print(f"\n{len(mesh.triangles):,} triangles, {args.steps} steps\n")
    head = ["way", "heat drift", "error", "least angle", "changes at rest", "meshing, ms", "solver, ms"]
    print(tables.table(head, [row_of(name, run, fine) for name, run in runs.items()]))
    draw(runs, args.out)
    if args.film:
        film(args.out, args.size, args.steps)
    return 0


if __name__ == "__main__":
    sys.exit(main())
