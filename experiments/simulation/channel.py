"""Which way to move the mesh keeps the solution right in the time loop of a simulation, and what does it cost?

    python -m experiments.simulation.channel

A disc travels four diameters through a channel and back, in 80 steps; a bump of heat spreads round it, conservatively,
in coordinates that move with the mesh (`experiments/simulation/heat.py`).  Each way moves the mesh step by step.  The
table has the drift of the heat; the error at the end, in the L2 norm, against a mesh of about four times as many
triangles on which the triangles are kept; the least angle; how often the mesh was changed at rest; and the processor
time of a step in milliseconds, for meshing with transfers and for the solver.  The plots have drift, least angle and
meshing over time.

    deform, when        FEMWARP, and beyond 15 degrees flips and smoothing; L2 projection.  The way of the guide
    deform              flips and smoothing in each step; L2 projection, or interpolation
    deform, left        the same, values left on vertices that were moved
    deform, keep        triangles stay: ALE alone
    femwarp, improve    as deform, when, by hand
    femwarp, gmsh       beyond 15 degrees the inside is meshed anew, with the same boundary; L2 projection
    elasticity, rbf     step by step (see `experiments/quality/layers.py`): ALE alone
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

import torchmesh as tm
from experiments.quality import layers
from experiments.shared import arguments, clocks, gmsh_mesher, tables
from experiments.simulation import heat
from torchmesh.mesh.boundary_parts import boundary_parts

STEPS, DURATION, TRAVEL, RADIUS = 80, 8.0, 2.0, 0.25
LENGTH, HEIGHT = 6.0, 2.0
BOUND = tm.Bound(angle=15.0)

# What a way does in a step: the pieces (mesh to transfer from or None, before, after, part of the step), and the mesh.
Piece = tuple["tm.MeshBatch | None", tm.MeshBatch, tm.MeshBatch, float]
Way = Callable[[tm.MeshBatch, torch.Tensor], "tuple[list[Piece], tm.MeshBatch]"]


def channel(size: float) -> tm.MeshBatch:
    """The channel round the disc at its start; `size` is the length of edges at the walls, half of it at the disc."""
    angle = np.arange(0, 2 * np.pi, 0.5 * size / RADIUS)
    disc = np.stack([1 + RADIUS * np.cos(angle), 1 + RADIUS * np.sin(angle), np.full_like(angle, size / 2)], 1)
    walls = np.array([(0, 0, size), (LENGTH, 0, size), (LENGTH, HEIGHT, size), (0, HEIGHT, size)], float)
    return tm.MeshBatch.from_arrays(*gmsh_mesher.triangulate([walls, disc]))


def on_disc(mesh: tm.MeshBatch) -> torch.Tensor:
    """(V,) bool: the vertices of the disc."""
    mask = torch.zeros_like(mesh.fixed)
    mask[boundary_parts(mesh)["hole:1"]] = True
    return mask


def meshed_anew(mesh: tm.MeshBatch) -> tm.MeshBatch:
    """gmsh's mesh inside the same boundary edges."""
    loops = []
    for loop in boundary_parts(mesh).values():
        p = mesh.points[loop].numpy()
        size = 0.5 * (np.linalg.norm(p - np.roll(p, 1, 0), axis=1) + np.linalg.norm(p - np.roll(p, -1, 0), axis=1))
        loops.append(np.concatenate([p, size[:, None]], 1))
    return tm.MeshBatch.from_arrays(*gmsh_mesher.triangulate(loops, unsplit=range(len(loops))))


def deforming(options: tm.DeformOptions) -> Way:
    def way(now: tm.MeshBatch, goal: torch.Tensor) -> tuple[list[Piece], tm.MeshBatch]:
        after, report = tm.deform(now, goal, options=options, trail=True)
        report.check()
        assert report.trail is not None
        return [(p.previous, p.before, p.after, p.end - p.start) for p in report.trail[0]], after

    return way


def warping(mend: Callable[[tm.MeshBatch], tm.MeshBatch]) -> Way:
    """FEMWARP, and where `mend` gives back another mesh, a transfer to it."""

    def way(now: tm.MeshBatch, goal: torch.Tensor) -> tuple[list[Piece], tm.MeshBatch]:
        warped = tm.femwarp(now, goal)
        after = mend(warped)
        pieces: list[Piece] = [(None, now, warped, 1.0)]
        return pieces if after is warped else [*pieces, (warped, after, after, 0.0)], after

    return way


def improved(mesh: tm.MeshBatch) -> tm.MeshBatch:
    after, report = tm.improve(mesh, tm.ImproveOptions(when=BOUND))
    return after if int(report.moved[0]) or bool(report.rewired[0]) else mesh


def moving(move: Callable[[tm.MeshBatch, tm.MeshBatch], tm.MeshBatch]) -> Way:
    def way(now: tm.MeshBatch, goal: torch.Tensor) -> tuple[list[Piece], tm.MeshBatch]:
        after = move(now, now.with_points(goal))
        return [(None, now, after, 1.0)], after

    return way


def left(way: Way) -> Way:
    """As if nothing had moved but the solution with its vertices."""

    def moved(now: tm.MeshBatch, goal: torch.Tensor) -> tuple[list[Piece], tm.MeshBatch]:
        _, after = way(now, goal)
        return [(None, after, after, 1.0)], after

    return moved


