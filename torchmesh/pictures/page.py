"""A page to look at: one HTML file with tables, histograms and an interactive picture of a mesh in its stages.

The file needs nothing but a browser: data, style and script are inside, and its content security
policy forbids every request.

    stages --measure--> tables, histograms (charts.py)
           --thin out--> encode (page_data.py) ---> data/page.html with page.css and *.js
"""

import json
import math
import os
from collections.abc import Sequence
from html import escape
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from string import Template

import numpy as np

from ..errors import InvalidMeshError
from ..files.atomic import replacing
from ..improving.report import Report, Step
from ..mesh.batch import MeshBatch
from ..mesh.measure import Quality, signed_minimum_angles
from ..mesh.measure import quality as measure
from .page_data import CODES_A_DOUBLING, INFINITE_CODE, encode
from .pictures import short
from .svg_histogram import histogram

# ColorBrewer's YlGnBu of nine classes (C. A. Brewer), the scale of the pictures that matplotlib draws.
PALETTE = ("#ffffd9", "#edf8b1", "#c7e9b4", "#7fcdbb", "#41b6c4", "#1d91c0", "#225ea8", "#253494", "#081d58")


_INVERTED = {"fill": "#d55e00", "rim": "#7f3200"}


_WORST_SHOWN = 3.0


_TICKS = (1, 1.25, 1.5, 2, 2.5, 3)


# Triangles of all stages together in one page: about 10 MB.
_TRIANGLES_SHOWN = 1_500_000


def report_page(
    path: str | os.PathLike[str],
    stages: Sequence[tuple[str, MeshBatch]],
    report: Report | None = None,
    *,
    title: str | None = None,
    note: str | None = None,
) -> None:
    """Write an HTML page that shows a mesh in its stages: tables, histograms, and a picture to zoom and click in.

    path    the file, written whole or not at all; the page loads nothing from anywhere
    stages  names and meshes, each a batch of one, in order: what `improve(mesh, observe=...)` calls with, or just
            [("before", mesh), ("after", improved)].  The picture leaves out stages in the middle where all together
            have more than 1,500,000 triangles; the tables have all
    report  what `improve` returned with these stages; adds flips, iterations, seconds and the outcome
    title   the heading; None: the path's name without extension
    note    a sentence to stand below the heading

    Raises InvalidMeshError if there is no stage or one is a batch of several; ValueError if the report's steps are
    not these stages; MeshIOError if the file cannot be written.
    """
    path = Path(path)
    stages = list(stages)
    _check(stages, report)
    measured = [measure(mesh) for _, mesh in stages]
    steps = report.steps[0] if report is not None else [None] * len(stages)
    shown = _shown([len(mesh.triangles) for _, mesh in stages], [int(q.inverted[0]) for q in measured])
    encoded = encode([(stages[i][1], measured[i]) for i in shown])
    for entry, i in zip(encoded.header["stages"], shown, strict=True):
        entry["name"] = _numbered(i, stages[i][0])
        entry["label"] = f"{entry['name']}: {_in_words(measured[i])}"
    header = encoded.header | {
        "palette": PALETTE,
        "inverted": _INVERTED,
        "worstShown": _WORST_SHOWN,
        "codesADoubling": CODES_A_DOUBLING,
        "infiniteCode": INFINITE_CODE,
    }
    names = ("before", "after") if len(stages) > 1 else ("mesh", "mesh")
    outcome = "" if report is None else f" {_verdict(report)} ({report.messages[0]})."
    text = Template(_asset("page.html")).substitute(
        title=escape(title or path.stem),
        style=_asset("page.css"),
        summary=escape(f"{_sentence(names, stages, measured)}{outcome}{' ' + note if note else ''}"),
        ticks="".join(f'<span style="left:{_position(t):.1f}%">{t:g}{"+" * (t == _TICKS[-1])}</span>' for t in _TICKS),
        numbers=_numbers(names, stages, measured),
        histograms=_histograms(stages, measured),
        steps=_steps(stages, measured, steps, shown),
        footer=f"torchmesh {escape(version('torchmesh-untangle'))}. Inverse mean ratio: 1 for an equilateral triangle, "
        "larger the flatter.",
        # A name may hold "</script>".
        header=json.dumps(header).replace("<", "\\u003c"),
        data=encoded.text,
        script=_asset("page_mesh.js") + _asset("page.js"),
    )
    with replacing(path) as whole:
        whole.write_text(text, encoding="utf-8")


def _asset(name: str) -> str:
    return (resources.files(__package__) / "assets" / name).read_text(encoding="utf-8")


def _check(stages: Sequence[tuple[str, MeshBatch]], report: Report | None) -> None:
    if not stages:
        raise InvalidMeshError("a page needs at least one stage: a name and a mesh")
    for name, mesh in stages:
        if len(mesh) != 1:
            raise InvalidMeshError(
                f"stage {name!r} is a batch of {len(mesh)} meshes and a page shows one: improve each of batch.split()"
            )
    if report is not None and (
        len(report.steps) != 1 or [step.stage for step in report.steps[0]] != [name for name, _ in stages]
    ):
        raise ValueError("report: its steps are not the stages given; pass what improve returned while it was observed")


def _verdict(report: Report) -> str:
    if bool(report.certified[0]):
        return "Certified valid by exact signs"
    return "Valid" if bool(report.valid[0]) else "Not valid"


