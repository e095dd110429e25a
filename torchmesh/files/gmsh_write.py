"""Writing Gmsh .msh files, versions 2.2 and 4.1, text and binary: a known file renewed, or a fresh one."""

import itertools
from dataclasses import replace
from typing import Any

import meshio
import numpy as np

from .gmsh import DATA, KINDS, NUMBERS, TAGS, Elements, MshFile, Nodes, data_name, entity_groups, physical_names
from .text_numbers import number_lines


def write(path: str, mesh: meshio.Mesh, file: MshFile) -> None:
    """Writes the file's sections: nodes, elements and `fixed` from `mesh`, less the data `mesh` has not.

    `file` comes from `read`, its blocks answering to `mesh.cells` one to one, or from `fresh`.
    """
    starts = np.cumsum([0] + [len(b.numbers) for b in file.nodes])
    nodes = [
        replace(b, coordinates=np.column_stack([mesh.points[s : s + len(b.numbers)], b.coordinates[:, 3:]]))
        for b, s in zip(file.nodes, starts[:-1], strict=True)
    ]
    elements = [replace(b, rows=c.data) for b, c in zip(file.elements, mesh.cells, strict=True)]
    names = np.concatenate([b.numbers for b in nodes])
    old = file.version == "2.2"
    renewed = {
        "Nodes": (_write_nodes_22 if old else _write_nodes_41)(nodes, file),
        "Elements": (_write_elements_22 if old else _write_elements_41)(elements, names, file),
    }
    current = {"NodeData": mesh.point_data, "ElementData": mesh.cell_data}
    kept = {(s, data_name(p)) for s, p in file.sections if s in DATA} - {("NodeData", "fixed")}
    with open(path, "wb") as out:
        for section, payload in file.sections:
            key = (section, data_name(payload)) if section in DATA else None
            if key is None or (key in kept and key[1] in current[section]):
                out.write(b"$%b\n%b$End%b\n" % (section.encode(), renewed.get(section, payload), section.encode()))
        numbers = {"NodeData": names, "ElementData": np.concatenate([b.numbers for b in elements])}
        for section, fields in current.items():
            for name, values in fields.items():
                if (section, name) in kept or name in TAGS:
                    continue
                table = np.concatenate(values) if section == "ElementData" else values
                body = _write_data(name, numbers[section], table, file.binary)
                out.write(b"$%b\n%b$End%b\n" % (section.encode(), body, section.encode()))


def fresh(mesh: meshio.Mesh, version: str, binary: bool, like: MshFile | None) -> tuple[meshio.Mesh, MshFile]:
    """A new file for any mesh, and the mesh with one cell block per entity, in the order it was.

    Elements of one (dimension, elementary tag, physical tag) make an entity.  In further physical
    groups it is if it was so in `like`.
    """
    blocks: list[Elements] = []
    entities: dict[tuple[int, int, int], int] = {}
    known = entity_groups(like) if like is not None and like.version == "4.1" else {}
    groups = {n: v for n, v in mesh.field_data.items() if np.shape(v) == (2,) and np.asarray(v).dtype.kind in "iu"}
    names = {(int(dim), int(tag), name) for name, (tag, dim) in groups.items()}
    if like is not None:  # where one name may stand in several dimensions
        names |= {entry for entry in physical_names(like) if entry[2] in groups}
    split: dict[str, list[np.ndarray]] = {name: [] for name in mesh.cell_data}
    first = 1
    for i, block in enumerate(mesh.cells):
        kind, dim = NUMBERS[block.type]
        n = len(block.data)
        zero = [np.zeros(n, np.int64)] * len(mesh.cells)
        physical, elementary = (mesh.cell_data.get(name, zero)[i].astype(np.int64) for name in TAGS)
        runs = [0, *(1 + np.flatnonzero((np.diff(physical) != 0) | (np.diff(elementary) != 0))), n]
        runs = [0, n] if version == "2.2" else runs
        for start, end in itertools.pairwise(runs):
            if start == end:
                continue
            key = (dim, int(elementary[start]), int(physical[start]))
            taken = {entity for (d, _, _), entity in entities.items() if d == dim}
            wanted = max(key[1], 1)
            entity = entities.setdefault(key, wanted if wanted not in taken else max(taken) + 1)
            tags = np.stack([physical, elementary], 1)[start:end] if version == "2.2" else np.zeros((end - start, 0))
            blocks.append(Elements(kind, entity, np.arange(first, first + end - start), tags, block.data[start:end]))
            first += end - start
            for name, values in mesh.cell_data.items():
                split[name].append(values[i][start:end])
    home = next((d, e) for (d, _, _), e in sorted(entities.items(), key=lambda item: -item[0][0]))
    count = len(mesh.points)
    nodes = [Nodes((*home, 0), np.arange(1, count + 1), np.zeros((count, 3)))]
    head = f"{version} {int(binary)} 8\n".encode() + (np.int32(1).tobytes() + b"\n" if binary else b"")
    sections = [("MeshFormat", head)]
    if names:
        text = "".join(f'{dim} {tag} "{name}"\n' for dim, tag, name in sorted(names))
        sections.append(("PhysicalNames", f"{len(names)}\n{text}".encode()))
    if version == "4.1":
        box = mesh.points.min(0).tolist(), mesh.points.max(0).tolist()
        sections.append(("Entities", _write_entities(entities, known, box, binary)))
    sections += [("Nodes", b""), ("Elements", b"")]
    cells = [(KINDS[b.kind][0], b.rows) for b in blocks]
    whole = meshio.Mesh(mesh.points, cells, point_data=mesh.point_data, cell_data=split)
    return whole, MshFile(version, binary, 8, sections, nodes, blocks)


