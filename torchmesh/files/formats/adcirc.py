"""Meshes of ADCIRC and SCHISM (fort.14, .grd, .gr3): nodes with a depth, elements, and boundaries as strings of nodes.

    title
    NE NP                    the numbers of elements and nodes
    5 1.4 0.5 -11            node, x, y, depth
    1 3 1 2 5                element, number of its nodes, nodes
    1 = open boundaries      NOPE, then NETA, then each string: its length, and a node a line
    1 = land boundaries      NBOU, then NVEL, then each string: its length and type, and a node a line

https://adcirc.org/home/documentation/users-manual-v53/input-file-descriptions/adcirc-grid-and-boundary-information-file-fort-14/
"""

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np

from .format import FLAT, Document, numbers_by_type
from .gmsh_read import RowOf
from .text_numbers import number_lines
from .text_tables import Reader, Rows, TextFormat, TextTables, chains, tagged, whole

# The number of the string that a line belongs to; strings of open boundaries come first.
STRING = "adcirc:boundary"

_HEAD = re.compile(rb"[^\n]*\n\s*\d+[ \t,]+\d+\b[^\n]*\n\s*\d+[ \t,]+[-+.\d]")

# The exponent of a number in double precision, as Fortran writes it.
_EXPONENT = re.compile(r"(?<=[\d.])[dD](?=[-+\d])")

# What is no number: exponents in double precision, and text behind the numbers, which Fortran passes over.
_WORDS = re.compile(r"[^\s\d.+\-eE]")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?(?=[\s,]|$)")

# The types of boundaries (IBTYPE) by what they are called; other types are just boundaries.
_ISLANDS = (1, 11, 21)
_NAMES = {**dict.fromkeys((0, 10, 20, 30), "land"), **dict.fromkeys(_ISLANDS, "island"),
          **dict.fromkeys((2, 12, 22, 32), "river"), **dict.fromkeys((3, 13, 23, 4, 24, 5, 25), "weir")}  # fmt: skip


@dataclass
class AdcircTables(TextTables):
    """The text of a mesh, and its strings of nodes.

    strings  for each string of nodes the name of its part of the boundary and its type, None for an open boundary
    """

    strings: list[tuple[str, int | None]]


@dataclass(frozen=True)
class AdcircFormat(TextFormat):
    """The depth is the third coordinate.  Strings of nodes are lines, called open-1, land-1, island-1 and so on."""

    def recognises(self, head: bytes) -> bool:
        return _HEAD.match(head) is not None

    def parse(self, lines: list[str], path: Path) -> Document:
        reader = Reader(lines)
        if lines and not lines[0].strip():  # the title may be empty
            reader.at = 0
        else:
            reader.text("its title")
        elements, nodes = reader.whole("the numbers of elements and nodes", 2)
        reader.texts = [_numbers_of(text) if _WORDS.search(text) else text for text in reader.texts]
        at, table = reader.columns(nodes, 4, "the nodes")
        names = whole(table[:, 0], "the nodes")
        if len(np.unique(names)) < len(names):
            raise ValueError("a node has the number of another one")
        row_of = RowOf(names, "node")
        blocks, rows, numbers = _read_elements(reader, elements, row_of)
        strings, edges, tags, skipped = _read_strings(reader, row_of)
        cells = [*blocks, ("line", edges)]
        data = {STRING: [*(np.zeros(len(found), np.int64) for _, found in blocks), tags]} if len(edges) else {}
        mesh = meshio.Mesh(table[:, 1:], cells if len(edges) else blocks, cell_data=data)
        sides = {name: edges[tags == k] for k, (name, _) in enumerate(strings, 1)}
        no_rows = [Rows(np.zeros(0, np.int64), 0)] if len(edges) else []  # strings of nodes never change
        tables = AdcircTables(lines, Rows(at, 1), [*rows, *no_rows], names, strings)
        none = [np.zeros(0, np.int64)] * (len(mesh.cells) - len(blocks))
        return Document(
            mesh, self.name, rest=tables, sides=sides, skipped=tuple(skipped), depths=True, node_numbers=names,
            cell_numbers=numbers_by_type(mesh, [*numbers, *none]),
        )  # fmt: skip

    def new_lines(self, mesh: meshio.Mesh, like: Document | None) -> Iterator[str]:
        points = np.pad(mesh.points, ((0, 0), (0, 3 - mesh.points.shape[1])))
        faces = [block.data for block in mesh.cells if block.type in FLAT]
        yield (like.rest.lines[0].rstrip("\r\n") if like is not None else "mesh") + "\n"
        yield f"{sum(map(len, faces))} {len(points)}\n"
        names = np.arange(1, len(points) + 1)
        yield from number_lines(np.column_stack([names.astype(object), points.astype(object)]))
        start = 1
        for block in faces:
            head = np.column_stack([start + np.arange(len(block)), np.full(len(block), block.shape[1])])
            yield from number_lines(np.column_stack([head, block + 1]))
            start += len(block)
        strings = like.rest.strings if like is not None else []
        yield from _string_lines(mesh, strings)


ADCIRC = AdcircFormat("adcirc", (".14", ".grd", ".gr3", ".ll"), (*FLAT, "line"), point_data="none", cell_data="regions",
                      region_name=STRING)  # fmt: skip


