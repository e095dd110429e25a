"""Lines of a Markdown table."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def line(cells: Iterable[str]) -> str:
    """One row."""
    return "| " + " | ".join(cells) + " |"


def head(titles: Sequence[str]) -> str:
    """The row of titles and the rule under it."""
    return line(titles) + "\n" + "|---" * len(titles) + "|"


def table(titles: Sequence[str], rows: Iterable[Iterable[str]]) -> str:
    """A whole table, without a newline at its end."""
    return "\n".join([head(titles), *map(line, rows)])
