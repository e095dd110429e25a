"""The cards of an Abaqus or CalculiX deck: keyword lines and the data lines below them.

*ELEMENT, TYPE=CPS3, ELSET=PLATE        Card("ELEMENT", {"TYPE": "CPS3", "ELSET": "PLATE"}, ...)
1, 1, 2, 5                              a data line: the spans of its items
** a comment                            belongs to no card
"""

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

_ITEM = re.compile(r"[^,]*")


@dataclass
class Card:
    """A keyword with its data lines.

    keyword  in capitals, words with one blank between them
    params   the parameters: name in capitals, value as it stands (without quotes), "" where there is none
    scope    the part or the instance that the card stands in, "" for none
    data     the numbers of the data lines
    """

    keyword: str
    params: dict[str, str]
    scope: str
    data: list[int] = field(default_factory=list)


# These make nodes or elements that stand nowhere in the text.
_REFUSED = {
    "INCLUDE": "put the text of the included file in its place",
    "NGEN": "", "NFILL": "", "NCOPY": "", "NMAP": "", "ELGEN": "", "ELCOPY": "", "SYSTEM": "",
    "IMPORT": "", "SUBSTRUCTURE GENERATE": "",
}  # fmt: skip


def cards(lines: list[str]) -> list[Card]:
    """All cards in file order.  Raises ValueError, naming the keyword, for a deck that is not complete in itself."""
    found: list[Card] = []
    scope, continued = "", False
    for number, line in enumerate(lines):
        text = line.strip()
        if not text or text.startswith("**"):
            continue
        if continued:
            found[-1].params.update(_params(text))
            continued = text.endswith(",")
            continue
        if not text.startswith("*"):
            if found:
                found[-1].data.append(number)
            continue
        name, _, rest = text[1:].partition(",")
        keyword = " ".join(name.split()).upper()
        params = _params(rest)
        continued = rest.rstrip().endswith(",")
        if keyword in _REFUSED:
            hint = _REFUSED[keyword] or "only nodes and elements that stand in the text can be changed in place"
            raise ValueError(f"line {number + 1}: it has *{keyword}; {hint}")
        if keyword in ("PART", "INSTANCE"):
            scope = (params.get("NAME", "") or keyword).upper()
        found.append(Card(keyword, params, scope))
        if keyword in ("END PART", "END INSTANCE"):
            scope = ""
    for card in found:
        if card.keyword in ("NODE", "ELEMENT", "NSET", "ELSET", "SURFACE") and "INPUT" in card.params:
            raise ValueError(f"*{card.keyword} reads another file (INPUT={card.params['INPUT']}); put its text here")
        if card.keyword == "NODE" and card.params.get("SYSTEM", "R").upper() not in ("R", ""):
            raise ValueError(f"*NODE has SYSTEM={card.params['SYSTEM']}; only rectangular coordinates can be changed")
    return found


def _params(text: str) -> dict[str, str]:
    """The parameters of a keyword line."""
    pairs = (item.partition("=") for item in text.split(",") if item.strip())
    return {" ".join(name.split()).upper(): value.strip().strip('"') for name, _, value in pairs}


def items(line: str) -> list[tuple[int, int, str]]:
    """Start, end and text of each item of a data line, without the blanks round it; a last empty item is left out."""
    body = line.rstrip("\r\n")
    found, position = [], 0
    while position <= len(body):
        match = _ITEM.match(body, position)
        assert match is not None
        text = match[0].strip()
        start = match.start() + len(match[0]) - len(match[0].lstrip()) if text else match.start()
        found.append((start, start + len(text), text))
        position = match.end() + 1
    if found and not found[-1][2]:
        found.pop()
    return found


def rows(card: Card, lines: list[str]) -> Iterator[list[tuple[int, int, int, str]]]:
    """The records of a card, as line, start, end and text of each item; a line that ends with a comma goes on."""
    record: list[tuple[int, int, int, str]] = []
    for number in card.data:
        record += [(number, *item) for item in items(lines[number])]
        if not lines[number].rstrip().endswith(","):
            yield record
            record = []
    if record:
        yield record


def set_members(card: Card, lines: list[str], known: Collection[int]) -> Iterator[str]:
    """The items of a set, with GENERATE written out; of a run with more numbers than there are, those `known`."""
    if "GENERATE" not in card.params:
        yield from (item for number in card.data for _, _, item in items(lines[number]) if item)
        return
    for number in card.data:
        first, last, step = [*(int(text) for _, _, text in items(lines[number])), 1][:3]
        run = range(first, last + 1, step or 1)
        yield from map(str, run if len(run) <= len(known) else sorted(number for number in known if number in run))


def element_kind(name: str, nodes: int) -> str:
    """meshio's name for an Abaqus element type with so many nodes.  Raises ValueError for an unknown one."""
    name = name.upper()
    if nodes == 1:
        return "vertex"
    if nodes == 2:
        return "line"
    if re.match(r"(B\d|T\dD|SAX|MAX|PIPE|ELBOW|FRAME|[AD]C1D|DSAX|RB|RAX|GK\d|ITT|CONN)", name):
        return f"line{nodes}"
    solid = re.match(r"(A?C3D|DC3D|DCC3D|SC\d|CSS|COH3D|F?C3D|GKPS|Q3D)", name) is not None
    planar = {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8", 9: "quad9"}
    volume = {4: "tetra", 5: "pyramid", 6: "wedge", 8: "hexahedron", 10: "tetra10", 15: "wedge15", 20: "hexahedron20"}
    known = volume if solid else planar
    if nodes not in known:
        raise ValueError(f"element type {name} with {nodes} nodes is not known")
    return known[nodes]


def sides_start(name: str, prefix: str) -> int:
    """The number in a face label that means the first side of a triangle of this type.

    The faces of plane and axisymmetric elements are their sides.  Shells and membranes have their two surfaces as
    faces 1 and 2 (CalculiX), and their sides as the labels E1, EDLD1 and so on (Abaqus).
    """
    shell = re.match(r"(S3|STRI|M3D|DS3|SFM|R3D)", name.upper()) is not None
    return 3 if shell and not prefix.upper().startswith("E") else 1
