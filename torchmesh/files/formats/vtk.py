"""Legacy VTK files (.vtk)."""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import meshio

from .checks import check_vtk
from .format import Document, Format
from .meshio_formats import MeshioFormat
from .skipped import in_vtk


@dataclass(frozen=True)
class VtkHead:
    """A file's version, title and field data, which meshio passes over."""

    version: str
    title: bytes
    binary: bool
    fields: bytes

    @classmethod
    def of(cls, data: bytes) -> "VtkHead":
        lines = data.split(b"\n", 3)
        if len(lines) < 4:
            raise ValueError("its header is cut short")
        between = re.search(rb"\nDATASET\s+UNSTRUCTURED_GRID\s*?\n(.*?)(?:^|\n)POINTS ", data, re.S)
        version = lines[0].split()[-1].decode(errors="replace")
        return cls(version, lines[1], lines[2].strip().upper() == b"BINARY", between[1] if between else b"")

    @property
    def has_fields(self) -> bool:
        return self.fields.startswith(b"FIELD")

    def put_into(self, path: Path) -> None:
        """Gives the title and the field data to another file."""
        version, _, mode, rest = path.read_bytes().split(b"\n", 3)
        if self.has_fields:
            begin, points = rest.split(b"\n", 1)
            rest = begin + b"\n" + self.fields + b"\n" + points
        path.write_bytes(b"\n".join([version, self.title, mode, rest]))


@dataclass(frozen=True)
class VtkFormat(MeshioFormat):
    def read(self, path: Path) -> Document:
        document = super().read(path)
        head = VtkHead.of(path.read_bytes())
        return replace(document, binary=head.binary, rest=head)

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        head = like.rest if like is not None else None
        old = head is not None and not head.version.startswith("5")
        binary = head is None or head.binary
        meshio.write(str(path), mesh, file_format="vtk42" if old else "vtk", binary=binary)
        if head is not None:
            head.put_into(path)

    def left_behind(self, document: Document, target: Format, same_rows: bool) -> list[str]:
        fields = ["the field data"] if target is not self and document.rest.has_fields else []
        return [*super().left_behind(document, target, same_rows), *fields]


VTK = VtkFormat(
    "vtk", (".vtk",), cell_sets=True, point_sets=True, set_arrays=True, check=check_vtk, skipped=in_vtk,
    cell_count=rb"\nCELL_TYPES\s+(\d+)",
)  # fmt: skip
