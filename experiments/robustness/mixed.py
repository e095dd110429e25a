"""Meshes of triangles and quads, tangled, by `improve` and by MFEM's TMOP: time and success side by side.

    python -m experiments.robustness.mixed

    jittered  free vertices thrown off by a normal deviate of so many cells
    moved     a disc with three layers of quads round it, moved through its mesh and warped after by FEMWARP
    pitched   an ellipse with layers of quads, turned inside its far field and warped after by FEMWARP

Success is an exact sign: every triangle and every corner of a quad is upright, with the quads kept.  TMOP runs in four
units of length, of which the best counts, with the time of that one run alone.  Times are of the processor.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

import torchmesh as tm
from experiments.shared import arguments
from experiments.shared.tables import table
from torchmesh.bench.methods.mfem_tmop import mfem


@dataclass(frozen=True, eq=False)
class Case:
    """A family, what sets how hard it is, the tangled mesh, and the mesh it came from."""

    family: str
    hard: str
    mesh: tm.MeshBatch
    before: tm.MeshBatch


def grid(columns: int, quads: int) -> tm.MeshBatch:
    """A square of cells, quads in the first columns and halves of them in the others."""
    x, y = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    row = np.arange(x.size).reshape(x.shape)
    cells = np.stack([row[:-1, :-1], row[1:, :-1], row[1:, 1:], row[:-1, 1:]], 2)
    left, right = cells[:quads].reshape(-1, 4), cells[quads:].reshape(-1, 4)
    triangles = np.concatenate([right[:, [0, 1, 2]], right[:, [0, 2, 3]]])
    return tm.MeshBatch.from_arrays(np.stack([x.ravel(), y.ravel()], 1), triangles, quads=left)


def around(axes: tuple[float, float], sectors: int, rows: int, height: float, far: float) -> tm.MeshBatch:
    """Layers of quads round an ellipse, growing by 1.3 from `height`, and rings of triangles out to `far`."""
    angle = 2 * np.pi * np.arange(sectors) / sectors
    body = np.stack([axes[0] * np.cos(angle), axes[1] * np.sin(angle)], 1)
    normal = np.stack([np.cos(angle) / axes[0], np.sin(angle) / axes[1]], 1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    out = height * np.cumsum([0.0, *(1.3**k for k in range(rows))])
    layers = body + out[:, None, None] * normal
    circle = far * np.stack([np.cos(angle), np.sin(angle)], 1)
    share = np.linspace(0, 1, sectors // 3)[1:, None, None] ** 1.5
    points = np.concatenate([layers, layers[-1] + share * (circle - layers[-1])])
    k, i = np.meshgrid(np.arange(len(points) - 1), np.arange(sectors), indexing="ij")
    a, b = (k * sectors + i).ravel(), (k * sectors + (i + 1) % sectors).ravel()
    cells = np.stack([a, a + sectors, b + sectors, b], 1)
    near = (k < rows).ravel()
    triangles = np.concatenate([cells[~near][:, [0, 1, 2]], cells[~near][:, [0, 2, 3]]])
    return tm.MeshBatch.from_arrays(points.reshape(-1, 2), triangles, quads=cells[near])


def cases(seeds: int) -> Iterator[Case]:
    """All cases, the easy ones of each family first."""
    for cells in (0.3, 0.6, 1.0, 2.0):
        for seed in range(seeds):
            mesh = grid(24, 12 if seed % 2 else 24)
            throw = torch.randn(mesh.points.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
            points = torch.where(mesh.fixed[:, None], mesh.points, mesh.points + cells / 24 * throw)
            yield Case("jittered", f"{cells} cells", mesh.with_points(points), mesh)
    disc = around((0.3, 0.3), 48, 3, 0.02, 2.5)
    wing = around((0.5, 0.06), 96, 5, 0.002, 3.0)
    for mesh, family, amounts in ((disc, "moved", (0.6, 1.2, 1.8)), (wing, "pitched", (15, 45, 90))):
        body = mesh.fixed & (mesh.points.norm(dim=1) < 0.6)
        for amount in amounts:
            goal = mesh.points.clone()
            if family == "moved":
                goal[body, 0] += amount
            else:
                turn = math.radians(amount)
                matrix = goal.new_tensor([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
                goal[body] = goal[body] @ matrix.T
            hard = f"{amount} radii of 0.3" if family == "moved" else f"{amount} degrees"
            hard = f"by {amount}" if family == "moved" else hard
            yield Case(family, hard, tm.femwarp(mesh, goal), mesh)


def ours(case: Case, reference: bool, topology: str = "flip") -> tuple[float, tm.MeshBatch]:
    """Seconds of the processor, and what `improve` makes of the mesh."""
    options = tm.ImproveOptions(workers=1, topology=topology, reference=case.before if reference else None)
    began = time.process_time()
    mesh, _ = tm.improve(case.mesh, options)
    return time.process_time() - began, mesh


def theirs(case: Case) -> tuple[float, tm.MeshBatch]:
    """The same of MFEM's TMOP, in the unit of length in which it leaves the fewest elements inverted, soonest."""
    mesh, tries = case.mesh, []
    for size in (0.125, 0.25, 0.5, 1.0):
        found = mfem(*(v.numpy() for v in (mesh.points, mesh.triangles, mesh.fixed)), size, mesh.quads.numpy())
        moved = mesh.with_points(torch.from_numpy(found.points))
        tries.append((int(tm.quality(moved).inverted), found.seconds.cpu, moved))
    _, seconds, moved = min(tries, key=lambda t: t[:2])
    return seconds, moved


def heights_kept(case: Case, mesh: tm.MeshBatch) -> str:
    """By which factors the shortest edges of quads have changed, in the middle and at most."""
    now, then = ((m.points[m.quads] - m.points[m.quads].roll(-1, 1)).norm(dim=2).amin(1) for m in (mesh, case.before))
    change = torch.maximum(now / then, then / now)
    return f"{float(change.median()):.2f} / {float(change.max()):.1f}"


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("--seeds", type=int, default=4, help="how many jittered meshes of each kind")
    seeds = arguments.parse(parser, argv).seeds
    tm.improve(grid(4, 2))
    groups: dict[tuple[str, str], list[Case]] = {}
    for case in cases(seeds):
        groups.setdefault((case.family, case.hard), []).append(case)
    rows = []
    for (family, hard), group in groups.items():
        runs = {"ours": lambda c: ours(c, False), "kept": lambda c: ours(c, False, "keep"), "TMOP": theirs}
        if family != "jittered":
            runs["reference"] = lambda c: ours(c, True)
        row = [f"{family} {hard}", f"{np.mean([float(tm.quality(c.mesh).inverted) for c in group]):.0f}"]
        for name in ("ours", "kept", "reference", "TMOP"):
            if name not in runs:
                row.append("")
                continue
            found = [runs[name](case) for case in group]
            left = [int(tm.quality(mesh).inverted) for _, mesh in found]
            quality = tm.quality(found[0][1])
            text = f"{sum(n == 0 for n in left)} of {len(group)}; {np.mean([s for s, _ in found]):.2f} s"
            text += f"; {float(quality.mean):.3f} / {float(quality.max):.1f}"
            if family != "jittered":
                text += f"; {heights_kept(group[0], found[0][1])}"
            row.append(text)
        rows.append(row)
        print(row, flush=True)
    titles = ["mesh", "inverted", "ours", "ours, triangles kept", "ours, with the reference", "MFEM TMOP"]
    print("valid; processor seconds; IMR average / maximum; change of heights, middle / most")
    print(table(titles, rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
