"""VTK's XML files of unstructured grids (.vtu)."""

import base64
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import meshio
import numpy as np

from ..swelling import allowed, inflated
from .checks import check_raw_vtu
from .format import Document
from .meshio_formats import HEAD, MeshioFormat
from .skipped import in_xml


def _check(data: bytes) -> None:
    if b"</VTKFile>" not in data[-500:]:
        raise ValueError("it does not end with </VTKFile>: truncated")
    check_raw_vtu(data)


def _is_binary(data: bytes) -> bool:
    return b'format="ascii"' not in data[:HEAD]


class _Reader(meshio.vtu._vtu.VtuReader):
    """meshio's reader, which unpacks no more data than a file of this size can have."""

    def __init__(self, path: Path, most: int) -> None:
        self._left = most
        super().__init__(str(path))

    def read_compressed_binary(self, data: str, dtype: np.dtype) -> np.ndarray:
        """The array: a header of whole numbers, then blocks, in base64 each.  Raises ValueError."""
        header_type = meshio.vtu._vtu.vtu_to_numpy_type[self.header_type]
        if self.byte_order is not None:
            order: Literal["<", ">"] = "<" if self.byte_order == "LittleEndian" else ">"
            header_type, dtype = header_type.newbyteorder(order), dtype.newbyteorder(order)
        size = header_type.itemsize
        (blocks,) = np.frombuffer(base64.b64decode(data[: _characters(size)])[:size], header_type).tolist()
        end = _characters((3 + blocks) * size)
        header = np.frombuffer(base64.b64decode(data[:end]), header_type)[: 3 + blocks].tolist()
        if len(header) < 3 + blocks:
            raise ValueError("its compressed data is cut short")
        packed, parts, at = base64.b64decode(data[end:]), [], 0
        for length in header[3:]:
            part = inflated(packed[at : at + length], self.compression, self._left)
            self._left -= len(part)
            at += length
            parts.append(part)
        return np.frombuffer(b"".join(parts), dtype)


def _characters(count: int) -> int:
    """The characters of base64 that stand for so many bytes."""
    return -(-count // 3) * 4


@dataclass(frozen=True)
class VtuFormat(MeshioFormat):
    def parse(self, path: Path, data: bytes) -> meshio.Mesh:
        reader = _Reader(path, allowed(len(data)))
        return meshio.Mesh(
            reader.points, reader.cells, point_data=reader.point_data, cell_data=reader.cell_data,
            field_data=reader.field_data,
        )  # fmt: skip

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        text = like is not None and like.binary is False
        meshio.vtu.write(str(path), mesh, binary=True, compression=None if text else "zlib")
        if text or mesh.field_data:
            _finish(path, mesh.field_data, text)


VTU = VtuFormat(
    "vtu", (".vtu",), cell_sets=True, point_sets=True, set_arrays=True, field_data=True, check=_check,
    skipped=partial(in_xml, form="vtu"),
    is_binary=_is_binary,
)  # fmt: skip


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
