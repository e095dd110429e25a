"""Are lift and drag right on a mesh that follows its body?  Flow past a cylinder that oscillates, in NGSolve.

    pip install "torchmesh-untangle[simulation]"
    python -m experiments.simulation.cylinder

A cylinder of diameter 1 moves across a stream of Reynolds number 100 from rest, up by 1.5 diameters and back down, at
a frequency near that of its wake.  The flow is computed three times, with the same triangles at the start and the same
steps (`experiments/simulation/flow.py`):

    at rest    in the frame of the cylinder: the mesh stands still, the stream moves, and the fluid feels the
               acceleration of the frame.  Nothing of the mesh's motion can be wrong, so this is the reference
    deform     the cylinder moves through the mesh: `deform` with a bound, ALE along the trail, and the velocity
               interpolated where the mesh was changed
    deform, keep   the same with the triangles kept

The table has the mean drag and the root mean square of the lift after the first period; how far each is from the
reference, as the root mean square of the difference over that of the reference; the least angle; changes at rest; and
the processor time of a step, for meshing and for the solver.  The plot has drag and lift over time.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

import torchmesh as tm
from experiments.shared import arguments, clocks, tables
from experiments.simulation.pictures import draw_forces
from torchmesh.bench.methods import gmsh_mesher
from torchmesh.mesh.boundary_parts import boundary_parts

STROKE, PERIOD = 1.5, 6.0
# Walls nearer than that are felt: at 8 diameters they change the lift of the moving cylinder by a tenth.
LEFT, RIGHT, HALF = -16.0, 16.0, 20.0
BOUND = tm.Bound(angle=20.0)


@dataclass
class Run:
    """The forces in each step, the least angles, and the times of meshing and solving."""

    drag: list[float] = field(default_factory=list)
    lift: list[float] = field(default_factory=list)
    angle: list[float] = field(default_factory=list)
    meshing: list[float] = field(default_factory=list)
    solving: list[float] = field(default_factory=list)
    changes: int = 0


def domain(size: float) -> tm.MeshBatch:
    """The domain at the start; `size` is the length of edges at the cylinder."""
    angle = np.arange(0, 2 * np.pi, 2 * size)
    cylinder = np.stack([0.5 * np.cos(angle), 0.5 * np.sin(angle), np.full_like(angle, size)], 1)
    far = 20 * size
    box = np.array([(LEFT, -HALF, far), (RIGHT, -HALF, far), (RIGHT, HALF, far), (LEFT, HALF, far)])
    return tm.MeshBatch.from_arrays(*gmsh_mesher.triangulate([box, cylinder]))


def height(t: float) -> float:
    """Where the cylinder is at a time."""
    return STROKE * (1 - np.cos(2 * np.pi * t / PERIOD)) / 2


def at_rest(mesh: tm.MeshBatch, steps: int, dt: float) -> Run:
    """In the frame of the cylinder."""
    from experiments.simulation.flow import Flow

    run, body = Run(), on_body(mesh)
    flow = Flow.on(mesh, body)
    flow.state.components[0].vec.FV().NumPy()[: len(mesh.points)] = 1.0
    before = 0.0
    for k in range(1, steps + 1):
        clock = time.process_time()
        speed = (height(k * dt) - height((k - 1) * dt)) / dt
        # The fluid is carried at its speed before, seen from the frame as it is after the step: so it is in the lab.
        faster = np.tile([0.0, speed - before], (len(mesh.points), 1))
        forces = flow.step(dt, (1.0, -speed), (0.0, 0.0), faster, force=-(speed - before) / dt)
        note(run, forces, mesh, 0.0, time.process_time() - clock)
        before = speed
    return run


def on_body(mesh: tm.MeshBatch) -> np.ndarray:
    """(V,) bool: the vertices of the cylinder."""
    mask = np.zeros(len(mesh.points), bool)
    mask[boundary_parts(mesh)["hole:1"].numpy()] = True
    return mask


def moving(mesh: tm.MeshBatch, steps: int, dt: float, options: tm.DeformOptions) -> Run:
    """The mesh follows the cylinder."""
    from experiments.simulation.flow import Flow

    run, body = Run(), on_body(mesh)
    flow = Flow.on(mesh, body)
    flow.state.components[0].vec.FV().NumPy()[: len(mesh.points)] = 1.0
    for k in range(1, steps + 1):
        clock = time.process_time()
        goal = mesh.points.clone()
        way = height(k * dt) - height((k - 1) * dt)
        goal[torch.from_numpy(body), 1] += way
        mesh, report = tm.deform(mesh, goal, options=options, trail=True)
        report.check()
        meshing, forces = time.process_time() - clock, (0.0, 0.0)
        clock = time.process_time()
        assert report.trail is not None
        for piece in report.trail[0]:
            if piece.previous is not None:
                flow, run.changes = flow.seen_on(piece.before, body), run.changes + 1
            if piece.end > piece.start:
                flow = Flow.on(piece.after, body, flow.values)
                part = (piece.end - piece.start) * dt
                forces = flow.step(part, (1.0, 0.0), (0.0, way / dt), piece.velocity(dt).numpy())
        note(run, forces, mesh, meshing, time.process_time() - clock)
    return run


def note(run: Run, forces: tuple[float, float], mesh: tm.MeshBatch, meshing: float, solving: float) -> None:
    """Write down a step; coefficients are twice the forces, as the cylinder is 1 wide and the stream 1 fast."""
    run.drag.append(2 * forces[0])
    run.lift.append(2 * forces[1])
    run.angle.append(float(tm.minimum_angle(mesh)[0]))
    run.meshing.append(meshing)
    run.solving.append(solving)


def row_of(name: str, run: Run, reference: Run, first: int) -> list[str]:
    """The row of a run in the table, by the steps from `first` on."""

    def rms(values: Sequence[float]) -> float:
        return float(np.sqrt(np.mean(np.square(values[first:]))))

    def far(mine: list[float], theirs: list[float]) -> str:
        return f"{100 * rms(np.subtract(mine, theirs)) / rms(theirs):.1f} %"

    return [
        name, f"{np.mean(run.drag[first:]):.3f}", f"{rms(run.lift):.3f}", far(run.drag, reference.drag),
        far(run.lift, reference.lift), f"{min(run.angle):.1f}", str(run.changes),
        f"{1e3 * np.mean(run.meshing):.0f}", f"{1e3 * np.mean(run.solving):.0f}",
    ]  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("--size", type=float, default=0.1, help="length of edges at the cylinder, in diameters")
    parser.add_argument("--steps", type=int, default=50, help="steps a period")
    parser.add_argument("--periods", type=int, default=2, help="how often the cylinder goes up and down")
    arguments.add_out(parser, "simulation")
    args = arguments.parse(parser, argv)
    args.out.mkdir(parents=True, exist_ok=True)
    mesh, steps, dt = domain(args.size), args.steps * args.periods, PERIOD / args.steps
    runs = {
        "at rest": at_rest(mesh, steps, dt),
        "deform": moving(mesh, steps, dt, tm.DeformOptions(when=BOUND)),
        "deform, keep": moving(mesh, steps, dt, tm.DeformOptions(topology="keep", when=BOUND)),
    }
    print(clocks.machine())
    print(f"\n{len(mesh.triangles):,} triangles, {steps} steps\n")
    head = [
        "way",
        "drag",
        "lift",
        "drag differs",
        "lift differs",
        "least angle",
        "changes",
        "meshing, ms",
        "solver, ms",
    ]
    first = args.steps if args.periods > 1 else 0
    print(tables.table(head, [row_of(name, run, runs["at rest"], first) for name, run in runs.items()]))
    draw_forces({name: (run.drag, run.lift) for name, run in runs.items()}, dt, args.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
