"""Exodus files (.e, .exo, .ex2), changed in place through netCDF4.

A file is copied, and of the copy only the coordinates, the corners of triangles, the sides of side sets and the
results that are carried over are written anew.  Blocks and element sets bound regions.
https://sandialabs.github.io/seacas-docs/exodusII-new.pdf
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from ..swelling import check_netcdf
from .deck import TRIANGLES, triangles_of
from .format import LINEAR, Document, Format, numbers_by_type
from .meshio_formats import MeshioFormat
from .sides import edges_of, followed

BLOCK = "exodus:block"

# So many bytes of a name a new file has room for.
_NAME = 32

# How the components of a vector are called, by how many there are; those of others are numbered.
_AXES = {2: "xy", 3: "xyz"}

_VOLUME = {4: "tetra", 5: "pyramid", 6: "wedge", 8: "hexahedron", 10: "tetra10", 20: "hexahedron20", 27: "hexahedron27"}
_PLANAR = {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8", 9: "quad9"}
_ONE = {1: "vertex", 2: "line", 3: "line3", 4: "line4"}


@dataclass
class _Sides:
    """A side set whose sides are edges of triangles: its number, and which of its members those are.

    members   (n,) rows in the side set
    elements  (n,) rows of triangles
    sides     (n,) 0, 1 or 2
    first     the number in the file that means the first side
    """

    number: int
    members: np.ndarray
    elements: np.ndarray
    sides: np.ndarray
    first: int


@dataclass
class ExodusFile:
    """What must be known of a file to change it.

    data        the whole file
    blocks      the number of each cell block in the file
    triangles   (R,) the element number of each triangle row, counted from 0 in the file
    sides       the side sets that name edges
    nodal       the results at nodes: name to the number of the variable
    elemental   the results in elements: name to the number of the variable
    others      names for what only Exodus holds
    """

    data: bytes
    blocks: list[int]
    triangles: np.ndarray
    sides: list[_Sides] = field(default_factory=list)
    nodal: dict[str, int] = field(default_factory=dict)
    elemental: dict[str, int] = field(default_factory=dict)
    others: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class ExodusFormat(MeshioFormat):
    """Exodus files.  A new file that follows no other is written by meshio.

    A result is one number for each node.  A field of several components becomes as many results, `velocity_x` and so
    on, which is how programs name the components of a vector.
    """

    def fit(self, mesh: meshio.Mesh) -> tuple[meshio.Mesh, set[str]]:
        fitted, lost = super().fit(mesh)
        fitted.point_data = {name: values for _, parts in _scalars(mesh) for name, values in parts.items()}
        return fitted, lost

    def conversions(self, mesh: meshio.Mesh) -> list[str]:
        told = [f"{name!r} is written as {', '.join(parts)}" for name, parts in _scalars(mesh) if [name] != [*parts]]
        sets = zip(mesh.point_sets, _short(list(mesh.point_sets)), strict=True)
        return told + [f"the name {name!r} is cut to {short!r}" for name, short in sets if name != short]

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        import netCDF4

        # meshio writes one byte of each character, and fails for long names: they are put in afterwards.
        fields, sets = list(mesh.point_data), _short(list(mesh.point_sets))
        made = meshio.Mesh(
            mesh.points, mesh.cells, point_sets={str(k): rows for k, rows in enumerate(mesh.point_sets.values())},
            point_data={str(k): values for k, values in enumerate(mesh.point_data.values())},
        )  # fmt: skip
        super().write(path, made, like, same_rows)
        with netCDF4.Dataset(str(path), "r+") as data:
            for variable, names in (("name_nod_var", fields), ("ns_names", sets)):
                for k, name in enumerate(names):
                    data.variables[variable][k] = np.array([*name.encode().ljust(_NAME + 1, b"\0")], "u1").view("S1")

    def read(self, path: Path) -> Document:
        import netCDF4

        check_netcdf(path)
        with netCDF4.Dataset(str(path)) as data:
            data.set_auto_mask(False)
            mesh, file = _read_cells(data, path.read_bytes())
            sides = _read_side_sets(data, mesh, file)
            _read_sets(data, mesh, file)
            _read_results(data, mesh, file)
            by_element = [f"attributes of block {n}" for n in file.blocks if _varies(data, f"attrib{n}")]
            at_nodes = _values_of_node_sets(data)
            node_numbers = _numbers(data, ("node_num_map", "node_map"), len(mesh.points))
            cell_numbers = _cell_numbers(data, mesh, file)
        return Document(
            mesh, self.name, rest=file, sides=sides, by_element=tuple(by_element), at_nodes=at_nodes,
            node_numbers=node_numbers, cell_numbers=cell_numbers,
        )  # fmt: skip

    def patches(self, document: Document) -> bool:
        return isinstance(document.rest, ExodusFile)

    def patch(self, path: Path, mesh: meshio.Mesh, like: Document) -> None:
        import netCDF4

        file: ExodusFile = like.rest
        path.write_bytes(file.data)
        with netCDF4.Dataset(str(path), "r+") as data:
            data.set_auto_mask(False)
            _write_points(data, mesh.points)
            for number, block in zip(file.blocks, mesh.cells, strict=True):
                if block.type in TRIANGLES:
                    data.variables[f"connect{number}"][:] = block.data + 1
            before, after = triangles_of(like.mesh), triangles_of(mesh)
            for one in file.sides:
                elements, sides = followed(before, after, one.elements, one.sides)
                named, numbers = data.variables[f"elem_ss{one.number}"], data.variables[f"side_ss{one.number}"]
                for variable, values in ((named, file.triangles[elements] + 1), (numbers, sides + one.first)):
                    column = variable[:]
                    column[one.members] = values
                    variable[:] = column
            _write_results(data, mesh, like, (before != after).any(1))

    def left_behind(self, document: Document, target: Format, same_rows: bool) -> list[str]:
        if target is self or not isinstance(document.rest, ExodusFile):
            return []
        return [*document.rest.others, *(f"side set {name!r}" for name in document.sides)]


EXODUS = ExodusFormat(
    "exodus", (".e", ".exo", ".ex2"), ("vertex", *LINEAR, "higher"), cell_data="none", point_sets=True
)


def _scalars(mesh: meshio.Mesh) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
    """The point data of a mesh, and for each the results that hold it, by names that a file has room for."""
    columns: list[tuple[str, str, np.ndarray]] = []
    for name, values in mesh.point_data.items():
        values = np.asarray(values)
        values = values.astype(np.int32) if values.dtype.kind == "b" else values
        flat = values.reshape(len(values), -1) if values.ndim > 1 else values[:, None]
        axes = _AXES.get(flat.shape[1], [str(k + 1) for k in range(flat.shape[1])])
        ends = [f"_{axis}" for axis in axes] if values.ndim > 1 else [""]
        columns += [(name, end, column) for end, column in zip(ends, flat.T, strict=True)]
    short = _short([name for name, _, _ in columns], [end for _, end, _ in columns])
    for name in mesh.point_data:
        yield name, {s: values for s, (own, _, values) in zip(short, columns, strict=True) if own == name}


def _short(names: list[str], ends: list[str] | None = None) -> list[str]:
    """The names with their ends, cut to what a file has room for, no two alike."""
    found: list[str] = []
    for name, end in zip(names, ends or [""] * len(names), strict=True):
        made, count = _cut(name, end), 1
        while made in found:
            count += 1
            made = _cut(name, f"{end}_{count}")
        found.append(made)
    return found


def _cut(name: str, end: str) -> str:
    """A name without the middle of it that no file has room for; no character is cut in two."""
    raw = name.encode(errors="replace")
    return raw[: _NAME - len(end.encode())].decode(errors="ignore") + end


def _names(data: Any, variable: str, count: int, else_: str) -> list[str]:
    """The names that a variable of characters holds; `else_` and a number where it has none."""
    found = [""] * count
    if variable in data.variables:
        rows = np.asarray(data.variables[variable][:]).reshape(count, -1)
        found = [b"".join(row.tolist()).split(b"\0")[0].decode(errors="replace").strip() for row in rows]
    return [name or f"{else_}_{k + 1}" for k, name in enumerate(found)]


def _ids(data: Any, variable: str, count: int) -> list[int]:
    return [int(n) for n in data.variables[variable][:]] if variable in data.variables else list(range(1, count + 1))


def _numbers(data: Any, names: tuple[str, ...], count: int) -> np.ndarray:
    """(count,) the numbers of nodes or elements: those of the first variable that is there, else from 1 on."""
    for name in names:
        if name in data.variables and data.variables[name].size == count:
            return np.array(data.variables[name][:], np.int64)
    return np.arange(1, count + 1)


def _size(data: Any, dimension: str) -> int:
    return len(data.dimensions[dimension]) if dimension in data.dimensions else 0


def _varies(data: Any, variable: str) -> bool:
    """Differ the rows of a variable?"""
    if variable not in data.variables:
        return False
    values = np.asarray(data.variables[variable][:])
    return len(values) > 0 and bool((values != values[:1]).any())


def _read_cells(data: Any, raw: bytes) -> tuple[meshio.Mesh, ExodusFile]:
    """Points and blocks, with the ids of blocks as cell data and their names as field data."""
    variables, count = data.variables, _size(data, "num_el_blk")
    if "coord" in variables:
        points = np.array(variables["coord"][:]).T
    else:
        axes = [variables[f"coord{axis}"][:] for axis in "xyz"[: _size(data, "num_dim")] if f"coord{axis}" in variables]
        points = np.stack(axes, 1)
    cells, numbers, ids, triangles, start = [], [], [], [np.zeros(0, np.int64)], 0
    all_ids, names = _ids(data, "eb_prop1", count), _names(data, "eb_names", count, "block")
    for number in range(1, count + 1):
        size = _size(data, f"num_el_in_blk{number}")
        if f"connect{number}" in variables and size:
            rows = np.array(variables[f"connect{number}"][:], np.int64) - 1
            kind = _kind(str(getattr(variables[f"connect{number}"], "elem_type", "")), rows.shape[1])
            cells.append((kind, rows))
            numbers.append(number)
            ids.append(np.full(len(rows), all_ids[number - 1]))
            if kind in TRIANGLES:
                triangles.append(start + np.arange(len(rows)))
        start += size
    others = [f"block name {name!r}" for name in names] if "eb_names" in variables else []
    others += [
        text for key, text in (("qa_records", "QA records"), ("info_records", "info records")) if key in variables
    ]
    mesh = meshio.Mesh(points, cells, cell_data={BLOCK: ids} if cells else None)
    return mesh, ExodusFile(raw, numbers, np.concatenate(triangles), others=others)


def _kind(name: str, nodes: int) -> str:
    """meshio's name for an Exodus element type.  Raises ValueError for an unknown one."""
    name = name.upper()
    if nodes <= 2 or name.startswith(("BAR", "BEAM", "TRUSS", "EDGE", "ROD")):
        known = _ONE
    else:
        known = _PLANAR if name.startswith(("TRI", "QUAD", "SHELL", "CIRCLE")) else _VOLUME
    if nodes not in known:
        raise ValueError(f"element type {name} with {nodes} nodes is not known")
    return known[nodes]