def _text(table: np.ndarray) -> bytes:
    """The rows as text, each number as short as gives it back to the bit."""
    return "".join(number_lines(table)).encode()


def _numbered(numbers: np.ndarray, table: np.ndarray) -> np.ndarray:
    """The rows with their whole numbers in front, as Python's own numbers."""
    return np.column_stack([numbers.astype(object), table.astype(object)])


def _pack(binary: bool, *parts: tuple[Any, Any]) -> bytes:
    """Numbers (values, dtype) one after another: raw, or as one line of text."""
    arrays = [np.asarray(values).astype(dtype).reshape(-1) for values, dtype in parts]
    if binary:
        return b"".join(a.tobytes() for a in arrays)
    return " ".join(repr(x) for a in arrays for x in a.tolist()).encode() + b"\n"


def _write_entities(
    entities: dict[tuple[int, int, int], int], known: dict[tuple[int, int], list[int]], box: Any, binary: bool
) -> bytes:
    out = [_pack(binary, ([sum(d == dim for d, _, _ in entities) for dim in range(4)], "u8"))]
    for (dim, elementary, physical), entity in sorted(entities.items(), key=lambda item: (item[0][0], item[1])):
        corners = box[0] if dim == 0 else [*box[0], *box[1]]
        groups = [physical] if physical else []
        before = known.get((dim, elementary), [])
        groups = before if before and abs(before[0]) == physical else groups
        parts = [(entity, "i4"), (corners, "f8"), (len(groups), "u8"), (groups, "i4")]
        out.append(_pack(binary, *parts, *([] if dim == 0 else [(0, "u8")])))
    return b"".join(out) + (b"\n" if binary else b"")


def _write_nodes_41(blocks: list[Nodes], file: MshFile) -> bytes:
    numbers, size = np.concatenate([b.numbers for b in blocks]), f"u{file.size}"
    out = [_pack(file.binary, ([len(blocks), len(numbers), numbers.min(), numbers.max()], size))]
    for block in blocks:
        out.append(_pack(file.binary, (block.entity, "i4"), (len(block.numbers), size)))
        if file.binary:
            out += [block.numbers.astype(size).tobytes(), block.coordinates.astype(float).tobytes()]
        else:
            out += [_text(block.numbers[:, None]), _text(block.coordinates)]
    return b"".join(out) + (b"\n" if file.binary else b"")


def _write_nodes_22(blocks: list[Nodes], file: MshFile) -> bytes:
    numbers, at = blocks[0].numbers, blocks[0].coordinates
    head = b"%d\n" % len(numbers)
    if not file.binary:
        return head + _text(_numbered(numbers, at))
    table = np.empty(len(numbers), [("number", np.int32), ("at", float, 3)])
    table["number"], table["at"] = numbers, at
    return head + table.tobytes() + b"\n"


def _write_elements_41(blocks: list[Elements], names: np.ndarray, file: MshFile) -> bytes:
    numbers, size = np.concatenate([b.numbers for b in blocks]), f"u{file.size}"
    out = [_pack(file.binary, ([len(blocks), len(numbers), numbers.min(), numbers.max()], size))]
    for block in blocks:
        out.append(
            _pack(file.binary, ([KINDS[block.kind][1], block.entity, block.kind], "i4"), (len(block.rows), size))
        )
        table = np.column_stack([block.numbers, names[block.rows]])
        out.append(table.astype(size).tobytes() if file.binary else _text(table))
    return b"".join(out) + (b"\n" if file.binary else b"")


def _write_elements_22(blocks: list[Elements], names: np.ndarray, file: MshFile) -> bytes:
    out = [b"%d\n" % sum(len(b.rows) for b in blocks)]
    for block in blocks:
        n, tags = block.tags.shape
        table = np.column_stack([block.numbers, block.tags, names[block.rows]]).astype(np.int32)
        if file.binary:
            out += [np.array([block.kind, n, tags], np.int32).tobytes(), table.tobytes()]
        else:
            kinds = np.broadcast_to(np.array([block.kind, tags]), (n, 2))
            out.append(_text(np.column_stack([table[:, :1], kinds, table[:, 1:]])))
    return b"".join(out) + (b"\n" if file.binary else b"")


def _write_data(name: str, numbers: np.ndarray, values: np.ndarray, binary: bool) -> bytes:
    table = np.asarray(values, float).reshape(len(numbers), -1)
    missing = {2: 1, 4: 5, 5: 4, 6: 3, 7: 2, 8: 1}.get(table.shape[1], 0)  # Gmsh knows 1, 3 and 9 components
    table = np.pad(table, ((0, 0), (0, missing)))
    head = f'1\n"{name}"\n1\n0.0\n3\n0\n{table.shape[1]}\n{len(table)}\n'.encode()
    if not binary:
        return head + _text(_numbered(numbers, table))
    packed = np.empty(len(table), [("number", np.int32), ("values", float, (table.shape[1],))])
    packed["number"], packed["values"] = numbers, table
    return head + packed.tobytes() + b"\n"
