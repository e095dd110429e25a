"""Gmsh .msh files, versions 2.2 and 4.1, text and binary, without loss.

meshio's own reader forgets what its mesh type cannot hold (groups of entities without nodes, second
physical groups, node numbers, partitions, periodicity) and refuses files whose groups cover only
some entities.  Here a file is its sections: nodes and elements are parsed, all others are kept as
the bytes they are and written back (`formats_gmsh_write`).

    $MeshFormat ... $PhysicalNames ... $Entities ... $Nodes ... $Elements ... $NodeData ...
"""

import re
import warnings
from dataclasses import dataclass, field, replace
from typing import Any

import meshio
import numpy as np

# Gmsh's element numbers: meshio's name, dimension, nodes.
KINDS = {
    1: ("line", 1, 2), 2: ("triangle", 2, 3), 3: ("quad", 2, 4), 4: ("tetra", 3, 4), 5: ("hexahedron", 3, 8),
    6: ("wedge", 3, 6), 7: ("pyramid", 3, 5), 8: ("line3", 1, 3), 9: ("triangle6", 2, 6), 10: ("quad9", 2, 9),
    11: ("tetra10", 3, 10), 15: ("vertex", 0, 1), 16: ("quad8", 2, 8), 21: ("triangle10", 2, 10), 26: ("line4", 1, 4),
}  # fmt: skip


NUMBERS = {name: (number, dim) for number, (name, dim, _) in KINDS.items()}


TAGS = ("gmsh:physical", "gmsh:geometrical")


DATA = ("NodeData", "ElementData")


@dataclass(frozen=True)
class Nodes:
    entity: tuple[int, int, int]  # dimension, number, parametric or not
    numbers: np.ndarray  # (n,)
    coordinates: np.ndarray  # (n, 3), with parameters after them where parametric


@dataclass(frozen=True)
class Elements:
    kind: int
    entity: int
    numbers: np.ndarray  # (n,)
    tags: np.ndarray  # (n, k): physical, elementary, ...; version 2.2 only
    rows: np.ndarray  # (n, m) rows of all nodes in file order


@dataclass(frozen=True)
class MshFile:
    """One .msh file: its sections in order, and the parsed ones among them."""

    version: str
    binary: bool
    size: int = 8
    sections: list[tuple[str, bytes]] = field(default_factory=list)
    nodes: list[Nodes] = field(default_factory=list)
    elements: list[Elements] = field(default_factory=list)


class _Numbers:
    """Walks through the numbers of a section, text or binary."""

    def __init__(self, payload: bytes, binary: bool, name: str) -> None:
        self.payload, self.binary, self.name, self.place = payload, binary, name, 0
        if not binary:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                self.values = np.fromstring(payload, sep=" ") if payload.strip() else np.zeros(0)

    def take(self, count: int, dtype: Any) -> np.ndarray:
        left = len(self.payload) - self.place if self.binary else len(self.values) - self.place
        needed = int(count) * (np.dtype(dtype).itemsize if self.binary else 1)
        if not 0 <= needed <= left:
            raise ValueError(f"${self.name} ends early: the file is truncated or damaged")
        start, self.place = self.place, self.place + needed
        if self.binary:
            return np.frombuffer(self.payload, dtype, int(count), start)
        return self.values[start : self.place].astype(dtype)


def read(path: str) -> tuple[meshio.Mesh, MshFile | None]:
    """The mesh and the file's other content; None beside a version 4.0 file, which meshio reads.

    Raises ValueError for what is not a complete .msh file.
    """
    with open(path, "rb") as stream:
        data = stream.read()
    sections = _sections(data)
    named = dict(reversed(sections))
    if "MeshFormat" not in named:
        raise ValueError("it does not begin with $MeshFormat")
    words = named["MeshFormat"].split(b"\n")[0].split()
    version, binary, size = words[0].decode(), words[1] == b"1", int(words[2])
    if version == "4.0":
        mesh = meshio.gmsh.read(path)
        mesh.point_data.pop("gmsh:dim_tags", None)
        mesh.cell_sets.clear()
        return mesh, None
    if not version.startswith("2") and version not in ("4", "4.1"):
        raise ValueError(f"version {version} of the format is not known (2.2, 4.0 and 4.1 are)")
    if binary and named["MeshFormat"].split(b"\n", 1)[1][:4] != np.int32(1).tobytes():
        raise ValueError("a binary file of the other byte order; save it anew with Gmsh")
    for name in ("Nodes", "Elements"):
        if name not in named:
            raise ValueError(f"it has no ${name}")
    old = version.startswith("2")
    nodes = (_nodes_22 if old else _nodes_41)(named["Nodes"], binary, size)
    row_of = _Lookup(np.concatenate([b.numbers for b in nodes]) if nodes else np.zeros(0, np.int64), "node")
    raw = (_elements_22 if old else _elements_41)(named["Elements"], binary, size)
    elements = [replace(block, rows=row_of(block.rows)) for block in raw]
    file = MshFile("2.2" if old else "4.1", binary, size, sections, nodes, elements)
    return _to_mesh(file, row_of), file


