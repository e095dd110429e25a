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
from .groups import FAMILY, in_sets, names_of, numbered
from .meshio_formats import MeshioFormat
from .meshio_numbers import med_units, of_med
from .skipped import in_med

# So many bytes a name has in a file.
_WIDTH = 80

# What families of nodes are in meshio's point data, and its names of the components of fields.
POINT_FAMILY, _UNITS = "point_tags", "med:nom"

# So many bytes the name of a family has.
_FAMILY_WIDTH = 64

_NINE = ("quad9", "QU9")


@dataclass(frozen=True)
class MedFormat(MeshioFormat):
    """meshio's reader and writer, with names as UTF-8."""

    def parse(self, path: Path, data: bytes) -> meshio.Mesh:
        with _mended():
            mesh = super().parse(path, data)
        if not any(mesh.field_data.get(_UNITS, [])):
            mesh.field_data.pop(_UNITS, None)  # the components of no field have names
        for number, names in mesh.point_tags.items() if POINT_FAMILY in mesh.point_data else ():
            own = np.flatnonzero(mesh.point_data[POINT_FAMILY] == number)
            for name in names:
                mesh.point_sets[name] = np.union1d(mesh.point_sets.get(name, own), own)
        return mesh

    def fit(self, mesh: meshio.Mesh) -> tuple[meshio.Mesh, set[str]]:
        """Beside what other formats do, named groups and sets become groups of families."""
        fitted, lost = super().fit(mesh)
        lost |= _with_families(fitted)
        if _UNITS in mesh.field_data:
            fitted.field_data[_UNITS] = mesh.field_data[_UNITS]
        return fitted, lost - {f"field data {_UNITS!r}"}

    def conversions(self, mesh: meshio.Mesh) -> list[str]:
        names = [*names_of(mesh, (0, 1, 2)), *mesh.cell_sets, *mesh.point_sets]
        return [f"the name {name!r} is cut to {_cut(name)!r}" for name in names if name != _cut(name)]

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
    "med", (".med",), ("vertex", *LINEAR, "higher"), field_data=True, names_only=True, families=True, cell_sets=True,
    point_sets=True, in_memory=True, check_file=check_hdf5,
    skipped_file=in_med, numbers=of_med, units=med_units,
)  # fmt: skip


def _with_families(mesh: meshio.Mesh) -> set[str]:
    """Puts the named groups and the sets of a mesh into families; names for those that cannot be."""
    groups, lost = {**numbered(mesh), **in_sets(mesh)}, set()
    known = [name for names in getattr(mesh, "point_tags", {}).values() for name in names]
    sets = {n: np.isin(np.arange(len(mesh.points)), rows) for n, rows in mesh.point_sets.items() if n not in known}
    mesh.field_data = {name: value for name, value in mesh.field_data.items() if name not in groups}
    mesh.cell_sets, mesh.point_sets = {}, {}
    if groups and FAMILY in mesh.cell_data:
        lost |= {f"group {name!r}" for name in groups}
    elif groups:
        values, names = _families_of({name: np.concatenate(masks) for name, masks in groups.items()})
        ends = np.cumsum([len(block.data) for block in mesh.cells])[:-1]
        mesh.cell_data[FAMILY] = np.split(-values, ends)
        mesh.cell_tags = {-number: own for number, own in names.items()}  # families of cells have negative numbers
    if sets and POINT_FAMILY in mesh.point_data:
        lost |= {f"point set {name!r}" for name in sets}
    elif sets:
        mesh.point_data[POINT_FAMILY], mesh.point_tags = _families_of(sets)
    return lost


def _families_of(groups: dict[str, np.ndarray]) -> tuple[np.ndarray, dict[int, list[str]]]:
    """For each row, which (n,) bool says of the groups, the number of its family, 0 for none; the groups of each."""
    kinds, kind = np.unique(np.stack(list(groups.values()), 1), axis=0, return_inverse=True)
    numbers = np.where(kinds.any(1), np.cumsum(kinds.any(1)), 0).astype(np.int64)
    names = {
        int(number): [name for name, own in zip(groups, row, strict=True) if own]
        for number, row in zip(numbers, kinds, strict=True)
    }
    names.pop(0, None)
    return numbers[kind.reshape(-1)], names


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
        title = f"FAM_{number}_{'_'.join(names)}".replace("/", "_")  # a slash would begin a group of HDF5 in it
        title = title.encode("utf-8", "surrogateescape")[:_FAMILY_WIDTH].decode("utf-8", "ignore")
        family = parent.create_group(title)
        family.attrs.create("NUM", number)
        group = family.create_group("GRO")
        group.attrs.create("NBR", len(names))
        rows = group.create_dataset("NOM", (len(names),), dtype=f"{_WIDTH}int8")
        for row, name in enumerate(names):
            raw = _cut(name).encode("utf-8", "surrogateescape")
            rows[row] = np.frombuffer(raw.ljust(_WIDTH, b"\0"), np.int8)


def _cut(name: str) -> str:
    """A name as far as there is room for it; no character is cut in two."""
    raw = name.encode("utf-8", "surrogateescape")
    return name if len(raw) < _WIDTH else raw[:_WIDTH].decode("utf-8", "ignore")


def _text(raw: bytes) -> str:
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("latin-1")
