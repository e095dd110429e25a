"""Kratos' model parts (.mdpa), changed in place.

The format is free: words may be spread over lines in any way, and // begins a comment.  Properties, sub model parts
and values that groups of elements share bound regions.  Conditions name their nodes, so that a flip does not touch
them.  https://kratosmultiphysics.github.io/Kratos/pages/Kratos/For_Developers/IO/Input-data.html
"""

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import meshio
import numpy as np

from .deck import TRIANGLES, Deck, DeckFormat, read_lines, span_table
from .format import ALL_BUT_POLYGONS, Document
from .nodal_values import NodalValues

PROPERTIES = "kratos:properties"

# A word with its line, start and end.
_Word = tuple[int, int, int, str]

_NODES = re.compile(r"\dD(\d+)N?$")

# The kinds of entities with nodes, and the words that stand before the nodes: number and properties, or number.
_ENTITIES = {"Elements": 2, "Conditions": 2, "Geometries": 1}


@dataclass(frozen=True)
class KratosFormat(DeckFormat):
    """Kratos' model parts."""

    def read(self, path: Path) -> Document:
        reader = _Reader(read_lines(path))
        reader.run()
        points = np.array(reader.points, np.int64).reshape(-1, 3, 4)
        corners = span_table(reader.corners)
        deck = Deck(reader.lines, points, corners, reader.labels, [], list(reader.cards))
        mesh, by_element = reader.mesh(), reader.by_element()
        several = sum(kind in TRIANGLES and name != "Elements" for name, kind in reader.blocks) > 0
        at_nodes = reader.values.rows(len(reader.nodes))
        return Document(
            mesh, self.name, rest=deck, repeats_triangles=several, by_element=tuple(by_element), at_nodes=at_nodes,
            node_numbers=reader.labels, cell_numbers=reader.numbers(),
        )  # fmt: skip

    def number(self, value: float, width: int) -> str:
        return repr(value)


KRATOS = KratosFormat("mdpa", (".mdpa",), ALL_BUT_POLYGONS, point_data="none", cell_data="none")


