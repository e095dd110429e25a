"""A Gmsh file as the list of its sections, with the tables of nodes and elements parsed."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

# Gmsh's number of each element type: meshio's name for it, its dimension, its number of nodes.
KINDS = {
    1: ("line", 1, 2), 2: ("triangle", 2, 3), 3: ("quad", 2, 4), 4: ("tetra", 3, 4), 5: ("hexahedron", 3, 8),
    6: ("wedge", 3, 6), 7: ("pyramid", 3, 5), 8: ("line3", 1, 3), 9: ("triangle6", 2, 6), 10: ("quad9", 2, 9),
    11: ("tetra10", 3, 10), 15: ("vertex", 0, 1), 16: ("quad8", 2, 8), 21: ("triangle10", 2, 10), 26: ("line4", 1, 4),
}  # fmt: skip

# meshio's name of each element type: Gmsh's number for it, its dimension.
NUMBERS = {name: (number, dim) for number, (name, dim, _) in KINDS.items()}

# The cell data that stands for a physical group and for an elementary entity.
TAGS = ("gmsh:physical", "gmsh:geometrical")

DATA_SECTIONS = ("NodeData", "ElementData")


@dataclass(frozen=True)
class Nodes:
    """A block of nodes.

    entity       dimension and number of the entity they lie on, and 1 if they have parameters on it
    numbers      (n,) Gmsh's numbers
    coordinates  (n, 3), with the parameters in further columns where there are any
    """

    entity: tuple[int, int, int]
    numbers: np.ndarray
    coordinates: np.ndarray


@dataclass(frozen=True)
class Elements:
    """A block of elements.

    kind     Gmsh's number of their type
    entity   the number of their entity; version 4.1 only
    numbers  (n,) Gmsh's numbers
    tags     (n, k) physical group, elementary entity and further tags; version 2.2 only, k is 0 otherwise
    rows     (n, m) their nodes, counted from 0 in file order
    """

    kind: int
    entity: int
    numbers: np.ndarray
    tags: np.ndarray
    rows: np.ndarray


@dataclass(frozen=True)
class MshFile:
    """One .msh file.

    version   "2.2" or "4.1"
    binary    is it binary
    size      bytes of a count in a binary file of version 4.1
    sections  name and content of all sections in file order
    nodes     the content of $Nodes
    elements  the content of $Elements
    """

    version: str
    binary: bool
    size: int = 8
    sections: list[tuple[str, bytes]] = field(default_factory=list)
    nodes: list[Nodes] = field(default_factory=list)
    elements: list[Elements] = field(default_factory=list)

    @property
    def physical_names(self) -> list[tuple[int, int, str]]:
        """Dimension, number and name of each physical group that has a name."""
        text = dict(self.sections).get("PhysicalNames", b"0").decode(errors="replace")
        found = re.findall(r'^\s*(\d+)\s+(-?\d+)\s+"(.*)"', text, re.M)
        return [(int(dim), int(tag), name) for dim, tag, name in found]


def labelled(sections: list[tuple[str, bytes]]) -> Iterator[tuple[str, bytes, str]]:
    """The sections with labels: for data the name of the field, with the number of its step from the second one on.

    A field of several steps has as many sections of one name.  Other sections have the label "".
    """
    seen: dict[tuple[str, str], int] = {}
    for section, payload in sections:
        label = data_name(payload) if section in DATA_SECTIONS else ""
        if label:
            step = seen[section, label] = seen.get((section, label), 0) + 1
            label = label if step == 1 else f"{label}:{step}"
        yield section, payload, label


def data_head(payload: bytes) -> tuple[bytes, list[list[bytes]]]:
    """What stands before the values of a data section: the bytes, and the lines of its texts, times and numbers."""
    rest, groups = payload, []
    for _ in range(3):
        count, rest = rest.split(b"\n", 1)
        *lines, rest = rest.split(b"\n", int(count))
        groups.append(lines)
    return payload[: len(payload) - len(rest)], groups


def data_name(payload: bytes) -> str:
    """The name of the field that a section $NodeData or $ElementData holds."""
    return payload.split(b"\n", 2)[1].decode(errors="replace").strip().strip('"')
