"""What a run comes to: success, time and quality of each method in each family and at each level."""

import math
import statistics
from collections.abc import Iterable
from dataclasses import dataclass

from .results import Row


@dataclass(frozen=True)
class Summary:
    """Some rows of one method.

    cases    how many
    refused  how many of them the method refused
    success  the share that came out valid; a refusal is none
    seconds  the median processor time, of the valid ones; None without any
    mean     the median of the average inverse mean ratio of the valid ones, and
    max      the median of the maximum; None without any
    """

    cases: int
    refused: int
    success: float
    seconds: float | None
    mean: float | None
    max: float | None

    @classmethod
    def of(cls, rows: Iterable[Row]) -> "Summary":
        some = list(rows)
        good = [row for row in some if row["valid"]]

        def median(name: str) -> float | None:
            values = [row[name] for row in good if row.get(name) is not None]
            return statistics.median(values) if values else None

        refused = sum(row["outcome"] == "refused" for row in some)
        share = len(good) / len(some) if some else math.nan
        return cls(len(some), refused, share, median("seconds"), median("mean"), median("max"))


def names(rows: Iterable[Row], column: str) -> list[str]:
    """The different values of a column, in the order in which they come first."""
    return list(dict.fromkeys(row[column] for row in rows))


def by_level(rows: list[Row], method: str, family: str) -> dict[float, Summary]:
    """The summary of a method at each level of a family, the easiest first."""
    some = [row for row in rows if row["method"] == method and row["family"] == family]
    levels = sorted({row["level"] for row in some})
    return {level: Summary.of(row for row in some if row["level"] == level) for level in levels}


def table(rows: list[Row]) -> tuple[list[str], list[list[str]]]:
    """Heads and lines: the share of valid results of each method by family, then over all, with time and quality."""
    families = names(rows, "family")
    heads = ["method", *families, "all", "seconds", "IMR average", "IMR maximum", "refused"]
    lines = []
    for method in names(rows, "method"):
        some = [row for row in rows if row["method"] == method]
        whole = Summary.of(some)
        parts = [Summary.of(row for row in some if row["family"] == family) for family in families]
        shares = [percent(part) for part in (*parts, whole)]
        lines.append([method, *shares, *map(number, (whole.seconds, whole.mean, whole.max)), str(whole.refused or "")])
    return heads, lines


def markdown(rows: list[Row]) -> str:
    """The table as Markdown."""
    heads, lines = table(rows)
    return "\n".join("| " + " | ".join(line) + " |" for line in [heads, ["---"] * len(heads), *lines]) + "\n"


def percent(summary: Summary) -> str:
    """The share of success in percent, "" without cases; short of 100 where one case failed."""
    if not summary.cases:
        return ""
    value = 100 * summary.success
    return f"{math.floor(value)} %" if value < 100 else "100 %"


def number(value: float | None) -> str:
    """Three digits, or "" for nothing."""
    return "" if value is None else f"{value:.3g}"
