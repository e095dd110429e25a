"""XDMF files (.xdmf): single meshes with tags of cells and facets here, time series in `files.time_series`."""

import contextlib
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import meshio
import numpy as np

from ..swelling import check_hdf5
from .format import ALL_BUT_POLYGONS, Document, Format
from .skipped import each_once, in_xml
from .xdmf_grids import read_grids
from .xdmf_text import XdmfText

# What grids of new files are called, by the cells that they have.
_TITLES = {"triangle": "mesh", "line": "lines", "vertex": "vertices"}

_INCLUDES = "https://www.w3.org/2001/XInclude"


def _has_series(data: bytes) -> bool:
    return re.search(rb"CollectionType\s*=\s*[\"']Temporal", data) is not None


@dataclass(frozen=True)
class XdmfFormat(Format):
    """The `rest` of a document is an `XdmfGrids`, or None where meshio reads an older version."""

    def read(self, path: Path) -> Document:
        data = path.read_bytes()
        if _has_series(data):
            raise ValueError("it is a time series: read it by read_series")
        check_data_files(path)
        names = each_once(partial(in_xml, form="xdmf")(data))
        text = XdmfText.of(data)
        if text.root.get("Version", "3").startswith("2"):
            return Document(meshio.xdmf.read(str(path)), self.name, skipped=names)
        mesh, file, sides = read_grids(path, text)
        return Document(mesh, self.name, rest=file, sides=sides, skipped=names)

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        if like is not None and same_rows and like.rest is not None and like.rest.changeable:
            like.rest.write(path, like.mesh, mesh)
        else:
            _write_new(path, mesh, {} if like is None or like.rest is None else like.rest.titles)

    def left_behind(self, document: Document, target: Format, same_rows: bool) -> list[str]:
        if target is self and same_rows and document.rest is not None and document.rest.changeable:
            return []
        return [name for name in document.skipped if target is not self or not name.startswith("the name ")]


XDMF = XdmfFormat("xdmf", (".xdmf", ".xmf"), ALL_BUT_POLYGONS)


def _write_new(path: Path, mesh: meshio.Mesh, titles: dict[str, str]) -> None:
    """A grid of the triangles, and others of lines and vertices on the same points: FEniCSx reads no mixed cells.

    All data is text in the one file, where meshio would put it into a second file (HDF5).

    titles  the names of grids, by meshio's name of their cells
    """
    groups = [("triangle", "quad"), ("line",), ("line3",), ("vertex",)]
    known = {kind for group in groups for kind in group}
    groups[0] = (*groups[0], *(block.type for block in mesh.cells if block.type not in known))
    grids = []
    for number, kinds in enumerate(groups):
        part = _only(mesh, kinds)
        if not part.cells and number:
            continue
        part.point_data = {} if number else mesh.point_data
        write_mixed(path, part)
        grid = ET.parse(path).getroot().find("Domain/Grid")
        assert grid is not None
        grid.set("Name", titles.get(kinds[0], _TITLES.get(kinds[0], kinds[0])))
        grid.set("GridType", "Uniform")
        if number:
            geometry = grid.find("Geometry")
            assert geometry is not None
            grid.remove(geometry)
            where = "xpointer(/Xdmf/Domain/Grid[@GridType='Uniform'][1]/Geometry)"
            grid.insert(0, ET.Element(f"{{{_INCLUDES}}}include", xpointer=where))
        grids.append(grid)
    ET.register_namespace("xi", _INCLUDES)
    root = ET.Element("Xdmf", Version="3.0")
    ET.SubElement(root, "Domain").extend(grids)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def write_mixed(path: Path, mesh: meshio.Mesh) -> None:
    """One grid with all cells, as meshio writes it, and its data as text."""
    meshio.xdmf.write(str(path), mesh, data_format="XML")


def _only(mesh: meshio.Mesh, kinds: tuple[str, ...]) -> meshio.Mesh:
    """The cells of some types, those of one type in one block."""
    order = {kind: [i for i, block in enumerate(mesh.cells) if block.type == kind] for kind in dict.fromkeys(kinds)}
    order = {kind: rows for kind, rows in order.items() if rows}
    cells = [(kind, np.concatenate([mesh.cells[i].data for i in rows])) for kind, rows in order.items()]
    data = {
        name: [np.concatenate([np.asarray(values[i]) for i in rows]) for rows in order.values()]
        for name, values in mesh.cell_data.items()
    }
    return meshio.Mesh(mesh.points, cells, cell_data=data if cells else None)


def check_data_files(path: Path) -> None:
    """Raises ValueError if a file that holds data of an XDMF file is none, or swells when it is read."""
    names: dict[str, set[str]] = {"HDF": set(), "Binary": set()}
    for _, item in ET.iterparse(path):
        if item.tag == "DataItem" and item.get("Format") in names:
            names[item.get("Format", "")].add((item.text or "").strip())
    # meshio looks for HDF5 beside the XDMF file, and for binary files in the working directory.
    hdf5 = {path.resolve().parent / name.partition(":")[0] for name in names["HDF"]}
    for other in sorted(hdf5 | {Path(name) for name in names["Binary"]}):
        if not other.is_file():
            raise ValueError(f"its data should lie in {other.name}, which is no file")
    for other in hdf5:
        check_hdf5(other)


def is_series(path: Path) -> bool:
    """Does the file hold a time series, as `time_series` reads it?  A file that cannot be read does not."""
    if path.suffix.lower() in XDMF.extensions:
        with contextlib.suppress(OSError):
            return _has_series(path.read_bytes())
    return False
