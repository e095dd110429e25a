"""Input decks of solvers: text that is changed in place.

A deck is kept as its lines.  Of the coordinates of nodes and the nodes of triangles it is known where they stand:

    line 7    GRID,5,,1.4,0.5,0.0
                      |   |   `-- span (7, 16, 19)
    patch     the spans whose value has changed get another text; every other character stays

References to the sides of elements (pressures, surfaces) are rewritten to the same edges.
"""

import abc
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import meshio
import numpy as np

from .format import Document, Format
from .meshio_formats import MeshioFormat
from .sides import edges_of, followed

# The columns of a span: its line, its first and last column, and the width that its text has to fill (0: any width;
# -k: nothing stands there yet, and k separators come before the text).
SPAN = 4

# Types of cells that are triangles: straight, and with mid-side nodes behind the corners.
TRIANGLES = ("triangle", "triangle6")


@dataclass(frozen=True)
class SideLine:
    """A line that names sides of elements.

    group     the name of what the line belongs to
    line      its number
    elements  (n,) rows of triangles
    sides     (n,) 0, 1 or 2
    render    gives the lines that name an element row and a side each, in place of the line
    """

    group: str
    line: int
    elements: np.ndarray
    sides: np.ndarray
    render: Callable[[list[tuple[int, int]]], list[str]]


@dataclass
class Deck:
    """A deck as it was read.

    lines        all lines with their ends
    points       (V, 3, SPAN) where the coordinates of each node stand
    corners      (R, 3 or 6, SPAN) where the nodes of each triangle stand; -1 behind those of a straight one
    labels       (V,) what lines of elements call each node
    side_lines   the lines that name sides of elements
    cards        what else the deck has, each once: named when it is lost
    separator    what stands between two fields
    """

    lines: list[str]
    points: np.ndarray
    corners: np.ndarray
    labels: list[str]
    side_lines: list[SideLine] = field(default_factory=list)
    cards: list[str] = field(default_factory=list)
    separator: str = " "


class Edits:
    """Changes to the lines of a text, put in all at once."""

    def __init__(self, lines: list[str]) -> None:
        self._lines = lines
        self._spans: dict[int, list[tuple[int, int, str]]] = {}
        self._columns: set[int] = set()
        self._whole: dict[int, list[str]] = {}

    def put(self, span: np.ndarray, text: str, separator: str) -> None:
        """Gives a span another text.  Raises ValueError if the text is too wide for it."""
        line, start, stop, width = span.tolist()
        if width > 0:
            self._columns.add(line)
            if len(text) > width:
                raise ValueError(f"{text} does not fit into a field of {width} characters")
            text = text.ljust(width)
            if start + width > len(self._lines[line].rstrip("\r\n").expandtabs(8)) and stop < start + width:
                text = text.rstrip()
        self._spans.setdefault(line, []).append((start, stop, separator * max(-width, 0) + text))

    def put_lines(self, line: int, texts: list[str]) -> None:
        """Puts other lines, without their ends, in place of a line."""
        self._whole[line] = texts

    def lines(self) -> list[str]:
        """The text with all changes."""
        result = list(self._lines)
        for line, spans in self._spans.items():
            text = result[line]
            body = text.rstrip("\r\n")
            end = text[len(body) :]
            body = body.expandtabs(8) if line in self._columns else body
            for start, stop, new in sorted(spans, reverse=True):
                body = body.ljust(start)[:start] + new + body[stop:]
            result[line] = body + end
        for line, texts in self._whole.items():
            end = self._lines[line][len(self._lines[line].rstrip("\r\n")) :] or "\n"
            result[line] = "".join(text + end for text in texts)
        return result


