"""Text files of points and cells whose lines stay: where their tables stand, and what changes in them.

    1 3 1 2 5        a row of cells: its first node is word 2; `order` tells how the file orders nodes
    5 1.4 0.5 -11    a row of points: x is word 1, and the file calls the point 5

Only the words of coordinates and nodes that changed get another text; every other character of the file stays.
"""

import abc
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import meshio
import numpy as np

from .deck import read_lines
from .format import Document, Format
from .text_numbers import numbers_of, with_words

# Larger numbers are not whole numbers of 64 bits, once they were read as floats.
_LARGEST = float(1 << 53)


@dataclass
class Rows:
    """Rows of a table in the text.

    lines  (n,) the numbers of their lines
    first  the word that the coordinates or nodes begin at
    order  the columns of the file in meshio's order; None: they agree
    words  the words that hold data: the name of the data, by the number of the word
    """

    lines: np.ndarray
    first: int
    order: tuple[int, ...] | None = None
    words: dict[int, str] = field(default_factory=dict)


@dataclass
class TextTables:
    """The text of a mesh.

    lines    its lines with their ends
    points   the rows of points; every point has as many coordinates as the mesh that was read
    cells    the rows of each block of cells
    labels   (V,) what the file calls the points
    """

    lines: list[str]
    points: Rows
    cells: list[Rows]
    labels: np.ndarray

    def patched(self, before: meshio.Mesh, after: meshio.Mesh) -> list[str]:
        """The lines with the points, cells and data of `after`, which has the rows of `before`, as it was read."""
        lines = list(self.lines)
        width = before.points.shape[1]
        _put(lines, self.points, before.points, after.points[:, :width])
        for rows, old, new in zip(self.cells, before.cells, after.cells, strict=True):
            order = list(range(old.data.shape[1])) if rows.order is None else np.argsort(rows.order).tolist()
            _put(lines, rows, self.labels[old.data[:, order]], self.labels[new.data[:, order]])
        for word, name in self.points.words.items():
            _put(lines, Rows(self.points.lines, word), before.point_data[name], after.point_data[name])
        for i, rows in enumerate(self.cells):
            for word, name in rows.words.items():
                _put(lines, Rows(rows.lines, word), before.cell_data[name][i], after.cell_data[name][i])
        return lines

    def holds(self, mesh: meshio.Mesh) -> bool:
        """Has a mesh all the data whose values stand in the text?"""
        points, cells = set(self.points.words.values()), {name for rows in self.cells for name in rows.words.values()}
        return points <= set(mesh.point_data) and cells <= set(mesh.cell_data)


def _put(lines: list[str], rows: Rows, before: np.ndarray, after: np.ndarray) -> None:
    """Changes the words of the rows (n, ...) that differ."""
    if not len(rows.lines):  # what stands elsewhere, or nowhere
        return
    old, new = before.reshape(len(before), -1), after.reshape(len(after), -1)
    changed = np.flatnonzero(((old != new) & ~((old != old) & (new != new))).any(1))
    for row in changed.tolist():
        number = int(rows.lines[row])
        for k in np.flatnonzero(old[row] != new[row]).tolist():
            lines[number] = with_words(lines[number], rows.first + k, [repr(new[row, k].item())])


@dataclass(frozen=True)
class TextFormat(Format):
    """A format of text whose files are changed in place while they keep their rows, and written anew otherwise.

    The `rest` of a document is a `TextTables`.
    """

    @abc.abstractmethod
    def parse(self, lines: list[str], path: Path) -> Document:
        """The document of a text.  Raises ValueError."""

    @abc.abstractmethod
    def new_lines(self, mesh: meshio.Mesh, like: Document | None) -> Iterator[str]:
        """The text of a new file, in runs of whole lines; `like` is a file of this format with other rows."""

    def read(self, path: Path) -> Document:
        return self.parse(read_lines(path), path)

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        with open(path, "w", encoding="utf-8", errors="surrogateescape", newline="") as stream:
            if like is not None and same_rows and like.rest.holds(mesh):
                stream.writelines(like.rest.patched(like.mesh, mesh))
            else:
                stream.writelines(self.new_lines(mesh, like))

    def left_behind(self, document: Document, target: Format, same_rows: bool) -> list[str]:
        return [] if target is self and same_rows else list(document.skipped)