def _numbers_of(text: str) -> str:
    """The numbers that a row begins with, as Python writes them; the row itself if it begins with none."""
    words = list(itertools.takewhile(_NUMBER.match, text.split("!")[0].replace(",", " ").split()))
    return _EXPONENT.sub("e", " ".join(words)) if words else text


def _read_elements(
    reader: Reader, count: int, row_of: RowOf
) -> tuple[list[tuple[str, np.ndarray]], list[Rows], list[np.ndarray]]:
    """Runs of triangles and of quads, where they stand, and their numbers."""
    at, numbers, starts, widths = reader.table(count, 5, "the elements")
    sizes = whole(numbers[starts + 1], "the sizes of elements") if count else np.zeros(0, np.int64)
    names = whole(numbers[starts], "the elements") if count else np.zeros(0, np.int64)
    blocks, rows, own = [], [], []
    ends = [0, *(1 + np.flatnonzero(np.diff(sizes))).tolist(), len(sizes)]
    for begin, end in itertools.pairwise(ends):
        if begin == end:
            continue
        size = int(sizes[begin])
        if size not in (3, 4) or (widths[begin:end] < 2 + size).any():
            raise ValueError(f"an element with {size} nodes is not known, or has fewer than it says")
        nodes = numbers[starts[begin:end, None] + 2 + np.arange(size)]
        blocks.append((FLAT[size - 3], row_of(whole(nodes, "the elements"))))
        rows.append(Rows(at[begin:end], 2))
        own.append(names[begin:end])
    return blocks, rows, own


def _read_strings(
    reader: Reader, row_of: RowOf
) -> tuple[list[tuple[str, int | None]], np.ndarray, np.ndarray, list[str]]:
    """The names and types of strings, their edges (K, 2), the number (K,) of the string of each, and what is left."""
    strings: list[tuple[str, int | None]] = []
    edges, tags = [np.zeros((0, 2), np.int64)], [np.zeros(0, np.int64)]
    skipped: list[str] = []
    for kind in ("open", "land"):
        if not reader.left:  # files of values at nodes have no boundaries
            break
        (count,) = reader.whole(f"the number of {kind} boundaries")
        reader.whole(f"the number of nodes of {kind} boundaries")
        counted: dict[str, int] = {}
        for _ in range(count):
            row = reader.text(f"a {kind} boundary")
            found = re.match(r"(\d+)(?:[\s,]+(-?\d+))?", row)
            if found is None:
                raise ValueError(f"a boundary begins with the number of its nodes: {row[:60]!r}")
            at, table = reader.columns(int(found[1]), 1, f"the nodes of a {kind} boundary")
            kind_of = None if kind == "open" else int(found[2] or 0)
            word = "open" if kind_of is None else _NAMES.get(kind_of, "boundary")
            counted[word] = counted.get(word, 0) + 1
            strings.append((f"{word}-{counted[word]}", kind_of))
            nodes = row_of(whole(table[:, 0], "the nodes of a boundary"))
            closed = word == "island" and len(nodes) > 2 and nodes[0] != nodes[-1]
            nodes = np.append(nodes, nodes[0]) if closed else nodes
            edges.append(np.stack([nodes[:-1], nodes[1:]], 1))
            tags.append(np.full(len(nodes) - 1 if len(nodes) else 0, len(strings)))
            if any(len(reader.texts[k].split()) > 1 for k in range(reader.at - len(at), reader.at)):
                skipped.append(f"heights and coefficients of {word}-{counted[word]}")
    if reader.left:
        skipped.append(f"lines such as {reader.texts[reader.at][:60]!r}")
    return strings, np.concatenate(edges), np.concatenate(tags), skipped


def _string_lines(mesh: meshio.Mesh, strings: list[tuple[str, int | None]]) -> Iterator[str]:
    """The sections of boundaries: the lines of each string in the order in which they follow one another."""
    lines = [(block.data, tagged(mesh, STRING, i, 1)) for i, block in enumerate(mesh.cells) if block.type == "line"]
    edges = np.concatenate([np.zeros((0, 2), np.int64), *(found for found, _ in lines)])
    tags = np.concatenate([np.zeros(0, np.int64), *(found for _, found in lines)])
    groups: dict[bool, list[tuple[int | None, list[int]]]] = {True: [], False: []}
    for tag in np.unique(tags[tags > 0]).tolist():
        kind = strings[tag - 1][1] if tag <= len(strings) else 0
        for chain in chains(edges[tags == tag].tolist()):
            groups[kind is None].append((kind, chain))
    for is_open, name in ((True, "open"), (False, "land")):
        found = groups[is_open]
        yield f"{len(found)} = Number of {name} boundaries\n"
        total = sum(len(chain) - (kind in _ISLANDS and chain[0] == chain[-1]) for kind, chain in found)
        yield f"{total} = Total number of {name} boundary nodes\n"
        for number, (kind, chain) in enumerate(found, 1):
            if kind in _ISLANDS and chain[0] == chain[-1]:  # its last node leads back to the first
                chain = chain[:-1]
            head = f"{len(chain)}" if kind is None else f"{len(chain)} {kind}"
            yield f"{head} = Number of nodes for {name} boundary {number}\n"
            yield "".join(f"{node + 1}\n" for node in chain)
