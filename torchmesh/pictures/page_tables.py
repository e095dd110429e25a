"""The tables of the report page as HTML: the mesh before and after, and every stage."""

import re
from collections.abc import Sequence
from html import escape

import numpy as np

from ..improving.report import Step
from ..mesh.batch import MeshBatch
from ..mesh.measure import Quality, signed_minimum_angles, signed_narrowest_angles
from .captions import short
from .places import Place

_INVERTED = "inverted"

# A table of more columns becomes a list on a narrow screen.
_NARROW = 3


def numbers_table(names: Sequence[str], stages: Sequence[tuple[str, MeshBatch]], measured: Sequence[Quality]) -> str:
    """The first and the last stage in numbers; of a single stage, that one.

    names     the heads of the columns
    measured  the quality of each stage
    """
    ends = [0, -1] if len(stages) > 1 else [0]
    mixed = any(len(stages[i][1].quads) for i in ends)
    columns = [_numbers(stages[i][1], measured[i], mixed) for i in ends]
    rows = [
        f'<tr><th scope="row">{title}</th>'
        + "".join(_cell(column[title], title == _INVERTED and column[title] != 0) for column in columns)
        + "</tr>"
        for title in columns[0]
    ]
    return _table(["", *names[: len(ends)]], rows)


def steps_table(
    labels: Sequence[str], measured: Sequence[Quality], steps: Sequence[Step | None], shown: Sequence[int]
) -> str:
    """One row for each stage: its quality, what it did where a report tells, a button where the picture has it.

    labels  the names of the stages
    shown   the stages that the picture has, in its order
    """
    costs = ["flips", "iterations", "seconds"] if steps[0] is not None else []
    rows = []
    for i, (label, q, step) in enumerate(zip(map(escape, labels), measured, steps, strict=True)):
        inverted = int(q.inverted[0])
        cells = [_cell(inverted, inverted > 0), _cell(float(q.mean[0])), _cell(float(q.max[0]))]
        if step is not None:
            cells += [_cell(step.flips), _cell(step.iterations), _cell(f"{step.seconds:.3f}")]
        button, mark = "", ""
        if i in shown:
            index = shown.index(i)
            mark = f' data-stage="{index}"'
            button = f'<button type="button" data-stage="{index}" aria-label="Show stage {label}">Show</button>'
        rows.append(f'<tr{mark}><th scope="row">{label}</th>{"".join(cells)}<td>{button}</td></tr>')
    return _table(["stage", _INVERTED, "IMR average", "IMR maximum", *costs, ""], rows)


def places_list(places: Sequence[Place]) -> str:
    """The places at which something is left, each with a button that shows it; empty without any."""
    if not places:
        return ""
    rows = [
        f'<li><button type="button" data-place="{k}">Show</button> {escape(place.text)}</li>'
        for k, place in enumerate(places)
    ]
    head = f"{len(places)} place{'s' if len(places) > 1 else ''} where something is left, marked by red rings"
    return f'<div id="places"><p class="note">{head}:</p><ol>{"".join(rows)}</ol></div>'


def series_section(series: Sequence[tuple[str, Quality, Quality, bool]] | None) -> str:
    """A section with a row for each step of a time series, as for `report_page`; empty without one."""
    if not series:
        return ""
    rows = []
    for name, before, after, shown in series:
        counts = [int(q.inverted[0]) for q in (before, after)]
        cells = [_cell(count, count > 0) for count in counts]
        cells += [_cell(float(value[0])) for q in (before, after) for value in (q.mean, q.max)]
        mark = ' aria-current="true"' if shown else ""
        rows.append(f'<tr{mark}><th scope="row">{escape(name)}{", shown" * shown}</th>{"".join(cells)}</tr>')
    head = ["", "inverted before", "after", "IMR average before", "maximum", "IMR average after", "maximum"]
    table = _table(head, rows)
    return f'<section aria-labelledby="series-heading"><h2 id="series-heading">Time series</h2>{table}</section>'


def _numbers(mesh: MeshBatch, quality: Quality, mixed: bool) -> dict[str, int | float | str]:
    """A mesh in numbers, by the names of the rows; `mixed`: with those of quads, which it or another column has."""
    quads = {"quads": len(mesh.quads)} if mixed else {}
    angle = np.abs(np.concatenate([signed_minimum_angles(mesh, quality), signed_narrowest_angles(mesh, quality)]))
    element = "triangle or quad" if quads else "triangle"
    return {
        "triangles": len(mesh.triangles),
        **quads,
        "vertices": len(mesh.points),
        _INVERTED: int(quality.inverted[0]),
        "IMR average": float(quality.mean[0]),
        "IMR maximum": float(quality.max[0]),
        "smallest angle (degrees)": f"{angle.min():.2f}",
        f"smallest angle of a {element}, average (degrees)": f"{angle.mean():.2f}",
    }


def _cell(value: int | float | str, bad: bool = False) -> str:
    text = f"{value:,}" if isinstance(value, int) else value if isinstance(value, str) else short(value)
    return f'<td class="bad">{text}</td>' if bad else f"<td>{text}</td>"


def _named_cells(head: Sequence[str], row: str) -> str:
    """The row with the name of its column in each cell, which narrow screens show beside it."""
    names = iter(head[1:])
    return re.sub(r"<td", lambda _: f'<td data-label="{escape(next(names, ""))}"', row)


def _table(head: Sequence[str], rows: Sequence[str]) -> str:
    cells = "".join(f'<th scope="col">{escape(name)}</th>' for name in head)
    body = "".join(_named_cells(head, row) for row in rows)
    wide = " wide" if len(head) > _NARROW else ""
    return f'<div class="table{wide}"><table><thead><tr>{cells}</tr></thead><tbody>{body}</tbody></table></div>'
