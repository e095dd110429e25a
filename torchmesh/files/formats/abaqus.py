"""Input decks of Abaqus and CalculiX (.inp), changed in place.

Parts, element sets and cards of elements bound regions.  Sets that only name the elements of a surface, as Abaqus/CAE
makes one for each number of a side, bound nothing: the surface is rewritten to the same edges.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

import meshio
import numpy as np

from .abaqus_cards import Card, cards, element_kind, items, rows, set_members, sides_start
from .deck import TRIANGLES, Deck, DeckFormat, SideLine, read_lines, side_groups, span_table, triangles_of
from .format import LINEAR, Document
from .nodal_values import NodalValues

# Cards whose data lines begin with an element or an element set, and go on with the label of a face.
_FACES = ("SURFACE", "DLOAD", "FILM", "DFLUX", "RADIATE", "DECHARGE", "DECURRENT", "FOUNDATION", "BASE MOTION")

# Cards whose data lines give values to single elements, or to element sets.
_BY_ELEMENT = ("INITIAL CONDITIONS", "DISTRIBUTION", "ELEMENT RESPONSE")

# Cards whose data lines give values to nodes, or node sets, and the first item that is a value.
_FIELDS = {"TEMPERATURE": 1, "FIELD": 1, "PRESSURE STRESS": 1, "MASS FLOW RATE": 1, "NODAL THICKNESS": 1}
_LOADS = {"BOUNDARY": 3, "CLOAD": 2, "CFLUX": 2, "CECHARGE": 2, "CECURRENT": 2, "CFLOW": 2}

# The types of *INITIAL CONDITIONS whose data lines begin with a node, and the first item that is a value.
_INITIAL = {
    **dict.fromkeys(("VELOCITY", "FLUID VELOCITY", "DISPLACEMENT"), 2),
    **dict.fromkeys(("TEMPERATURE", "FIELD", "PORE PRESSURE", "PRESSURE", "TOTAL PRESSURE", "MASS FLOW",
                     "MASS FLOW RATE", "CONCENTRATION", "SATURATION", "RATIO", "RELATIVE DENSITY"), 1),
}  # fmt: skip

_FACE = re.compile(r"(EDLD|EDNOR|EDTRA|EDSHR|EDMOM|[PSFRE])(\d)([A-Z]*)", re.IGNORECASE)

# The types of elements in a new deck: plane stress and plane trusses, or where z is not the same everywhere, shells and
# trusses in space.
_PLANE = {"triangle": "CPS3", "triangle6": "CPS6", "quad": "CPS4", "quad8": "CPS8", "line": "T2D2", "line3": "T2D3"}
_IN_SPACE = {"triangle": "S3", "triangle6": "STRI65", "quad": "S4", "quad8": "S8R", "line": "T3D2", "line3": "T3D3"}

# CalculiX reads twenty characters of a number.
_WIDTH = 20


@dataclass(frozen=True)
class AbaqusFormat(DeckFormat):
    """Decks of Abaqus and CalculiX."""

    def read(self, path: Path) -> Document:
        reader = _Reader(read_lines(path))
        mesh, deck = reader.mesh(), reader.deck()
        by_element = tuple(dict.fromkeys(reader.by_element))
        at_nodes = reader.at_nodes()
        return Document(
            mesh, self.name, rest=deck, sides=reader.sides, by_element=by_element, at_nodes=at_nodes,
            node_numbers=reader.labels, cell_numbers=reader.numbers(),
        )  # fmt: skip

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        flat = mesh.points.shape[1] == 2 or bool((mesh.points[:, 2:] == mesh.points[:1, 2:]).all())
        # meshio itself takes the last type that it knows of each kind: rigid triangles, and beams with hybrid forces.
        table: dict[str, str] = meshio.abaqus._abaqus.meshio_to_abaqus_type
        was = dict(table)
        table.update(_PLANE if flat else _IN_SPACE)
        try:
            super().write(path, mesh, like, same_rows)
        finally:
            table.clear()
            table.update(was)

    def number(self, value: float, width: int) -> str:
        digits = (f"{value:.{n}g}" for n in range(16, 0, -1))
        text = next(text for text in (repr(value), *digits) if len(text) <= _WIDTH)
        return text if any(mark in text for mark in ".en") else text + "."


ABAQUS = AbaqusFormat(
    "abaqus", (".inp",), (*LINEAR, "higher"), point_data="none", cell_data="none", cell_sets=True, point_sets=True,
    counts=False,
)  # fmt: skip


@dataclass
class _Element:
    """One element: its type, the spans of its nodes, its position (block, row in the block) and triangle row."""

    type: str
    row: int = -1
    block: int = 0
    position: int = 0


@dataclass
class _Reader:
    """What is found in the lines of a deck; numbers of nodes and elements are known by (scope, number)."""

    lines: list[str]
    cards: list[Card] = field(default_factory=list)
    part_of: dict[str, str] = field(default_factory=dict)
    nodes: dict[tuple[str, int], int] = field(default_factory=dict)
    coordinates: list[list[float]] = field(default_factory=list)
    points: list[list[tuple[int, int, int, int]]] = field(default_factory=list)
    labels: list[str] = field(default_factory=list)
    elements: dict[tuple[str, int], _Element] = field(default_factory=dict)
    names: list[tuple[str, int]] = field(default_factory=list)
    corners: list[list[tuple[int, int, int, int]]] = field(default_factory=list)
    blocks: list[tuple[str, list[list[int]]]] = field(default_factory=list)
    sets: dict[str, dict[tuple[str, str], list[tuple[str, int]]]] = field(default_factory=dict)
    side_lines: list[SideLine] = field(default_factory=list)
    sides: dict[str, np.ndarray] = field(default_factory=dict)
    by_element: list[str] = field(default_factory=list)

    def mesh(self) -> meshio.Mesh:
        """The mesh, with the sets that bound regions."""
        self.cards = cards(self.lines)
        self.sets = {"NSET": {}, "ELSET": {}}
        for card in self.cards:
            if card.keyword == "INSTANCE":
                self.part_of[card.params.get("NAME", "").upper()] = card.params.get("PART", "").upper()
            elif card.keyword == "NODE":
                self._read_nodes(card)
        for card in self.cards:
            if card.keyword == "ELEMENT":
                self._read_elements(card)
        for card in self.cards:
            if card.keyword in ("NSET", "ELSET"):
                self._read_set(card)
        if not self.nodes or not self.blocks:
            raise ValueError("it has no *NODE or no *ELEMENT")
        surface_only = self._read_sides()
        cells = [(kind, np.array(rows, np.int64)) for kind, rows in self.blocks]
        mesh = meshio.Mesh(np.array(self.coordinates), cells)
        self._give_sets(mesh, surface_only)
        self.sides = side_groups(self.side_lines, triangles_of(mesh))
        return mesh

    def deck(self) -> Deck:
        """The deck, after `mesh`."""
        known = {"NODE", "ELEMENT", "NSET", "ELSET", "SURFACE", "HEADING"}
        others = dict.fromkeys(f"*{card.keyword}" for card in self.cards if card.keyword not in known)
        corners = span_table(self.corners)
        points = np.array(self.points, np.int64).reshape(-1, 3, 4)
        return Deck(self.lines, points, corners, self.labels, self.side_lines, list(others), ", ")

    def numbers(self) -> dict[str, list[int]]:
        """The numbers of elements by kind, in the order of blocks and rows, after `mesh`."""
        found: dict[str, list[int]] = {}
        for (_, number), element in sorted(self.elements.items(), key=lambda e: (e[1].block, e[1].position)):
            found.setdefault(self.blocks[element.block][0], []).append(number)
        return found

    def at_nodes(self) -> dict[str, np.ndarray]:
        """The nodes with values that the deck keeps to the letter, after `mesh`."""
        found = NodalValues()
        for card in self.cards:
            first, load = _first_value(card), card.keyword in _LOADS
            if first is None:
                continue
            kind = card.params.get("TYPE", "") if card.keyword == "INITIAL CONDITIONS" else ""
            name = f"*{card.keyword}" + (f" TYPE={kind.upper()}" if kind else "")
            if "INPUT" in card.params or "FILE" in card.params:  # the values stand elsewhere, for any node
                for node, label in enumerate(self.labels):
                    found.add(name, node, [label], load=load)
            for line in card.data:
                texts = [text for _, _, text in items(self.lines[line])]
                for key in self._named("NSET", texts[0], self._scope(card)) if texts and texts[0] else []:
                    found.add(name, self.nodes[key], texts[1:], first - 1, load, _real)
        return found.rows(len(self.labels))

    def _read_nodes(self, card: Card) -> None:
        added = []
        for record in rows(card, self.lines):
            key = (card.scope, int(record[0][3]))
            if key in self.nodes:
                raise ValueError(f"node {key[1]} is there twice")
            values, spans = [], []
            line, _, end, _ = record[-1]
            for axis in range(1, 4):
                text = record[axis][3] if axis < len(record) else ""
                values.append(_real(text) if text else 0.0)
                if axis < len(record):
                    spans.append((*record[axis][:3], 0))
                else:  # the coordinate is left out: it would stand behind the last one
                    missing = axis - len(record) + 1 if axis == len(record) else 1
                    spans.append((line, end, end, -missing))
            self.nodes[key] = len(self.labels)
            self.labels.append(record[0][3])
            self.coordinates.append(values)
            self.points.append(spans)
            added.append(key)
        if "NSET" in card.params:
            self.sets["NSET"].setdefault((card.scope, card.params["NSET"].upper()), []).extend(added)

    def _read_elements(self, card: Card) -> None:
        name = card.params.get("TYPE", "").upper()
        added, kinds = [], {}
        for record in rows(card, self.lines):
            key = (card.scope, int(record[0][3]))
            if key in self.elements:
                raise ValueError(f"element {key[1]} is there twice")
            nodes = [item for item in record[1:] if item[3]]
            kind = element_kind(name, len(nodes))
            try:
                row = [self.nodes[card.scope, int(item[3])] for item in nodes]
            except KeyError as error:
                raise ValueError(f"element {key[1]} has node {error.args[0][1]}, which is not there") from None
            if kind not in kinds:
                kinds[kind] = len(self.blocks)
                self.blocks.append((kind, []))
            block = kinds[kind]
            element = _Element(name, block=block, position=len(self.blocks[block][1]))
            self.blocks[block][1].append(row)
            if kind in TRIANGLES:
                element.row = len(self.names)
                self.names.append(key)
                self.corners.append([(*item[:3], 0) for item in nodes])
            self.elements[key] = element
            added.append(key)
        if "ELSET" in card.params:
            self.sets["ELSET"].setdefault((card.scope, card.params["ELSET"].upper()), []).extend(added)

    def _scope(self, card: Card) -> str:
        """The part or instance that the numbers of a card belong to."""
        instance = card.params.get("INSTANCE", "").upper()
        return self.part_of.get(instance, "") or instance or card.scope

    def _read_set(self, card: Card) -> None:
        """Adds the members of *NSET or *ELSET, which may be names of earlier sets."""
        kind, own = card.keyword, self._scope(card)
        found = self.sets[kind].setdefault((card.scope, card.params.get(kind, "").upper()), [])
        table = self.nodes if kind == "NSET" else self.elements
        known = {number for scope, number in table if scope == own} if "GENERATE" in card.params else ()
        for text in set_members(card, self.lines, known):
            found.extend(self._named(kind, text, own))

    def _named(self, kind: str, text: str, scope: str) -> list[tuple[str, int]]:
        """The nodes or elements that a number or the name of a set stands for; `Instance.name` is understood."""
        instance, dot, name = text.strip('"').upper().rpartition(".")
        if dot and (instance in self.part_of or instance in self.part_of.values()):
            scope, text = self.part_of.get(instance, "") or instance, name
        table = self.nodes if kind == "NSET" else self.elements
        if re.fullmatch(r"\d+", text):
            return [(scope, int(text))] if (scope, int(text)) in table else []
        sets = self.sets[kind]
        return sets.get((scope, text.strip('"').upper()), sets.get(("", text.strip('"').upper()), []))

    def _read_sides(self) -> set[tuple[str, str]]:
        """Finds the lines that name sides of triangles; returns the sets that are used for nothing else."""
        used: set[str] = set()
        surface: set[str] = set()
        whole: dict[str, list[tuple[str, int]]] = {}
        for number, card in enumerate(self.cards):
            if card.keyword == "SURFACE" and card.params.get("TYPE", "ELEMENT").upper() != "ELEMENT":
                continue
            by_element = card.keyword in _BY_ELEMENT and _first_value(card) is None
            for line in card.data if card.keyword in _FACES or by_element else []:
                found = items(self.lines[line])
                named = self._named("ELSET", found[0][2], self._scope(card)) if found else []
                side = _FACE.fullmatch(found[1][2]) if len(found) > 1 and card.keyword in _FACES else None
                group = card.params.get("NAME", "") or f"*{card.keyword} {number}"
                one = self._side_line(group, line, found, side, named) if side else None
                if one is not None:
                    self.side_lines.append(one)
                    surface.add(found[0][2].upper().rpartition(".")[2])
                elif found and re.fullmatch(r"(.*\.)?\d+", found[0][2]):
                    rest = ", ".join(text for _, _, text in found[1:])
                    whole.setdefault(f"*{card.keyword} {rest}".strip(), []).extend(named)
                elif found:
                    used.add(found[0][2].upper().rpartition(".")[2])
            if card.keyword not in ("ELEMENT", "ELSET", "NSET", "NODE", "SURFACE"):
                used |= {value.upper().rpartition(".")[2] for value in card.params.values()}
            elif card.keyword == "ELEMENT" and "ELSET" in card.params:
                used.add(card.params["ELSET"].upper())
        for card in self.cards:
            if card.keyword == "ELSET" and "GENERATE" not in card.params:
                used |= {text.upper() for text in set_members(card, self.lines, ()) if not text.isdigit()}
        self._bind_single_elements(whole)
        return {key for key in self.sets["ELSET"] if key[1] in surface - used}

    def _bind_single_elements(self, whole: dict[str, list[tuple[str, int]]]) -> None:
        """Elements that bear the same load are a region; where nearly each has its own, the load rides along."""
        if whole and 2 * len(whole) <= sum(map(len, whole.values())):
            self.sets["ELSET"].update({("", name): found for name, found in whole.items()})
        elif whole:
            self.by_element += [f"values by element of {name.split(' ', 1)[0]}" for name in whole]

    def _side_line(
        self, group: str, line: int, found: list[tuple[int, int, str]], label: re.Match, named: list[tuple[str, int]]
    ) -> SideLine | None:
        """The sides of triangles that a line names; None if it names none."""
        hits = [e for e in (self.elements[key] for key in named) if e.row >= 0]
        starts = [sides_start(e.type, label[1]) for e in hits]
        sides = [int(label[2]) - start for start in starts]
        if not hits or not all(0 <= side < 3 for side in sides):
            return None
        text = self.lines[line].rstrip("\r\n")
        first, second = found[0], found[1]
        prefix = first[2].rpartition(".")[0] + "." if "." in first[2] else self._prefix(named)
        start, others = starts[0], [key for key in named if self.elements[key].row < 0]

        def render(pairs: list[tuple[int, int]]) -> list[str]:
            wanted = [(number, label[2]) for _, number in others]
            wanted += [(self.names[row][1], str(side + start)) for row, side in pairs]
            return [
                f"{text[: first[0]]}{prefix}{number}{text[first[1] : second[0]]}{label[1]}{digit}{label[3]}"
                f"{text[second[1] :]}"
                for number, digit in wanted
            ]

        return SideLine(group, line, np.array([e.row for e in hits]), np.array(sides), render)

    def _prefix(self, named: list[tuple[str, int]]) -> str:
        """What comes before the number of an element outside of its part; "" where it has no part."""
        instances = [name for name, part in self.part_of.items() if named[0][0] in (name, part)]
        return f"{instances[0]}." if instances else ""

    def _give_sets(self, mesh: meshio.Mesh, surface_only: set[tuple[str, str]]) -> None:
        """Puts the sets into the mesh.  Parts are sets too, where there are several."""
        count = len(mesh.cells)
        sets = {key: found for key, found in self.sets["ELSET"].items() if key not in surface_only and key[1]}
        scopes = dict.fromkeys(scope for scope, _ in self.elements)
        if len(scopes) > 1:
            sets.update({(scope, "part"): [key for key in self.elements if key[0] == scope] for scope in scopes})
        names = _short_names(list(sets))
        for key, found in sets.items():
            members: list[list[int]] = [[] for _ in range(count)]
            for name in dict.fromkeys(found):
                members[self.elements[name].block].append(self.elements[name].position)
            mesh.cell_sets[names[key]] = [np.array(sorted(m), np.int64) for m in members]
        groups = {key: found for key, found in self.sets["NSET"].items() if key[1]}
        names = _short_names(list(groups))
        for key, found in groups.items():
            mesh.point_sets[names[key]] = np.array([self.nodes[name] for name in dict.fromkeys(found)], np.int64)


def _first_value(card: Card) -> int | None:
    """The first item of a data line of the card that is a value at a node; None for a card without such values."""
    if card.keyword == "INITIAL CONDITIONS":
        return _INITIAL.get(" ".join(card.params.get("TYPE", "").upper().split()))
    if card.keyword == "DISTRIBUTION":
        return 1 if card.params.get("LOCATION", "").upper() == "NODE" else None
    return (_FIELDS | _LOADS).get(card.keyword)


def _real(text: str) -> float:
    return float(re.sub("[dD]", "e", text))


def _short_names(keys: list[tuple[str, str]]) -> dict[tuple[str, str], str]:
    """The name of each set, with its scope only where two scopes have a set of this name."""
    names = [name for _, name in keys]
    return {(scope, name): name if names.count(name) == 1 or not scope else f"{scope}.{name}" for scope, name in keys}
