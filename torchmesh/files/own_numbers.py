"""What a file itself calls its nodes and elements, added to messages that count rows.

the constrained edge [654, 629] meets ...    rows of points and triangles, counted from 0
(in the file: nodes 655, 630)                Gmsh's tags, Nastran's and Abaqus' numbers, the maps of Exodus
"""

import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from .content import merged_rows
from .formats.deck import TRIANGLES, triangles_of
from .formats.format import Document

# So many numbers are told in one message.
_TOLD = 12

_LIST = re.compile(r"\[(\d+(?:, \d+)*)\]")
_VERTEX = re.compile(r"\b(?:vertex|vertices|point|points)(?: row| rows)? (\d+(?:(?:, | and )\d+)*)")
_TRIANGLE = re.compile(r"\btriangles?(?: cells)?(?: rows?)? (\d+(?:(?:, | and )\d+)*)\b")


def triangle_numbers(document: Document) -> Sequence[Any] | np.ndarray | None:
    """(T,) what the file calls each triangle of the mesh that is read from it; None without numbers of its own."""
    if not any(kind in document.cell_numbers for kind in TRIANGLES):
        return None
    numbers: list[Any] = []
    taken = dict.fromkeys(TRIANGLES, 0)
    for block in document.mesh.cells:
        if block.type in TRIANGLES:
            start = taken[block.type]
            taken[block.type] += len(block.data)
            numbers += list(document.cell_numbers.get(block.type, ())[start : taken[block.type]])
    if not document.repeats_triangles:
        return numbers
    first, _ = merged_rows(triangles_of(document.mesh))
    return [numbers[row] for row in first.tolist()]


def with_own_numbers(text: str, document: Document) -> str:
    """The message, and behind it what the file calls the vertices and triangles that it names by their rows."""
    parts: list[str] = []
    if document.node_numbers is not None:
        parts += _named("node", _rows(text, _VERTEX, _LIST), document.node_numbers)
    triangles = triangle_numbers(document)
    if triangles is not None:
        parts += _named("element", _rows(text, _TRIANGLE), triangles)
    return f"{text} (in the file: {'; '.join(parts)})" if parts else text


def _rows(text: str, *patterns: re.Pattern[str]) -> list[int]:
    """The rows that a message names, each once, in its order."""
    found = sorted(match.span(1) for pattern in patterns for match in pattern.finditer(text))
    return list(dict.fromkeys(int(row) for start, stop in found for row in re.findall(r"\d+", text[start:stop])))


def _named(noun: str, rows: list[int], numbers: Sequence[Any] | np.ndarray) -> Iterator[str]:
    known = [str(numbers[row]) for row in rows if row < len(numbers)]
    if known:
        more = f" and {len(known) - _TOLD} more" if len(known) > _TOLD else ""
        yield f"{noun}{'s' if len(known) > 1 else ''} {', '.join(known[:_TOLD])}{more}"