def _shown(triangles: Sequence[int], inverted: Sequence[int]) -> list[int]:
    """Which stages the picture has: all, or where that is too much the ends, the first valid one and some between."""
    last = len(triangles) - 1
    room = _TRIANGLES_SHOWN // max(1, max(triangles))
    if last < room:
        return list(range(last + 1))
    kept = {0, last} | {inverted.index(0) if 0 in inverted else last}
    spread = np.linspace(0, last, max(2, room - 1)).round().astype(int).tolist()
    return sorted(kept | set(spread))


def _numbered(index: int, name: str) -> str:
    return f"{index}. {name}"


def _in_words(q: Quality) -> str:
    return f"{int(q.inverted[0]):,} inverted, IMR average {short(float(q.mean[0]))}, maximum {short(float(q.max[0]))}"


def _sentence(names: Sequence[str], stages: Sequence[tuple[str, MeshBatch]], measured: Sequence[Quality]) -> str:
    count = len(stages[-1][1].triangles)
    ends = f"{names[1]}: {_in_words(measured[-1])}."
    return f"{count:,} triangles. " + (f"{names[0]}: {_in_words(measured[0])}; {ends}" if len(stages) > 1 else ends)


def _position(ratio: float) -> float:
    """Percent of the colour scale, which is logarithmic."""
    return 100 * math.log(ratio) / math.log(_WORST_SHOWN)


def _cell(value: int | float | str, bad: bool = False) -> str:
    text = f"{value:,}" if isinstance(value, int) else value if isinstance(value, str) else short(value)
    return f'<td class="bad">{text}</td>' if bad else f"<td>{text}</td>"


def _table(head: Sequence[str], rows: Sequence[str]) -> str:
    cells = "".join(f'<th scope="col">{escape(name)}</th>' for name in head)
    body = "".join(rows)
    return f'<div class="table"><table><thead><tr>{cells}</tr></thead><tbody>{body}</tbody></table></div>'


def _numbers(names: Sequence[str], stages: Sequence[tuple[str, MeshBatch]], measured: Sequence[Quality]) -> str:
    ends = [0, -1] if len(stages) > 1 else [0]
    columns: list[tuple[int | float | str, ...]] = []
    for i in ends:
        mesh, q = stages[i][1], measured[i]
        angle = np.abs(signed_minimum_angles(mesh, q))
        columns.append((len(mesh.triangles), len(mesh.points), int(q.inverted[0]), float(q.mean[0]), float(q.max[0]),
                        f"{angle.min():.2f}", f"{angle.mean():.2f}"))  # fmt: skip
    titles = ("triangles", "vertices", "inverted", "IMR average", "IMR maximum", "smallest angle (degrees)",
              "smallest angle of a triangle, average (degrees)")  # fmt: skip
    rows = [
        f'<tr><th scope="row">{title}</th>'
        + "".join(_cell(column[k], title == "inverted" and column[k] != 0) for column in columns)
        + "</tr>"
        for k, title in enumerate(titles)
    ]
    return _table(["", *names[: len(ends)]], rows)


def _steps(
    stages: Sequence[tuple[str, MeshBatch]],
    measured: Sequence[Quality],
    steps: Sequence[Step | None],
    shown: Sequence[int],
) -> str:
    known = steps[0] is not None
    costs = ["flips", "iterations", "seconds"] if known else []
    head = ["stage", "inverted", "IMR average", "IMR maximum", *costs, ""]
    rows = []
    for i, ((name, _), q, step) in enumerate(zip(stages, measured, steps, strict=True)):
        inverted = int(q.inverted[0])
        cells = [_cell(inverted, inverted > 0), _cell(float(q.mean[0])), _cell(float(q.max[0]))]
        if step is not None:
            cells += [_cell(step.flips), _cell(step.iterations), _cell(f"{step.seconds:.3f}")]
        label = escape(_numbered(i, name))
        button, mark = "", ""
        if i in shown:
            place = shown.index(i)
            mark = f' data-stage="{place}"'
            button = f'<button type="button" data-stage="{place}" aria-label="Show stage {label}">Show</button>'
        rows.append(f'<tr{mark}><th scope="row">{label}</th>{"".join(cells)}<td>{button}</td></tr>')
    return _table(head, rows)


def _histograms(stages: Sequence[tuple[str, MeshBatch]], measured: Sequence[Quality]) -> str:
    ends = (stages[0][1], measured[0]), (stages[-1][1], measured[-1])
    ratios = [q.inverse_mean_ratio.cpu().numpy() for _, q in ends]
    angles = [signed_minimum_angles(mesh, q) for mesh, q in ends]
    floor = -60 if min(float(a.min()) for a in angles) < 0 else 0
    ratio_ticks = [(t, f"{t:g}") for t in (1, 1.5, 2, 3, 5)] + [(10, "10+")]
    return histogram(
        ratios[0], ratios[1], np.geomspace(1.0, 10.0, 47), ratio_ticks, "inverse mean ratio (1: equilateral)",
        logarithmic=True,
    ) + histogram(
        angles[0], angles[1], np.arange(floor, 61, 2.0), [(t, str(t)) for t in range(floor, 61, 20)],
        "smallest angle of each triangle (degrees; 60: equilateral)", shade_below=0.0,
    )  # fmt: skip
