"""Lines of a Markdown table, each of which is kept as a row of a CSV file, too, once `keep` has named a place."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

# A number with commas between thousands.
_THOUSANDS = re.compile(r"-?\d{1,3}(,\d{3})+(\.\d+)?")


class _Book:
    """The CSV files of one run: NAME.csv for its first table, NAME-2.csv for the next, and so on."""

    def __init__(self, folder: Path, name: str, record: Mapping[str, object]) -> None:
        self.folder, self.name = folder, name
        self.tables, self.columns = 0, 0
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps(record, indent=1, default=str) + "\n"
        (folder / f"{name}.run.json").write_text(text, encoding="utf-8")

    def begin(self, titles: Sequence[str]) -> None:
        self.tables, self.columns = self.tables + 1, len(titles)
        self._write(titles, "w")

    def add(self, cells: Sequence[str]) -> None:
        if len(cells) == self.columns:
            self._write(cells, "a")

    def _write(self, cells: Sequence[str], mode: str) -> None:
        number = f"-{self.tables}" if self.tables > 1 else ""
        with open(self.folder / f"{self.name}{number}.csv", mode, newline="", encoding="utf-8") as stream:
            csv.writer(stream).writerow([_plain(cell) for cell in cells])


_book: _Book | None = None


def keep(folder: Path | None, name: str, record: Mapping[str, object]) -> None:
    """From here on every table is written to `folder`, too: NAME.csv, and NAME.run.json, where it comes from.

    Rows are written as they are made, so that a run that is stopped leaves those that it has.  None: nothing is kept.
    """
    global _book
    _book = None if folder is None else _Book(folder, name, record)


def line(cells: Iterable[str]) -> str:
    """One row."""
    row = list(cells)
    if _book is not None:
        _book.add(row)
    return _joined(row)


def head(titles: Sequence[str]) -> str:
    """The row of titles and the rule under it."""
    if _book is not None:
        _book.begin(titles)
    return _joined(titles) + "\n" + "|---" * len(titles) + "|"


def table(titles: Sequence[str], rows: Iterable[Iterable[str]]) -> str:
    """A whole table, without a newline at its end."""
    return "\n".join([head(titles), *map(line, rows)])


def _joined(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _plain(cell: str) -> str:
    """A cell without the marks of Markdown, and numbers without commas."""
    text = cell.replace("**", "").replace("`", "").strip()
    return text.replace(",", "") if _THOUSANDS.fullmatch(text) else text
