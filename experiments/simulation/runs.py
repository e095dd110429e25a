"""The simulation by one way, step by step, and how far it is from a fine one."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import torch

import torchmesh as tm
from experiments.simulation import heat
from experiments.simulation.ways import Way, on_disc
from torchmesh.transferring.transfer import Method

STEPS, DURATION, TRAVEL = 80, 8.0, 2.0


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


# Takes a mesh, the number of the step that begins and the number of all steps to where its body is after it.
Motion = Callable[[tm.MeshBatch, int, int], torch.Tensor]


def there_and_back(mesh: tm.MeshBatch, k: int, steps: int) -> torch.Tensor:
    """(V, 2) the positions where the disc of the channel has gone a step further."""
    goal = mesh.points.clone()
    shift = TRAVEL * (1 - abs(1 - 2 * k / steps)) - TRAVEL * (1 - abs(1 - 2 * (k - 1) / steps))
    goal[on_disc(mesh), 0] += shift
    return goal


def simulated(
    mesh: tm.MeshBatch,
    way: Way,
    method: Method,
    steps: int,
    frame: Callable[[Run], None] | None = None,
    motion: Motion = there_and_back,
    hot: tuple[float, float, float] = (2.2, 1.2, 0.2),
) -> Run:
    """The simulation by one way; it ends early if a triangle inverts.

    motion  how the body moves
    hot     x and y of the middle of the heat at the start, and the square of its width
    """
    u = torch.exp(-((mesh.points - torch.tensor(hot[:2])) ** 2).sum(1) / hot[2])
    begun = heat.heat(mesh, u)
    run = Run(mesh, u)
    for k in range(1, steps + 1):
        goal = motion(run.mesh, k, steps)
        clock = time.process_time()
        pieces, after = way(run.mesh, goal)
        run.meshing.append(time.process_time() - clock)
        run.solving.append(0.0)
        if int(tm.quality(after).inverted[0]):
            run.dead = k
            break
        for previous, before, then, part in pieces:
            clock = time.process_time()
            if previous is not None:
                u = tm.transfer(previous, before, u, method=method)
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
