"""VTK's lists of blocks (.vtm): the blocks are files of their own, and bound regions; all are changed in place.

    <DataSet index="0" name="fluid" file="a/a_0.vtu"/>

Points of different blocks at one position are one vertex of the mesh, and stay points of each block.
"""

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path

import meshio
import numpy as np

from ..fields import REGION_TAGS
from .format import ALL_CELLS, Document, Format
from .groups import is_group
from .vtk import VTK
from .vtkhdf import VTKHDF
from .vtu import VTP, VTU

BLOCK = "vtm:block"

_READERS: dict[str, Format] = {ext: form for form in (VTU, VTP, VTK, VTKHDF) for ext in form.extensions}


@dataclass
class _Part:
    """A block.

    file      its file, as the list names it
    document  what is in it
    vertices  (n,) the vertex of each of its points
    cells     its blocks of cells among those of the mesh
    """

    file: str
    document: Document
    vertices: np.ndarray
    cells: slice


@dataclass
class VtkBlocks:
    """The text of a list, and its blocks."""

    text: str
    parts: list[_Part] = field(default_factory=list)


@dataclass(frozen=True)
class VtmFormat(Format):
    """The `rest` of a document is a `VtkBlocks`."""

    def read(self, path: Path) -> Document:
        text = path.read_bytes().decode("utf-8", errors="surrogateescape")
        file = VtkBlocks(text)
        try:
            root = ET.fromstring(text.encode("utf-8", errors="surrogateescape"))
        except ET.ParseError as error:
            raise ValueError(f"it is no XML: {error}") from None
        found = [(element.get("file", ""), element.get("name") or "") for element in root.iter("DataSet")]
        found = [(name, title) for name, title in found if name]
        if root.get("type") != "vtkMultiBlockDataSet" or not found:
            raise ValueError("it is no list of blocks, or lists none")
        points = np.zeros((0, 3))
        cells: list[tuple[str, np.ndarray]] = []
        for name, _ in found:
            document = _read_part(path, name)
            given = np.pad(document.mesh.points, ((0, 0), (0, 3 - document.mesh.points.shape[1])))
            vertices, points = _joined(points, given)
            rows = slice(len(cells), len(cells) + len(document.mesh.cells))
            cells += [(block.type, vertices[block.data]) for block in document.mesh.cells]
            file.parts.append(_Part(name, document, vertices, rows))
        mesh = meshio.Mesh(points, cells)
        at_nodes, by_element = _give_data(mesh, file.parts)
        _name_blocks(mesh, file.parts, [title for _, title in found])
        skipped = tuple(dict.fromkeys(name for part in file.parts for name in part.document.skipped))
        return Document(mesh, self.name, rest=file, at_nodes=at_nodes, by_element=by_element, skipped=skipped)

    def patches(self, document: Document) -> bool:
        return True

    def patch(self, path: Path, mesh: meshio.Mesh, like: Document) -> None:
        file: VtkBlocks = like.rest
        names = {}
        for number, part in enumerate(file.parts):
            suffix = Path(part.file).suffix
            names[part.file] = f"{path.stem}_{number}{suffix}"
            _write_part(path.with_name(names[part.file]), part, like.mesh, mesh)
        text = re.sub(
            r"(\bfile\s*=\s*[\"'])([^\"']*)", lambda m: m[1] + names.get(m[2], m[2]), file.text
        )  # fmt: skip
        path.write_bytes(text.encode("utf-8", errors="surrogateescape"))

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        """A list of one block."""
        name = f"{path.stem}_0.vtu"
        VTU.write(path.with_name(name), mesh, None, False)
        path.write_text(
            '<?xml version="1.0"?>\n<VTKFile type="vtkMultiBlockDataSet" version="1.0" byte_order="LittleEndian">\n'
            f'<vtkMultiBlockDataSet>\n<DataSet index="0" file="{name}"/>\n</vtkMultiBlockDataSet>\n</VTKFile>\n'
        )

    def left_behind(self, document: Document, target: Format, same_rows: bool) -> list[str]:
        return [] if target is self else list(document.skipped)


VTM = VtmFormat("vtm", (".vtm",), ALL_CELLS, cell_sets=True, point_sets=True, set_arrays=True, field_data=True)


def parts_of(path: Path) -> list[Path]:
    """The files of the blocks of a list; none of a file that cannot be read."""
    try:
        text = path.read_bytes().decode("utf-8", errors="surrogateescape")
    except OSError:
        return []
    return [path.parent / name for name in re.findall(r"<DataSet\b[^>]*\bfile\s*=\s*[\"']([^\"']+)", text)]


