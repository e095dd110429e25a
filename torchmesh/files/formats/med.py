"""MED files (.med), by meshio, of which two faults are mended: names of groups in UTF-8, and quads of nine nodes.

meshio takes the bytes of a name, which the file has as signed numbers, for characters, and so reads no byte above 127;
it writes a name that needs more bytes than characters cut short.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from ..swelling import check_hdf5
from .format import LINEAR, Document
from .meshio_formats import MeshioFormat
from .meshio_numbers import med_units, of_med
from .skipped import in_med

# So many bytes a name has in a file.
_WIDTH = 80

_NINE = ("quad9", "QU9")


@dataclass(frozen=True)
class MedFormat(MeshioFormat):
    """meshio's reader and writer, with names as UTF-8."""

    def parse(self, path: Path, data: bytes) -> meshio.Mesh:
        with _mended():
            return super().parse(path, data)

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        with _mended():
            super().write(path, _with_one_block_a_type(mesh), like, same_rows)


def _with_one_block_a_type(mesh: meshio.Mesh) -> meshio.Mesh:
    """The mesh with all cells of a type in one block, as the format has them."""
    blocks: dict[str, list[int]] = {}
    for i, block in enumerate(mesh.cells):
        blocks.setdefault(block.type, []).append(i)
    if len(blocks) == len(mesh.cells):
        return mesh
    cells = [(kind, np.concatenate([mesh.cells[i].data for i in rows])) for kind, rows in blocks.items()]
    data = {
        name: [np.concatenate([np.asarray(values[i]) for i in rows]) for rows in blocks.values()]
        for name, values in mesh.cell_data.items()
    }
    made = meshio.Mesh(mesh.points, cells, mesh.point_data, data, mesh.field_data)
    vars(made).update({name: value for name, value in vars(mesh).items() if name not in vars(made)})
    return made


MED = MedFormat(
    "med", (".med",), ("vertex", *LINEAR, "higher"), field_data=True, in_memory=True, check_file=check_hdf5,
    skipped_file=in_med, numbers=of_med, units=med_units,
)  # fmt: skip


@contextlib.contextmanager
def _mended() -> Iterator[None]:
    """Inside, meshio knows the names of groups in UTF-8, and quads of nine nodes."""
    module: Any = meshio.med._med
    was = module._read_families, module._write_families
    module._read_families, module._write_families = _read_names, _write_names
    module.meshio_to_med_type.setdefault(*_NINE)
    module.med_to_meshio_type.setdefault(*_NINE[::-1])
    try:
        yield
    finally:
        module._read_families, module._write_families = was


def _read_names(families: Any) -> dict[int, list[str]]:
    """The names of the groups of each family, by the numbers of the families."""
    found: dict[int, list[str]] = {}
    for family in families.values():
        rows = np.asarray(family["GRO/NOM"][()] if "GRO" in family else np.zeros((0, _WIDTH), np.int8))
        raw = (row.astype(np.int8).tobytes().split(b"\0")[0] for row in rows.reshape(-1, _WIDTH))
        found[family.attrs["NUM"]] = [_text(name).strip() for name in raw]
    return found


def _write_names(parent: Any, tags: dict[int, list[str]]) -> None:
    for number, names in tags.items():
        family = parent.create_group(f"FAM_{number}_{'_'.join(names)}")
        family.attrs.create("NUM", number)
        group = family.create_group("GRO")
        group.attrs.create("NBR", len(names))
        rows = group.create_dataset("NOM", (len(names),), dtype=f"{_WIDTH}int8")
        for row, name in enumerate(names):
            raw = name.encode("utf-8", "surrogateescape")[:_WIDTH]
            raw = raw.decode("utf-8", "ignore").encode() if len(raw) == _WIDTH else raw  # no character is cut in two
            rows[row] = np.frombuffer(raw.ljust(_WIDTH, b"\0"), np.int8)


def _text(raw: bytes) -> str:
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("latin-1")