def _read_side_sets(data: Any, mesh: meshio.Mesh, file: ExodusFile) -> dict[str, np.ndarray]:
    """The edges of each side set.  Fills `file.sides`."""
    count, found = _size(data, "num_side_sets"), {}
    total = sum(_size(data, f"num_el_in_blk{n}") for n in range(1, _size(data, "num_el_blk") + 1))
    row_of = np.full(total, -1)
    row_of[file.triangles] = np.arange(len(file.triangles))
    first = 3 if _size(data, "num_dim") == 3 else 1  # in space, sides 1 and 2 of a triangle are its two faces
    rows = triangles_of(mesh)
    for number, name in enumerate(_names(data, "ss_names", count, "side_set"), 1):
        if f"elem_ss{number}" not in data.variables:
            continue
        elements = row_of[np.asarray(data.variables[f"elem_ss{number}"][:], np.int64) - 1]
        sides = np.asarray(data.variables[f"side_ss{number}"][:], np.int64) - first
        members = np.flatnonzero((elements >= 0) & (sides >= 0) & (sides < 3))
        file.sides.append(_Sides(number, members, elements[members], sides[members], first))
        found[name] = edges_of(rows, elements[members], sides[members])
    return found


def _read_sets(data: Any, mesh: meshio.Mesh, file: ExodusFile) -> None:
    """Node sets and element sets."""
    count = _size(data, "num_node_sets")
    for number, name in enumerate(_names(data, "ns_names", count, "node_set"), 1):
        if f"node_ns{number}" in data.variables:
            mesh.point_sets[name] = np.asarray(data.variables[f"node_ns{number}"][:], np.int64) - 1
    count = _size(data, "num_elem_sets")
    starts = np.cumsum([0] + [_size(data, f"num_el_in_blk{n}") for n in range(1, _size(data, "num_el_blk") + 1)])
    for number, name in enumerate(_names(data, "els_names", count, "element_set"), 1):
        if f"elem_els{number}" in data.variables:
            members = np.asarray(data.variables[f"elem_els{number}"][:], np.int64) - 1
            own = [members[(members >= starts[n - 1]) & (members < starts[n])] - starts[n - 1] for n in file.blocks]
            mesh.cell_sets[name] = own


