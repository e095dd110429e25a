"""The three experiments of Kim 2017: our rows and the paper's side by side, as tables, meshes and figures.

    data/*.vtk --femwarp--> deformed --flip--> after the first edge flip --...--> untangled --smooth--> final
                               |                     (flip and untangle-beta in turn)
                               |--- untangle-beta, smooth ---> steps 2 and 3 only (the ablation)
                               `--- the default method ------> default

The paper shows its domains as pictures only.  The dimensions, and with them the meshes, are ours
(experiments/paper/make_meshes.py made them).  The paper's numbers allow to compare kinds and sizes of effects, but not
digits.
"""

import math
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import torch
from rich import box
from rich.console import Console
from rich.table import Table

from ..errors import MeshError, MeshIOError
from ..files.atomic import check_target, replacing
from ..files.mesh_files import write
from ..flipping.delaunay import FlipOptions, flip_to_delaunay
from ..improving.options import ImproveOptions
from ..improving.pipeline import improve
from ..improving.report import Report
from ..learning.domains import moving
from ..mesh.batch import MeshBatch
from ..mesh.measure import quality
from ..pictures.captions import short
from ..pictures.mesh_plot import require_matplotlib
from ..pictures.pictures import before_after, with_close_up
from ..pictures.regions import Box
from ..smoothing.smoothing import SmoothOptions
from .console import json_text

SOURCE = (
    "J. Kim, An Iterative Mesh Untangling Algorithm Using Edge Flip, "
    "Mathematical Problems in Engineering 2017, 2953736, tables 2 to 4"
)


NOTE = (
    "The paper shows its domains as pictures only: the dimensions and the meshes are ours, chosen so that the "
    "undeformed and the deformed mesh resemble the paper's. beta is 0.03 of the mesh's mean absolute area "
    "(the paper: 0.01 in its own unit of area); step 2 takes 20 iterations at most in the first round and three times "
    "as many in each further one (the paper names no limit)."
)


STAGES = {
    "initial": "initial mesh",
    "deformed": "deformed mesh",
    "flipped": "after the first edge flip",
    "untangled": "untangled mesh",
    "final": "final mesh",
    "ablation": "steps 2 and 3 only",
    "default": "our default method",
}


# The stages of which the paper has figures, in its order.  Each figure shows the whole mesh and a close-up.
_PICTURED = ("initial", "deformed", "flipped", "untangled", "final")


@dataclass(frozen=True)
class Row:
    """One row of the paper's tables: inverse mean ratio, inverted triangles, and rounds of steps 1 and 2."""

    mean: float
    max: float
    inverted: int
    rounds: int | None = None


@dataclass(frozen=True)
class Experiment:
    """One domain of the paper.

    first_figure  the number of the paper's first figure of it; one for each pictured stage follows
    paper         the rows of the paper's table, by stage
    """

    name: Literal["circle", "bar", "gate"]
    first_figure: int
    paper: dict[str, Row]


EXPERIMENTS = (
    Experiment(
        "circle",
        4,
        {  # table 2; rounds from section 5.1
            "initial": Row(1.038, 1.944, 0),
            "deformed": Row(23681.0, 1e6, 53),
            "flipped": Row(3.274, 346.5, 39),
            "untangled": Row(1.829, 938.8, 0, 3),
            "final": Row(1.083, 6.358, 0),
            "ablation": Row(17.54, 1228.0, 54),
        },
    ),
    Experiment(
        "bar",
        9,
        {  # table 3; rounds from section 5.2
            "initial": Row(1.075, 1.649, 0),
            "deformed": Row(2.019, 623.425, 27),
            "flipped": Row(1.283, 71.158, 26),
            "untangled": Row(1.191, 3.987, 0, 3),
            "final": Row(1.061, 2.075, 0),
            "ablation": Row(2.052, 571.588, 30),
        },
    ),
    Experiment(
        "gate",
        14,
        {  # table 4; rounds from section 5.3
            "initial": Row(1.057, 1.779, 0),
            "deformed": Row(1.253, 26.368, 19),
            "flipped": Row(1.145, 16.378, 20),
            "untangled": Row(1.136, 2.540, 0, 5),
            "final": Row(1.065, 1.979, 0),
            "ablation": Row(1.325, 77.267, 14),
        },
    ),
)


