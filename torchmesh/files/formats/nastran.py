"""Bulk data decks of Nastran (.bdf, .nas, .fem), changed in place.

Properties (PID) and pressures that several elements share bound regions.  Loads on the edges of plane elements
(PLOADE1, PLOADX1) and surfaces of heat (CHBDYE) are rewritten to the same edges; other loads name nodes.
"""

import re
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

import meshio
import numpy as np

from .deck import TRIANGLES, Deck, DeckFormat, SideLine, read_lines, side_groups, span_table, triangles_of
from .format import Document
from .nastran_cards import Entry, entries, real, real_text
from .nodal_values import NodalValues

PROPERTY = "nastran:ref"

# meshio's cell type, and the fields of the nodes, counted from 0 behind the name.  All but a few have their property
# in the next field behind their number.
_ELEMENTS = {
    **dict.fromkeys(("CTRIA3", "CTRIAR", "CTRAX3", "CPLSTN3", "CPLSTS3"), ("triangle", range(2, 5))),
    **dict.fromkeys(("CQUAD4", "CQUADR", "CSHEAR", "CQUADX4", "CPLSTN4", "CPLSTS4"), ("quad", range(2, 6))),
    **dict.fromkeys(("CBAR", "CBEAM", "CROD", "CTUBE", "CGAP", "CBUSH"), ("line", range(2, 4))),
    "CONROD": ("line", range(1, 3)),
    "PLOTEL": ("line", range(1, 3)),
    "CONM2": ("vertex", range(1, 2)),
    **dict.fromkeys(("CTRIA6", "CTRIAX6", "CPLSTN6", "CPLSTS6"), ("triangle6", range(2, 8))),
    **dict.fromkeys(("CQUAD8", "CPLSTN8", "CPLSTS8"), ("quad8", range(2, 10))),
    "CTETRA": ("tetra", range(2, 6)),
    "CPENTA": ("wedge", range(2, 8)),
    "CHEXA": ("hexahedron", range(2, 10)),
    "CPYRAM": ("pyramid", range(2, 7)),
}
_WITHOUT_PROPERTY = ("CONROD", "PLOTEL", "CONM2")

# Loads on whole elements: the fields of element numbers, THRU among them.
_PRESSURES = {"PLOAD2": range(2, 8), "PLOAD4": (1, 6, 7), "QBDY3": range(4, 8)}

# Entries with values at nodes: the fields of each node and of its value.
_FIELDS = {"TEMP": ((1, 2), (3, 4), (5, 6)), "TIC": ((1, 3), (1, 4))}
_LOADS = {
    **dict.fromkeys(("SPC", "SPCD", "DAREA"), ((1, 3), (4, 6))),
    **dict.fromkeys(("FORCE", "MOMENT"), ((1, 3),)),
    **dict.fromkeys(("FORCE1", "FORCE2", "MOMENT1", "MOMENT2"), ((1, 2),)),
    "SLOAD": ((1, 2), (3, 4), (5, 6)),
}


@dataclass(frozen=True)
class NastranFormat(DeckFormat):
    """Bulk data decks of Nastran."""

    def read(self, path: Path) -> Document:
        reader = _Reader(read_lines(path))
        mesh = reader.mesh()
        points = np.array(reader.points, np.int64).reshape(-1, 3, 4)
        corners = span_table([span for kind in reader.blocks for span in reader.corners.get(kind, [])])
        known = {"GRID", "CTRIA3", "CQUAD4"}
        cards = [name for name in dict.fromkeys([*reader.control, *reader.found]) if name not in known]
        deck = Deck(reader.lines, points, corners, reader.labels, reader.side_lines, cards, ",")
        sides = side_groups(reader.side_lines, triangles_of(mesh))
        by_element, at_nodes = tuple(reader.by_element), reader.values.rows(len(reader.nodes))
        return Document(
            mesh, self.name, rest=deck, sides=sides, by_element=by_element, at_nodes=at_nodes,
            node_numbers=reader.labels, cell_numbers=reader.numbers(),
        )  # fmt: skip

    def number(self, value: float, width: int) -> str:
        # Solvers cut numbers in free fields to sixteen characters at most.
        return real_text(value, width if width > 0 else 16)

    def value(self, text: str) -> float:
        return real(text)

    def label(self, text: str, width: int) -> str:
        return text.rjust(width) if width > 0 else text


# Cells of new files.
_CELLS = ("vertex", "line", "triangle", "quad", "triangle6", "quad8")

NASTRAN = NastranFormat(
    "nastran", (".bdf", ".fem", ".nas"), _CELLS, point_data="none", cell_data="regions", region_name=PROPERTY
)


