"""Does a mesh remember where its body has been, and does it hang on rounding errors?

    python -m experiments.simulation.history

The disc of the channel goes four diameters there and back, again and again.  The first table compares the mesh after a
cycle with the mesh a cycle before: the median and the largest way of a vertex, in local widths, and the number of edges
that are others.  The second part moves two discs, which start 1e-13 apart, there and back once, and counts the edges
that both meshes have.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import torch

import torchmesh as tm
from experiments.shared import arguments, tables
from experiments.simulation.runs import STEPS, there_and_back
from experiments.simulation.ways import channel, on_disc
from torchmesh.mesh.connectivity import edges
from torchmesh.mesh.means import local_widths

BOUND, APART = tm.Bound(angle=15.0), 1e-13


def edges_of(mesh: tm.MeshBatch) -> set[tuple[int, int]]:
    """The edges, as pairs of rows of vertices."""
    return set(map(tuple, edges(mesh.triangles, mesh.twin).sort(1).values.tolist()))


def cycle(mesh: tm.MeshBatch, steps: int, options: tm.DeformOptions) -> tm.MeshBatch:
    """The mesh after one motion there and back."""
    for k in range(1, steps + 1):
        mesh, report = tm.deform(mesh, there_and_back(mesh, k, steps), options=options)
        report.check()
    return mesh


def compared(mesh: tm.MeshBatch, before: tm.MeshBatch) -> str:
    """How far vertices are from where they were a cycle before, and how many edges are others."""
    way = ((mesh.points - before.points).norm(dim=1) / local_widths(before))[~mesh.fixed]
    return f"{float(way.median()):.2g} / {float(way.max()):.2g} / {len(edges_of(mesh) - edges_of(before)):,}"


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("--size", type=float, default=0.092, help="length of edges at the walls")
    parser.add_argument("--steps", type=int, default=STEPS // 2, help="steps of a cycle")
    parser.add_argument("--cycles", type=int, default=10, help="cycles")
    args = arguments.parse(parser, argv)
    start = channel(args.size)
    shown = [c for c in (1, 2, 5, 10) if c < args.cycles] + [args.cycles]
    print(f"{len(start.triangles):,} triangles, {len(edges_of(start)):,} edges, {args.steps} steps a cycle\n")
    rows = []
    for name, reference in (("no reference", None), ("reference= the undeformed mesh", start)):
        options = tm.DeformOptions(when=BOUND, reference=reference)
        mesh, row = start, [name]
        for c in range(1, args.cycles + 1):
            before, mesh = mesh, cycle(mesh, args.steps, options)
            row += [compared(mesh, before)] if c in shown else []
        rows.append([*row, f"{len(edges_of(mesh) - edges_of(start)):,}"])
    head = ["", *(f"cycle {c}" for c in shown), "edges other than undeformed"]
    print(tables.table(head, rows))
    options, shift = tm.DeformOptions(when=BOUND), torch.zeros_like(start.points)
    shift[on_disc(start), 0] = APART
    ends = [cycle(mesh, args.steps, options) for mesh in (start, start.with_points(start.points + shift))]
    both, whole = edges_of(ends[0]) & edges_of(ends[1]), edges_of(ends[0])
    print(f"\ndiscs {APART:g} apart: {len(both):,} of {len(whole):,} edges are the same")
    return 0


if __name__ == "__main__":
    sys.exit(main())
