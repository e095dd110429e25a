"""A page to look at: one HTML file with tables, histograms and an interactive picture of a mesh in its stages.

The file needs nothing but a browser: data, style and script are inside, and its content security policy forbids
every request.

    stages --measure--> tables (page_tables.py), histograms (histograms.py, svg_histogram.py)
           --thin out--> encode (page_data.py) ---> assets/page.html with page.css and *.js
"""

import json
import math
import os
from collections.abc import Sequence
from dataclasses import replace
from html import escape
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from ..errors import InvalidMeshError
from ..files.atomic import replacing
from ..files.messages import printable
from ..improving.report import Report
from ..mesh.batch import MeshBatch
from ..mesh.measure import Quality
from ..mesh.measure import quality as measure
from ..mesh.quads import halved
from . import histograms, palette
from .captions import quality_in_words
from .curves import Curves
from .page_data import CODES_A_DOUBLING, INFINITE_CODE, encode
from .page_tables import numbers_table, places_list, series_section, steps_table
from .places import places_left
from .svg_histogram import svg_histogram

# The picture has at most so many triangles, those of all its stages together: about 10 MB.
_TRIANGLES_SHOWN = 1_500_000


def report_page(
    path: str | os.PathLike[str],
    stages: Sequence[tuple[str, MeshBatch]],
    report: Report | None = None,
    *,
    title: str | None = None,
    note: str | None = None,
    series: Sequence[tuple[str, Quality, Quality, bool]] | None = None,
    curves: Sequence[Curves | None] | None = None,
) -> None:
    """Write an HTML page that shows a mesh in its stages: tables, histograms, and a picture to zoom and click in.

    path    the file, written whole or not at all; the page loads nothing from anywhere
    stages  names and meshes, each a batch of one, in order: what `improve(mesh, observe=...)` calls with, or just
            [("before", mesh), ("after", improved)].  The picture leaves out stages in the middle where all together
            have more than 1,500,000 triangles; the tables have all
    report  what `improve` returned with these stages; adds flips, iterations, seconds and the outcome
    title   the heading; None: the path's name without extension
    note    a sentence to stand below the heading
    series  of a mesh that is one step of a time series: for each step its name, its quality before and after, and
            whether it is the step that the page shows
    curves  of each stage the curved sides of its six-node triangles (`pictures.curves.Curves`); None: there are none

    Raises InvalidMeshError if there is no stage or one is a batch of several; ValueError if the report's steps are
    not these stages; MeshIOError if the file cannot be written.
    """
    path = Path(path)
    stages = list(stages)
    _check(stages, report)
    bent = [None] * len(stages) if curves is None else list(curves)
    measured = [_judged(measure(mesh), own) for (_, mesh), own in zip(stages, bent, strict=True)]
    labels = [f"{i}. {name}" for i, (name, _) in enumerate(stages)]
    steps = report.steps[0] if report is not None else [None] * len(stages)
    shown = _shown(
        [len(mesh.triangles) + 2 * len(mesh.quads) for _, mesh in stages], [int(q.inverted[0]) for q in measured]
    )
    header, data = _picture(stages, measured, labels, shown, bent)
    drawn = _histograms(stages, measured)
    places = places_left(stages[-1][1], measured[-1]) if len(stages) > 1 or report is not None else []
    header["places"] = [[*place.position, place.size] for place in places]
    names = ("before", "after") if len(stages) > 1 else ("mesh", "mesh")
    summary = [_summary(names, stages, measured), *([_outcome(report)] if report else []), *([note] if note else [])]
    text = Template(_asset("page.html")).substitute(
        title=escape(printable(title or path.stem)),
        style=palette.css() + _asset("page.css"),
        summary=escape(printable(" ".join(summary))),
        ticks=_ticks(),
        numbers=numbers_table(names, stages, measured),
        histograms=drawn[0],
        counted=drawn[1],
        steps=steps_table(labels, measured, steps, shown),
        series=series_section(series),
        places=places_list(places),
        footer=f"torchmesh {escape(version('torchmesh-untangle'))}. Inverse mean ratio: 1 for an equilateral triangle, "
        "larger the flatter.",
        # A name may hold "</script>".
        header=json.dumps(header).replace("<", "\\u003c"),
        data=data,
        script=_asset("page_mesh.js") + _asset("page.js"),
    )
    with replacing(path) as whole:
        whole.write_text(text, encoding="utf-8")


