"""New XML files of VTK for any mesh, in the style of another one."""

from dataclasses import dataclass, field

import meshio
import numpy as np

from . import vtk_cells
from .vtk_blocks import Coding, encoded
from .vtk_xml import TYPE_NAMES, VtkXml, as_text, escaped

# Sections of cells in a file of polygons: which types they hold.
_SECTIONS = {"Verts": ("vertex",), "Lines": ("line",), "Polys": ("triangle", "quad", "polygon", "pixel")}


@dataclass(frozen=True)
class Style:
    """How a file is written.

    kind      UnstructuredGrid or PolyData
    version   of the format
    coding    how numbers are stored that are not text
    form      "ascii", "binary" (base64), "raw" or "base64" (both behind the rest)
    """

    kind: str
    version: str = "1.0"
    coding: Coding = field(default_factory=lambda: Coding(compressor="vtkZLibDataCompressor"))
    form: str = "binary"

    @classmethod
    def of(cls, xml: VtkXml) -> "Style":
        points = next((array for array in xml.arrays if array.section == "Points"), None)
        form = points.tag.get("format", "ascii") if points else "binary"
        if form == "appended":
            form = "raw" if xml.appended is not None and xml.appended[2] else "base64"
        version = xml.version if xml.coding.header == "u4" or xml.version not in ("0.1", "") else "1.0"
        return cls(xml.kind, version, xml.coding, form)


class _Writer:
    """The text of a file, and its appended data."""

    def __init__(self, style: Style) -> None:
        self.style, self.size = style, 0
        self.out: list[bytes] = []
        self.appended: list[bytes] = []

    def array(self, name: str, values: np.ndarray) -> None:
        values = vtk_cells.storable(np.asarray(values))
        kind, coding = TYPE_NAMES[values.dtype], self.style.coding
        width = f' NumberOfComponents="{values.shape[1]}"' if values.ndim > 1 else ""
        head = f'<DataArray type="{kind}" Name="{escaped(name)}"{width}'.encode()
        raw = np.ascontiguousarray(values).astype(values.dtype.newbyteorder(coding.order)).tobytes()
        if self.style.form == "ascii":
            self.out.append(head + b' format="ascii">\n' + as_text(values, True) + b"\n</DataArray>\n")
        elif self.style.form == "binary":
            self.out.append(head + b' format="binary">\n' + encoded(raw, coding, False) + b"\n</DataArray>\n")
        else:
            self.out.append(head + f' format="appended" offset="{self.size}"/>\n'.encode())
            self.appended.append(encoded(raw, coding, self.style.form == "raw"))
            self.size += len(self.appended[-1])

    def arrays(self, section: str, found: dict[str, np.ndarray]) -> None:
        self.out.append(f"<{section}>\n".encode())
        for name, values in found.items():
            self.array(name, values)
        self.out.append(f"</{section}>\n".encode())


def new_file(mesh: meshio.Mesh, style: Style) -> bytes:
    """The bytes of a file."""
    writer, coding = _Writer(style), style.coding
    order = "LittleEndian" if coding.order == "<" else "BigEndian"
    header = "" if style.version == "0.1" else f' header_type="{ {"u4": "UInt32", "u8": "UInt64"}[coding.header] }"'
    packed = f' compressor="{coding.compressor}"' if coding.compressor else ""
    writer.out.append(
        f'<?xml version="1.0"?>\n<VTKFile type="{style.kind}" version="{style.version}" byte_order="{order}"'
        f"{header}{packed}>\n<{style.kind}>\n".encode()
    )
    fields = {name: np.asarray(value) for name, value in mesh.field_data.items()}
    fields = {name: value.reshape(-1) for name, value in fields.items() if value.dtype.kind in "iufb" and value.size}
    if fields:
        writer.out.append(b"<FieldData>\n")
        for name, value in fields.items():
            before = len(writer.out)
            writer.array(name, value)
            writer.out[before] = writer.out[before].replace(
                b" format=", b' NumberOfTuples="%d" format=' % len(value), 1
            )
        writer.out.append(b"</FieldData>\n")
    groups = _groups(mesh, style.kind)
    cells = [mesh.cells[i] for _, found in groups for i in found]
    counts = f'NumberOfCells="{sum(len(b.data) for b in cells)}"'
    if style.kind == "PolyData":
        sizes = {name: sum(len(mesh.cells[i].data) for i in found) for name, found in groups}
        counts = " ".join(f'NumberOf{name}="{sizes.get(name, 0)}"' for name in ("Verts", "Lines", "Strips", "Polys"))
    writer.out.append(f'<Piece NumberOfPoints="{len(mesh.points)}" {counts}>\n'.encode())
    writer.arrays("PointData", mesh.point_data)
    order_of = [i for _, found in groups for i in found]
    data = {
        name: np.concatenate([np.asarray(v[i]) for i in order_of]) for name, v in mesh.cell_data.items() if order_of
    }
    writer.arrays("CellData", data)
    writer.arrays("Points", {"Points": np.pad(mesh.points, ((0, 0), (0, 3 - mesh.points.shape[1])))})
    for name, found in groups:
        types, offsets, nodes = vtk_cells.arrays([mesh.cells[i] for i in found])
        arrays = {"connectivity": nodes, "offsets": offsets[1:]}
        writer.arrays(name, arrays | ({"types": types.astype(np.uint8)} if name == "Cells" else {}))
    writer.out.append(f"</Piece>\n</{style.kind}>\n".encode())
    if writer.appended:
        writer.out += [
            b'<AppendedData encoding="%b">\n_' % style.form.encode(),
            *writer.appended,
            b"\n</AppendedData>\n",
        ]
    return b"".join([*writer.out, b"</VTKFile>\n"])


def _groups(mesh: meshio.Mesh, kind: str) -> list[tuple[str, list[int]]]:
    """The sections of cells, and the blocks of the mesh that each has."""
    if kind == "UnstructuredGrid":
        return [("Cells", list(range(len(mesh.cells))))]
    return [(name, [i for i, b in enumerate(mesh.cells) if b.type in types]) for name, types in _SECTIONS.items()]
