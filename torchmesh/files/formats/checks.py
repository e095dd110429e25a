"""What is wrong with a file that a library's reader would not notice, find out too late, or never come back from.

Each check takes the bytes of a file and raises ValueError.
"""

import re
import xml.etree.ElementTree as ET

import numpy as np

from ..swelling import check_swelling


def check_ply(data: bytes) -> None:
    """Its header must end, and its counts must fit its size."""
    head, end, _ = data.partition(b"\nend_header")
    if not end:
        raise ValueError("its header has no end")
    for what, count in re.findall(rb"^element\s+(\w+)\s+(\d+)", head, re.M):
        _fits(what.decode(), int(count), 2, data)


def check_stl(data: bytes) -> None:
    """A binary file has a head of 80 bytes, the number of triangles, and 50 bytes for each; text ends in words."""
    if not is_binary_stl(data) and b"endsolid" not in data[-500:]:
        raise ValueError("it does not end with endsolid: truncated")


def is_binary_stl(data: bytes) -> bool:
    return len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")


def check_off(data: bytes) -> None:
    """The line of counts must be there and fit the file's size."""
    lines = (line.strip() for line in data.split(b"\n", 1000)[1:])
    counts = next((line.split() for line in lines if line and not line.startswith(b"#")), [])
    if len(counts) < 2 or not all(word.isdigit() for word in counts):
        raise ValueError("it has no line with the numbers of vertices, faces and edges: truncated or damaged")
    _fits("vertices", int(counts[0]), len(b"0 0 0\n"), data)
    _fits("faces", int(counts[1]), len(b"3 0 1 2\n"), data)


def check_avs(data: bytes) -> None:
    """The five counts of the first line must fit the file's size, and no node or cell may come twice."""
    lines = [line for line in data.split(b"\n") if line.strip() and not line.startswith(b"#")]
    counts = lines[0].split() if lines else []
    if len(counts) != 5 or not all(word.isdigit() for word in counts):
        raise ValueError("its first line is not five counts: truncated or damaged")
    nodes, cells = int(counts[0]), int(counts[1])
    _fits("nodes", nodes, len(b"1 0 0 0\n"), data)
    _fits("cells", cells, len(b"1 0 tri 1 2 3\n"), data)
    if len(lines) < 1 + nodes + cells:
        raise ValueError(f"it has {nodes} nodes and {cells} cells by its first line, and ends before: truncated")
    for what, rows in (("node", lines[1 : 1 + nodes]), ("cell", lines[1 + nodes : 1 + nodes + cells])):
        numbers = {row.split(None, 1)[0] for row in rows}
        if len(numbers) < len(rows):
            raise ValueError(f"a {what} has the number of another one")


def check_permas(data: bytes) -> None:
    if b"$FIN" not in data:
        raise ValueError("it does not end with $FIN: truncated")


def check_dolfin(data: bytes) -> None:
    """Vertices and cells must be there once each: what is missing would be whatever was in memory."""
    numbers: dict[str, list[int]] = {"vertices": [], "cells": []}
    sizes: dict[str, int] = {}
    for element in ET.fromstring(data).iter():
        if element.tag in numbers:
            sizes[element.tag] = int(element.get("size", "0"))
            numbers[element.tag] = [int(child.get("index", "-1")) for child in element]
    for what, size in sizes.items():
        if len(numbers[what]) != size or not np.array_equal(np.sort(numbers[what]), np.arange(size)):
            raise ValueError(f"it says that it has {size} {what}, and does not have each of them once")


def check_vtk(data: bytes) -> None:
    """Counts must fit the file's size; grids that are given by their dimensions alone must not be huge."""
    sections = rb"^(POINTS|CELLS|CELL_TYPES|POINT_DATA|CELL_DATA|LOOKUP_TABLE\s+\S+)\s+(\d+)"
    for what, count in re.findall(sections, data, re.M):
        _fits(what.decode(errors="replace"), int(count), 1, data)
    for words in re.findall(rb"^DIMENSIONS\s+(\d+)\s+(\d+)\s+(\d+)", data, re.M):
        count = int(words[0]) * int(words[1]) * int(words[2])
        check_swelling(24 * count, len(data))


def _fits(what: str, count: int, least: int, data: bytes) -> None:
    """Raises ValueError if a file is too small for what it says it has.

    least  bytes that each needs at least
    """
    if count * least > len(data) + least:
        raise ValueError(f"it says that it has {count} {what}, for which it is too small: truncated or damaged")
