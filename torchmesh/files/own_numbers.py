"""What a file itself calls its nodes and elements, added to messages that count rows.

the constrained edge [654, 629] meets ...    rows of points and triangles, counted from 0
(in the file: nodes 655, 630)                Gmsh's tags, the numbers of decks, the maps of Exodus, counts from 1

Nothing is added where the file's own numbers are the rows, as in files that count from 0.
"""

import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from .content import merged_rows
from .curved_cells import straightened
from .formats.deck import TRIANGLES, triangles_of
from .formats.format import Document
from .quads import quads_of

# Types of cells that are quads.
_QUADS = ("quad", "quad8", "quad9")

# So many numbers are told in one message.
_TOLD = 12

_LIST = re.compile(r"\[(\d+(?:, \d+)*)\]")
_VERTEX = re.compile(r"\b(?:vertex|vertices|point|points)(?: row| rows)? (\d+(?:(?:, | and )\d+)*)")
_TRIANGLE = re.compile(r"\btriangles?(?: cells)?(?: rows?)? (\d+(?:(?:, | and )\d+)*)\b")
_QUAD = re.compile(r"\bquads?(?: cells)?(?: rows?)? (\d+(?:(?:, | and )\d+)*)\b")


def triangle_numbers(document: Document) -> Sequence[Any] | np.ndarray | None:
    """(T,) what the file calls each triangle of the mesh that is read from it; None without numbers of its own."""
    numbers = _in_file_order(document, TRIANGLES)
    if numbers is None or not document.repeats_triangles:
        return numbers
    first, _ = merged_rows(triangles_of(document.mesh))
    return [numbers[row] for row in first.tolist()]


def quad_numbers(document: Document) -> Sequence[Any] | np.ndarray | None:
    """(Q,) what the file calls each quad of the mesh that is read from it; None without numbers of its own."""
    numbers = _in_file_order(document, _QUADS)
    if numbers is None or not document.repeats_triangles:
        return numbers
    _, first, _ = quads_of(straightened(document.mesh)[0], True)
    return [numbers[row] for row in first.tolist()]


def _in_file_order(document: Document, kinds: Sequence[str]) -> list[Any] | None:
    """The numbers of all cells of these types; None where the file has none for one of them."""
    numbers: list[Any] = []
    taken = dict.fromkeys(kinds, 0)
    for block in document.mesh.cells:
        if block.type in kinds:
            start = taken[block.type]
            taken[block.type] += len(block.data)
            own = document.cell_numbers.get(block.type, ())[start : taken[block.type]]
            if len(own) < len(block.data):
                return None
            numbers += list(own)
    return numbers or None


def with_own_numbers(text: str, document: Document) -> str:
    """The message, and behind it what the file calls the vertices and triangles that it names by their rows."""
    parts: list[str] = []
    if document.node_numbers is not None:
        parts += _named("node", _rows(text, _VERTEX, _LIST), document.node_numbers)
    rows = [(_rows(text, _TRIANGLE), triangle_numbers), (_rows(text, _QUAD), quad_numbers)]
    for found, numbers_of in rows:
        numbers = numbers_of(document) if found else None
        parts += [] if numbers is None else _named("element", found, numbers)
    return f"{text} (in the file: {'; '.join(parts)})" if parts else text


def _rows(text: str, *patterns: re.Pattern[str]) -> list[int]:
    """The rows that a message names, each once, in its order."""
    found = sorted(match.span(1) for pattern in patterns for match in pattern.finditer(text))
    return list(dict.fromkeys(int(row) for start, stop in found for row in re.findall(r"\d+", text[start:stop])))


def _named(noun: str, rows: list[int], numbers: Sequence[Any] | np.ndarray) -> Iterator[str]:
    """The numbers of rows in words; nothing where they are the rows themselves."""
    known = [str(numbers[row]) for row in rows if row < len(numbers)]
    if known and known != [str(row) for row in rows]:
        more = f" and {len(known) - _TOLD} more" if len(known) > _TOLD else ""
        yield f"{noun}{'s' if len(known) > 1 else ''} {', '.join(known[:_TOLD])}{more}"
