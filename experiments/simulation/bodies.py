"""Does the way of the guide hold for other bodies and motions: heat, error, and time beside the solver?

    python -m experiments.simulation.bodies

Heat round bodies that move in a box, as in `experiments/simulation/channel.py`: a square block on a diagonal and back,
an ellipse that turns once about itself, two discs that pass each other and come back, a wall that is pushed in and out,
and an airfoil that flaps by 25 degrees.  `deform` with a bound of 10 degrees is compared with FEMWARP and gmsh anew
beyond 10 degrees; both transfer conservatively at a change.  The error is that against a mesh of about four times as
many triangles.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

import numpy as np
import torch

import torchmesh as tm
from experiments.shared import arguments, clocks, tables
from experiments.simulation.runs import STEPS, Motion, Run, error, simulated
from experiments.simulation.ways import WAYS
from torchmesh.bench.methods import gmsh_mesher
from torchmesh.mesh.boundary_parts import boundary_parts

COMPARED = ("deform, when, L2", "femwarp, gmsh, L2")
# A mesh with edges of the length given, how its boundary moves, and the heat at the start.
Body = tuple[tm.MeshBatch, Motion, tuple[float, float, float]]


def sized(points: np.ndarray | list[tuple[float, float]], size: float) -> np.ndarray:
    """(N, 3) a closed line, with the length of edges there."""
    p = np.asarray(points, float)
    return np.concatenate([p, np.full((len(p), 1), size)], 1)


def box(width: float, height: float, size: float) -> np.ndarray:
    return sized([(0, 0), (width, 0), (width, height), (0, height)], size)


def curve(at: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], size: float) -> np.ndarray:
    """The closed curve at(t) for t from 0 to 2 pi, in edges of equal length."""
    t = np.linspace(0, 2 * np.pi, 4001)
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(np.stack(at(t), 1), axis=0), axis=1))])
    count = max(12, int(way[-1] / size))
    return sized(np.stack(at(np.interp(np.linspace(0, way[-1], count + 1)[:-1], way, t)), 1), size)


def circle(x: float, y: float, radius: float, size: float) -> np.ndarray:
    return curve(lambda t: (x + radius * np.cos(t), y + radius * np.sin(t)), size)


def meshed(*lines: np.ndarray) -> tm.MeshBatch:
    return tm.MeshBatch.from_arrays(*gmsh_mesher.triangulate(list(lines)))


def holes(mesh: tm.MeshBatch) -> list[torch.Tensor]:
    """The vertices of each hole, the lowest hole first."""
    found = [rows for name, rows in boundary_parts(mesh).items() if name.startswith("hole")]
    return sorted(found, key=lambda rows: float(mesh.points[rows, 1].mean()))


def there_and_back(k: int, steps: int) -> float:
    """How far step k goes, where the whole way is 1."""
    return (1 - abs(1 - 2 * k / steps)) - (1 - abs(1 - 2 * (k - 1) / steps))


def shifted(*ways: tuple[float, float]) -> Motion:
    """Each hole goes its way and comes back."""

    def motion(mesh: tm.MeshBatch, k: int, steps: int) -> torch.Tensor:
        goal = mesh.points.clone()
        for rows, way in zip(holes(mesh), ways, strict=True):
            goal[rows] += there_and_back(k, steps) * torch.tensor(way, dtype=goal.dtype)
        return goal

    return motion


def turned(x: float, y: float, angle: Callable[[float], float]) -> Motion:
    """The hole stands at angle(t) about (x, y) when the part t of the time has passed."""

    def motion(mesh: tm.MeshBatch, k: int, steps: int) -> torch.Tensor:
        goal, (rows,) = mesh.points.clone(), holes(mesh)
        by, middle = angle(k / steps) - angle((k - 1) / steps), goal.new_tensor([x, y])
        cos, sin = np.cos(by), np.sin(by)
        goal[rows] = (goal[rows] - middle) @ goal.new_tensor([[cos, sin], [-sin, cos]]) + middle
        return goal

    return motion


def pushed(mesh: tm.MeshBatch, k: int, steps: int) -> torch.Tensor:
    """The right wall of a box of length 4 goes to 2.2 and back; what is left of 1.6 stays."""
    ends = [4 - 1.8 * np.sin(np.pi * j / steps) ** 2 for j in (k - 1, k)]
    goal, moves = mesh.points.clone(), mesh.fixed & (mesh.points[:, 0] > 1.6)
    goal[moves, 0] = 1.6 + (goal[moves, 0] - 1.6) * (ends[1] - 1.6) / (ends[0] - 1.6)
    return goal


def airfoil(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """NACA 0012, its nose at (1.5, 1.5)."""
    x = 0.5 * (1 + np.cos(t))
    half = 0.6 * (0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
    return 1.5 + x, 1.5 + np.sign(np.sin(t)) * half


def ellipse(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return 2 + 0.8 * np.cos(t), 1.5 + 0.2 * np.sin(t)


def bodies(h: float) -> dict[str, Callable[[], Body]]:
    """The bodies by name, in meshes whose edges are h long at the walls and less at the bodies."""
    block = [(0.6, 0.6), (1.1, 0.6), (1.1, 1.1), (0.6, 1.1)]
    discs = circle(1, 0.9, 0.25, h / 2), circle(3, 2.1, 0.25, h / 2)
    return {
        "block": lambda: (meshed(box(4, 3, h), sized(block, h / 2)), shifted((2.2, 1.2)), (2.0, 1.5, 0.15)),
        "ellipse": lambda: (
            meshed(box(4, 3, h), curve(ellipse, h / 2)), turned(2, 1.5, lambda t: 2 * np.pi * t), (1.0, 0.8, 0.1)
        ),
        "two discs": lambda: (meshed(box(4, 3, h), *discs), shifted((2, 0), (-2, 0)), (2.0, 1.5, 0.15)),
        "wall": lambda: (meshed(box(4, 2, h), circle(1, 1, 0.3, h / 2)), pushed, (2.0, 1.0, 0.1)),
        "airfoil": lambda: (
            meshed(box(4, 3, h), curve(airfoil, h / 3)),
            turned(1.75, 1.5, lambda t: np.radians(25) * np.sin(2 * np.pi * t)), (2.7, 1.5, 0.1),
        ),
    }  # fmt: skip


def row_of(name: str, way: str, count: int, run: Run, fine: Run) -> list[str]:
    """The row of a body and a way in the table."""
    if run.dead is not None:
        return [name, f"{count:,}", way, f"dead in step {run.dead}", *[""] * 6]
    mean = [1e3 * float(np.mean(times)) for times in (run.meshing, run.solving)]
    return [name, f"{count:,}", way, f"{run.drift[-1]:.1e}", f"{100 * error(run, fine):.1f} %", f"{min(run.angle):.1f}",
            str(run.changes), f"{mean[0]:.0f}", f"{mean[1]:.0f}", f"{mean[0] / mean[1]:.2f}"]  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("--size", type=float, default=0.1, help="length of edges at the walls")
    parser.add_argument("--steps", type=int, default=STEPS, help="steps of each motion")
    parser.add_argument("--bodies", nargs="+", choices=list(bodies(1)), default=list(bodies(1)), help="which bodies")
    args = arguments.parse(parser, argv)
    rows = []
    for name in args.bodies:
        mesh, motion, hot = bodies(args.size)[name]()
        fine = simulated(bodies(args.size / 2)[name]()[0], *WAYS[COMPARED[0]], args.steps, motion=motion, hot=hot)
        for way in COMPARED:
            run = simulated(mesh, *WAYS[way], args.steps, motion=motion, hot=hot)
            rows.append(row_of(name, way, len(mesh.triangles), run, fine))
    print(clocks.machine())
    head = ["body", "triangles", "way", "heat drift", "error", "least angle", "changes", "meshing, ms", "solver, ms",
            "meshing over solver"]  # fmt: skip
    print(tables.table(head, rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
