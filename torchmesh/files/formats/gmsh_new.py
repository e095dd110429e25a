"""A new Gmsh file for any mesh, versions 2.2 and 4.1."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field

import meshio
import numpy as np

from .gmsh_file import KINDS, NUMBERS, TAGS, Elements, MshFile, Nodes
from .gmsh_read import entity_groups
from .gmsh_write import packed


def new_file(mesh: meshio.Mesh, version: str, binary: bool, like: MshFile | None) -> tuple[meshio.Mesh, MshFile]:
    """The file, and the mesh with one cell block for each block of elements, in the order they were in.

    Elements that agree in dimension, elementary tag and physical tag make an entity.  An entity has further physical
    groups where it has them in `like`.  All nodes are in one block of the first entity of the highest dimension.
    """
    entities = _Entities()
    blocks, cell_data = _blocks(mesh, version, entities)
    count = len(mesh.points)
    nodes = [Nodes((*entities.highest, 0), np.arange(1, count + 1), np.zeros((count, 3)))]
    head = f"{version} {int(binary)} 8\n".encode() + (np.int32(1).tobytes() + b"\n" if binary else b"")
    sections = [("MeshFormat", head)]
    names = _group_names(mesh, like)
    if names:
        text = "".join(f'{dim} {tag} "{name}"\n' for dim, tag, name in sorted(names))
        sections.append(("PhysicalNames", f"{len(names)}\n{text}".encode()))
    if version == "4.1":
        known = entity_groups(like) if like is not None and like.version == "4.1" else {}
        sections.append(("Entities", _entity_section(entities, known, mesh.points, binary)))
    sections += [("Nodes", b""), ("Elements", b"")]
    cells = [(KINDS[b.kind][0], b.rows) for b in blocks]
    whole = meshio.Mesh(mesh.points, cells, point_data=mesh.point_data, cell_data=cell_data)
    return whole, MshFile(version, binary, 8, sections, nodes, blocks)


@dataclass
class _Entities:
    """The entities of a file: (dimension, elementary tag, physical tag) to their number."""

    numbers: dict[tuple[int, int, int], int] = field(default_factory=dict)

    def number(self, dim: int, elementary: int, physical: int) -> int:
        """The number of an entity: its elementary tag, or the next free number where another one has that."""
        key = (dim, elementary, physical)
        if key not in self.numbers:
            taken = {number for (d, _, _), number in self.numbers.items() if d == dim}
            wanted = max(elementary, 1)
            self.numbers[key] = wanted if wanted not in taken else max(taken) + 1
        return self.numbers[key]

    @property
    def highest(self) -> tuple[int, int]:
        """Dimension and number of the first entity of the highest dimension."""
        return next((d, e) for (d, _, _), e in sorted(self.numbers.items(), key=lambda item: -item[0][0]))


def _blocks(mesh: meshio.Mesh, version: str, entities: _Entities) -> tuple[list[Elements], dict[str, list[np.ndarray]]]:
    """The blocks of elements, and the cell data of `mesh` cut as they are.  Fills `entities`.

    In version 2.2 each element has tags of its own, and a cell block stays whole.
    """
    blocks: list[Elements] = []
    cell_data: dict[str, list[np.ndarray]] = {name: [] for name in mesh.cell_data}
    first = 1
    for i, block in enumerate(mesh.cells):
        kind, dim = NUMBERS[block.type]
        n = len(block.data)
        zero = [np.zeros(n, np.int64)] * len(mesh.cells)
        physical, elementary = (mesh.cell_data.get(name, zero)[i].astype(np.int64) for name in TAGS)
        for start, end in [(0, n)] if version == "2.2" else _runs(physical, elementary):
            if start == end:
                continue
            entity = entities.number(dim, int(elementary[start]), int(physical[start]))
            tags = np.stack([physical, elementary], 1)[start:end] if version == "2.2" else np.zeros((end - start, 0))
            blocks.append(Elements(kind, entity, np.arange(first, first + end - start), tags, block.data[start:end]))
            first += end - start
            for name, values in mesh.cell_data.items():
                cell_data[name].append(values[i][start:end])
    return blocks, cell_data


def _runs(*columns: np.ndarray) -> Iterator[tuple[int, int]]:
    """Start and end of each run of rows in which no column changes."""
    changes = np.any([np.diff(column) != 0 for column in columns], 0)
    return itertools.pairwise([0, *(1 + np.flatnonzero(changes)).tolist(), len(columns[0])])


def _group_names(mesh: meshio.Mesh, like: MshFile | None) -> set[tuple[int, int, str]]:
    """Dimension, number and name of the physical groups."""
    groups = {n: v for n, v in mesh.field_data.items() if np.shape(v) == (2,) and np.asarray(v).dtype.kind in "iu"}
    names = {(int(dim), int(tag), name) for name, (tag, dim) in groups.items()}
    if like is not None:  # there one name may stand in several dimensions, which meshio's field data cannot say
        names |= {entry for entry in like.physical_names if entry[2] in groups}
    return names


def _entity_section(
    entities: _Entities, known: dict[tuple[int, int], list[int]], points: np.ndarray, binary: bool
) -> bytes:
    """The content of $Entities.  All entities get the bounding box of the mesh; none says what bounds it.

    known  the physical groups of the entities of the file that this one follows
    """
    low, high = points.min(0).tolist(), points.max(0).tolist()
    out = [packed(binary, ([sum(d == dim for d, _, _ in entities.numbers) for dim in range(4)], "u8"))]
    for (dim, elementary, physical), entity in sorted(entities.numbers.items(), key=lambda item: (item[0][0], item[1])):
        groups = [physical] if physical else []
        before = known.get((dim, elementary), [])
        groups = before if before and abs(before[0]) == physical else groups
        parts = [(entity, "i4"), (low if dim == 0 else [*low, *high], "f8"), (len(groups), "u8"), (groups, "i4")]
        out.append(packed(binary, *parts, *([] if dim == 0 else [(0, "u8")])))
    return b"".join(out) + (b"\n" if binary else b"")
