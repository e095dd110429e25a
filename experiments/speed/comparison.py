"""The rows of the comparison with other tools, and their table."""

from __future__ import annotations

from dataclasses import dataclass

from experiments.shared import tables


@dataclass(frozen=True)
class Row:
    """One tool on one domain; without seconds, `note` says why.  `kept` is the share of vertices that are kept."""

    domain: str
    triangles: int
    inverted: int
    tool: str
    seconds: float | None = None
    cpu_seconds: float | None = None
    inverted_left: int | None = None
    kept: float | None = None
    mean: float | None = None
    max: float | None = None
    note: str = ""


def table(rows: list[Row]) -> str:
    """Markdown: a table of the rows that have seconds, and under it each reason why others have none, once."""
    titles = (
        "domain",
        "triangles",
        "inverted",
        "tool",
        "seconds",
        "inverted left",
        "vertices kept",
        "IMR average",
        "IMR maximum",
        "note",
    )
    measured: list[list[str]] = []
    left_out: dict[str, list[str]] = {}
    for row in rows:
        if row.seconds is None:
            left_out.setdefault(f"{row.tool}: {row.note}", []).append(f"{row.domain} ({row.triangles:,})")
            continue
        head = [row.domain, f"{row.triangles:,}", f"{row.inverted:,}", row.tool, f"{row.seconds:.3f}"]
        measured.append(
            [*head, str(row.inverted_left), f"{row.kept:.0%}", f"{row.mean:.3f}", f"{row.max:.2f}", row.note]
        )
    reasons = [f"\n{reason}: {', '.join(where)}." for reason, where in left_out.items()]
    return "\n".join([tables.table(titles, measured), *reasons])
