"""An XDMF file as its text, and where in it stands what may change: items of data, attributes, the ends of grids.

The elements are those of ElementTree; the places in the text are found by the parser beneath it, in the same order.
"""

import copy
import re
import xml.etree.ElementTree as ET
import xml.parsers.expat
from dataclasses import dataclass, field

from .edits import edited

_INCLUDE = re.compile(r"include$")

# The ways in which programs name the grid whose mesh another grid has: meshio and ParaView by its name, others by its
# number among the uniform grids, or among all.  FEniCSx takes its Geometry alone, of the first grid.
_NAMED = re.compile(r"""Grid\[@Name\s*=\s*["']([^"']*)["']\](?:/Grid\[(\d+)\])?""")
_UNIFORM = re.compile(r"""Grid\[@GridType\s*=\s*["']Uniform["']\](?:\[(\d+)\])?""")
_PLAIN = re.compile(r"/Domain/Grid(?:\[(\d+)\])?/")

# The names of cell types in any spelling, as meshio spells them.
_SPELLINGS = {
    "polyvertex": "Polyvertex", "polyline": "Polyline", "triangle": "Triangle", "quadrilateral": "Quadrilateral",
    "edge_3": "Edge_3", "triangle_6": "Triangle_6", "tri_6": "Tri_6", "quadrilateral_8": "Quadrilateral_8",
    "quad_8": "Quad_8", "quadrilateral_9": "Quadrilateral_9", "quad_9": "Quad_9", "mixed": "Mixed",
    "tetrahedron": "Tetrahedron", "hexahedron": "Hexahedron",
}  # fmt: skip


@dataclass
class XdmfText:
    """The text of a file.

    root    its elements
    places  for elements the bytes that each begins and ends at, and its content begins and ends at
    """

    data: bytes
    root: ET.Element = field(default_factory=lambda: ET.Element("Xdmf"))
    places: dict[ET.Element, tuple[int, int, int, int]] = field(default_factory=dict)

    @classmethod
    def of(cls, data: bytes) -> "XdmfText":
        """Raises ValueError for anything but XML."""
        text = cls(data)
        stack: list[int] = []
        found: list[list[int]] = []
        parser = xml.parsers.expat.ParserCreate()

        def start(*_: object) -> None:
            at = parser.CurrentByteIndex
            stack.append(len(found))
            found.append([at, 0, _end_of_tag(data, at), 0])

        def end(_: object) -> None:
            at, own = parser.CurrentByteIndex, found[stack.pop()]
            closed = data[own[2] - 2 : own[2]] == b"/>"
            own[1], own[3] = (own[2], own[2]) if closed else (_end_of_tag(data, at), at)

        parser.StartElementHandler, parser.EndElementHandler = start, end
        try:
            parser.Parse(data, True)
            text.root = ET.fromstring(data)
        except (xml.parsers.expat.ExpatError, ET.ParseError) as error:
            raise ValueError(f"it is no XML: {error}") from None
        text.places = {element: tuple(place) for element, place in zip(text.root.iter(), found, strict=True)}  # type: ignore[misc]
        return text

    @property
    def domain(self) -> ET.Element:
        """Raises ValueError if there is none."""
        domain = self.root.find("Domain")
        if domain is None:
            raise ValueError("it has no Domain")
        return domain

    def edited(self, edits: list[tuple[int, int, bytes]]) -> bytes:
        """The text with other bytes in some places."""
        return edited(self.data, edits)


def _end_of_tag(data: bytes, at: int) -> int:
    """The byte behind a tag that begins at `at`."""
    end = re.compile(rb"(?:[^>\"']|\"[^\"]*\"|'[^']*')*>").match(data, at)
    return end.end() if end else len(data)


def alone(domain: ET.Element, grid: ET.Element) -> ET.Element:
    """A document with one grid of `domain`, in which references to other grids are replaced by what they name."""
    own = ET.Element("Grid")
    for part in grid:
        if isinstance(part.tag, str) and _INCLUDE.search(part.tag):
            own.extend(included(domain, part))
        elif part.tag == "Topology":
            own.append(_respelled(part))
        elif part.tag in ("Geometry", "Attribute"):
            own.append(part)
    root = ET.Element("Xdmf", Version="3.0")
    ET.SubElement(root, "Domain").append(own)
    return root


def included(domain: ET.Element, include: ET.Element) -> list[ET.Element]:
    """The topology and geometry of the grid that an XInclude names, or the geometry alone."""
    words = include.get("xpointer", "")
    if found := _NAMED.search(words):
        grids = [grid for grid in domain.iter("Grid") if grid.get("Name") == found[1]]
        if grids and found[2]:
            grids = grids[0].findall("Grid")[int(found[2]) - 1 :]
    elif found := _UNIFORM.search(words):
        grids = domain.findall("Grid[@GridType='Uniform']")[int(found[1] or 1) - 1 :]
    elif found := _PLAIN.search(words):
        grids = domain.findall("Grid")[int(found[1] or 1) - 1 :]
    else:
        raise ValueError(f"the reference {words!r} is not understood")
    wanted = ("Geometry",) if re.search(r"/Geometry\b", words) and "Topology" not in words else ("Topology", "Geometry")
    parts = [copy.deepcopy(part) for grid in grids[:1] for part in grid if part.tag in wanted]
    if not parts:
        raise ValueError(f"the reference {words!r} leads to no grid with Topology and Geometry")
    return [_respelled(part) if part.tag == "Topology" else part for part in parts]


def _respelled(topology: ET.Element) -> ET.Element:
    """The topology with the name of its type in meshio's spelling."""
    result = copy.deepcopy(topology)
    for key in ("Type", "TopologyType"):
        if key in result.attrib:
            result.set(key, _SPELLINGS.get(result.attrib[key].lower(), result.attrib[key]))
    return result