WAYS: dict[str, tuple[Way, str]] = {
    "deform, when, L2": (deforming(tm.DeformOptions(when=BOUND)), "conservative"),
    "deform, L2": (deforming(tm.DeformOptions()), "conservative"),
    "deform, interpolation": (deforming(tm.DeformOptions()), "linear"),
    "deform, left": (left(deforming(tm.DeformOptions())), ""),
    "deform, keep": (deforming(tm.DeformOptions(topology="keep")), ""),
    "femwarp, improve, L2": (warping(improved), "conservative"),
    "femwarp, gmsh, L2": (
        warping(lambda mesh: meshed_anew(mesh) if float(tm.minimum_angle(mesh)[0]) < BOUND.angle else mesh),
        "conservative",
    ),
    "elasticity": (moving(layers.elasticity), ""),
    "rbf": (moving(layers.rbf), ""),
}


@dataclass
class Run:
    """What a way came to: the last mesh and its values, and a row a step."""

    mesh: tm.MeshBatch
    values: torch.Tensor
    drift: list[float] = field(default_factory=list)
    angle: list[float] = field(default_factory=list)
    meshing: list[float] = field(default_factory=list)
    solving: list[float] = field(default_factory=list)
    changes: int = 0
    dead: int | None = None


def simulated(mesh: tm.MeshBatch, way: Way, method: str, steps: int, frame: Callable[[Run], None] | None = None) -> Run:
    """The simulation by one way; it ends early if a triangle inverts."""
    u = torch.exp(-((mesh.points - torch.tensor([2.2, 1.2])) ** 2).sum(1) / 0.2)
    begun = heat.heat(mesh, u)
    run = Run(mesh, u)
    for k in range(1, steps + 1):
        clock = time.process_time()
        goal = run.mesh.points.clone()
        disc = on_disc(run.mesh)
        shift = TRAVEL * (1 - abs(1 - 2 * k / steps)) - TRAVEL * (1 - abs(1 - 2 * (k - 1) / steps))
        goal[disc, 0] += shift
        pieces, after = way(run.mesh, goal)
        run.meshing.append(time.process_time() - clock)
        run.solving.append(0.0)
        if int(tm.quality(after).inverted[0]):
            run.dead = k
            break
        for previous, before, then, part in pieces:
            clock = time.process_time()
            if previous is not None:
                u = tm.transfer(previous, before, u, method=method)  # type: ignore[call-overload]
                run.changes += 1
            run.meshing[-1] += time.process_time() - clock
            clock = time.process_time()
            if part:
                u = heat.step(before, then, u, part * DURATION / steps)
            run.solving[-1] += time.process_time() - clock
        run.mesh, run.values = after, u
        run.drift.append(abs(heat.heat(after, u) / begun - 1))
        run.angle.append(float(tm.minimum_angle(after)[0]))
        if frame is not None:
            frame(run)
    return run


def error(run: Run, fine: Run) -> float:
    """The relative L2 norm of the difference from the fine solution, on the mesh of the run."""
    exact = tm.transfer(fine.mesh, run.mesh, fine.values, method="conservative")
    q, t = tm.quality(run.mesh).area, run.mesh.triangles

    def square(v: torch.Tensor) -> float:
        return float((q * v[t].square().mean(1)).sum())

    return (square(run.values - exact) / square(exact)) ** 0.5


def row_of(name: str, run: Run, fine: Run) -> list[str]:
    """The row of a way in the table."""
    if run.dead is not None:
        return [name, f"dead in step {run.dead}", "", f"{min(run.angle, default=0):.1f}", "", "", ""]
    mean = [1e3 * float(np.mean(times)) for times in (run.meshing, run.solving)]
    return [name, f"{run.drift[-1]:.1e}", f"{100 * error(run, fine):.1f} %", f"{min(run.angle):.1f}", str(run.changes),
            f"{mean[0]:.0f}", f"{mean[1]:.0f}"]  # fmt: skip


def draw(runs: dict[str, Run], out: Path) -> None:
    """Drift, least angle and the time of meshing over the steps."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(3, 1, figsize=(8, 9), sharex=True, layout="constrained")
    for name, run in runs.items():
        axes[0].semilogy(np.maximum(run.drift, 1e-17), label=name)
        axes[1].plot(run.angle)
        axes[2].semilogy(1e3 * np.asarray(run.meshing))
    for axis, label in zip(axes, ("drift of the heat", "least angle, degrees", "meshing, ms"), strict=True):
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[2].set_xlabel("step")
    figure.legend(loc="outside right upper", fontsize=8)
    figure.savefig(out / "channel.png", dpi=110)
    plt.close(figure)


def film(out: Path, size: float, steps: int) -> None:
    """The way of the guide, as a film."""
    import matplotlib.pyplot as plt
    from matplotlib.animation import FuncAnimation, PillowWriter

    frames: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    way, method = WAYS["deform, when, L2"]
    simulated(
        channel(size), way, method, steps,
        lambda run: frames.append((run.mesh.points.numpy(), run.mesh.triangles.numpy(), run.values.numpy())),
    )  # fmt: skip
    figure, axis = plt.subplots(figsize=(9, 3.2), layout="constrained")

    def show(k: int) -> None:
        axis.clear()
        points, triangles, values = frames[k]
        axis.tripcolor(*points.T, triangles, values, shading="gouraud", vmin=0, vmax=0.5)
        axis.triplot(*points.T, triangles, color="white", lw=0.2, alpha=0.5)
        axis.set_aspect("equal")
        axis.set_axis_off()

    FuncAnimation(figure, show, len(frames)).save(out / "channel.gif", PillowWriter(10))  # type: ignore[arg-type]
    plt.close(figure)


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
    fine = simulated(channel(args.size / 2), deforming(keep), "", args.steps)
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