@dataclass(frozen=True)
class DeckFormat(MeshioFormat):
    """A format of decks.  A new file that follows no deck is written by meshio."""

    def patches(self, document: Document) -> bool:
        return isinstance(document.rest, Deck)

    @abc.abstractmethod
    def number(self, value: float, width: int) -> str:
        """The text of a coordinate: as exact as a field of this width (0: free) allows, and no wider."""

    def label(self, text: str, width: int) -> str:
        """The text of the number of a node in a field."""
        return text

    def patch(self, path: Path, mesh: meshio.Mesh, like: Document) -> None:
        deck: Deck = like.rest
        edits = Edits(deck.lines)
        before, after = triangles_of(like.mesh), triangles_of(mesh)
        old = np.pad(like.mesh.points, ((0, 0), (0, 3 - like.mesh.points.shape[1])))
        new = np.pad(mesh.points, ((0, 0), (0, 3 - mesh.points.shape[1])))
        written = new.copy()
        for node, axis in np.argwhere(new != old).tolist():
            span = deck.points[node, axis]
            if span[0] < 0:
                raise ValueError(f"node {deck.labels[node]} has no field for its coordinate {axis + 1}")
            text = self.number(float(new[node, axis]), int(span[3]))
            edits.put(span, text, deck.separator)
            written[node, axis] = self.value(text)
        _check_rounding(new, written, after)
        nodes, was_nodes = nodes_of(mesh), nodes_of(like.mesh)
        for row, corner in np.argwhere(was_nodes != nodes).tolist():
            span = deck.corners[row, corner]
            edits.put(span, self.label(deck.labels[nodes[row, corner]], int(span[3])), deck.separator)
        for side in deck.side_lines:
            elements, sides = followed(before, after, side.elements, side.sides)
            was = set(zip(side.elements.tolist(), side.sides.tolist(), strict=True))
            now = list(zip(elements.tolist(), sides.tolist(), strict=True))
            if set(now) != was:
                edits.put_lines(side.line, side.render(now))
        with open(path, "w", encoding="utf-8", errors="surrogateescape", newline="") as stream:
            stream.writelines(edits.lines())

    def value(self, text: str) -> float:
        """The number that the solver reads from a text."""
        return float(text)

    def left_behind(self, document: Document, target: Format, same_rows: bool) -> list[str]:
        if target is self or not isinstance(document.rest, Deck):
            return []
        groups = [f"sides {name!r}" for name in document.sides]
        return [*document.rest.cards, *groups]


def read_lines(path: Path) -> list[str]:
    """The lines of a text with their ends, whatever bytes are in it."""
    with open(path, encoding="utf-8", errors="surrogateescape", newline="") as stream:
        return list(stream)


def triangles_of(mesh: meshio.Mesh) -> np.ndarray:
    """(R, 3) the triangles of all blocks, in file order, by their corners."""
    return nodes_of(mesh)[:, :3]


def nodes_of(mesh: meshio.Mesh) -> np.ndarray:
    """(R, 6) the nodes of the triangles of all blocks, in file order; -1 behind those of straight ones."""
    blocks = [block.data for block in mesh.cells if block.type in TRIANGLES]
    padded = [np.pad(rows, ((0, 0), (0, 6 - rows.shape[1])), constant_values=-1) for rows in blocks]
    return np.concatenate([np.zeros((0, 6), np.int64), *padded])


def span_table(rows: Sequence[Sequence[tuple[int, int, int, int]]]) -> np.ndarray:
    """(R, 6, SPAN) where the nodes of triangles stand; the first column is -1 behind those of straight ones."""
    none = (-1, 0, 0, 0)
    return np.array([[*row, *[none] * (6 - len(row))] for row in rows], np.int64).reshape(-1, 6, SPAN)


def side_groups(lines: list[SideLine], rows: np.ndarray) -> dict[str, np.ndarray]:
    """The edges (K, 2) of each group of side lines."""
    groups: dict[str, list[np.ndarray]] = {}
    for line in lines:
        groups.setdefault(line.group, []).append(edges_of(rows, line.elements, line.sides))
    return {name: np.concatenate(edges) for name, edges in groups.items()}


def _check_rounding(exact: np.ndarray, written: np.ndarray, rows: np.ndarray) -> None:
    """Raises ValueError if the digits that a field has room for turn a triangle over."""
    if not len(rows) or (exact == written).all():
        return

    def normals(points: np.ndarray) -> np.ndarray:
        a, b, c = points[rows[:, 0]], points[rows[:, 1]], points[rows[:, 2]]
        return np.cross(b - a, c - a)

    given, rounded = normals(exact), normals(written)
    turned = ((given * rounded).sum(1) <= 0) & (np.abs(given).sum(1) > 0)
    if turned.any():
        raise ValueError(
            f"its fields have too few digits: rounded to them, {int(turned.sum())} triangles would turn over; "
            "give the nodes wider fields"
        )
