"""SMS' and QGIS' planar meshes (.2dm): a card a line, with its keyword in front.

    E3T 1 1 2 5 7            element, its nodes, the number of its material
    ND 5 1.4 0.5 -11         node, x, y, z
    NS 1 2 -3 1              a string of nodes, whose last one is negative, and its number

https://www.xmswiki.com/wiki/SMS:2D_Mesh_Files_*.2dm
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np

from .format import LINEAR, Document, numbers_by_type
from .gmsh_read import RowOf
from .text_numbers import number_lines, numbers_of
from .text_tables import Rows, TextFormat, TextTables, chains, tagged, whole

MATERIAL = "sms:material"

# The keywords of elements: meshio's type, its number of nodes, and which word of the file is each of meshio's nodes.
# Elements of second order go round, corner after mid-side node.
_KINDS: dict[str, tuple[str, int, tuple[int, ...] | None]] = {
    "E3T": ("triangle", 3, None), "E4Q": ("quad", 4, None), "E2L": ("line", 2, None), "E3L": ("line3", 3, (0, 2, 1)),
    "E6T": ("triangle6", 6, (0, 2, 4, 1, 3, 5)), "E8Q": ("quad8", 8, (0, 2, 4, 6, 1, 3, 5, 7)),
    "E9Q": ("quad9", 9, (0, 2, 4, 6, 1, 3, 5, 7, 8)),
}  # fmt: skip
_WORDS = {name: (word, count) for word, (name, count, _) in _KINDS.items()}


@dataclass(frozen=True)
class SmsFormat(TextFormat):
    """Materials are the cell data `sms:material`; strings of nodes are lines, by their numbers and names."""

    def parse(self, lines: list[str], path: Path) -> Document:
        heads = [line.split(None, 1)[:1] for line in lines]
        cards: dict[str, list[int]] = {}
        runs: list[tuple[str, list[int]]] = []
        for number, head in enumerate(heads):
            word = head[0].upper() if head else ""
            cards.setdefault(word, []).append(number)
            if word in _KINDS:
                if not runs or runs[-1][0] != word:
                    runs.append((word, []))
                runs[-1][1].append(number)
        if not ({"MESH2D", "ND"} & set(cards)):
            raise ValueError("it has no card MESH2D and no nodes (ND)")
        at, table, _ = _columns(lines, cards.get("ND", []), 4, "ND")
        names = whole(table[:, 0], "ND")
        if len(np.unique(names)) < len(names):
            raise ValueError("a node has the number of another one")
        row_of = RowOf(names, "node")
        cells, tags, rows, own = [], [], [], []
        for word, numbers in runs:
            kind, count, order = _KINDS[word]
            where, table_of, material = _columns(lines, numbers, 1 + count, word)
            nodes = row_of(whole(table_of[:, 1:], word))
            cells.append((kind, nodes if order is None else nodes[:, order]))
            tags.append(material)
            rows.append(Rows(where, 2, order))
            own.append(whole(table_of[:, 0], word))
        strings = _strings(lines, cards.get("NS", []), row_of)
        for edges in strings.values():
            cells.append(("line", edges))
            tags.append(np.zeros(len(edges), np.int64))
            rows.append(Rows(np.zeros(0, np.int64), 0))  # these lines never change
            own.append(np.zeros(len(edges), np.int64))
        mesh = meshio.Mesh(table[:, 1:], cells, cell_data={MATERIAL: tags} if cells else None)
        known = {"MESH2D", "ND", "NS", "NUM_MATERIALS_PER_ELEM", "", *_KINDS}
        others = [f"{word} cards" for word in cards if word not in known]
        return Document(
            mesh,
            self.name,
            rest=TextTables(lines, Rows(at, 2), rows, names),
            sides=strings,
            skipped=tuple(others),
            depths=True,
            node_numbers=names,
            cell_numbers=numbers_by_type(mesh, own),
        )

    def new_lines(self, mesh: meshio.Mesh, like: Document | None) -> Iterator[str]:
        yield "MESH2D\n"
        yield "NUM_MATERIALS_PER_ELEM 1\n"
        start, strings = 1, []
        for i, block in enumerate(mesh.cells):
            if block.type == "line":
                strings.append(block.data)
                continue
            word, _ = _WORDS[block.type]
            order = _KINDS[word][2]
            nodes = block.data if order is None else block.data[:, np.argsort(order)]
            tags = np.maximum(tagged(mesh, MATERIAL, i, 1), 1)
            yield from number_lines(np.column_stack([start + np.arange(len(nodes)), nodes + 1, tags]), f"{word} ")
            start += len(nodes)
        points = np.pad(mesh.points, ((0, 0), (0, 3 - mesh.points.shape[1])))
        names = np.arange(1, len(points) + 1)
        yield from number_lines(np.column_stack([names.astype(object), points.astype(object)]), "ND ")
        for number, edges in enumerate(strings, 1):
            for chain in chains(edges.tolist()):
                nodes = [*(str(node + 1) for node in chain[:-1]), str(-chain[-1] - 1)]
                for first in range(0, len(nodes), 10):
                    last = first + 10 >= len(nodes)
                    yield f"NS {' '.join(nodes[first : first + 10])}{f' {number}' if last else ''}\n"


SMS = SmsFormat("sms", (".2dm",), (*LINEAR, "higher"), point_data="none", cell_data="regions", region_name=MATERIAL,
                counts=False)  # fmt: skip


def _columns(lines: list[str], numbers: list[int], width: int, word: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Line numbers (n,) and first columns (n, width) behind the keyword of cards, and the whole number behind these.

    Where a card has nothing behind its columns, or no whole number, that number is 0.
    """
    texts = [" ".join(lines[number].split()[1:]) for number in numbers]
    values, starts, widths = numbers_of(texts, word)
    if len(numbers) and widths.min() < width:
        raise ValueError(f"a card {word} needs {width} numbers: {lines[numbers[int(widths.argmin())]].strip()[:60]!r}")
    more = np.zeros(len(numbers))
    rich = widths > width
    more[rich] = values[starts[rich] + width]
    more[more != np.floor(more)] = 0
    return np.array(numbers, np.int64), values[starts[:, None] + np.arange(width)], whole(more, word)


def _strings(lines: list[str], numbers: list[int], row_of: RowOf) -> dict[str, np.ndarray]:
    """The edges of each string of nodes, which may go on over several cards, by its number or name."""
    found: dict[str, np.ndarray] = {}
    nodes: list[int] = []
    for number in numbers:
        words = lines[number].split()[1:]
        for k, word in enumerate(words):
            if not re.fullmatch(r"-?\d{1,18}", word):
                raise ValueError(f"a string of nodes has {word!r}")
            nodes.append(abs(int(word)))
            if word.startswith("-"):
                rest = " ".join(words[k + 1 :]).strip('"')
                name = f"string-{rest or len(found) + 1}" if not rest or rest.isdigit() else rest
                while name in found:
                    name += "+"
                rows = row_of(np.array(nodes, np.int64))
                found[name] = np.stack([rows[:-1], rows[1:]], 1)
                nodes = []
                break
    if nodes:
        raise ValueError("its last string of nodes has no end: the file is cut short")
    return found
