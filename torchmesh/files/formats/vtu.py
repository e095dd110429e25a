"""VTK's XML files of unstructured grids (.vtu) and polygons (.vtp), changed in place: text, base64 or appended data,
compressed or not, of any version up to 2.3.

Our own reader is guarded against damaged files, on which VTK's own may kill the process.
"""

from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import meshio
import numpy as np

from . import vtk_cells
from .format import ALL_CELLS, Document, Format
from .skipped import each_once, in_xml
from .vtk_new import Style, new_file
from .vtk_xml import VtkXml

# The sections of cells in a file of polygons, in the order of their data; VTK's type of cells with one and more nodes.
_POLYGONS = {"Verts": (1, 2), "Lines": (3, 4), "Polys": (7, 7), "Strips": (6, 6)}


@dataclass
class _Piece:
    """A piece of a file.

    points    its rows among all points
    cells     the number of its cells
    sections  the arrays of nodes: the number of the array, its blocks, and the first block among those of the mesh
    blocks    the rows of its blocks among those of the mesh
    """

    points: slice
    cells: int = 0
    sections: list[tuple[int, np.ndarray, list[vtk_cells.Block], int]] = field(default_factory=list)
    blocks: list[tuple[int, vtk_cells.Block]] = field(default_factory=list)


@dataclass
class VtkFile:
    """A file and what its pieces hold."""

    xml: VtkXml
    pieces: list[_Piece]

    def patched(self, before: meshio.Mesh, after: meshio.Mesh) -> bytes:
        """The bytes of the file with the points, cells and data of `after`, which has the rows of `before`."""
        changes: dict[int, np.ndarray] = {}
        added: list[tuple[str, int, str, np.ndarray]] = []
        gone: set[int] = set()
        for number, piece in enumerate(self.pieces):
            (array,) = list(self.xml.of_piece("Points", number).values())[:1]
            rows = np.pad(after.points, ((0, 0), (0, 3 - after.points.shape[1])))[piece.points]
            old = np.pad(before.points, ((0, 0), (0, 3 - before.points.shape[1])))[piece.points]
            if not np.array_equal(rows, old, equal_nan=True):
                changes[array] = rows
            for array, nodes, blocks, first in piece.sections:
                own = [
                    meshio.CellBlock(b.type, b.data - piece.points.start) for b in after.cells[first:][: len(blocks)]
                ]
                new = vtk_cells.renewed(nodes, blocks, own)
                if not np.array_equal(new, nodes):
                    changes[array] = new
            given = {name: values[piece.points] for name, values in after.point_data.items()}
            self._put("PointData", number, given, {n: v[piece.points] for n, v in before.point_data.items()}, changes,
                      added, gone)  # fmt: skip
            self._put("CellData", number, _in_file(piece, after), _in_file(piece, before), changes, added, gone)
        return self.xml.patched(changes, added, gone)

    def _put(
        self, section: str, piece: int, after: dict[str, np.ndarray], before: dict[str, np.ndarray],
        changes: dict[int, np.ndarray], added: list[tuple[str, int, str, np.ndarray]], gone: set[int],
    ) -> None:  # fmt: skip
        """Notes what becomes of the arrays of a section."""
        known = self.xml.of_piece(section, piece)
        for name, number in known.items():
            if name in before and name not in after:
                gone.add(number)
            elif name in before and not _same(before[name], after[name]):
                changes[number] = after[name]
        added += [
            (section, piece, name, vtk_cells.storable(values)) for name, values in after.items() if name not in known
        ]


def _same(one: np.ndarray, other: np.ndarray) -> bool:
    return np.array_equal(one, other, equal_nan=one.dtype.kind == "f" and other.dtype.kind == "f")


def _in_file(piece: _Piece, mesh: meshio.Mesh) -> dict[str, np.ndarray]:
    """The cell data of a piece in the rows of the file."""
    found = {}
    for name, values in mesh.cell_data.items():
        own = [np.asarray(values[i]) for i, _ in piece.blocks]
        if own:
            empty = np.zeros((piece.cells, *own[0].shape[1:]), np.result_type(*own))
            found[name] = vtk_cells.spread([block for _, block in piece.blocks], own, empty)
    return found


@dataclass(frozen=True)
class VtkXmlFormat(Format):
    """The `rest` of a document is a `VtkFile`.

    kind  what VTK calls it: UnstructuredGrid or PolyData
    """

    kind: str = ""

    def read(self, path: Path) -> Document:
        data = path.read_bytes()
        xml = VtkXml.of(data)
        if xml.kind != self.kind:
            raise ValueError(f"it holds a {xml.kind}; give it the extension {_EXTENSIONS[xml.kind]}")
        mesh, file = _parse(xml)
        names = each_once(partial(in_xml, form="vtu")(data))
        text = all(a.tag.get("format", "ascii") == "ascii" for a in xml.arrays if a.section == "Points")
        return Document(mesh, self.name, binary=not text, rest=file, skipped=names)

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        if like is not None and same_rows:
            path.write_bytes(like.rest.patched(like.mesh, mesh))
        else:
            style = Style(self.kind) if like is None else replace(Style.of(like.rest.xml), kind=self.kind)
            path.write_bytes(new_file(mesh, style))

    def left_behind(self, document: Document, target: Format, same_rows: bool) -> list[str]:
        return [] if target is self and same_rows else list(document.skipped)


