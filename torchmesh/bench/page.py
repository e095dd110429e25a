"""A page of results that needs no network: success and time against difficulty, for every method and family."""

import contextlib
import json
from html import escape

from .charts import Line, chart
from .results import Row
from .summary import by_level, names, table

# Colours that readers with any colour vision tell apart (Okabe & Ito 2008), then the same with dashes.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#8c8c8c")

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 70rem; padding: 0 1rem; color: #222; }
table { border-collapse: collapse; margin: 1rem 0; } td, th { padding: .2rem .7rem; text-align: right; }
td:first-child, th:first-child { text-align: left; } thead { border-bottom: 1px solid #888; }
.pair { display: flex; flex-wrap: wrap; gap: 1rem; } svg { width: 32rem; max-width: 100%; height: auto; }
svg text { font: 12px system-ui, sans-serif; fill: #333; } .key { display: inline-block; margin-right: 1.2rem; }
.axis { stroke: #888; stroke-width: 1; fill: none; } .small { color: #555; font-size: 13px; }
"""


def page(rows: list[Row]) -> str:
    """The page as one HTML document."""
    methods = names(rows, "method")
    colours = {name: (_COLOURS[i % len(_COLOURS)], i >= len(_COLOURS)) for i, name in enumerate(methods)}
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        "<meta name='viewport' content='width=device-width'>",
        f"<title>Benchmark of tangled meshes</title><style>{_STYLE}</style></head><body>",
        "<h1>Benchmark of tangled meshes</h1>",
        f"<p>{len(rows):,} rows: {len(methods)} methods. A result is valid if no triangle is inverted by exact "
        "signs and the boundary, fixed vertices and interfaces are where they were. Seconds are processor time, the "
        "median over the valid results; a point has a case at least.</p>",
        _table(rows),
        "<p>" + "".join(_key(name, *colours[name]) for name in methods) + "</p>",
    ]
    for family in names(rows, "family"):
        parts.append(f"<h2>{escape(family)}</h2><div class='pair'>{_charts(rows, methods, family, colours)}</div>")
    parts.append(_provenance(rows))
    return "\n".join([*parts, "</body></html>"]) + "\n"


def _key(name: str, colour: str, dashed: bool) -> str:
    dash = " stroke-dasharray='5 3'" if dashed else ""
    line = (
        f"<svg style='width:2rem' viewBox='0 0 32 8'><path d='M0 4H32' stroke='{colour}' stroke-width='3'{dash}/></svg>"
    )
    return f"<span class='key'>{line} {escape(name)}</span>"


def _charts(rows: list[Row], methods: list[str], family: str, colours: dict[str, tuple[str, bool]]) -> str:
    """Success and time of one family."""
    unit = next(row["unit"] for row in rows if row["family"] == family)
    success, seconds = [], []
    for name in methods:
        levels = by_level(rows, name, family)
        if levels:
            success.append(Line(name, *colours[name], [(x, 100 * s.success) for x, s in levels.items()]))
            timed = [(x, s.seconds) for x, s in levels.items() if s.seconds is not None]
            seconds.append(Line(name, *colours[name], timed))
    return chart(success, unit, "valid, percent", limits=(0.0, 100.0)) + chart(
        seconds, unit, "seconds", logarithmic=True
    )


def _table(rows: list[Row]) -> str:
    """Success of each method in each family, and the time and the quality over all."""
    heads, lines = table(rows)
    head = "".join(f"<th>{escape(text)}</th>" for text in heads)
    body = "".join("<tr>" + "".join(f"<td>{escape(text)}</td>" for text in line) + "</tr>" for line in lines)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _provenance(rows: list[Row]) -> str:
    """What machines, versions and commits the rows come from."""
    lines = []
    for machine in dict.fromkeys((r["processor"], r["system"], r["kernels"], r["commit"], r["versions"]) for r in rows):
        processor, system, kernels, commit, versions = (str(part or "") for part in machine)
        with contextlib.suppress(ValueError):
            versions = ", ".join(f"{name} {value}" for name, value in json.loads(versions).items())
        lines.append(f"{processor}; {system}; {kernels} kernels; commit {commit or 'unknown'}; {versions}")
    return "<h2>Where this comes from</h2>" + "".join(f"<p class='small'>{escape(line)}</p>" for line in lines)
