"""Legacy VTK files (.vtk), changed in place: unstructured grids and polygons, text and binary, up to version 5.1.

Structured grids are read by meshio.  Our own reader is guarded against damaged files, on which VTK's own may kill
the process.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

import meshio
import numpy as np

from . import vtk_cells
from .checks import check_vtk
from .edits import edited
from .format import Document, Format
from .skipped import each_once
from .vtk_legacy import TYPE_NAMES, LegacyArray, VtkLegacy, coded
from .vtk_xml import as_text, renewed_text

# The sections of cells of POLYDATA in the order of their data; VTK's type of cells with one (two) and more nodes.
_POLYGONS = {"VERTICES": (1, 2), "LINES": (3, 4), "POLYGONS": (7, 7), "TRIANGLE_STRIPS": (6, 6)}
_SECTION_OF = {"vertex": "VERTICES", "line": "LINES"}


@dataclass
class VtkFile:
    """A file and its cells.

    cells   the number of its cells
    blocks  its blocks of cells, in the order of those of the mesh
    nodes   for each array of nodes: the array, how many numbers stand before the nodes of each of its cells (1 before
            version 5), its nodes with these, its blocks, and the first of them
    """

    legacy: VtkLegacy
    cells: int = 0
    blocks: list[vtk_cells.Block] = field(default_factory=list)
    nodes: list[tuple[LegacyArray, list[vtk_cells.Block], int]] = field(default_factory=list)

    def patched(self, before: meshio.Mesh, after: meshio.Mesh) -> bytes:
        """The bytes with the points, cells and data of `after`, which has the rows of `before`."""
        changes: list[tuple[LegacyArray, np.ndarray]] = []
        gone: list[LegacyArray] = []
        points = self.legacy.array("points")
        if points is not None:
            changes.append((points, np.pad(after.points, ((0, 0), (0, 3 - after.points.shape[1])))))
        for array, blocks, first in self.nodes:
            changes.append((array, vtk_cells.renewed(array.values, blocks, after.cells[first:][: len(blocks)])))
        old = {"point": before.point_data, "cell": self._in_file(before)}
        new = {"point": after.point_data, "cell": self._in_file(after)}
        for array in self.legacy.arrays:
            if array.section in old and array.name in old[array.section]:
                if array.name in new[array.section]:
                    changes.append((array, new[array.section][array.name]))
                else:
                    gone.append(array)
        edits = self._without(gone)
        for where in old:
            edits += self._with(where, {n: v for n, v in new[where].items() if n not in old[where]})
        return self._edited(changes, edits)

    def _without(self, gone: list[LegacyArray]) -> list[tuple[int, int, bytes]]:
        """The edits that leave arrays out, with what is noted of them."""
        edits = []
        for array in gone:
            start, end = array.whole
            note = _METADATA.match(self.legacy.data, end)
            end = note.end() if note else end
            # Behind a head of fields, an empty line in its place would stop other readers.
            begins = self.legacy.data[start - 1 : start] == b"\n" and not self.legacy.data.startswith(b"\n", start)
            edits.append((start, end + (begins and self.legacy.data.startswith(b"\n", end)), b""))
        for number in {array.of for array in gone} - {-1}:
            start, end = self.legacy.heads[number]
            less = sum(array.of == number for array in gone)
            edits.append((start, end, str(int(self.legacy.data[start:end]) - less).encode()))
        return edits

    def _with(self, where: str, data: dict[str, np.ndarray]) -> list[tuple[int, int, bytes]]:
        """The edit that adds data at points or in cells."""
        if not data:
            return []
        out: list[bytes] = []
        rows = len(next(iter(data.values())))
        at = self.legacy.ends.get(where, len(self.legacy.data))
        _put_field(out, data, self.legacy.binary, "" if where in self.legacy.ends else f"{where.upper()}_DATA {rows}\n")
        before = b"" if self.legacy.data[:at].endswith(b"\n") else b"\n"
        return [(at, at, before + b"".join(out))]

    def _edited(self, changes: list[tuple[LegacyArray, np.ndarray]], edits: list[tuple[int, int, bytes]]) -> bytes:
        for array, values in changes:
            if np.array_equal(array.values, values, equal_nan=array.values.dtype.kind == "f"):
                continue
            start, end = array.span
            old = self.legacy.data[start:end]
            if self.legacy.binary:
                edits.append((start, end, _binary(array.kind, values)))
            else:
                kind = "u1" if array.kind == "bit" else array.kind
                edits.append((start, end, renewed_text(old, array.values, np.asarray(values).astype(kind))))
            note = _METADATA.match(self.legacy.data, end)
            if note is not None:
                edits.append((*note.span(), _with_norms(note[0], values)))
        return edited(self.legacy.data, edits)

    def _in_file(self, mesh: meshio.Mesh) -> dict[str, np.ndarray]:
        """The cell data in the rows of the file."""
        found = {}
        for name, values in mesh.cell_data.items():
            own = [np.asarray(block) for block in values]
            empty = np.zeros((self.cells, *own[0].shape[1:]), np.result_type(*own)) if own else np.zeros(0)
            found[name] = vtk_cells.spread(self.blocks, own, empty)
        return found


# What VTK notes of an array behind it, up to a blank line; and the range of the lengths of its rows there.
_METADATA = re.compile(rb"\s*METADATA\n(?:[^\n]+\n)*")
_NORMS = re.compile(rb"(NAME L2_NORM_(?:FINITE_)?RANGE LOCATION vtkDataArray\nDATA 2 )[^\n]*")


def _with_norms(note: bytes, values: np.ndarray) -> bytes:
    sizes = np.linalg.norm(np.asarray(values, float).reshape(len(values), -1), axis=1)
    sizes = sizes[np.isfinite(sizes)]
    if not len(sizes):
        return note
    return _NORMS.sub(lambda m: m[1] + f"{sizes.min().item()!r} {sizes.max().item()!r}".encode(), note)


def _binary(kind: str, values: np.ndarray) -> bytes:
    if kind == "bit":
        return np.packbits(np.asarray(values).reshape(-1) != 0).tobytes()
    return np.ascontiguousarray(values).astype(np.dtype(kind).newbyteorder(">")).tobytes()


@dataclass(frozen=True)
class VtkFormat(Format):
    """The `rest` of a document is a `VtkFile`, or None for a structured grid."""

    def read(self, path: Path) -> Document:
        data = path.read_bytes()
        check_vtk(data)
        legacy = VtkLegacy.of(data)
        if legacy.dataset not in ("UNSTRUCTURED_GRID", "POLYDATA"):
            return Document(meshio.vtk.read(str(path)), self.name, legacy.binary)
        mesh, file = _parse(legacy)
        names = [*legacy.skipped, *(["the field data"] if legacy.fields else [])]
        return Document(mesh, self.name, legacy.binary, file, skipped=each_once(names))

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        file: VtkFile | None = like.rest if like is not None else None
        data = file.patched(like.mesh, mesh) if file is not None and like is not None and same_rows else b""
        path.write_bytes(
            data or new_file(mesh, None if file is None else file.legacy, like is None or bool(like.binary))
        )

    def left_behind(self, document: Document, target: Format, same_rows: bool) -> list[str]:
        if target is self:
            return (
                [] if same_rows else [name for name in document.skipped if name not in ("the field data", "METADATA")]
            )
        return list(document.skipped)


VTK = VtkFormat("vtk", (".vtk",), cell_sets=True, point_sets=True, set_arrays=True)


def _parse(legacy: VtkLegacy) -> tuple[meshio.Mesh, VtkFile]:
    """Raises ValueError for arrays that do not fit together."""
    points = legacy.array("points")
    if points is None:
        raise ValueError("it has no POINTS: cut short or damaged")
    file = VtkFile(legacy)
    cells: list[tuple[str, np.ndarray]] = []
    for key in ("CELLS",) if legacy.dataset == "UNSTRUCTURED_GRID" else _POLYGONS:
        nodes = legacy.array(f"{key} CONNECTIVITY" if legacy.offsets else key)
        if nodes is None:
            continue
        offsets, starts, values = _offsets(legacy, key, nodes)
        if key == "CELLS":
            array = legacy.array("types")
            if array is None:
                raise ValueError("it has no CELL_TYPES: cut short or damaged")
            types = array.values.astype(np.int64)
        else:
            one, more = _POLYGONS[key]
            types = np.where(np.diff(offsets) == (2 if key == "LINES" else 1), one, more)
        found = vtk_cells.blocks(types, offsets, values)
        found = [
            vtk_cells.Block(b.kind, b.nodes, b.cells + file.cells, np.where(b.places < 0, -1, starts[b.cells]))
            for b in found
        ]
        file.nodes.append((nodes, found, len(cells)))
        file.blocks += found
        file.cells += len(types)
        cells += [(block.kind, block.nodes) for block in found]
    mesh = meshio.Mesh(points.values, cells)
    for array in legacy.arrays:
        rows = {"point": len(mesh.points), "cell": file.cells}.get(array.section)
        if rows is not None and len(array.values) != rows:
            raise ValueError(f"the array {array.name!r} has {len(array.values)} rows instead of {rows}")
        if array.section == "point":
            mesh.point_data[array.name] = array.values
        elif array.section == "cell" and cells:
            mesh.cell_data[array.name] = [array.values[block.cells] for block in file.blocks]
    return mesh, file


def _offsets(legacy: VtkLegacy, key: str, nodes: LegacyArray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The offsets (n + 1,) of the cells among their nodes, where each begins in the file's array, and the nodes."""
    values = nodes.values.astype(np.int64)
    if legacy.offsets:
        array = legacy.array(f"{key} OFFSETS")
        offsets = array.values.astype(np.int64) if array is not None else np.zeros(1, np.int64)
        return (offsets if len(offsets) else np.zeros(1, np.int64)), offsets, values
    starts, at = [], 0
    table = values.tolist()
    while at < len(table):
        starts.append(at + 1)
        if table[at] < 0:
            raise ValueError(f"a cell of {key} has {table[at]} nodes")
        at += 1 + table[at]
    if at != len(table):
        raise ValueError(f"the last cell of {key} is cut short")
    begins = np.array(starts, np.int64)
    sizes = values[begins - 1]
    keep = np.ones(len(values), bool)
    keep[begins - 1] = False
    return np.concatenate([[0], np.cumsum(sizes)]), begins, values[keep]