@dataclass
class _Reader:
    """What is found in the words of a file.

    blocks  cells by (Elements, Conditions or Geometries; meshio's cell type): rows of nodes, and properties
    where   the position (block, row) of each entity
    """

    lines: list[str]
    nodes: dict[str, int] = field(default_factory=dict)
    labels: list[str] = field(default_factory=list)
    coordinates: list[list[float]] = field(default_factory=list)
    points: list[list[tuple[int, int, int, int]]] = field(default_factory=list)
    corners: list[list[tuple[int, int, int, int]]] = field(default_factory=list)
    blocks: dict[tuple[str, str], tuple[list[list[int]], list[int]]] = field(default_factory=dict)
    where: dict[tuple[str, str], tuple[tuple[str, str], int]] = field(default_factory=dict)
    sets: dict[tuple[str, str], list[str]] = field(default_factory=dict)
    data: dict[str, dict[str, str]] = field(default_factory=dict)
    cards: dict[str, None] = field(default_factory=dict)
    nodal: dict[str, list[_Word]] = field(default_factory=dict)
    values: NodalValues = field(default_factory=NodalValues)

    def run(self) -> None:
        """Reads all blocks.  Raises ValueError for a file that is cut short or refers to nodes that it lacks."""
        corners: dict[tuple[str, str], list[list[tuple[int, int, int, int]]]] = {}
        for path, words in _blocks(self.lines):
            name, *rest = path[-1].split()
            if name == "Nodes":
                self._read_nodes(words)
            elif name in _ENTITIES and len(path) == 1:
                self._read_entities(name, rest[0] if rest else "", words, corners)
            elif name in ("ElementalData",):
                self._read_data(rest[0] if rest else "", words)
                self.cards[path[-1]] = None
            elif name == "NodalData":
                self.nodal.setdefault(rest[0] if rest else "", []).extend(words)
                self.cards[path[-1]] = None
            elif match := re.fullmatch(r"(?:SubModelPart|Mesh)(Nodes|Elements|Conditions|Geometries)", name):
                owner = ".".join(p.split()[-1] if p.startswith("SubModelPart") else p for p in path[:-1])
                self.sets.setdefault((match[1], owner), []).extend(word[3] for word in words)
            elif len(path) == 1 and (words or name != "ModelPartData") and name not in ("SubModelPart", "Mesh"):
                self.cards[path[-1]] = None
            elif words:
                self.cards[" of ".join(reversed(path))] = None
        if not self.nodes or not self.blocks:
            raise ValueError("it has no nodes or no elements")
        self._read_nodal_values()
        self.corners = [spans for key, found in corners.items() if key[1] in TRIANGLES for spans in found]

    def _read_nodes(self, words: list[_Word]) -> None:
        if len(words) % 4:
            raise ValueError("the block Nodes has a node without three coordinates")
        for start in range(0, len(words), 4):
            label = words[start][3]
            if label in self.nodes:
                raise ValueError(f"node {label} is there twice")
            self.nodes[label] = len(self.labels)
            self.labels.append(label)
            at = words[start + 1 : start + 4]
            self.coordinates.append([float(word[3]) for word in at])
            self.points.append([(*word[:3], 0) for word in at])

    def _read_entities(self, block: str, name: str, words: list[_Word], corners: dict) -> None:
        before, said = _ENTITIES[block], _NODES.search(name)
        position = 0
        while position < len(words):
            if said:
                width = before + int(said[1])
            else:  # the name does not tell: the entity ends with its line
                line = words[position][0]
                width = next((k for k, w in enumerate(words[position:]) if w[0] != line), len(words) - position)
            entity = words[position : position + width]
            if len(entity) < width or width <= before:
                raise ValueError(f"the block {block} {name} ends within an entity")
            position += width
            nodes = entity[before:]
            key = (block, _kind(block, name, len(nodes)))
            rows, properties = self.blocks.setdefault(key, ([], []))
            try:
                rows.append([self.nodes[word[3]] for word in nodes])
            except KeyError as error:
                raise ValueError(f"{block} {entity[0][3]} has node {error.args[0]}, which is not there") from None
            properties.append(int(entity[1][3]) if before == 2 else 0)
            self.where[block, entity[0][3]] = (key, len(rows) - 1)
            corners.setdefault(key, []).append([(*word[:3], 0) for word in nodes])

    def _read_data(self, name: str, words: list[_Word]) -> None:
        """Values of elements, one a line."""
        self.data[name] = {texts[0]: " ".join(texts[1:]) for texts in _by_line(words)}

    def _read_nodal_values(self) -> None:
        """Notes the values at nodes, one a line: node, is it held there, value.  Flags have no value."""
        for name, words in self.nodal.items():
            for label, *texts in _by_line(words):
                if label in self.nodes:
                    # The components of a vector stand between brackets: [3] (0, 0, 1).
                    parts = re.findall(r"[^\s(),]+", re.sub(r"\[\d+\]", " ", " ".join(texts)))
                    self.values.add(f"NodalData {name}", self.nodes[label], parts, 1)

    def mesh(self) -> meshio.Mesh:
        """The mesh, with properties as cell data and sub model parts as sets."""
        cells = [(kind, np.array(rows, np.int64)) for (_, kind), (rows, _) in self.blocks.items()]
        properties = [np.array(found, np.int64) for _, found in self.blocks.values()]
        mesh = meshio.Mesh(np.array(self.coordinates), cells, cell_data={PROPERTIES: properties})
        order = {key: i for i, key in enumerate(self.blocks)}
        sets: dict[str, list[list[int]]] = {}

        def put(name: str, block: str, labels: list[str]) -> None:
            members = sets.setdefault(name, [[] for _ in order])
            for label in labels:
                if (block, label) in self.where:
                    key, row = self.where[block, label]
                    members[order[key]].append(row)

        for (block, owner), labels in self.sets.items():
            if block == "Nodes":
                rows = [self.nodes[label] for label in labels if label in self.nodes]
                mesh.point_sets[owner] = np.array(rows, np.int64)
            else:
                put(owner, block, labels)
        for name, values in self.data.items():
            if _shared(values):
                for value in dict.fromkeys(values.values()):
                    put(f"{name} {value}", "Elements", [label for label, v in values.items() if v == value])
        for name, members in sets.items():
            mesh.cell_sets[name] = [np.unique(np.array(m, np.int64)) for m in members]
        return mesh

    def numbers(self) -> dict[str, list[str]]:
        """The numbers of entities by cell type, in the order of blocks and rows."""
        by_block: dict[tuple[str, str], list[str]] = {key: [] for key in self.blocks}
        for (_, label), (key, _row) in self.where.items():
            by_block[key].append(label)
        found: dict[str, list[str]] = {}
        for (_, kind), labels in by_block.items():
            found.setdefault(kind, []).extend(labels)
        return found

    def by_element(self) -> list[str]:
        """The values that nearly each element has its own of."""
        return [f"ElementalData {name}" for name, values in self.data.items() if not _shared(values)]


