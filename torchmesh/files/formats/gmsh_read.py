"""Reading Gmsh files, versions 2.2 and 4.1."""

import re
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from ..swelling import check_swelling
from .gmsh_file import KINDS, TAGS, Elements, MshFile, Nodes, data_head, labelled


class _Numbers:
    """The numbers of a section, text or binary, taken one run after another."""

    def __init__(self, payload: bytes, binary: bool, name: str) -> None:
        self.payload, self.binary, self.name, self.position = payload, binary, name, 0
        if not binary:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                self.values = np.fromstring(payload, sep=" ") if payload.strip() else np.zeros(0)

    def take(self, count: int, dtype: Any) -> np.ndarray:
        """The next `count` numbers.  Raises ValueError if there are fewer."""
        left = len(self.payload) - self.position if self.binary else len(self.values) - self.position
        needed = int(count) * (np.dtype(dtype).itemsize if self.binary else 1)
        if not 0 <= needed <= left:
            raise ValueError(f"${self.name} ends early: the file is truncated or damaged")
        start, self.position = self.position, self.position + needed
        if self.binary:
            return np.frombuffer(self.payload, dtype, int(count), start)
        return self.values[start : self.position].astype(dtype)


def read(path: Path) -> tuple[meshio.Mesh, MshFile | None]:
    """The mesh and the whole file; None in place of a file of version 4.0, which meshio reads.

    Raises ValueError if it is not a complete .msh file.
    """
    data = path.read_bytes()
    if data.lstrip()[:1] == b"(":
        raise ValueError("it looks like a mesh of Fluent; save it as .su2, or as one of Gmsh's")
    sections = _sections(data)
    named = dict(reversed(sections))
    if "MeshFormat" not in named:
        raise ValueError("it does not begin with $MeshFormat")
    words = named["MeshFormat"].split(b"\n")[0].split()
    version, binary, size = words[0].decode(), words[1] == b"1", int(words[2])
    if version in ("4", "4.0"):
        mesh = _by_meshio(path)
        mesh.point_data.pop("gmsh:dim_tags", None)
        mesh.cell_sets.clear()
        return mesh, None
    if not version.startswith("2") and version != "4.1":
        raise ValueError(f"version {version} of the format is not known (2.2, 4.0 and 4.1 are)")
    if binary and named["MeshFormat"].split(b"\n", 1)[1][:4] != np.int32(1).tobytes():
        raise ValueError("a binary file of the other byte order; save it anew with Gmsh")
    for name in ("Nodes", "Elements"):
        if name not in named:
            raise ValueError(f"it has no ${name}")
    old = version.startswith("2")
    nodes = (_nodes_22 if old else _nodes_41)(named["Nodes"], binary, size)
    row_of = RowOf(np.concatenate([b.numbers for b in nodes]) if nodes else np.zeros(0, np.int64), "node")
    raw = (_elements_22 if old else _elements_41)(named["Elements"], binary, size)
    elements = [replace(block, rows=row_of(block.rows)) for block in raw]
    file = MshFile("2.2" if old else "4.1", binary, size, sections, nodes, elements)
    return _to_mesh(file, row_of), file


def _by_meshio(path: Path) -> meshio.Mesh:
    """A file of version 4.0, which Gmsh calls 4; meshio would take that for 4.1."""
    reader = meshio.gmsh
    with open(path, "rb") as stream:
        while (line := stream.readline()).strip() != b"$MeshFormat":
            if not line:
                raise ValueError("it does not begin with $MeshFormat")
        _version, size, is_text = reader.main._read_header(stream)
        return reader._gmsh40.read_buffer(stream, is_text, size)


