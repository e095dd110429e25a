"""How good the improved meshes are, and how good their boundaries let them be, as a Markdown table.

    python -m experiments.quality.improved_meshes            (needs gmsh, the extra `peers`)

Variants of the paper's domains tangled two to ten times harder, an airfoil turned in a graded mesh and a cylinder moved
by four of its diameters in an O-mesh, with topology "flip" and "full".  With --seed N the variants are drawn by N
instead: several holes, slanting bars, other gates, turns and directions.  A *limit* is what no mesh of that boundary
can better; limits.py derives it.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import torchmesh as tm
from experiments.quality.limits import boundary_limits
from experiments.quality.variants import VARIANTS, drawn
from experiments.shared import arguments, tables

TOPOLOGIES: tuple[Literal["flip", "full"], ...] = ("flip", "full")
TITLES = (
    "variant", "topology", "vertices before", "after", "inverted", "IMR average", "maximum (limit)",
    "minimum angle (limit)", "edge length / size wanted: mean (5 - 95 percent)", "certified",
)  # fmt: skip


def row(name: str, tangled: tm.MeshBatch, topology: Literal["flip", "full"]) -> list[str]:
    """The cells of one variant."""
    after, report = tm.improve(tangled, tm.ImproveOptions(topology=topology))
    q, sizes = report.quality, tm.size_conformity(after)
    angle, limits = float(tm.minimum_angle(after)), boundary_limits(after)
    return [
        name, topology, f"{len(tangled.points):,}", f"{len(after.points):,}", str(int(tm.quality(tangled).inverted)),
        f"{float(q.mean):.3f}", f"{float(q.max):.2f} ({limits.ratio:.2f})", f"{angle:.1f} ({limits.angle:.1f})",
        f"{float(sizes.mean):.2f} ({float(sizes.low):.2f} - {float(sizes.high):.2f})",
        "yes" if bool(report.certified) else "no",
    ]  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("--only", default="", help="variants whose name has this text")
    parser.add_argument("--seed", type=int, help="draw variants by this seed in place of those that have names here")
    parser.add_argument("--out", type=Path, help="a file for the table")
    given = arguments.parse(parser, argv)
    variants = VARIANTS if given.seed is None else drawn(given.seed)
    chosen = {name: make for name, make in variants.items() if given.only in name}
    if not chosen:
        parser.error(f"no variant's name has {given.only!r}; there are {', '.join(variants)}")
    lines = [tables.head(TITLES)]
    print(lines[0])
    for name, make in chosen.items():
        tangled = make()
        for topology in TOPOLOGIES:
            lines.append(tables.line(row(name, tangled, topology)))
            print(lines[-1], flush=True)
    if given.out is not None:
        given.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
