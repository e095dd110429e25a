"""Rows of numbers in text files: read with errors that quote the row, written without loss."""

import re
import warnings
from collections.abc import Iterator

import numpy as np


def numbers_of(rows: list[str], section: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All numbers of the rows one after another, where each row begins among them, and how many it has.

    Raises ValueError, naming the section, if a row has anything but numbers.
    """
    widths = np.fromiter((len(row.split()) for row in rows), np.int64, len(rows))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            numbers = np.fromstring(" ".join(rows), sep=" ") if rows else np.zeros(0)
            complete = len(numbers) == widths.sum()
        except (DeprecationWarning, ValueError):
            complete = False
    if not complete:
        raise ValueError(f"{section} has a row that is not numbers: {_first_bad_row(rows)!r}")
    return numbers, np.cumsum(widths) - widths, widths


def _first_bad_row(rows: list[str]) -> str:
    """The first row that has anything but numbers."""
    for row in rows:
        try:
            [float(word) for word in row.split()]
        except ValueError:
            return row.strip()
    return ""


def number_lines(table: np.ndarray, before: str = "") -> Iterator[str]:
    """The rows (n, m) as lines of text with `before` in front of each; a string has some thousands of lines.

    Each number has as many digits as it needs to be read back bit for bit.
    """
    line = before + " ".join(["%r"] * table.shape[1]) + "\n"
    for start in range(0, len(table), 1 << 14):
        part = table[start : start + (1 << 14)]
        yield line * len(part) % tuple(part.reshape(-1).tolist())


def with_words(line: str, first: int, words: list[str]) -> str:
    """The line with other words from the word `first` on."""
    spans = [match.span() for match in re.finditer(r"\S+", line)][first : first + len(words)]
    for (start, stop), word in reversed(list(zip(spans, words, strict=True))):
        line = line[:start] + word + line[stop:]
    return line