def _sections(data: bytes) -> list[tuple[str, bytes]]:
    """Name and content of all sections.  Raises ValueError for anything else."""
    found, position = [], 0
    while len(data) - position > 100 or data[position:].strip():
        start = re.compile(rb"\s*\$(\w+)[ \t]*\r?\n").match(data, position)
        if start is None:
            raise ValueError("a section ($Name) was expected: not a .msh file, or damaged")
        name = start[1].decode()
        end = data.find(b"$End" + start[1], start.end())
        if end < 0:
            raise ValueError(f"${name} is not closed by $End{name}: the file is truncated")
        found.append((name, data[start.end() : end]))
        position = end + len(name) + 4
    return found


def _nodes_41(payload: bytes, binary: bool, size: int) -> list[Nodes]:
    numbers, blocks = _Numbers(payload, binary, "Nodes"), []
    count = f"u{size}"
    for _ in range(int(numbers.take(4, count)[0])):
        dim, entity, parametric = numbers.take(3, np.int32).tolist()
        n = int(numbers.take(1, count)[0])
        width = 3 + (dim if parametric else 0)
        names = numbers.take(n, count).astype(np.int64)
        blocks.append(Nodes((dim, entity, parametric), names, numbers.take(n * width, float).reshape(n, width)))
    return blocks


def _nodes_22(payload: bytes, binary: bool, _: int) -> list[Nodes]:
    head, body = payload.split(b"\n", 1)
    numbers, n = _Numbers(body, binary, "Nodes"), int(head)
    if binary:
        table = numbers.take(n, [("number", np.int32), ("at", float, 3)])
        return [Nodes((2, 0, 0), table["number"].astype(np.int64), np.array(table["at"]))]
    table = numbers.take(4 * n, float).reshape(n, 4)
    return [Nodes((2, 0, 0), table[:, 0].astype(np.int64), table[:, 1:])]


def _kind(number: int) -> tuple[str, int, int]:
    """The row of KINDS.  Raises ValueError for a type that is not in it."""
    if number not in KINDS:
        raise ValueError(f"element type {number} of Gmsh is not supported")
    return KINDS[number]


def _elements_41(payload: bytes, binary: bool, size: int) -> list[Elements]:
    numbers, blocks = _Numbers(payload, binary, "Elements"), []
    count = f"u{size}"
    for _ in range(int(numbers.take(4, count)[0])):
        _dim, entity, kind = numbers.take(3, np.int32).tolist()
        n, width = int(numbers.take(1, count)[0]), 1 + _kind(kind)[2]
        table = numbers.take(n * width, count).astype(np.int64).reshape(n, width)
        blocks.append(Elements(kind, entity, table[:, 0], np.zeros((n, 0), np.int64), table[:, 1:]))
    return blocks


