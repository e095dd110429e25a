"""I-DEAS universal files (.unv), as Salome, Code_Aster and others exchange them: datasets between lines of -1.

    -1 / 2411           nodes: a line of numbers, and a line of coordinates in columns of 25
    -1 / 2412           elements: a line of numbers, and a line of nodes in columns of 10
    -1 / 2467           groups of elements and nodes, with names

Datasets that are not known stay to the letter.  https://www.ceas3.uc.edu/sdrluff/all_files.php
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import meshio
import numpy as np

from .deck import read_lines
from .format import Document, Format, numbers_by_type
from .gmsh_read import RowOf
from .text_tables import whole

PROPERTY = "unv:property"

_NODES, _ELEMENTS, _GROUPS = ("2411", "781"), ("2412",), ("2467", "2477", "2452", "2435", "2432", "2430", "2429")

# The last two digits of the numbers of plane, shell and axisymmetric elements, and what they are.
_PLANAR = {1: ("triangle", 3), 2: ("triangle6", 6), 4: ("quad", 4), 5: ("quad8", 8)}
_BEAMS = {11: ("line", 2), 21: ("line", 2), 22: ("line", 2), 23: ("line3", 3), 24: ("line3", 3)}
_NUMBERS = {"triangle": 91, "triangle6": 92, "quad": 94, "quad8": 95, "line": 11, "line3": 24, "vertex": 161}

# Nodes of second order go round, corner after mid-side node: which of them is each of meshio's.
_ORDER = {"triangle6": [0, 2, 4, 1, 3, 5], "quad8": [0, 2, 4, 6, 1, 3, 5, 7], "line3": [0, 2, 1]}

# Dataset 164: what its numbers of systems of units mean, by length and force.
_UNITS = {1: "metre, newton", 2: "foot, pound-force", 3: "metre, kilogram-force", 4: "foot, poundal",
          5: "millimetre, millinewton", 6: "centimetre, centinewton", 7: "inch, pound-force",
          8: "millimetre, kilogram-force", 9: "chosen by the user", 10: "millimetre, newton"}  # fmt: skip

_ELEMENT = 8  # the type of the members of groups that are elements


@dataclass
class UnvFile:
    """The lines of a file, and where nodes and elements stand in them.

    points   (V,) the number of the line with the coordinates of each node
    cells    for each block the number of the first line with the nodes of each element
    labels   (V,) the numbers of the nodes
    """

    lines: list[str]
    points: list[int] = field(default_factory=list)
    cells: list[list[int]] = field(default_factory=list)
    labels: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))

    def patched(self, before: meshio.Mesh, after: meshio.Mesh) -> list[str]:
        """The lines with the points and cells of `after`, which has the rows of `before`."""
        lines = list(self.lines)
        new = np.pad(after.points, ((0, 0), (0, 3 - after.points.shape[1])))
        for row in np.flatnonzero((new != before.points).any(1)).tolist():
            number = self.points[row]
            lines[number] = _reals(new[row], "D" if "D" in lines[number].upper() else "E") + _end(lines[number])
        for numbers, old, block in zip(self.cells, before.cells, after.cells, strict=True):
            order = np.argsort(_ORDER.get(block.type, np.arange(block.data.shape[1])))
            for row in np.flatnonzero((old.data != block.data).any(1)).tolist():
                number = numbers[row]
                lines[number] = _whole(self.labels[block.data[row][order]]) + _end(lines[number])
        return lines


def _end(line: str) -> str:
    return line[len(line.rstrip("\r\n")) :]


def _reals(values: np.ndarray, letter: str) -> str:
    return "".join(f"{value:25.16E}".replace("E", letter) for value in values.tolist())


def _whole(values: np.ndarray) -> str:
    return "".join(f"{value:10d}" for value in values.tolist())


@dataclass(frozen=True)
class UnvFormat(Format):
    """The `rest` of a document is a `UnvFile`; groups of elements are cell sets, those of lines are walls."""

    def read(self, path: Path) -> Document:
        return _Reader(read_lines(path)).document(self.name)

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        with open(path, "w", encoding="utf-8", errors="surrogateescape", newline="") as stream:
            if like is not None and same_rows:
                stream.writelines(like.rest.patched(like.mesh, mesh))
            else:
                stream.writelines(_new_lines(mesh))

    def left_behind(self, document: Document, target: Format, same_rows: bool) -> list[str]:
        return [] if target is self and same_rows else list(document.skipped)


UNV = UnvFormat("unv", (".unv",), tuple(_NUMBERS), point_data="none", cell_data="regions", region_name=PROPERTY,
                cell_sets=True, point_sets=True)  # fmt: skip


class _Reader:
    """What is found in the datasets of a file."""

    def __init__(self, lines: list[str]) -> None:
        self.file = UnvFile(lines)
        self.coordinates: list[list[float]] = []
        self.names: list[int] = []
        self.blocks: dict[str, tuple[list[list[int]], list[int], list[int]]] = {}
        self.labels: dict[str, list[int]] = {}
        self.where: dict[int, tuple[str, int]] = {}
        self.groups: list[tuple[str, list[tuple[int, int]]]] = []
        self.skipped: dict[str, None] = {}
        self.units = ""

    def document(self, name: str) -> Document:
        for number, begin, end in self._datasets():
            if number in _NODES:
                self._read_nodes(begin, end)
            elif number in _ELEMENTS:
                self._read_elements(begin, end)
            elif number in _GROUPS:
                self._read_groups(number, begin, end)
            else:
                self.skipped[f"dataset {number}"] = None
                if number == "164" and begin < end:
                    code = self.file.lines[begin][:10].strip()
                    self.units = _UNITS.get(int(code) if code.isdigit() else 0, "")
        labels = self.file.labels = np.array(self.names, np.int64)
        if not len(labels) or not self.blocks:
            raise ValueError("it has no nodes (2411) or no elements (2412)")
        if len(np.unique(labels)) < len(labels):
            raise ValueError("a node has the number of another one")
        row_of = RowOf(labels, "node")
        cells, tags = [], []
        for kind, (rows, properties, at) in self.blocks.items():
            nodes = row_of(np.array(rows, np.int64))
            cells.append((kind, nodes[:, _ORDER[kind]] if kind in _ORDER else nodes))
            tags.append(np.array(properties, np.int64))
            self.file.cells.append(at)
        mesh = meshio.Mesh(np.array(self.coordinates), cells, cell_data={PROPERTY: tags})
        self._give_groups(mesh, row_of)
        own = [np.array(self.labels[kind], np.int64) for kind in self.blocks]
        return Document(
            mesh, name, rest=self.file, skipped=tuple(self.skipped), node_numbers=labels,
            cell_numbers=numbers_by_type(mesh, own), units=self.units,
        )  # fmt: skip

    def _datasets(self) -> Iterator[tuple[str, int, int]]:
        """The number of each dataset, and the lines that it begins at and ends before."""
        marks = [number for number, line in enumerate(self.file.lines) if line.strip() == "-1"]
        if len(marks) % 2 or not marks:
            raise ValueError("a dataset has no end (-1): not a universal file, or cut short")
        for first, last in zip(marks[::2], marks[1::2], strict=True):
            words = self.file.lines[first + 1].split()
            yield (words or [""])[0], first + 2, last

    def _words(self, number: int, count: int, what: str) -> list[str]:
        """The words of a line.  Raises ValueError if there are fewer than `count`."""
        words = self.file.lines[number].split()
        if len(words) < count:
            raise ValueError(
                f"line {number + 1}: {what} needs {count} numbers: {self.file.lines[number].strip()[:60]!r}"
            )
        return words

    def _read_nodes(self, begin: int, end: int) -> None:
        for number in range(begin, end - 1, 2):
            self.names.append(int(self._words(number, 1, "a node")[0]))
            words = self._words(number + 1, 3, "a node")[:3]
            self.coordinates.append([float(word.upper().replace("D", "E")) for word in words])
            self.file.points.append(number + 1)

    def _read_elements(self, begin: int, end: int) -> None:
        number = begin
        while number < end:
            label, kind_of, *properties = [int(word) for word in self._words(number, 6, "an element")[:6]]
            count = properties[-1]
            beam = kind_of in _BEAMS
            kind, size = _BEAMS[kind_of] if beam else _PLANAR.get(kind_of % 10, ("", 0))
            kind = kind if beam or 41 <= kind_of <= 95 else "vertex" if count == 1 else ""
            if not kind or count != (size if kind != "vertex" else 1):
                raise ValueError(f"element type {kind_of} with {count} nodes is not planar or not known")
            at = number + 1 + beam  # beams have a line of orientations
            if at >= end:
                raise ValueError("its last element is cut short")
            rows, tags, places = self.blocks.setdefault(kind, ([], [], []))
            self.where[label] = (kind, len(rows))
            self.labels.setdefault(kind, []).append(label)
            rows.append([int(word) for word in self._words(at, count, "an element")[:count]])
            tags.append(properties[0])
            places.append(at)
            number = at + 1

    def _read_groups(self, dataset: str, begin: int, end: int) -> None:
        number = begin
        while number + 1 < end:
            count = int(self._words(number, 8, "a group")[7])
            name = self.file.lines[number + 1].strip()
            number += 2
            members: list[tuple[int, int]] = []
            width = 4 if dataset in ("2467", "2477", "2452", "2435") else 2
            while len(members) < count and number < end:
                texts = self.file.lines[number].split()
                if not all(text.lstrip("-").isdigit() for text in texts):
                    break
                words = [int(text) for text in texts]
                members += [(words[k], words[k + 1]) for k in range(0, len(words) - 1, width)]
                number += 1
            if len(members) < count:
                raise ValueError(f"the group {name[:40]!r} has {len(members)} members instead of {count}")
            self.groups.append((name, members))

    def _give_groups(self, mesh: meshio.Mesh, row_of: RowOf) -> None:
        """Gives the mesh its sets."""
        kinds = list(self.blocks)
        for name, members in self.groups:
            found = [self.where[label] for kind, label in members if kind == _ELEMENT and label in self.where]
            rows = [np.unique(np.array([r for k, r in found if k == kind], np.int64)) for kind in kinds]
            if found:
                mesh.cell_sets[name] = rows
            nodes = [label for kind, label in members if kind == _ELEMENT - 1]
            if nodes:
                mesh.point_sets[name] = row_of(np.array(nodes, np.int64))


def _new_lines(mesh: meshio.Mesh) -> Iterator[str]:
    """The file of a mesh, in runs of whole lines."""
    points = np.pad(mesh.points, ((0, 0), (0, 3 - mesh.points.shape[1])))
    yield "    -1\n  2411\n"
    for label, point in enumerate(points, 1):
        yield f"{label:10d}{1:10d}{1:10d}{11:10d}\n{_reals(point, 'D')}\n"
    yield "    -1\n    -1\n  2412\n"
    starts = np.cumsum([1] + [len(block.data) for block in mesh.cells])
    for i, block in enumerate(mesh.cells):
        order = np.argsort(_ORDER.get(block.type, np.arange(block.data.shape[1])))
        tags = mesh.cell_data[PROPERTY][i] if PROPERTY in mesh.cell_data else np.ones(len(block.data), np.int64)
        beam = "         0         1         1\n" if block.type in ("line", "line3") else ""
        kind, count = _NUMBERS[block.type], block.data.shape[1]
        for k, (row, tag) in enumerate(
            zip(block.data[:, order] + 1, whole(np.asarray(tags, float), "tags"), strict=True)
        ):
            head = np.array([starts[i] + k, kind, tag, 1, 7, count])
            yield f"{_whole(head)}\n{beam}{_whole(row)}\n"
    yield "    -1\n"
    groups: dict[str, list[tuple[int, int]]] = {}
    for name, members in mesh.cell_sets.items():
        rows = [int(starts[i]) + int(r) for i, found in enumerate(members) for r in np.asarray(found).tolist()]
        groups.setdefault(name, []).extend((_ELEMENT, row) for row in rows)
    for name, found in mesh.point_sets.items():
        groups.setdefault(name, []).extend((_ELEMENT - 1, int(row) + 1) for row in np.asarray(found).tolist())
    if groups:
        yield "    -1\n  2467\n"
        for number, (name, pairs) in enumerate(groups.items(), 1):
            yield f"{_whole(np.array([number, 0, 0, 0, 0, 0, 0, len(pairs)]))}\n{name[:40]}\n"
            for k in range(0, len(pairs), 2):
                yield "".join(_whole(np.array([kind, label, 0, 0])) for kind, label in pairs[k : k + 2]) + "\n"
        yield "    -1\n"
