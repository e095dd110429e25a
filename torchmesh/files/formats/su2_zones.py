"""The lines of SU2 files, in which points and elements are changed in place; and files with several zones.

    NZONE= 2
    IZONE= 1    NDIME ... NELEM ... NPOIN ... NMARK ...     points are numbered from 0 in each zone
    IZONE= 2    NDIME ... NELEM ... NPOIN ... NMARK ...

The zones lie side by side in one mesh; no point belongs to two of them.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import overload

import meshio
import numpy as np

from .format import FLAT
from .text_numbers import numbers_of, with_words

# The integer cell data that says in which zone a cell is, as IZONE counts them.
ZONE = "su2:zone"

# Runs of elements of one type, by the rows of a section and its name: the type and the nodes (n, width).
Elements = Callable[[list[str], str], Iterator[tuple[str, np.ndarray]]]


@dataclass
class Su2Lines:
    """The lines of a file, with their ends.

    points   for each point the number of its line
    cells    for each block of cells the numbers of their lines
    starts   for each block of cells the first point of its zone
    rest     the lines that belong to no section
    several  has the file several zones
    remarks  do lines of sections end in comments
    height   the third coordinate of all points; None in a file of two dimensions
    """

    lines: list[str]
    points: list[int] = field(default_factory=list)
    cells: list[list[int]] = field(default_factory=list)
    starts: list[int] = field(default_factory=list)
    rest: list[str] = field(default_factory=list)
    several: bool = False
    remarks: bool = False
    height: float | None = None

    def patched(self, mesh: meshio.Mesh) -> list[str]:
        """The lines with the points and cells of `mesh`, which has the points and cells of the file, row by row."""
        lines = list(self.lines)
        for number, point in zip(self.points, mesh.points[:, :2].tolist(), strict=True):
            words = lines[number].split("%")[0].split()
            if [float(word) for word in words[:2]] != point:
                lines[number] = with_words(lines[number], 0, [repr(x) for x in point])
        for numbers, start, block in zip(self.cells, self.starts, mesh.cells, strict=True):
            for number, row in zip(numbers, (block.data - start).tolist(), strict=True):
                words = lines[number].split("%")[0].split()
                if [int(float(word)) for word in words[1 : 1 + len(row)]] != row:
                    lines[number] = with_words(lines[number], 1, [str(node) for node in row])
        return lines


def zones_of(lines: list[str]) -> int:
    """What the file says of the number of its zones; 1 if it says nothing before its first section."""
    for line in lines:
        match = re.match(r"\s*(NZONE|NELEM|NPOIN|NMARK)\s*=\s*(\d+)", line)
        if match:
            return int(match[2]) if match[1] == "NZONE" else 1
    return 1


@dataclass(frozen=True)
class InZones(Sequence[str]):
    """Numbers that begin anew in each zone, as a message names them: "5 of zone 2".

    numbers  (n,)
    zones    (n,) as IZONE counts them
    """

    numbers: np.ndarray
    zones: np.ndarray

    def __len__(self) -> int:
        return len(self.numbers)

    @overload
    def __getitem__(self, row: int) -> str: ...
    @overload
    def __getitem__(self, row: slice) -> "InZones": ...
    def __getitem__(self, row: int | slice) -> "str | InZones":
        if isinstance(row, slice):
            return InZones(self.numbers[row], self.zones[row])
        return f"{self.numbers[row]} of zone {self.zones[row]}"


def numbers_in_zones(mesh: meshio.Mesh, file: Su2Lines) -> tuple[InZones, dict[str, InZones]]:
    """What a file of several zones calls its points, and its triangles and quads by their type."""
    starts = np.unique(file.starts)
    zone = starts.searchsorted(np.arange(len(mesh.points)), "right")
    nodes = InZones(np.arange(len(zone)) - starts[zone - 1], zone)
    cells: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    counts: dict[int, int] = {}
    for block, zones in zip(mesh.cells, mesh.cell_data[ZONE], strict=True):
        if block.type in FLAT and len(zones):
            own = int(zones[0])
            first = counts.get(own, 0)
            counts[own] = first + len(zones)
            cells.setdefault(block.type, []).append((first + np.arange(len(zones)), zones))
    return nodes, {kind: InZones(*map(np.concatenate, zip(*parts, strict=True))) for kind, parts in cells.items()}


def read_zones(lines: list[str], elements: Elements, tag_name: str) -> tuple[meshio.Mesh, Su2Lines]:
    """The mesh of all zones.  Markers are lines with the cell data `tag_name`; the same name is the same number.

    Raises ValueError for anything but complete planar zones, as many as the file says.
    """
    file = Su2Lines(lines, several=True)
    points: list[np.ndarray] = []
    blocks: list[tuple[str, int, int, np.ndarray]] = []
    names: dict[str, int] = {}
    zone = start = end = tag = 0
    width = 2
    numbered = iter(enumerate(lines))
    for _, line in numbered:
        match = re.match(r"\s*(\w+)\s*=\s*([^%]*)", line)
        key, value = (match[1].upper(), match[2].strip()) if match else ("", "")
        if key == "IZONE":
            _check_nodes(blocks, zone, start, end)
            zone, start = zone + 1, end
        elif key == "NDIME":
            width = dimension(value)
        elif key == "NPOIN":
            at, rows = section_rows(numbered, int(value.split()[0]), f"NPOIN of zone {zone}")
            numbers, starts, widths = numbers_of(rows, f"NPOIN of zone {zone}")
            points.append(flat_points(rows, numbers, starts, widths, width)[0])
            file.points += at
            end += len(rows)
        elif key == "MARKER_TAG":
            tag = names.setdefault(value, len(names) + 1)
        elif key in ("NELEM", "MARKER_ELEMS"):
            at, rows = section_rows(numbered, int(value), f"{key} of zone {zone}")
            done = 0
            for kind, nodes in elements(rows, key):
                blocks.append((kind, zone, tag if key == "MARKER_ELEMS" else 0, nodes + start))
                file.cells.append(at[done : done + len(nodes)])
                file.starts.append(start)
                done += len(nodes)
        elif line.strip() and key not in ("NZONE", "NMARK"):
            file.rest.append(line.rstrip("\r\n"))
    _check_nodes(blocks, zone, start, end)
    if zone != zones_of(lines):
        raise ValueError(f"NZONE says {zones_of(lines)} zones, the file has {zone}")
    if not points or not blocks:
        raise ValueError("it has no NPOIN or no NELEM section")
    data = {
        tag_name: [np.full(len(nodes), own) for _, _, own, nodes in blocks],
        ZONE: [np.full(len(nodes), of) for _, of, _, nodes in blocks],
    }
    groups = {name: np.array([number, 1]) for name, number in names.items()}
    cells = [(kind, nodes) for kind, _, _, nodes in blocks]
    return meshio.Mesh(np.concatenate(points), cells, cell_data=data, field_data=groups), file


def dimension(value: str) -> int:
    """The number of coordinates that NDIME states.  Raises ValueError unless it is 2 or 3."""
    if value not in ("2", "3"):
        raise ValueError("NDIME is not 2: only planar meshes can be improved")
    return int(value)


def flat_points(
    rows: list[str], numbers: np.ndarray, starts: np.ndarray, widths: np.ndarray, width: int
) -> tuple[np.ndarray, float]:
    """The first two coordinates of points (n, 2), and the third one, which is the same at all.  Raises ValueError."""
    if len(rows) and widths.min() < width:
        said = {2: "two", 3: "three"}[width]
        raise ValueError(f"a point needs {said} coordinates: {rows[int(widths.argmin())].strip()!r}")
    table = numbers[starts[:, None] + np.arange(width)]
    height = table[:, 2] if width == 3 and len(table) else np.zeros(1)
    if (height != height[0]).any():
        raise ValueError("NDIME is not 2, and z is not the same at all points: only planar meshes can be improved")
    return table[:, :2], float(height[0])


def section_rows(lines: Iterator[tuple[int, str]], count: int, section: str) -> tuple[list[int], list[str]]:
    """The numbers and texts of the next `count` lines that are not empty, without comments.  Raises ValueError.

    Markers of periodic boundaries have a line SEND_TO first, which stays.
    """
    numbers: list[int] = []
    texts: list[str] = []
    while len(numbers) < count:
        number, line = next(lines, (-1, ""))
        if number < 0:
            raise ValueError(f"{section} says {count}, the file ends after {len(numbers)}")
        text = line.split("%", 1)[0]
        if text.strip() and (numbers or not re.match(r"\s*SEND_TO\s*=", text)):
            numbers.append(number)
            texts.append(text)
    return numbers, texts


def _check_nodes(blocks: list[tuple[str, int, int, np.ndarray]], zone: int, start: int, end: int) -> None:
    """Raises ValueError if a cell of a zone has a point that is not one of the zone's, rows `start` to `end`."""
    for kind, own, _, nodes in blocks:
        if own == zone and ((nodes < start) | (nodes >= end)).any():
            row = nodes[((nodes < start) | (nodes >= end)).any(1)][0] - start
            raise ValueError(f"zone {zone} has a {kind} {row.tolist()}, and its points run from 0 to {end - start - 1}")
