"""COMSOL's meshes as text (.mphtxt): numbers, and strings with their length in front; # begins a comment.

    0 0 1 / 4 Mesh / 4 / 2         an object of class Mesh, its version, the dimension of space
    5 / 0                          the number of vertices, and the number of the first one
    0 0 / 1 0 ...                  coordinates
    2                              the number of element types; each of them:
    3 tri / 3 / 4 / 0 1 4 ...      its name, its number of vertices, its elements ...
    4 / 1 1 2 2                    ... and for each element the number of its geometric entity

https://doc.comsol.com (Programming Reference Manual, The COMSOL File Formats)
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np

from .format import LINEAR, Document
from .text_numbers import number_lines
from .text_tables import Reader, Rows, TextFormat, TextTables, groups_by_tag, tagged, whole

ENTITY = "comsol:entity"

# The names of element types: meshio's name, the number of vertices, and which of them is each of meshio's.  COMSOL
# counts the corners of a quad by rows.
_KINDS: dict[str, tuple[str, int, tuple[int, ...] | None]] = {
    "vtx": ("vertex", 1, None), "edg": ("line", 2, None), "tri": ("triangle", 3, None),
    "quad": ("quad", 4, (0, 1, 3, 2)),
}  # fmt: skip
_NAMES = {name: word for word, (name, _, _) in _KINDS.items()}
_DIMENSION = {"vertex": 0, "line": 1, "triangle": 2, "quad": 2}


@dataclass(frozen=True)
class ComsolFormat(TextFormat):
    """Numbers of geometric entities, as COMSOL shows them, are the cell data `comsol:entity`.

    Boundaries are called boundary-1 and so on, or by the names of selections.
    """

    def parse(self, lines: list[str], path: Path) -> Document:
        reader = Reader(lines, "#")
        version = _read_head(reader)
        (dimension,) = reader.whole("the dimension of space")
        if not 2 <= dimension <= 3:
            raise ValueError(f"its dimension is {dimension}: only planar meshes can be improved")
        (count,) = reader.whole("the number of vertices")
        (first,) = reader.whole("the number of the first vertex")
        at, points = reader.columns(count, dimension, "the vertices")
        (kinds,) = reader.whole("the number of element types")
        cells, tags, rows = [], [], []
        for _ in range(kinds):
            kind, where, order, nodes, entities = _read_type(reader, first, version < 4)
            if len(nodes):
                cells.append((kind, nodes))
                tags.append(entities)
                rows.append(Rows(where, 0, order))
        mesh = meshio.Mesh(points, cells, cell_data={ENTITY: tags} if cells else None)
        edges = [(n, t) for (kind, n), t in zip(cells, tags, strict=True) if kind == "line"]
        sides = groups_by_tag([n for n, _ in edges], [t for _, t in edges], "boundary")
        more = [f"lines such as {reader.texts[reader.at][:60]!r}"] if reader.left else []
        selections, others = _read_selections(reader)
        for name, members in selections.items():
            found = [sides.get(f"boundary-{number}", np.zeros((0, 2), np.int64)) for number in members]
            sides[name] = np.concatenate([np.zeros((0, 2), np.int64), *found])
        tables = TextTables(lines, Rows(at, 0), rows, first + np.arange(count))
        skipped = [*(f"the selection {name!r}" for name in selections), *(more if others else [])]
        return Document(mesh, self.name, rest=tables, sides=sides, skipped=tuple(skipped))

    def new_lines(self, mesh: meshio.Mesh, like: Document | None) -> Iterator[str]:
        points = np.asarray(mesh.points)
        if points.shape[1] == 3 and not points[:, 2].any():
            points = points[:, :2]
        yield "# Created by torchmesh.\n\n# Major & minor version\n0 1\n1 # number of tags\n# Tags\n5 mesh1\n"
        yield "1 # number of types\n# Types\n3 obj\n\n# --------- Object 0 ----------\n\n0 0 1\n4 Mesh # class\n"
        yield f"4 # version\n{points.shape[1]} # sdim\n{len(points)} # number of mesh vertices\n"
        yield "0 # lowest mesh vertex index\n\n# Mesh vertex coordinates\n"
        yield from number_lines(points)
        order = sorted(range(len(mesh.cells)), key=lambda i: _DIMENSION[mesh.cells[i].type])
        groups = {name: [i for i in order if mesh.cells[i].type == name] for name in _NAMES}
        groups = {name: found for name, found in groups.items() if found}
        yield f"\n{len(groups)} # number of element types\n"
        for number, (name, found) in enumerate(groups.items()):
            word = _NAMES[name]
            columns = _KINDS[word][2]
            nodes = np.concatenate([mesh.cells[i].data for i in found])
            nodes = nodes if columns is None else nodes[:, np.argsort(columns)]
            tags = np.concatenate([tagged(mesh, ENTITY, i, 1) for i in found])
            less = int(_DIMENSION[name] != 2)
            yield f"\n# Type #{number}\n\n{len(word)} {word} # type name\n\n\n"
            yield f"{nodes.shape[1]} # number of vertices per element\n{len(nodes)} # number of elements\n# Elements\n"
            yield from number_lines(nodes)
            yield f"\n{len(tags)} # number of geometric entity indices\n# Geometric entity indices\n"
            yield from number_lines(np.maximum(tags - less, 0)[:, None])


COMSOL = ComsolFormat("comsol", (".mphtxt",), ("vertex", *LINEAR), point_data="none", cell_data="regions",
                      region_name=ENTITY)  # fmt: skip


def _word(reader: Reader, what: str) -> str:
    """A string with its length in front."""
    reader.text(what)
    row = reader.lines[reader.numbers[reader.at - 1]].strip()  # the string may have a #
    length, _, word = row.partition(" ")
    if not length.isdigit():
        raise ValueError(f"{what} should be a length and a word: {row[:60]!r}")
    return word[: int(length)]


def _read_head(reader: Reader) -> int:
    """The version of the mesh, after which the dimension of space comes.  Raises ValueError for anything but a mesh."""
    reader.whole("the version", 2)
    for what in ("tags", "types"):
        (count,) = reader.whole(f"the number of {what}")
        for _ in range(min(count, reader.left + 1)):
            _word(reader, what)
    reader.whole("an object", 3)
    kind = _word(reader, "the class of the object")
    if kind != "Mesh":
        raise ValueError(f"its first object is a {kind}, not a Mesh")
    return reader.whole("the version of the mesh")[0]


def _read_type(
    reader: Reader, first: int, old: bool
) -> tuple[str, np.ndarray, tuple[int, ...] | None, np.ndarray, np.ndarray]:
    """A type of elements: its name, the lines of its elements, their order, the nodes (n, k) and entities (n,)."""
    word = _word(reader, "the name of an element type")
    if word not in _KINDS:
        raise ValueError(f"element type {word!r} is not known; only planar meshes of linear elements can be improved")
    kind, width, order = _KINDS[word]
    if reader.whole("the number of vertices of an element") != [width]:
        raise ValueError(f"its elements of type {word} have not {width} vertices")
    (count,) = reader.whole(f"the number of elements of type {word}")
    where, nodes = reader.columns(count, width, f"the elements of type {word}")
    nodes = whole(nodes, f"the elements of type {word}") - first
    if old or _says(reader, "parameter"):  # the values of parameters: their number for an element, that of all, rows
        reader.whole("the number of parameter values of an element")
        (number,) = reader.whole("the number of parameters")
        reader.table(number, 1, "the parameters")
    (number,) = reader.whole("the number of geometric entity indices")
    _, entities = reader.columns(number, 1, "the geometric entity indices")
    tags = whole(entities[:, 0], "the geometric entity indices")
    if len(tags) != count:
        raise ValueError(f"it has {count} elements of type {word} and {len(tags)} numbers of entities")
    if old or _says(reader, "pairs"):  # the domains on both sides
        (number,) = reader.whole("the number of up/down pairs")
        reader.table(number, 2, "the up/down pairs")
    tags = tags if kind in ("triangle", "quad") else tags + 1  # COMSOL shows these from 1, and stores them from 0
    return kind, where, order, nodes if order is None else nodes[:, order], tags


def _says(reader: Reader, word: str) -> bool:
    """Has the next row a comment with this word?"""
    return bool(reader.left) and word in reader.lines[reader.numbers[reader.at]].partition("#")[2]


def _read_selections(reader: Reader) -> tuple[dict[str, list[int]], bool]:
    """The boundaries, counted from 1, of the selections that have a name; and whether anything else follows."""
    found: dict[str, list[int]] = {}
    try:
        while reader.left:
            reader.whole("an object", 3)
            if _word(reader, "the class") != "Selection":
                return found, True
            reader.whole("the version")
            name = _word(reader, "the label")
            _word(reader, "the tag of the mesh")
            (dimension,) = reader.whole("the dimension")
            (count,) = reader.whole("the number of entities")
            _, table = reader.columns(count, 1, "the entities")
            if dimension == 1:
                found[name] = (whole(table[:, 0], "the entities") + 1).tolist()
    except ValueError:
        return found, True
    return found, False