def run_all(out: Path, plots: bool, console: Console) -> list[dict[str, Any]]:
    """Runs the experiments, prints their tables, and writes tables, meshes and, if asked, figures into `out`.

    Returns the records that are also in out/reproduction.json: for every domain and stage our row and the paper's,
    which is None for the default method.

    Raises MeshIOError if `out` cannot be written to, MissingDependencyError for plots without matplotlib.
    """
    if plots:
        require_matplotlib()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MeshIOError(f"{out}: cannot be made a directory: {error.strerror}") from None
    check_target(out / "reproduction.json")
    records = []
    console.print(NOTE, soft_wrap=True, highlight=False)
    for experiment in EXPERIMENTS:
        with _working(console, f"moving {experiment.name}"):
            before, meshes, rows = run(experiment)
            for stage, mesh in meshes.items():
                write(out / f"{experiment.name}-{stage}.vtu", mesh)
        records += [
            {
                "domain": experiment.name,
                "stage": stage,
                "ours": vars(row),
                "paper": vars(experiment.paper[stage]) if stage in experiment.paper else None,
            }
            for stage, row in rows.items()
        ]
        console.print(_table(experiment, len(before.triangles), rows))
        for line in verdicts(experiment, rows):
            console.print(line, soft_wrap=True, highlight=False)
        if plots:
            with _working(console, f"moving {experiment.name}: pictures"):
                _draw(out, experiment, meshes)
    document = {"source": SOURCE, "note": NOTE, "torchmesh": version("torchmesh-untangle"), "rows": records}
    with replacing(out / "reproduction.json") as path:
        path.write_text(json_text(document), encoding="utf-8")
    console.print(f"\ntables, meshes{' and figures' if plots else ''} are in {out}", soft_wrap=True, highlight=False)
    return records


def run(experiment: Experiment) -> tuple[MeshBatch, dict[str, MeshBatch], dict[str, Row]]:
    """Takes one domain through every stage; returns the undeformed mesh, then by stage the meshes and our rows."""
    initial, deformed = moving(experiment.name)
    paper = ImproveOptions.paper()
    final, report = improve(deformed, paper)
    ablation, _ = improve(deformed, ImproveOptions.paper(topology="keep"))
    default, _ = improve(deformed)
    # The same method up to where smoothing begins.
    untangled, _ = improve(deformed, replace(paper, smooth=SmoothOptions(max_iterations=0)))
    flipped, _ = flip_to_delaunay(deformed, FlipOptions.paper())
    rounds = sum(step.stage == "flip" for step in report.steps[0])
    meshes = {
        "initial": initial,
        "deformed": deformed,
        "flipped": flipped,
        "untangled": untangled,
        "final": final,
        "ablation": ablation,
        "default": default,
    }
    rows = {stage: measured(mesh, rounds if stage == "untangled" else None) for stage, mesh in meshes.items()}
    _check_against(report, rows)
    return initial, meshes, rows


def markdown(runs: list[tuple[Experiment, dict[str, Row]]]) -> list[str]:
    """The lines of the README's table: a line for each stage and a column for each domain, ours and (the paper's)."""
    lines = []
    for stage, title in STAGES.items():
        cells = []
        for experiment, rows in runs:
            ours, paper = rows[stage], experiment.paper.get(stage)
            beside = "" if paper is None else f" ({_brief(paper)})"
            cells.append(_brief(ours) + beside)
        lines.append(f"| {title} | {' | '.join(cells)} |")
    return lines


def _brief(row: Row) -> str:
    return f"{short(row.mean)} / {short(row.max)} / {row.inverted}"


def measured(mesh: MeshBatch, rounds: int | None = None) -> Row:
    """The row of one mesh."""
    q = quality(mesh)
    return Row(float(q.mean[0]), float(q.max[0]), int(q.inverted[0]), rounds)