def _elements_22(payload: bytes, binary: bool, _: int) -> list[Elements]:
    head, body = payload.split(b"\n", 1)
    numbers, total = _Numbers(body, binary, "Elements"), int(head)
    runs: list[tuple[int, int, np.ndarray]] = []
    done = 0
    while done < total:
        if binary:
            kind, n, tags = numbers.take(3, np.int32).tolist()
            width = 1 + tags + _kind(kind)[2]
            table = numbers.take(n * width, np.int32).reshape(n, width).astype(np.int64)
        else:
            # Look a window ahead for elements of the same kind; the first that differs ends the run.
            _number, kind, tags = numbers.values[numbers.position : numbers.position + 3].astype(np.int64).tolist()
            width = 3 + tags + _kind(kind)[2]
            n = max(1, min(1024, total - done, (len(numbers.values) - numbers.position) // width))
            window = numbers.take(n * width, np.int64).reshape(n, width)
            same = (window[:, 1] == kind) & (window[:, 2] == tags)
            table = window[: n if same.all() else int(same.argmin())]
            numbers.position -= (n - len(table)) * width
            table = np.delete(table, [1, 2], axis=1)
        if runs and runs[-1][:2] == (kind, tags):
            runs[-1] = (kind, tags, np.concatenate([runs[-1][2], table]))
        else:
            runs.append((kind, tags, table))
        done += len(table)
        if not len(table):
            raise ValueError("$Elements is damaged")
    return [Elements(kind, 0, t[:, 0], t[:, 1 : 1 + tags], t[:, 1 + tags :]) for kind, tags, t in runs]


class RowOf:
    """Finds the rows of nodes or elements by Gmsh's numbers.

    what  "node" or "element", for the error
    """

    def __init__(self, numbers: np.ndarray, what: str) -> None:
        self.order, self.what = numbers.argsort(kind="stable"), what
        self.sorted = numbers[self.order]

    def __call__(self, numbers: np.ndarray) -> np.ndarray:
        found = self.sorted.searchsorted(numbers).clip(max=max(len(self.sorted) - 1, 0))
        missing = self.sorted[found] != numbers if len(self.sorted) else np.ones(numbers.shape, bool)
        if missing.any():
            raise ValueError(f"it refers to {self.what} {numbers[missing].flat[0]}, which it does not have")
        return self.order[found]


def entity_groups(file: MshFile) -> dict[tuple[int, int], list[int]]:
    """The physical groups of each entity, which is given by dimension and number; version 4.1 only."""
    return {(dim, entity): groups for dim, entity, _, groups in _entities(file)}


def with_group_0(file: MshFile) -> MshFile:
    """The file with each entity that has elements and no physical group in the group 0, if others have groups.

    Version 4.1 lets entities be without a group, but meshio refuses files in which some have one and some have none.
    0 stands for no group in version 2.2.  A file that meshio takes comes back as it is.
    """
    used = {(KINDS[block.kind][1], block.entity) for block in file.elements}
    entities = [(place, groups) for dim, entity, place, groups in _entities(file) if (dim, entity) in used]
    places = [place for place, groups in entities if not groups]
    if not places or len(places) == len(entities):
        return file
    payload = dict(file.sections).get("Entities", b"")
    words = [] if file.binary else [match.span() for match in re.finditer(rb"\S+", payload)]
    one = np.array([1], f"u{file.size}").tobytes() + np.int32(0).tobytes() if file.binary else b"1 0"
    for place in reversed(places):
        start, end = (place, place + file.size) if file.binary else words[place]
        payload = payload[:start] + one + payload[end:]
    return replace(file, sections=[(n, payload if n == "Entities" else text) for n, text in file.sections])


def _entities(file: MshFile) -> Iterator[tuple[int, int, int, list[int]]]:
    """Dimension, number and physical groups of each entity; before the groups where their count stands in $Entities.

    The place is the byte in a binary file, and the number of the word in a text file.
    """
    payload = dict(file.sections).get("Entities")
    if payload is None:
        return
    numbers, count = _Numbers(payload, file.binary, "Entities"), f"u{file.size}"
    for dim, n in enumerate(numbers.take(4, count).tolist()):
        for _ in range(int(n)):
            entity = int(numbers.take(1, np.int32)[0])
            numbers.take(3 if dim == 0 else 6, float)  # its coordinates, or its bounding box
            place = numbers.position
            yield dim, entity, place, numbers.take(int(numbers.take(1, count)[0]), np.int32).tolist()
            if dim:
                numbers.take(int(numbers.take(1, count)[0]), np.int32)  # the entities that bound it


def _to_mesh(file: MshFile, row_of: RowOf) -> meshio.Mesh:
    cell_data = dict(zip(TAGS, _tags(file), strict=True))
    if not any(values.any() for values in cell_data[TAGS[0]]):
        del cell_data[TAGS[0]]
    points = np.concatenate([b.coordinates[:, :3] for b in file.nodes]) if file.nodes else np.zeros((0, 3))
    point_data: dict[str, np.ndarray] = {}
    cells = [(KINDS[b.kind][0], b.rows) for b in file.elements]
    ends = np.cumsum([len(b.rows) for b in file.elements])[:-1]
    element_of = RowOf(np.concatenate([b.numbers for b in file.elements] or [np.zeros(0, np.int64)]), "element")
    for section, payload, name in labelled(file.sections):
        if section == "NodeData":
            numbers, values = data_table(payload, file.binary)
            point_data[name] = _scattered(row_of(numbers), values, len(points))
        elif section == "ElementData":
            numbers, values = data_table(payload, file.binary)
            total = sum(len(b.rows) for b in file.elements)
            cell_data[name] = np.split(_scattered(element_of(numbers), values, total), ends)
    names = {name: np.array([tag, dim]) for dim, tag, name in file.physical_names}
    return meshio.Mesh(points, cells, point_data=point_data, cell_data=cell_data, field_data=names)


def _tags(file: MshFile) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """The physical group and the elementary entity of each element, block by block; 0 where there is none."""
    groups = entity_groups(file) if file.version == "4.1" else {}
    physical, elementary = [], []
    for block in file.elements:
        n = len(block.rows)
        if file.version == "4.1":
            own = groups.get((KINDS[block.kind][1], block.entity), [])
            physical.append(np.full(n, abs(own[0]) if own else 0))
            elementary.append(np.full(n, block.entity))
        else:
            padded = np.pad(block.tags, ((0, 0), (0, 2)))
            physical.append(padded[:, 0])
            elementary.append(padded[:, 1] if block.tags.shape[1] > 1 else np.zeros(n, np.int64))
    return physical, elementary


def data_table(payload: bytes, binary: bool) -> tuple[np.ndarray, np.ndarray]:
    """The numbers (n,) of the nodes or elements of a data section, and their values (n, c)."""
    head, groups = data_head(payload)
    _step, components, n = [int(word) for word in groups[2][:3]]
    numbers = _Numbers(payload[len(head) :], binary, "Data")
    if binary:
        table = numbers.take(n, [("number", np.int32), ("values", float, (components,))])
        return table["number"].astype(np.int64), table["values"]
    table = numbers.take(n * (1 + components), float).reshape(n, 1 + components)
    return table[:, 0].astype(np.int64), table[:, 1:]


def _scattered(rows: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """(count, ...) the values at their rows; NaN in rows that the file leaves out."""
    check_swelling(8 * count * values.shape[1], values.nbytes)
    out = np.full((count, values.shape[1]), np.nan)
    out[rows] = values
    return out[:, 0] if out.shape[1] == 1 else out


def paired_nodes(file: MshFile) -> np.ndarray:
    """The rows of the nodes that $Periodic pairs with others, each once."""
    row_of = RowOf(np.concatenate([b.numbers for b in file.nodes]), "node")
    found = [np.zeros(0, np.int64)]
    for section, payload in file.sections:
        if section == "Periodic":
            found.append(_periodic_41(payload, file) if file.version == "4.1" else _periodic_22(payload))
    return np.unique(row_of(np.concatenate(found)))


def _periodic_41(payload: bytes, file: MshFile) -> np.ndarray:
    """The numbers of all nodes in $Periodic of version 4.1."""
    numbers, count, found = _Numbers(payload, file.binary, "Periodic"), f"u{file.size}", [np.zeros(0, np.int64)]
    for _ in range(int(numbers.take(1, count)[0])):
        numbers.take(3, np.int32)  # the dimension and the two entities
        numbers.take(int(numbers.take(1, count)[0]), float)  # an affine map
        found.append(numbers.take(2 * int(numbers.take(1, count)[0]), count).astype(np.int64))
    return np.concatenate(found)


def _periodic_22(payload: bytes) -> np.ndarray:
    """The numbers of all nodes in $Periodic of version 2.2, which is text in binary files, too."""
    lines = [line.split() for line in payload.decode(errors="replace").splitlines() if line.strip()]
    found: list[int] = []
    at = 1
    for _ in range(int(lines[0][0]) if lines else 0):
        at += 1 + (lines[at + 1][0] == "Affine")
        count = int(lines[at][0])
        if count < 0:
            raise ValueError("$Periodic has a negative number of nodes")
        found += [int(word) for words in lines[at + 1 : at + 1 + count] for word in words]
        at += 1 + count
    return np.array(found, np.int64)