def _values_of_node_sets(data: Any) -> dict[str, np.ndarray]:
    """The nodes of each node set whose distribution factors or results differ from node to node."""
    found: dict[str, np.ndarray] = {}
    for number, name in enumerate(_names(data, "ns_names", _size(data, "num_node_sets"), "node_set"), 1):
        if f"node_ns{number}" not in data.variables:
            continue
        rows = np.asarray(data.variables[f"node_ns{number}"][:], np.int64) - 1
        if _varies(data, f"dist_fact_ns{number}"):
            found[f"distribution factors of node set {name!r}"] = rows
        results = [v for v in data.variables if re.fullmatch(rf"vals_nset_var\d+ns{number}", v)]
        if any(bool((np.diff(np.asarray(data.variables[v][:])) != 0).any()) for v in results):
            found[f"results of node set {name!r}"] = rows
    return found


def _read_results(data: Any, mesh: meshio.Mesh, file: ExodusFile) -> None:
    """Results of all time steps: a column a step, or one value where there is one step."""
    steps = _size(data, "time_step")
    if steps == 0:
        return
    for k, name in enumerate(_names(data, "name_nod_var", _size(data, "num_nod_var"), "nodal"), 1):
        if f"vals_nod_var{k}" in data.variables:
            mesh.point_data[name] = _columns(data.variables[f"vals_nod_var{k}"], name, len(mesh.points))
            file.nodal[name] = k
    for k, name in enumerate(_names(data, "name_elem_var", _size(data, "num_elem_var"), "elemental"), 1):
        blocks = []
        for number, block in zip(file.blocks, mesh.cells, strict=True):
            variable = data.variables.get(f"vals_elem_var{k}eb{number}")
            shape = (len(block.data),) if steps == 1 else (len(block.data), steps)
            blocks.append(np.full(shape, np.nan) if variable is None else _columns(variable, name, len(block.data)))
        mesh.cell_data[name] = blocks
        file.elemental[name] = k
    others = {"vals_glo_var": "global results", "vals_nset_var": "results of node sets", "vals_sset_var": "results of "
              "side sets", "dist_fact_ss": "distribution factors of side sets"}  # fmt: skip
    file.others += [text for start, text in others.items() if any(v.startswith(start) for v in data.variables)]
    file.others += ["the times of the steps"] if steps > 1 else []


