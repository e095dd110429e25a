"""Rows of numbers in text files, with errors that name the line."""

import itertools
import warnings
from collections.abc import Iterator

import numpy as np


def _numbers(rows: list[str], section: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All numbers of the rows, where each row begins among them, and how many it has."""
    widths = np.fromiter((len(row.split()) for row in rows), np.int64, len(rows))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            numbers = np.fromstring(" ".join(rows), sep=" ") if rows else np.zeros(0)
            complete = len(numbers) == widths.sum()
        except (DeprecationWarning, ValueError):
            complete = False
    if not complete:
        raise ValueError(f"{section} has a row that is not numbers: {_not_numbers(rows)!r}")
    return numbers, np.cumsum(widths) - widths, widths


def _not_numbers(rows: list[str]) -> str:
    """The first row that is not numbers only."""
    for row in rows:
        try:
            [float(word) for word in row.split()]
        except ValueError:
            return row.strip()
    return ""


def _rows(lines: Iterator[str], count: int, section: str) -> list[str]:
    """The next `count` lines that hold something, without the remarks at their ends."""
    rows: list[str] = []
    while len(rows) < count:
        more = list(itertools.islice(lines, count - len(rows)))
        if not more:
            raise ValueError(f"{section} says {count}, the file ends after {len(rows)}")
        more = [line.split("%", 1)[0] if "%" in line else line for line in more]
        rows += [line for line in more if not line.isspace() and line]
    return rows


def number_lines(table: np.ndarray, before: str = "") -> Iterator[str]:
    """The rows (n, m) as lines of text, `before` in front of each, some thousands at a time.

    Each number is as short as gives it back to the bit.
    """
    line = before + " ".join(["%r"] * table.shape[1]) + "\n"
    for start in range(0, len(table), 1 << 14):
        part = table[start : start + (1 << 14)]
        yield line * len(part) % tuple(part.reshape(-1).tolist())
