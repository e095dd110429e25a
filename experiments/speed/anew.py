"""What does topology "full" cost next to meshing the boundary anew?  Two peers that do nothing else, in turn with it.

    python -m experiments.speed.anew                 (needs gmsh, the extra `peers`; Triangle where it is installed)
    python -m experiments.speed.anew --triangles 2200 20000 200000 --repeats 3

Domains are circle, bar and gate of Kim 2017, deformed harder than there.  Everybody has the same boundary vertices, and
one thread; seconds are the processor's, the least of `--repeats` runs.  Of gmsh and Triangle only their own call is
timed.  Triangle (J. R. Shewchuk, free for private and research use) refines to angles of 30 degrees, without new
vertices on the boundary, and with areas no larger than those of equilateral triangles of the longest boundary edge.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

import torchmesh as tm
from experiments.shared import arguments, clocks, domains, peers, tables
from torchmesh.bench.methods.outcome import Outcome
from torchmesh.bench.stopwatch import Seconds, Stopwatch

GMSH = "gmsh, meshed anew"
TITLES = (
    "domain", "triangles", "inverted", "tool", "seconds", "over gmsh", "triangles after", "IMR average", "maximum",
    "vertices kept",
)  # fmt: skip


@dataclass
class Best:
    """The least seconds of a tool, and the shapes that it came to."""

    cpu: float = np.inf
    cells: list[str] = field(default_factory=list)


def triangle_anew(case: domains.Case) -> Outcome:
    """Triangle's mesh of the boundary."""
    try:
        import triangle
    except ImportError as error:
        raise peers.Missing("triangle is not installed") from error
    points = case.arrays[0]
    edges = tm.mesh.connectivity.boundary_edges(case.mesh.triangles, case.mesh.twin).numpy()
    used, local = np.unique(edges, return_inverse=True)
    local = local.reshape(-1, 2)
    longest = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1).max()
    outline = {"vertices": points[used], "segments": local, "holes": _in_holes(points[used], local)}
    outline = {name: values for name, values in outline.items() if len(values)}
    with Stopwatch() as watch:
        made = triangle.triangulate(outline, f"pYYq30a{np.sqrt(3) / 4 * longest**2:.17f}")
    return Outcome(np.asarray(made["vertices"]), np.asarray(made["triangles"], np.int64), watch.seconds)


def _in_holes(points: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(H, 2) the middle of each loop that runs clockwise."""
    after = dict(edges.tolist())
    middles = []
    while after:
        loop = [next(iter(after))]
        while (follower := after.pop(loop[-1])) != loop[0]:
            loop.append(follower)
        x, y = points[loop].T
        if np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) < 0:
            middles.append(points[loop].mean(0))
    return np.array(middles).reshape(-1, 2)


def improved(case: domains.Case, topology: str) -> tuple[Seconds, tm.MeshBatch, float]:
    """The seconds of `improve`, its mesh, and which share of the vertices is still there."""
    with Stopwatch() as watch:
        mesh, report = tm.improve(case.mesh, tm.ImproveOptions(topology=topology))
    kept = 1.0 if report.vertex_map is None else float((report.vertex_map.old_to_new >= 0).double().mean())
    return watch.seconds, mesh, kept


def outside(made: Callable[[], Outcome], case: domains.Case) -> tuple[Seconds, tm.MeshBatch, float]:
    """The same of another tool, which keeps the boundary's vertices."""
    outcome = made()
    mesh = tm.MeshBatch.from_arrays(outcome.points, outcome.triangles)
    return outcome.seconds, mesh, float(case.mesh.fixed.double().mean())


def rows(case: domains.Case, repeats: int) -> list[list[str]]:
    """A row for each tool."""
    ways = {
        "torchmesh, full": lambda: improved(case, "full"),
        "torchmesh, flip": lambda: improved(case, "flip"),
        GMSH: lambda: outside(lambda: peers.gmsh_anew(*case.arrays), case),
        "Triangle, meshed anew": lambda: outside(lambda: triangle_anew(case), case),
    }
    best = {name: Best() for name in ways}
    for _ in range(repeats):
        for name, way in ways.items():
            try:
                seconds, mesh, kept = way()
            except peers.Missing as why:
                print(why, file=sys.stderr)
                continue
            q = tm.quality(mesh)
            cells = [f"{len(mesh.triangles):,}", f"{float(q.mean):.3f}", f"{float(q.max):.2f}", f"{kept:.0%}"]
            best[name] = Best(min(best[name].cpu, seconds.cpu), cells)
    head = [case.name, f"{len(case.mesh.triangles):,}", f"{int(tm.quality(case.mesh).inverted):,}"]
    return [
        [*head, name, f"{b.cpu:.3f}", f"{b.cpu / best[GMSH].cpu:.2f}", *b.cells] for name, b in best.items() if b.cells
    ]


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    arguments.add_cache(parser)
    arguments.add_sizes(parser, 2200, 20000)
    parser.add_argument("--repeats", type=int, default=5, help="the least time of so many runs counts")
    given = arguments.parse(parser, argv)
    torch.set_num_threads(1)
    found = [
        row
        for n in given.triangles
        for case in domains.variants(3, n, given.cache)
        for row in rows(case, given.repeats)
    ]
    print(f"{clocks.machine()}; one thread; processor seconds, least of {given.repeats} runs\n")
    print(tables.table(TITLES, found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