def _by_line(words: list[_Word]) -> Iterator[list[str]]:
    """The texts of the words of each line."""
    for _, texts in itertools.groupby(words, lambda word: word[0]):
        yield [text for _, _, _, text in texts]


def _shared(values: dict[str, str]) -> bool:
    """Do groups of elements share their values, which then bound regions?"""
    return 2 * len(set(values.values())) <= len(values)


def _kind(block: str, name: str, nodes: int) -> str:
    """meshio's name for the cells of a block of so many nodes."""
    flat = re.search(r"Shell|Membrane|Surface|Quadrilateral|Triangle|2D\d+N?$", name) is not None
    if nodes == 1:
        return "vertex"
    if nodes == 2:
        return "line"
    if nodes == 3 and (name.startswith("Line") or (block == "Conditions" and "2D" in name and "Triangle" not in name)):
        return "line3"
    planar = {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8", 9: "quad9"}
    volume = {3: "triangle", 4: "tetra", 6: "wedge", 8: "hexahedron", 10: "tetra10", 20: "hexahedron20"}
    known = planar if flat or block == "Conditions" else volume
    if nodes not in known:
        raise ValueError(f"{name} with {nodes} nodes is not known")
    return known[nodes]


def _blocks(lines: list[str]) -> Iterator[tuple[list[str], list[_Word]]]:
    """The innermost blocks of words: the headers that lead to each, and the words right in it.

    A block that holds other blocks is given too, with the words that stand between them.
    """
    stack: list[tuple[str, list[_Word]]] = []
    for number, line in enumerate(lines):
        text = line.split("//", 1)[0]
        words = [(number, m.start(), m.end(), m[0]) for m in re.finditer(r"\S+", text)]
        while words:
            if words[0][3] == "Begin":
                # The header is the rest of the line; an empty block may end on the same line.
                rest = [w[3] for w in words[1:]]
                cut = rest.index("End") if "End" in rest else len(rest)
                stack.append((" ".join(rest[:cut]), []))
                words = words[1 + cut :]
            elif words[0][3] == "End":
                if not stack or len(words) < 2 or stack[-1][0].split()[:1] != [words[1][3]]:
                    raise ValueError(f"line {number + 1}: {text.strip()!r} ends no block")
                yield [name for name, _ in stack], stack[-1][1]
                stack.pop()
                words = words[2:]
            elif not stack:
                raise ValueError(f"line {number + 1}: {text.strip()!r} stands in no block")
            else:
                stack[-1][1].append(words.pop(0))
    if stack:
        raise ValueError(f"the block {stack[-1][0]} has no end: the file is cut short")
