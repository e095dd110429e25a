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

from .format import Document, counted_by_type
from .text_numbers import number_lines
from .text_tables import Reader, Rows, TextFormat, TextTables, groups_by_tag, tagged, whole

ENTITY = "comsol:entity"

# The names of element types: meshio's name, the number of vertices, and which of them is each of meshio's.  COMSOL
# counts the corners of a quad by rows, and mid-side nodes by rows, too.
_KINDS: dict[str, tuple[str, int, tuple[int, ...] | None]] = {
    "vtx": ("vertex", 1, None), "edg": ("line", 2, None), "tri": ("triangle", 3, None),
    "quad": ("quad", 4, (0, 1, 3, 2)), "edg2": ("line3", 3, None), "tri2": ("triangle6", 6, (0, 1, 2, 3, 5, 4)),
    "quad2": ("quad9", 9, (0, 1, 3, 2, 4, 7, 8, 5, 6)),
}  # fmt: skip
_NAMES = {name: word for word, (name, _, _) in _KINDS.items()}
_DIMENSION = {"vertex": 0, "line": 1, "line3": 1, "triangle": 2, "quad": 2, "triangle6": 2, "quad9": 2}

# Programs that write such files by their own order of mid-side nodes have this one; see `_order_of_nodes`.
_OTHER_ORDER = (0, 1, 2, 3, 4, 5)


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
            if kind == "triangle6":
                order = _order_of_nodes(nodes, points, order)
            nodes = nodes if order is None else nodes[:, order]
            if len(nodes):
                cells.append((kind, nodes))
                tags.append(entities)
                rows.append(Rows(where, 0, order))
        mesh = meshio.Mesh(points, cells, cell_data={ENTITY: tags} if cells else None)
        edges = [(n[:, :2], t) for (kind, n), t in zip(cells, tags, strict=True) if kind in ("line", "line3")]
        sides = groups_by_tag([n for n, _ in edges], [t for _, t in edges], "boundary")
        more = [f"lines such as {reader.texts[reader.at][:60]!r}"] if reader.left else []
        selections, others = _read_selections(reader)
        for name, members in selections.items():
            found = [sides.get(f"boundary-{number}", np.zeros((0, 2), np.int64)) for number in members]
            sides[name] = np.concatenate([np.zeros((0, 2), np.int64), *found])
        tables = TextTables(lines, Rows(at, 0), rows, first + np.arange(count))
        skipped = [*(f"the selection {name!r}" for name in selections), *(more if others else [])]
        return Document(
            mesh, self.name, rest=tables, sides=sides, skipped=tuple(skipped), node_numbers=tables.labels,
            cell_numbers=counted_by_type(mesh, 0),
        )  # fmt: skip

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
            columns = _order_in(like, name) or _KINDS[word][2]
            nodes = np.concatenate([mesh.cells[i].data for i in found])
            nodes = nodes if columns is None else nodes[:, np.argsort(columns)]
            tags = np.concatenate([tagged(mesh, ENTITY, i, 1) for i in found])
            less = int(_DIMENSION[name] != 2)
            yield f"\n# Type #{number}\n\n{len(word)} {word} # type name\n\n\n"
            yield f"{nodes.shape[1]} # number of vertices per element\n{len(nodes)} # number of elements\n# Elements\n"
            yield from number_lines(nodes)
            yield f"\n{len(tags)} # number of geometric entity indices\n# Geometric entity indices\n"
            yield from number_lines(np.maximum(tags - less, 0)[:, None])


COMSOL = ComsolFormat("comsol", (".mphtxt",), tuple(_DIMENSION), point_data="none", cell_data="regions",
                      region_name=ENTITY)  # fmt: skip


def _order_of_nodes(nodes: np.ndarray, points: np.ndarray, usual: tuple[int, ...] | None) -> tuple[int, ...] | None:
    """Which columns of `tri2` elements (n, 6) are meshio's nodes.

    A node lies on one edge.  With the wrong order, nodes between two elements lie on several.  Where that tells
    nothing, as in a single element, the nodes lie nearer to the middles of their edges with the right order.
    """

    def fault(order: tuple[int, ...] | None) -> tuple[int, float]:
        rows = nodes[:, order]
        ends = np.stack([rows[:, :3], np.roll(rows[:, :3], -1, 1)], 2).reshape(-1, 2)
        middle = rows[:, 3:].reshape(-1)
        pairs = np.unique(np.column_stack([np.sort(ends, 1), middle]), axis=0)
        with np.errstate(all="ignore"):
            away = float(np.abs(points[middle] - points[ends].mean(1)).sum())
        return len(pairs), away

    if not len(nodes) or nodes.min() < 0 or nodes.max() >= len(points):
        return usual
    return min(usual, _OTHER_ORDER, key=fault)


def _order_in(like: Document | None, name: str) -> tuple[int, ...] | None:
    """The order of nodes that a file has for a type of cells; None where it has no such cells."""
    if like is None:
        return None
    rows: list[Rows] = like.rest.cells
    return next((r.order for block, r in zip(like.mesh.cells, rows, strict=True) if block.type == name), None)


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
    """A type of elements: its name, the lines of its elements, their order; as they stand, nodes and entities."""
    word = _word(reader, "the name of an element type")
    if word not in _KINDS:
        raise ValueError(f"element type {word!r} is not known; only planar elements of order 1 and 2 can be improved")
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
    tags = tags if _DIMENSION[kind] == 2 else tags + 1  # COMSOL shows these from 1, and stores them from 0
    return kind, where, order, nodes, tags


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