def new_file(mesh: meshio.Mesh, like: VtkLegacy | None, binary: bool) -> bytes:
    """The bytes of a new file, in the version and the kind of `like`, with its title and its data of the whole file."""
    dataset = like.dataset if like is not None else "UNSTRUCTURED_GRID"
    offsets = like is None or like.offsets
    version = "5.1" if like is None else like.version
    title = b"written by torchmesh" if like is None else like.title
    out = [f"# vtk DataFile Version {version}\n".encode(), title, b"\n", b"BINARY\n" if binary else b"ASCII\n"]
    out.append(f"DATASET {dataset}\n".encode())
    if like is not None and like.fields:
        out += [like.fields.rstrip(b"\n") if not binary else like.fields, b"\n"]
    points = vtk_cells.storable(np.pad(mesh.points, ((0, 0), (0, 3 - mesh.points.shape[1]))))
    out.append(f"POINTS {len(points)} {TYPE_NAMES[points.dtype]}\n".encode())
    _put(out, points, binary)
    order: list[int] = []
    for key in ("CELLS",) if dataset == "UNSTRUCTURED_GRID" else ("VERTICES", "LINES", "POLYGONS"):
        own = [i for i, b in enumerate(mesh.cells) if key in ("CELLS", _SECTION_OF.get(b.type, "POLYGONS"))]
        types, ends, nodes = vtk_cells.arrays([mesh.cells[i] for i in own])
        order += own
        if not len(types) and key != "CELLS":
            continue
        if offsets:
            out.append(f"{key} {len(ends)} {len(nodes)}\nOFFSETS vtktypeint64\n".encode())
            _put(out, ends, binary)
            out.append(b"CONNECTIVITY vtktypeint64\n")
            _put(out, nodes, binary)
        else:
            out.append(f"{key} {len(types)} {len(types) + len(nodes)}\n".encode())
            _put(out, np.insert(nodes, ends[:-1], np.diff(ends)).astype(np.int32), binary)
        if key == "CELLS":
            out.append(f"CELL_TYPES {len(types)}\n".encode())
            _put(out, types.astype(np.int32), binary)
    cell_data = {n: np.concatenate([np.asarray(v[i]) for i in order]) for n, v in mesh.cell_data.items() if order}
    for key, data, count in (
        ("CELL_DATA", cell_data, sum(len(mesh.cells[i].data) for i in order)),
        ("POINT_DATA", mesh.point_data, len(mesh.points)),
    ):
        if data:
            _put_field(out, data, binary, f"{key} {count}\n")
    return b"".join(out)


def _put_field(out: list[bytes], data: dict[str, np.ndarray], binary: bool, head: str) -> None:
    """Adds arrays as a FIELD behind a line."""
    out.append(f"{head}FIELD FieldData {len(data)}\n".encode())
    for name, given in data.items():
        values = vtk_cells.storable(np.asarray(given))
        width = values.shape[1] if values.ndim > 1 else 1
        out.append(f"{coded(name)} {width} {len(values)} {TYPE_NAMES[values.dtype]}\n".encode())
        _put(out, values, binary)


def _put(out: list[bytes], values: np.ndarray, binary: bool) -> None:
    """Adds the numbers of an array."""
    out.append(_binary(values.dtype.str[1:], values) if binary else as_text(values, True))
    out.append(b"\n")