def _picture(
    stages: Sequence[tuple[str, MeshBatch]], measured: Sequence[Quality], labels: Sequence[str], shown: Sequence[int],
    bent: Sequence[Curves | None],
) -> tuple[dict[str, Any], str]:  # fmt: skip
    """What the script draws from: its header for JSON, and the encoded data of the stages `shown`."""
    encoded = encode([_drawn(stages[i][1], measured[i]) for i in shown], [bent[i] for i in shown])
    for entry, i in zip(encoded.header["stages"], shown, strict=True):
        entry["name"] = labels[i]
        entry["label"] = f"{labels[i]}: {quality_in_words(measured[i])}"
    colours = {
        "shapes": palette.SHAPES,
        "inverted": palette.INVERTED,
        "outline": palette.INVERTED_OUTLINE,
        "edge": palette.EDGE,
        "boundary": palette.BOUNDARY,
        "interface": palette.INTERFACE,
        "interfacePale": palette.INTERFACE_PALE,
        "selected": palette.FRAME,
        "canvas": palette.LIGHT_CANVAS,
        "dark": {name: palette.DARK[name] for name in ("canvas", "boundary")},
    }
    header = {
        "colours": colours,
        "worstShown": palette.WORST_SHOWN,
        "codesADoubling": CODES_A_DOUBLING,
        "infiniteCode": INFINITE_CODE,
    }
    return encoded.header | header, encoded.text


def _judged(quality: Quality, curves: Curves | None) -> Quality:
    """The quality with curved triangles that are inverted."""
    return quality if curves is None else curves.judged(quality)


def _drawn(mesh: MeshBatch, quality: Quality) -> tuple[MeshBatch, Quality]:
    """The mesh as the script draws it: of triangles, among which each quad has two with its own quality."""
    if not len(mesh.quads):
        return mesh, quality
    halves = halved(mesh)
    whole = len(mesh.triangles)  # before their halves; curved ones may be inverted where straight ones are not
    measured = measure(halves)
    upright = measured.upright.clone()
    upright[:whole] &= quality.upright
    upright[whole:] = quality.quad_upright.repeat_interleave(2)
    return halves, replace(measured, upright=upright)


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


def _outcome(report: Report) -> str:
    if bool(report.certified[0]):
        verdict = "Certified valid by exact signs"
    else:
        verdict = "Valid" if bool(report.valid[0]) else "Not valid"
    return f"{verdict} ({report.messages[0]})."


def _shown(triangles: Sequence[int], inverted: Sequence[int]) -> list[int]:
    """The stages that the picture has: all, or if they are too many, the ends, the first valid one and some between."""
    last = len(triangles) - 1
    room = _TRIANGLES_SHOWN // max(1, max(triangles))
    if last < room:
        return list(range(last + 1))
    kept = {0, last} | {inverted.index(0) if 0 in inverted else last}
    spread = np.linspace(0, last, max(2, room - 1)).round().astype(int).tolist()
    return sorted(kept | set(spread))


def _summary(names: Sequence[str], stages: Sequence[tuple[str, MeshBatch]], measured: Sequence[Quality]) -> str:
    mesh = stages[-1][1]
    start = f"{names[0]}: {quality_in_words(measured[0])}; " if len(stages) > 1 else ""
    quads = f" and {len(mesh.quads):,} quads" if len(mesh.quads) else ""
    return f"{len(mesh.triangles):,} triangles{quads}. {start}{names[1]}: {quality_in_words(measured[-1])}."


def _ticks() -> str:
    """The marks below the colour scale, which is logarithmic; the last one stands for all ratios beyond."""
    parts = []
    for tick in palette.TICKS:
        percent = 100 * math.log(tick) / math.log(palette.WORST_SHOWN)
        parts.append(f'<span style="left:{percent:.1f}%">{tick:g}{"+" * (tick == palette.TICKS[-1])}</span>')
    return "".join(parts)


def _histograms(stages: Sequence[tuple[str, MeshBatch]], measured: Sequence[Quality]) -> tuple[str, str]:
    """The histograms as HTML, and what they count."""
    before, after = stages[0][1], stages[-1][1]
    ends = measured[0], measured[-1]
    both = histograms.shapes(*ends), histograms.angles(before, after, *ends)
    return "".join(map(svg_histogram, both)), both[0].counted