class Reader:
    """The rows of a text, one after another.  A row is a line that has more than blanks and a comment.

    comment  what begins a comment; "" for none
    """

    def __init__(self, lines: list[str], comment: str = "") -> None:
        self.lines = lines
        texts = [line.split(comment, 1)[0] if comment else line for line in lines]
        self.numbers = [number for number, text in enumerate(texts) if not text.isspace() and text]
        self.texts = [texts[number].strip() for number in self.numbers]
        self.at = 0

    @property
    def left(self) -> int:
        return len(self.texts) - self.at

    def text(self, what: str) -> str:
        """The next row.  Raises ValueError, saying what is missing, at the end."""
        if not self.left:
            raise ValueError(f"it ends before {what}: the file is cut short")
        self.at += 1
        return self.texts[self.at - 1]

    def whole(self, what: str, count: int = 1) -> list[int]:
        """The first words of the next row, which are whole numbers; text may follow.  Raises ValueError."""
        row = self.text(what)
        words = row.replace(",", " ").split()[:count]
        if len(words) < count or not all(re.fullmatch(r"[-+]?\d{1,18}", word) for word in words):
            raise ValueError(f"{what} should be {'a whole number' if count == 1 else 'whole numbers'}: {row[:60]!r}")
        return [int(word) for word in words]

    def table(self, count: int, width: int, what: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The next rows: their line numbers, all their numbers, where each row begins, how many it has.

        Raises ValueError if there are fewer than `count` rows, or fewer than `width` numbers in one.
        """
        if not 0 <= count <= self.left:
            raise ValueError(f"{what} says {count}, the file ends after {self.left}")
        texts, lines = self.texts[self.at : self.at + count], self.numbers[self.at : self.at + count]
        numbers, starts, widths = numbers_of(texts, what)
        if count and widths.min() < width:
            raise ValueError(f"a row of {what} needs {width} numbers: {texts[int(widths.argmin())][:60]!r}")
        self.at += count
        return np.array(lines, np.int64), numbers, starts, widths

    def columns(self, count: int, width: int, what: str) -> tuple[np.ndarray, np.ndarray]:
        """The line numbers (n,) and first columns (n, width) of the next rows.  Raises ValueError."""
        lines, numbers, starts, _ = self.table(count, width, what)
        return lines, numbers[starts[:, None] + np.arange(width)]


def whole(values: np.ndarray, what: str) -> np.ndarray:
    """Numbers as int64.  Raises ValueError unless they are whole."""
    with np.errstate(invalid="ignore"):
        bad = ~(np.abs(values) <= _LARGEST) | (values != np.floor(values))
    if bad.any():
        raise ValueError(f"{what} has {values[bad].flat[0]:g}, which is no whole number of an entry")
    return values.astype(np.int64)


def tagged(mesh: meshio.Mesh, name: str, block: int, default: int = 0) -> np.ndarray:
    """(n,) the integers that cell data gives to a block of cells; the default where the mesh has no such data."""
    values = mesh.cell_data.get(name)
    return np.full(len(mesh.cells[block].data), default) if values is None else np.asarray(values[block], np.int64)


def groups_by_tag(lines: Sequence[np.ndarray], tags: Sequence[np.ndarray], word: str) -> dict[str, np.ndarray]:
    """Edges (K, 2) by names made of a word and their tag; those with the tag 0 have no name."""
    edges = np.concatenate([np.zeros((0, 2), np.int64), *lines])
    numbers = np.concatenate([np.zeros(0, np.int64), *tags])
    return {f"{word}-{tag}": edges[numbers == tag] for tag in np.unique(numbers).tolist() if tag}


def chains(edges: list[list[int]]) -> Iterator[list[int]]:
    """Runs of edges in which each one begins where the one before ends, as strings of nodes."""
    chain: list[int] = []
    for tail, head in edges:
        if chain and chain[-1] != tail:
            yield chain
            chain = []
        chain = chain or [tail]
        chain.append(head)
    if chain:
        yield chain
