"""Does mesh quality matter to a PDE?  Poisson's equation on undeformed, paper-final and our final meshes.

    python -m pip install '.[experiments]' && python -m experiments.quality.poisson

The solution is sin(k x) sin(k y), with k = 2 pi over the domain's height.  For each mesh: the condition number of the
interior stiffness matrix (its extreme eigenvalues, dense), the iterations of conjugate gradients to a residual of 1e-8,
without and with the diagonal as preconditioner, and the error in L2 and in the H1 seminorm, relative to the solution's
own norm.  Writes poisson.csv, poisson.md and poisson.png.

The position of the body changes the domain, so the final meshes are to be compared with each other; the undeformed mesh
tells what the same number of vertices can do.  The full topology has other numbers of vertices.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torchmesh as tm
from experiments.quality.poisson_solver import solve
from experiments.shared import arguments, tables
from torchmesh.learning.domains import moving


@dataclass(frozen=True)
class Row:
    """One mesh of one domain."""

    domain: str
    mesh: str
    triangles: int
    inverted: int
    imr_average: float
    imr_maximum: float
    condition: float = math.nan
    cg: float = math.nan
    cg_diagonal: float = math.nan
    l2_error: float = math.nan
    h1_error: float = math.nan


def domains() -> dict[str, tuple[tm.MeshBatch, tm.MeshBatch]]:
    """Undeformed and deformed meshes: the three of the paper, and harder ones."""
    found = {f"moving {name}": moving(name) for name in ("circle", "bar", "gate")}  # type: ignore[arg-type]
    for name, factor, text in (("circle", 3.0, "circle, three times as far"), ("bar", 2.0, "bar, twice as far")):
        mesh, warped = moving(name)  # type: ignore[arg-type]
        moved = mesh.points + factor * (warped.points - mesh.points)
        found[text] = mesh, tm.femwarp(mesh, moved)
    return found


METHODS: dict[str, Callable[[], tm.ImproveOptions]] = {
    "paper": tm.ImproveOptions.paper,
    "paper, no flips": lambda: tm.ImproveOptions.paper(topology="keep"),
    "default": tm.ImproveOptions,
    "default, sliding": lambda: tm.ImproveOptions(boundary="slide"),
    "full": lambda: tm.ImproveOptions(topology="full"),
}


def meshes_of(mesh: tm.MeshBatch, deformed: tm.MeshBatch) -> dict[str, tm.MeshBatch]:
    """The meshes to solve on."""
    return {"undeformed": mesh} | {name: tm.improve(deformed, make())[0] for name, make in METHODS.items()}


def rows_of(domain: str, mesh: tm.MeshBatch, deformed: tm.MeshBatch) -> list[Row]:
    """A row for each mesh of a domain; there is no solution on a mesh with inverted triangles."""
    k = 2 * math.pi / float(mesh.points[:, 1].max() - mesh.points[:, 1].min())
    rows = []
    for name, candidate in meshes_of(mesh, deformed).items():
        q = tm.quality(candidate)
        inverted = int(q.inverted)
        solved = {} if inverted else asdict(solve(candidate.points.numpy(), candidate.triangles.numpy(), k))
        rows.append(Row(domain, name, len(candidate.triangles), inverted, float(q.mean), float(q.max), **solved))
    return rows


def markdown(rows: list[Row]) -> str:
    """The rows as a table."""
    titles = (
        "domain", "mesh", "triangles", "inverted", "IMR average", "IMR maximum", "condition number", "CG",
        "CG, diagonal", "L2 error", "H1 error",
    )  # fmt: skip
    lines = []
    for r in rows:
        numbers = [f"{r.condition:,.0f}", f"{r.cg:.0f}", f"{r.cg_diagonal:.0f}"]
        numbers += [f"{r.l2_error:.3%}", f"{r.h1_error:.2%}"]
        shape = [f"{r.triangles:,}", str(r.inverted), f"{r.imr_average:.3f}", f"{r.imr_maximum:.2f}"]
        lines.append([r.domain, r.mesh, *shape, *(["-"] * 5 if r.inverted else numbers)])
    return tables.table(titles, lines)


def draw(rows: list[Row], path: Path) -> None:
    """A panel for each measure, relative to what the default mesh of the domain has."""
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    panels = {
        "condition": "condition number",
        "cg": "CG iterations",
        "l2_error": "L2 error",
        "h1_error": "H1 error",
    }
    names = list(dict.fromkeys(r.domain for r in rows))
    kinds = list(dict.fromkeys(r.mesh for r in rows))
    colours = dict(zip(kinds, ["#9a9a9a", "#d55e00", "#e69f00", "#0072b2", "#56b4e9", "#009e73"], strict=False))
    figure, axes = plt.subplots(1, len(panels), figsize=(15, 1.2 + 0.9 * len(names)), sharey=True, layout="constrained")
    width = 0.8 / len(kinds)
    for axis, (key, title) in zip(axes, panels.items(), strict=True):
        for r in rows:
            reference = next(getattr(o, key) for o in rows if o.domain == r.domain and o.mesh == "default")
            value = getattr(r, key) / reference
            y = names.index(r.domain) + (kinds.index(r.mesh) - (len(kinds) - 1) / 2) * width
            if r.inverted:
                axis.annotate(
                    f"{r.inverted} inverted", (1, y), (6, 0), textcoords="offset points", va="center", fontsize=7
                )
                continue
            axis.hlines(y, min(value, 1), max(value, 1), color=colours[r.mesh], linewidth=2)
            axis.plot(value, y, "o", color=colours[r.mesh], markersize=5)
            axis.annotate(
                f"{value:,.2f}", (max(value, 1), y), (6, 0), textcoords="offset points", va="center", fontsize=7
            )
        axis.axvline(1, color="black", linewidth=0.6)
        axis.set_title(f"{title}, default mesh = 1", fontsize=10)
        axis.set_yticks(range(len(names)), names)
        axis.set_xscale("log")
        axis.margins(x=0.2)
        axis.xaxis.set_major_formatter("{x:g}")
        axis.xaxis.set_minor_formatter("")
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].invert_yaxis()
    handles = [plt.Rectangle((0, 0), 1, 1, color=colours[kind]) for kind in kinds]
    figure.legend(handles, kinds, loc="outside lower center", ncols=len(kinds), frameon=False)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    arguments.add_out(parser, "poisson")
    parser.add_argument("--only", default="", help="domains whose name has this text")
    given = arguments.parse(parser, argv)
    every = domains()
    rows = [row for name, pair in every.items() if given.only in name for row in rows_of(name, *pair)]
    if not rows:
        parser.error(f"no domain's name has {given.only!r}; there are {', '.join(every)}")
    given.out.mkdir(parents=True, exist_ok=True)
    arguments.write_rows(given, "poisson", [asdict(row) for row in rows])
    table = markdown(rows)
    (given.out / "poisson.md").write_text(table + "\n")
    draw(rows, given.out / "poisson.png")
    print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