def _sections(data: bytes) -> list[tuple[str, bytes]]:
    found, place = [], 0
    while len(data) - place > 100 or data[place:].strip():
        start = re.compile(rb"\s*\$(\w+)[ \t]*\r?\n").match(data, place)
        if start is None:
            raise ValueError("a section ($Name) was expected: not a .msh file, or damaged")
        name = start[1].decode()
        end = data.find(b"$End" + start[1], start.end())
        if end < 0:
            raise ValueError(f"${name} is not closed by $End{name}: the file is truncated")
        found.append((name, data[start.end() : end]))
        place = end + len(name) + 4
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
    pieces: list[tuple[int, int, np.ndarray]] = []
    done = 0
    while done < total:
        if binary:
            kind, n, tags = numbers.take(3, np.int32).tolist()
            width = 1 + tags + _kind(kind)[2]
            table = numbers.take(n * width, np.int32).reshape(n, width).astype(np.int64)
        else:
            # Look a window ahead for elements of the same kind; the first that differs ends the run.
            _number, kind, tags = numbers.values[numbers.place : numbers.place + 3].astype(np.int64).tolist()
            width = 3 + tags + _kind(kind)[2]
            n = max(1, min(1024, total - done, (len(numbers.values) - numbers.place) // width))
            window = numbers.take(n * width, np.int64).reshape(n, width)
            same = (window[:, 1] == kind) & (window[:, 2] == tags)
            table = window[: n if same.all() else int(same.argmin())]
            numbers.place -= (n - len(table)) * width
            table = np.delete(table, [1, 2], axis=1)
        if pieces and pieces[-1][:2] == (kind, tags):
            pieces[-1] = (kind, tags, np.concatenate([pieces[-1][2], table]))
        else:
            pieces.append((kind, tags, table))
        done += len(table)
        if not len(table):
            raise ValueError("$Elements is damaged")
    return [Elements(kind, 0, t[:, 0], t[:, 1 : 1 + tags], t[:, 1 + tags :]) for kind, tags, t in pieces]


class _Lookup:
    """From Gmsh's numbers to rows."""

    def __init__(self, numbers: np.ndarray, what: str) -> None:
        self.order, self.what = numbers.argsort(kind="stable"), what
        self.sorted = numbers[self.order]

    def __call__(self, numbers: np.ndarray) -> np.ndarray:
        place = self.sorted.searchsorted(numbers).clip(max=max(len(self.sorted) - 1, 0))
        missing = self.sorted[place] != numbers if len(self.sorted) else np.ones(numbers.shape, bool)
        if missing.any():
            raise ValueError(f"it refers to {self.what} {numbers[missing].flat[0]}, which it does not have")
        return self.order[place]


def entity_groups(file: MshFile) -> dict[tuple[int, int], list[int]]:
    """(dimension, number) of each entity to its physical groups; version 4.1."""
    groups: dict[tuple[int, int], list[int]] = {}
    payload = dict(file.sections).get("Entities")
    if payload is None:
        return groups
    numbers, count = _Numbers(payload, file.binary, "Entities"), f"u{file.size}"
    for dim, n in enumerate(numbers.take(4, count).tolist()):
        for _ in range(int(n)):
            entity = int(numbers.take(1, np.int32)[0])
            numbers.take(3 if dim == 0 else 6, float)
            groups[dim, entity] = numbers.take(int(numbers.take(1, count)[0]), np.int32).tolist()
            if dim:
                numbers.take(int(numbers.take(1, count)[0]), np.int32)
    return groups


def _to_mesh(file: MshFile, row_of: _Lookup) -> meshio.Mesh:
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
    cell_data = {"gmsh:physical": physical} if any(p.any() for p in physical) else {}
    cell_data["gmsh:geometrical"] = elementary
    points = np.concatenate([b.coordinates[:, :3] for b in file.nodes]) if file.nodes else np.zeros((0, 3))
    point_data: dict[str, np.ndarray] = {}
    cells = [(KINDS[b.kind][0], b.rows) for b in file.elements]
    ends = np.cumsum([len(b.rows) for b in file.elements])[:-1]
    element_of = _Lookup(np.concatenate([b.numbers for b in file.elements] or [np.zeros(0, np.int64)]), "element")
    for section, payload in file.sections:
        if section == "NodeData":
            name, numbers, values = _data(payload, file.binary)
            point_data[name] = _scattered(row_of(numbers), values, len(points))
        elif section == "ElementData":
            name, numbers, values = _data(payload, file.binary)
            total = sum(len(b.rows) for b in file.elements)
            cell_data[name] = np.split(_scattered(element_of(numbers), values, total), ends)
    names = {name: np.array([tag, dim]) for dim, tag, name in physical_names(file)}
    return meshio.Mesh(points, cells, point_data=point_data, cell_data=cell_data, field_data=names)


def physical_names(file: MshFile) -> list[tuple[int, int, str]]:
    text = dict(file.sections).get("PhysicalNames", b"0").decode(errors="replace")
    return [(int(dim), int(tag), name) for dim, tag, name in re.findall(r'^\s*(\d+)\s+(-?\d+)\s+"(.*)"', text, re.M)]


def data_name(payload: bytes) -> str:
    return payload.split(b"\n", 2)[1].decode(errors="replace").strip().strip('"')


def _data(payload: bytes, binary: bool) -> tuple[str, np.ndarray, np.ndarray]:
    """A data section's name, the (n,) numbers of its nodes or elements, the (n, c) values."""
    rest, groups = payload, []
    for _ in range(3):
        head, rest = rest.split(b"\n", 1)
        *lines, rest = rest.split(b"\n", int(head))
        groups.append(lines)
    _step, components, n = [int(word) for word in groups[2][:3]]
    numbers = _Numbers(rest, binary, "Data")
    if binary:
        table = numbers.take(n, [("number", np.int32), ("values", float, (components,))])
        return data_name(payload), table["number"].astype(np.int64), table["values"]
    table = numbers.take(n * (1 + components), float).reshape(n, 1 + components)
    return data_name(payload), table[:, 0].astype(np.int64), table[:, 1:]


def _scattered(rows: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """The values at their rows, NaN at those the file leaves out."""
    out = np.full((count, values.shape[1]), np.nan)
    out[rows] = values
    return out[:, 0] if out.shape[1] == 1 else out
