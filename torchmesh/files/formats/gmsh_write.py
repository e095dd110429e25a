"""Writing Gmsh files, versions 2.2 and 4.1, text and binary."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from .gmsh_file import KINDS, TAGS, Elements, MshFile, Nodes, data_head, labelled
from .gmsh_read import RowOf, data_table
from .text_numbers import number_lines

# Gmsh knows fields of 1, 3 and 9 components: the columns of zeros that a field of so many components gets.
_PADDING = {2: 1, 4: 5, 5: 4, 6: 3, 7: 2, 8: 1}


def write(path: Path, mesh: meshio.Mesh, file: MshFile) -> None:
    """Writes the sections of `file` with the nodes, elements and data of `mesh`.

    Sections that are not parsed are written as they are.  Data that `mesh` still has under its name keeps its section,
    with new values where they are others; the point data `fixed` is written anew.  Data that `mesh` has besides is
    added at the end.  Data at the corners of elements goes where elements have other corners.

    file  from `gmsh_read.read`, with one block of elements for each block of `mesh.cells`, or from `gmsh_new.new_file`
    """
    starts = np.cumsum([0] + [len(b.numbers) for b in file.nodes])
    nodes = [
        replace(b, coordinates=np.column_stack([mesh.points[s : s + len(b.numbers)], b.coordinates[:, 3:]]))
        for b, s in zip(file.nodes, starts[:-1], strict=True)
    ]
    elements = [replace(b, rows=c.data) for b, c in zip(file.elements, mesh.cells, strict=True)]
    node_numbers = np.concatenate([b.numbers for b in nodes])
    old = file.version == "2.2"
    renewed = {
        "Nodes": (_nodes_22 if old else _nodes_41)(nodes, file),
        "Elements": (_elements_22 if old else _elements_41)(elements, node_numbers, file),
    }
    current = {"NodeData": mesh.point_data, "ElementData": mesh.cell_data}
    kept = {(s, label) for s, _, label in labelled(file.sections) if label} - {("NodeData", "fixed")}
    numbers = {"NodeData": node_numbers, "ElementData": np.concatenate([b.numbers for b in elements])}
    same_corners = all(np.array_equal(a.rows, b.rows) for a, b in zip(elements, file.elements, strict=True))
    with open(path, "wb") as out:
        for section, payload, label in labelled(file.sections):
            if section == "ElementNodeData" and not same_corners:
                continue
            if label and (section, label) in kept and label in current[section]:
                values = current[section][label]
                values = np.concatenate(values) if section == "ElementData" else values
                payload = _renewed(payload, RowOf(numbers[section], section), np.asarray(values), file.binary)
            if not label or ((section, label) in kept and label in current[section]):
                out.write(_section(section, renewed.get(section, payload)))
        for section, fields in current.items():
            for name, values in fields.items():
                if (section, name) not in kept and name not in TAGS:
                    table = np.concatenate(values) if section == "ElementData" else values
                    out.write(_section(section, _data(name, numbers[section], table, file.binary)))


def _section(name: str, payload: bytes) -> bytes:
    return b"$%b\n%b$End%b\n" % (name.encode(), payload, name.encode())


def _text(table: np.ndarray) -> bytes:
    """The rows as text; each number has as many digits as it needs to be read back bit for bit."""
    return "".join(number_lines(table)).encode()


def _numbered(numbers: np.ndarray, table: np.ndarray) -> np.ndarray:
    """The rows with their integers in front, as Python objects, so that integers are not written as floats."""
    return np.column_stack([numbers.astype(object), table.astype(object)])


def packed(binary: bool, *parts: tuple[Any, Any]) -> bytes:
    """Numbers, given as (values, dtype), one after another: as raw bytes, or as one line of text."""
    arrays = [np.asarray(values).astype(dtype).reshape(-1) for values, dtype in parts]
    if binary:
        return b"".join(a.tobytes() for a in arrays)
    return " ".join(repr(x) for a in arrays for x in a.tolist()).encode() + b"\n"


def _nodes_41(blocks: list[Nodes], file: MshFile) -> bytes:
    numbers, size = np.concatenate([b.numbers for b in blocks]), f"u{file.size}"
    out = [packed(file.binary, ([len(blocks), len(numbers), numbers.min(), numbers.max()], size))]
    for block in blocks:
        out.append(packed(file.binary, (block.entity, "i4"), (len(block.numbers), size)))
        if file.binary:
            out += [block.numbers.astype(size).tobytes(), block.coordinates.astype(float).tobytes()]
        else:
            out += [_text(block.numbers[:, None]), _text(block.coordinates)]
    return b"".join(out) + (b"\n" if file.binary else b"")


def _nodes_22(blocks: list[Nodes], file: MshFile) -> bytes:
    numbers, at = blocks[0].numbers, blocks[0].coordinates
    head = b"%d\n" % len(numbers)
    if not file.binary:
        return head + _text(_numbered(numbers, at))
    table = np.empty(len(numbers), [("number", np.int32), ("at", float, 3)])
    table["number"], table["at"] = numbers, at
    return head + table.tobytes() + b"\n"


def _elements_41(blocks: list[Elements], node_numbers: np.ndarray, file: MshFile) -> bytes:
    numbers, size = np.concatenate([b.numbers for b in blocks]), f"u{file.size}"
    out = [packed(file.binary, ([len(blocks), len(numbers), numbers.min(), numbers.max()], size))]
    for block in blocks:
        out.append(
            packed(file.binary, ([KINDS[block.kind][1], block.entity, block.kind], "i4"), (len(block.rows), size))
        )
        table = np.column_stack([block.numbers, node_numbers[block.rows]])
        out.append(table.astype(size).tobytes() if file.binary else _text(table))
    return b"".join(out) + (b"\n" if file.binary else b"")


def _elements_22(blocks: list[Elements], node_numbers: np.ndarray, file: MshFile) -> bytes:
    out = [b"%d\n" % sum(len(b.rows) for b in blocks)]
    for block in blocks:
        n, tags = block.tags.shape
        table = np.column_stack([block.numbers, block.tags, node_numbers[block.rows]]).astype(np.int32)
        if file.binary:
            out += [np.array([block.kind, n, tags], np.int32).tobytes(), table.tobytes()]
        else:
            kinds = np.broadcast_to(np.array([block.kind, tags]), (n, 2))
            out.append(_text(np.column_stack([table[:, :1], kinds, table[:, 1:]])))
    return b"".join(out) + (b"\n" if file.binary else b"")


def _renewed(payload: bytes, row_of: RowOf, values: np.ndarray, binary: bool) -> bytes:
    """A data section with the `values` (n, ...) of all nodes or elements; itself where they are those that it has."""
    numbers, old = data_table(payload, binary)
    new = values.reshape(len(values), -1)[row_of(numbers)].astype(float)
    new = np.pad(new, ((0, 0), (0, old.shape[1] - new.shape[1])))
    return payload if np.array_equal(old, new, equal_nan=True) else data_head(payload)[0] + _table(numbers, new, binary)


def _data(name: str, numbers: np.ndarray, values: np.ndarray, binary: bool) -> bytes:
    table = np.asarray(values, float).reshape(len(numbers), -1)
    table = np.pad(table, ((0, 0), (0, _PADDING.get(table.shape[1], 0))))
    head = f'1\n"{name}"\n1\n0.0\n3\n0\n{table.shape[1]}\n{len(table)}\n'.encode()
    return head + _table(numbers, table, binary)


def _table(numbers: np.ndarray, table: np.ndarray, binary: bool) -> bytes:
    """The rows of a data section: numbers (n,) of nodes or elements, and their values (n, c)."""
    if not binary:
        return _text(_numbered(numbers, table))
    rows = np.empty(len(table), [("number", np.int32), ("values", float, (table.shape[1],))])
    rows["number"], rows["values"] = numbers, table
    return rows.tobytes() + b"\n"