def verdicts(experiment: Experiment, rows: dict[str, Row]) -> list[str]:
    """Sentences that say whether each final row is at least as good as the paper's, and whether the ablation agrees."""
    target = experiment.paper["final"]
    lines = []
    for stage, name in (("final", "the paper's method"), ("default", "our default method")):
        row = rows[stage]
        good = row.inverted == 0 and row.mean <= target.mean and row.max <= target.max
        lines.append(
            f"{name} ends at {short(row.mean)} / {short(row.max)} / {row.inverted}, the paper at "
            f"{short(target.mean)} / {short(target.max)} / {target.inverted}: "
            + ("at least as good" if good else f"not as good ({_worse(row, target)})")
        )
    ablation, theirs = rows["ablation"], experiment.paper["ablation"]
    if ablation.inverted == 0:
        lines.append(
            f"contrary to the paper ({theirs.inverted} inverted), steps 2 and 3 alone do untangle this mesh of ours, "
            f"to {short(ablation.mean)} / {short(ablation.max)}"
        )
    return lines


def _worse(row: Row, target: Row) -> str:
    parts = ("average", row.mean > target.mean), ("maximum", row.max > target.max), ("inverted", row.inverted > 0)
    return ", ".join(name for name, worse in parts if worse)


def _check_against(report: Report, rows: dict[str, Row]) -> None:
    """Raises MeshError unless the meshes that the figures show have the quality that `improve` reports."""
    before, *rest = report.steps[0]
    last = [step for step in rest if step.stage != "smooth"][-1]
    pairs = [("deformed", before), ("flipped", rest[0]), ("untangled", last), ("final", rest[-1])]
    for stage, step in pairs:
        row = rows[stage]
        same = math.isclose(row.mean, step.mean, rel_tol=1e-9) and math.isclose(row.max, step.max, rel_tol=1e-9)
        if not same or row.inverted != step.inverted:
            raise MeshError(f"{stage}: measured {row}, but improve reports {step}; please file this as a bug")


def _draw(out: Path, experiment: Experiment, meshes: dict[str, MeshBatch]) -> None:
    """Writes a figure for each pictured stage, and one of the mesh before and after the default method."""
    name = experiment.name
    here, there = _close_ups(meshes["initial"], meshes["deformed"])
    for number, stage in enumerate(_PICTURED, experiment.first_figure):
        title = f"Figure {number}. Moving {name} domain (our dimensions): {STAGES[stage]}"
        close_up = here if stage == "initial" else there
        with_close_up(out / f"figure-{number:02d}.png", meshes[stage], close_up, title)
    title = f"Moving {name} domain (our dimensions): deformed mesh, and after our default method"
    before_after(out / f"{name}-default.png", meshes["deformed"], meshes["default"], title)


def _close_ups(initial: MeshBatch, deformed: MeshBatch) -> tuple[Box, Box]:
    """Two rectangles of the same size around the boundary that moves, before and after it has moved."""
    moved = initial.fixed & (initial.points != deformed.points).any(1)
    boxes = [(m.points[moved].amin(0), m.points[moved].amax(0)) for m in (initial, deformed)]
    margin = 0.05 * float((initial.points.amax(0) - initial.points.amin(0)).norm())
    half = torch.stack([high - low for low, high in boxes]).max() / 2 + margin
    first, second = ((low + high) / 2 for low, high in boxes)
    return (*(first - half).tolist(), *(first + half).tolist()), (*(second - half).tolist(), *(second + half).tolist())


def _table(experiment: Experiment, triangles: int, rows: dict[str, Row]) -> Table:
    table = Table(
        title=f"\nmoving {experiment.name} ({triangles:,} triangles); inverse mean ratio",
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    table.add_column("")
    for who in ("ours", "paper"):
        for name in ("average", "maximum", "inverted", "rounds"):
            table.add_column(f"{who}\n{name}" if name == "average" else f"\n{name}", justify="right")
    for stage, row in rows.items():
        table.add_row(STAGES[stage], *_cells(row), *_cells(experiment.paper.get(stage)))
    return table


def _cells(row: Row | None) -> list[str]:
    if row is None:
        return [""] * 4
    return [short(row.mean), short(row.max), f"{row.inverted:,}", "" if row.rounds is None else str(row.rounds)]


def _working(console: Console, text: str) -> Any:
    """Shows a spinner inside, if the console is a terminal."""
    return console.status(text, spinner="line")