def _read_part(path: Path, name: str) -> Document:
    """The block in a file beside a list.  Raises ValueError, naming the file."""
    part = path.parent / name
    form = _READERS.get(part.suffix.lower())
    if form is None:
        raise ValueError(f"its block {name} is in a format of its own; blocks are .vtu, .vtp, .vtk or .vtkhdf")
    if not part.is_file():
        raise ValueError(f"its block should lie in {name}, which is no file")
    try:
        return form.read(part)
    except ValueError as error:
        raise ValueError(f"its block {name}: {error}") from None


def _joined(known: np.ndarray, given: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The vertices (n,) of the points of a block, and all positions; those of earlier blocks are taken up again."""
    if not len(known):
        return np.arange(len(given)), given
    both = np.concatenate([known, given])
    _, first, place = np.unique(both, axis=0, return_index=True, return_inverse=True)
    vertices = first[place.reshape(-1)[len(known) :]]
    new = vertices >= len(known)
    vertices[new] = len(known) + np.arange(int(new.sum()))
    return vertices, np.concatenate([known, given[new]])


def _give_data(mesh: meshio.Mesh, parts: list[_Part]) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Gives the mesh the data that all blocks have; returns the points and names of what only some of them have."""
    everywhere = [
        set.intersection(*(set(data) for data in found))
        for found in ([p.document.mesh.point_data for p in parts], [p.document.mesh.cell_data for p in parts])
    ]
    for name in parts[0].document.mesh.point_data:
        if name in everywhere[0]:
            values = [np.asarray(part.document.mesh.point_data[name]) for part in parts]
            whole = np.zeros((len(mesh.points), *values[0].shape[1:]), np.result_type(*values))
            for part, own in zip(parts, values, strict=True):
                whole[part.vertices] = own
            mesh.point_data[name] = whole
    for name in parts[0].document.mesh.cell_data:
        if name in everywhere[1]:
            mesh.cell_data[name] = [v for part in parts for v in part.document.mesh.cell_data[name]]
    at_nodes: dict[str, np.ndarray] = {}
    by_element: dict[str, None] = {}
    for part in parts:
        for name in set(part.document.mesh.point_data) - everywhere[0]:
            at_nodes[f"{name} of {part.file}"] = part.vertices
        alone = set(part.document.mesh.cell_data) - everywhere[1]
        by_element |= {f"cell data {name!r} of {part.file}": None for name in sorted(alone)}
    return at_nodes, tuple(by_element)


def _name_blocks(mesh: meshio.Mesh, parts: list[_Part], titles: list[str]) -> None:
    """Gives the mesh the names of blocks, which bound regions, and the names of groups in them.

    Names of groups belong to the numbers that the blocks themselves have; names of blocks are sets then.
    """
    sizes = [len(block.data) for block in mesh.cells]
    known = [{n: tuple(v) for n, v in p.document.mesh.field_data.items() if is_group(v)} for p in parts]
    same = all(own.get(name, value) == value for names in known for name, value in names.items() for own in known)
    if any(known) and same and any(name in REGION_TAGS for name in mesh.cell_data):
        mesh.field_data = {name: np.array(value) for names in known for name, value in names.items()}
        for part, title in zip(parts, titles, strict=True):
            if title:
                rows = range(part.cells.start, part.cells.stop)
                mesh.cell_sets[title] = [np.arange(size if i in rows else 0) for i, size in enumerate(sizes)]
        return
    numbers = [number for number, part in enumerate(parts, 1) for _ in part.document.mesh.cells]
    mesh.cell_data[BLOCK] = [np.full(size, number) for size, number in zip(sizes, numbers, strict=True)]
    titles = [title or f"block-{number}" for number, title in enumerate(titles, 1)]
    mesh.field_data = {title: np.array([number, 2]) for number, title in enumerate(titles, 1)}


def _write_part(path: Path, part: _Part, before: meshio.Mesh, after: meshio.Mesh) -> None:
    """Writes a block with its points, cells and data in `after`."""
    row = np.full(len(after.points), -1)
    row[part.vertices] = np.arange(len(part.vertices))
    own = part.document.mesh
    # Two points of a block at one position are two vertices unless an earlier block has a point there.
    cells = []
    for old, block in zip(own.cells, after.cells[part.cells], strict=True):
        same = (part.vertices[old.data] == block.data).all(1)
        cells.append((block.type, np.where(same[:, None], old.data, row[block.data])))
    width = own.points.shape[1]
    mesh = meshio.Mesh(after.points[part.vertices][:, :width].astype(own.points.dtype), cells)
    mesh.point_data = {**own.point_data, **{n: v[part.vertices] for n, v in after.point_data.items()}}
    mesh.cell_data = {**own.cell_data, **{n: v[part.cells] for n, v in after.cell_data.items() if n != BLOCK}}
    for name in set(before.point_data) - set(after.point_data):
        mesh.point_data.pop(name, None)
    for name in set(before.cell_data) - set(after.cell_data):
        mesh.cell_data.pop(name, None)
    _READERS[Path(part.file).suffix.lower()].write(path, mesh, part.document, True)