def _cell_numbers(data: Any, mesh: meshio.Mesh, file: ExodusFile) -> dict[str, np.ndarray]:
    """The numbers of all elements by their types."""
    numbers = _numbers(data, ("elem_num_map", "elem_map"), _size(data, "num_elem"))
    sizes = [_size(data, f"num_el_in_blk{n + 1}") for n in range(max(file.blocks, default=0))]
    starts = np.cumsum([0, *sizes])
    blocks = zip(file.blocks, mesh.cells, strict=False)
    return numbers_by_type(mesh, [numbers[starts[n - 1] : starts[n - 1] + len(block.data)] for n, block in blocks])


def _columns(variable: Any, name: str, count: int) -> np.ndarray:
    """(count,) the values of the only step, or (count, steps).

    meshio writes vectors, which Exodus does not know, as (1, count, components): they are read as rows of components.
    Raises ValueError for another table.
    """
    values = np.asarray(variable[:], float)
    if values.ndim == 3 and values.shape[:2] == (1, count):
        return values[0]
    if values.ndim != 2 or values.shape[1] != count:
        shape = " by ".join(map(str, values.shape))
        raise ValueError(f"its result {name!r} is a table of {shape} numbers instead of steps by {count}")
    values = values.T
    return values[:, 0] if values.shape[1] == 1 else np.ascontiguousarray(values)


def _write_points(data: Any, points: np.ndarray) -> None:
    if "coord" in data.variables:
        variable = data.variables["coord"]
        variable[:] = np.pad(points, ((0, 0), (0, 3)))[:, : variable.shape[0]].T
        return
    for axis, values in zip("xyz", points.T, strict=False):
        if f"coord{axis}" in data.variables:
            data.variables[f"coord{axis}"][:] = values


def _write_results(data: Any, mesh: meshio.Mesh, like: Document, changed: np.ndarray) -> None:
    """Writes the results that were carried over.  Those in elements that were not are NaN in changed triangles."""
    file: ExodusFile = like.rest
    for name, k in file.nodal.items():
        if name in mesh.point_data:
            _put(data.variables[f"vals_nod_var{k}"], mesh.point_data[name])
    for name, k in file.elemental.items():
        row = 0
        for i, number in enumerate(file.blocks):
            size, variable = len(mesh.cells[i].data), data.variables.get(f"vals_elem_var{k}eb{number}")
            triangle = mesh.cells[i].type in TRIANGLES
            if variable is not None and name in mesh.cell_data:
                _put(variable, mesh.cell_data[name][i])
            elif variable is not None and triangle and changed[row : row + size].any():
                values = like.mesh.cell_data[name][i].copy()
                values[changed[row : row + size]] = np.nan
                _put(variable, values)
            row += size if triangle else 0


def _put(variable: Any, values: np.ndarray) -> None:
    values = np.asarray(values)
    variable[:] = values[None] if variable.ndim == 3 else np.atleast_2d(values.T)
