"""VTK's XML files of unstructured grids (.vtu)."""

import base64
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from .format import Document
from .meshio_formats import HEAD, MeshioFormat


def _inspect(data: bytes) -> bool:
    if b"</VTKFile>" not in data[-500:]:
        raise ValueError("it does not end with </VTKFile>: truncated")
    return b'format="ascii"' not in data[:HEAD]


@dataclass(frozen=True)
class VtuFormat(MeshioFormat):
    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        text = like is not None and like.binary is False
        meshio.vtu.write(str(path), mesh, binary=True, compression=None if text else "zlib")
        if text or mesh.field_data:
            _finish(path, mesh.field_data, text)


VTU = VtuFormat("vtu", (".vtu",), cell_sets=True, point_sets=True, set_arrays=True, field_data=True, inspect=_inspect)


def _finish(path: Path, field_data: dict[str, Any], text: bool) -> None:
    """Adds what meshio leaves out: the field data, and text with all digits (meshio writes eleven)."""
    tree = ET.parse(path)
    if text:
        header = meshio.vtu._vtu.vtu_to_numpy_type[tree.getroot().get("header_type", "UInt32")]
        for array in tree.iter("DataArray"):
            raw = base64.b64decode((array.text or "").strip())
            kind = meshio.vtu._vtu.vtu_to_numpy_type[array.get("type")]
            values = np.frombuffer(raw, kind, offset=np.dtype(header).itemsize)
            array.set("format", "ascii")
            array.text = " ".join(map(repr, values.tolist()))
    grid = tree.getroot().find("UnstructuredGrid")
    fields = ET.Element("FieldData")
    for key, value in field_data.items():
        flat = np.asarray(value)
        if flat.dtype.kind in "iuf" and flat.size:
            kind = meshio.vtu._vtu.numpy_to_vtu_type[flat.dtype]
            array = ET.SubElement(fields, "DataArray", type=kind, Name=key, format="ascii")
            array.set("NumberOfTuples", str(len(flat.reshape(-1))))
            array.text = " ".join(map(repr, flat.reshape(-1).tolist()))
    if grid is not None and len(fields):
        grid.insert(0, fields)
    tree.write(path, xml_declaration=True, encoding="utf-8")