_EXTENSIONS = {"UnstructuredGrid": ".vtu", "PolyData": ".vtp"}

VTU = VtkXmlFormat("vtu", (".vtu",), cell_sets=True, point_sets=True, set_arrays=True, field_data=True,
                   kind="UnstructuredGrid")  # fmt: skip
VTP = VtkXmlFormat("vtp", (".vtp",), tuple(c for c in ALL_CELLS if c != "higher"), cell_sets=True, point_sets=True,
                   set_arrays=True, field_data=True, kind="PolyData")  # fmt: skip


def _parse(xml: VtkXml) -> tuple[meshio.Mesh, VtkFile]:
    """The mesh of all pieces, one behind another.  Raises ValueError."""
    points: list[np.ndarray] = []
    cells: list[tuple[str, np.ndarray]] = []
    pieces: list[_Piece] = []
    start = 0
    for number in range(len(xml.pieces)):
        found = list(xml.of_piece("Points", number).values())
        if not found:
            raise ValueError(f"piece {number} has no points")
        table = xml.values(xml.arrays[found[0]])
        if table.ndim != 2 or table.shape[1] != 3:
            raise ValueError("its points have not 3 coordinates")
        piece = _Piece(slice(start, start + len(table)))
        for array, nodes, blocks in _cells_of(xml, number):
            shifted = [replace(block, cells=block.cells + piece.cells) for block in blocks]
            piece.sections.append((array, nodes, shifted, len(cells)))
            for block in shifted:
                piece.blocks.append((len(cells), block))
                cells.append((block.kind, block.nodes + start))
            piece.cells += _count_of(xml, number, array)
        points.append(table)
        pieces.append(piece)
        start += len(table)
    if not points:
        raise ValueError("it has no pieces")
    mesh = meshio.Mesh(np.concatenate(points), cells)
    _read_data(xml, pieces, mesh)
    for name, array in xml.of_piece("FieldData", -1).items():
        mesh.field_data[name] = xml.values(xml.arrays[array])
    return mesh, VtkFile(xml, pieces)


def _cells_of(xml: VtkXml, piece: int) -> list[tuple[int, np.ndarray, list[vtk_cells.Block]]]:
    """The arrays of nodes of a piece: the number of each, its values and its blocks."""
    found = []
    for section in ("Cells",) if xml.kind == "UnstructuredGrid" else _POLYGONS:
        arrays = xml.of_piece(section, piece)
        if not {"connectivity", "offsets"} <= set(arrays):
            continue
        nodes, ends = (_whole(xml, arrays[name]) for name in ("connectivity", "offsets"))
        offsets = np.concatenate([[0], ends])
        if section == "Cells":
            if "types" not in arrays:
                raise ValueError("it does not say of what types its cells are")
            types = _whole(xml, arrays["types"])
        else:
            one, more = _POLYGONS[section]
            types = np.where(np.diff(offsets) == (2 if section == "Lines" else 1), one, more)
        found.append((arrays["connectivity"], nodes, vtk_cells.blocks(types, offsets, nodes)))
    return found


def _count_of(xml: VtkXml, piece: int, array: int) -> int:
    """The number of cells of the section that has this array of nodes."""
    offsets = xml.of_piece(xml.arrays[array].section, piece)["offsets"]
    return len(_whole(xml, offsets))


def _whole(xml: VtkXml, array: int) -> np.ndarray:
    values = xml.values(xml.arrays[array])
    if values.dtype.kind not in "iu":
        raise ValueError(f"the array {xml.arrays[array].name!r} is not of whole numbers")
    return values.reshape(-1).astype(np.int64)


def _read_data(xml: VtkXml, pieces: list[_Piece], mesh: meshio.Mesh) -> None:
    """Gives the mesh the data at points and in cells that all its pieces have."""
    for section in ("PointData", "CellData"):
        known = [xml.of_piece(section, number) for number in range(len(pieces))]
        for name in known[0]:
            if not all(name in arrays for arrays in known):
                continue
            values = [xml.values(xml.arrays[arrays[name]]) for arrays in known]
            sizes = [p.points.stop - p.points.start if section == "PointData" else p.cells for p in pieces]
            if [len(v) for v in values] != sizes:
                raise ValueError(f"the array {name!r} has {len(values[0])} rows instead of {sizes[0]}")
            if section == "PointData":
                mesh.point_data[name] = np.concatenate(values)
            elif mesh.cells:
                rows = [v[b.cells] for v, piece in zip(values, pieces, strict=True) for _, b in piece.blocks]
                mesh.cell_data[name] = rows