@dataclass
class _Reader:
    """What is found in the entries of a deck."""

    lines: list[str]
    nodes: dict[int, int] = field(default_factory=dict)
    labels: list[str] = field(default_factory=list)
    coordinates: list[list[float]] = field(default_factory=list)
    points: list[list[tuple[int, int, int, int]]] = field(default_factory=list)
    corners: dict[str, list[list[tuple[int, int, int, int]]]] = field(default_factory=dict)
    names: dict[str, list[int]] = field(default_factory=dict)
    blocks: dict[str, tuple[list[list[int]], list[int]]] = field(default_factory=dict)
    where: dict[int, tuple[str, int]] = field(default_factory=dict)
    control: list[str] = field(default_factory=list)
    found: list[str] = field(default_factory=list)
    side_lines: list[SideLine] = field(default_factory=list)
    by_element: list[str] = field(default_factory=list)
    values: NodalValues = field(default_factory=NodalValues)

    def mesh(self) -> meshio.Mesh:
        """The mesh, with properties as cell data and shared pressures as sets."""
        begin, end = self._bulk()
        bulk = list(entries(self.lines, begin, end))
        self.found = list(dict.fromkeys(entry.name for entry in bulk))
        self._read_nodes([entry for entry in bulk if entry.name == "GRID"])
        self._check_systems(bulk)
        for entry in bulk:
            if entry.name in _ELEMENTS:
                self._read_element(entry)
        if not self.nodes or not self.blocks:
            raise ValueError("it has no GRID or no elements")
        cells = [(kind, np.array(rows, np.int64)) for kind, (rows, _) in self.blocks.items()]
        properties = [np.array(found, np.int64) for _, found in self.blocks.values()]
        mesh = meshio.Mesh(np.array(self.coordinates), cells, cell_data={PROPERTY: properties})
        self._bind_pressures(bulk, mesh)
        for entry in bulk:
            self._read_side(entry, mesh)
            self._read_values(entry)
        return mesh

    def numbers(self) -> dict[str, list[int]]:
        """The numbers of elements by kind, after `mesh`."""
        found: dict[str, list[int]] = {}
        for number, (kind, _) in self.where.items():
            found.setdefault(kind, []).append(number)
        return found

    def _bulk(self) -> tuple[int, int]:
        """The lines that the bulk data begins at and ends before; a deck without BEGIN BULK is bulk data alone."""
        begin, end, ended = 0, len(self.lines), False
        for number, line in enumerate(self.lines):
            word = " ".join(line.upper().split())
            if word.startswith(("BEGIN BULK", "BEGIN,BULK")):
                begin = number + 1
            elif word.startswith("ENDDATA"):
                end, ended = number, True
                break
        if begin and not ended:
            raise ValueError("it has BEGIN BULK and no ENDDATA: the file is cut short")
        for number, line in enumerate(self.lines[:begin]):
            if re.match(r"\s*INCLUDE\b", line, re.IGNORECASE):
                raise ValueError(f"line {number + 1}: it has INCLUDE; put the text of the included file in its place")
        if any(line.split("$")[0].strip() for line in self.lines[: max(begin - 1, 0)]):
            self.control = ["the case control"]
        return begin, end

    def _read_nodes(self, grids: list[Entry]) -> None:
        for entry in grids:
            number = int(entry.text(0))
            if number in self.nodes:
                raise ValueError(f"GRID {number} is there twice")
            self.nodes[number] = len(self.labels)
            self.labels.append(str(number))
            self.coordinates.append([real(entry.text(k)) for k in (2, 3, 4)])
            spans = [entry.fields[k].span if k < len(entry.fields) else (-1, 0, 0, 0) for k in (2, 3, 4)]
            self.points.append(spans)

    def _check_systems(self, bulk: list[Entry]) -> None:
        """Raises ValueError unless all coordinates are rectangular ones of one system."""
        default = next((entry.text(1) for entry in bulk if entry.name == "GRDSET"), "")
        systems = {int(entry.text(1) or default or 0) for entry in bulk if entry.name == "GRID"}
        if len(systems) > 1:
            raise ValueError(f"its GRIDs stand in several coordinate systems ({sorted(systems)})")
        round_ones = {int(e.text(0)) for e in bulk if e.name in ("CORD1C", "CORD2C", "CORD1S", "CORD2S")}
        if systems & round_ones:
            raise ValueError(f"its GRIDs have coordinates of the system {systems.pop()}, which is not rectangular")

    def _read_element(self, entry: Entry) -> None:
        kind, places = _ELEMENTS[entry.name]
        number = int(entry.text(0))
        nodes = [entry.fields[k] for k in places if entry.text(k)]
        if kind == "line" and len(nodes) != 2:  # fastened to the ground, or with an orientation only
            kind = "vertex"
        if kind not in ("line", "vertex") and len(nodes) != len(places):
            raise ValueError(f"{entry.name} {number} has {len(nodes)} nodes")
        if not nodes:
            return
        try:
            row = [self.nodes[int(node.text)] for node in nodes]
        except KeyError as error:
            raise ValueError(f"{entry.name} {number} has node {error.args[0]}, which is not there") from None
        rows, properties = self.blocks.setdefault(kind, ([], []))
        if entry.name == "CTRIAX6":  # its corners and mid-side nodes stand in turn
            nodes = [nodes[k] for k in (0, 2, 4, 1, 3, 5)]
            row = [row[k] for k in (0, 2, 4, 1, 3, 5)]
        if kind in TRIANGLES:
            self.corners.setdefault(kind, []).append([node.span for node in nodes])
            self.names.setdefault(kind, []).append(number)
            angle = entry.text(places[-1] + 1)
            if angle and "." in angle and real(angle) != 0:
                self.by_element.append(f"the material angle (THETA) of {entry.name}, which is relative to a side")
        self.by_element = list(dict.fromkeys(self.by_element))
        self.where[number] = (kind, len(rows))
        rows.append(row)
        properties.append(0 if entry.name in _WITHOUT_PROPERTY else int(entry.text(1) or number))

    def _bind_pressures(self, bulk: list[Entry], mesh: meshio.Mesh) -> None:
        """Elements that bear the same pressure are a region; where nearly each has its own, it rides along."""
        for name, places in _PRESSURES.items():
            groups: dict[str, list[int]] = {}
            for entry in bulk:
                if entry.name == name:
                    rest = [f.text for k, f in enumerate(entry.fields) if k not in places and f.text]
                    numbers = _numbers([entry.text(k) for k in places], self.where)
                    groups.setdefault(" ".join([name, *rest]), []).extend(numbers)
            if groups and 2 * len(groups) > sum(map(len, groups.values())):
                self.by_element.append(f"{name} by element")
                continue
            for group, numbers in groups.items():
                rows = [
                    [self.where[n][1] for n in numbers if self.where.get(n, "")[:1] == (b.type,)] for b in mesh.cells
                ]
                mesh.cell_sets[group] = [np.unique(np.array(r, np.int64)) for r in rows]

    def _read_values(self, entry: Entry) -> None:
        """Notes the values that an entry gives to nodes."""
        for node, value in (_FIELDS | _LOADS).get(entry.name, ()):
            number = entry.text(node)
            row = self.nodes.get(int(number)) if re.fullmatch(r"\d+", number) else None
            if row is not None:
                self.values.add(entry.name, row, [entry.text(value)], 0, entry.name in _LOADS, real)

    def _read_side(self, entry: Entry, mesh: meshio.Mesh) -> None:
        """Finds the element that an entry names together with one of its edges."""
        if entry.name in ("PLOADE1", "PLOADX1"):
            element, ends = 1, (4, 5)
        elif entry.name == "CHBDYE":
            element, ends = 1, None
        else:
            return
        where = self.where.get(int(entry.text(element) or 0))
        if where is None or where[0] not in TRIANGLES:
            return
        number_of_row = [number for kind in self.blocks for number in self.names.get(kind, [])]
        place = number_of_row.index(int(entry.text(element)))
        row = triangles_of(mesh)[place].tolist()
        if ends is None:
            side = int(entry.text(2) or 0) - 1
        else:
            edge = {self.nodes.get(int(entry.text(k) or 0)) for k in ends}
            side = next((k for k in range(3) if {row[k], row[(k + 1) % 3]} == edge), -1)
        if not 0 <= side < 3:
            return
        line, start, stop, width = entry.fields[element].span
        text = self.lines[line].rstrip("\r\n")
        text = text if width == 0 else text.expandtabs(8)

        def render(pairs: list[tuple[int, int]]) -> list[str]:
            number = str(number_of_row[pairs[0][0]])
            made = (
                text[:start] + (number.ljust(width)[: max(width, len(number))] if width > 0 else number) + text[stop:]
            )
            if ends is None:
                _, first, last, wide = entry.fields[2].span
                shift = len(made) - len(text)
                digit = str(pairs[0][1] + 1)
                made = made[: first + shift] + (digit.ljust(wide) if wide > 0 else digit) + made[last + shift :]
            return [made]

        self.side_lines.append(SideLine(entry.name, line, np.array([place]), np.array([side]), render))


def _numbers(texts: list[str], known: Collection[int]) -> list[int]:
    """Element numbers, with `a THRU b` written out; of a run with more numbers than there are, those `known`."""
    words = [text.upper() for text in texts if text]
    if len(words) == 3 and words[1] == "THRU":
        run = range(int(words[0]), int(words[2]) + 1)
        return list(run) if len(run) <= len(known) else sorted(number for number in known if number in run)
    return [int(word) for word in words if re.fullmatch(r"\d+", word)]
