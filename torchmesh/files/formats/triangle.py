"""Meshes of Shewchuk's Triangle: a file of nodes, one of elements, and one of segments, beside one another.

    a.1.node     5 2 1 1          the numbers of nodes, coordinates, attributes and markers of each
                 5 1.4 0.5 7.5 0  node, x, y, attributes, marker
    a.1.ele      4 3 1            the numbers of triangles, of their nodes and attributes
                 1 1 2 5 1        triangle, nodes, attributes
    a.1.poly     0 2 0 1          no nodes of its own
                 4 1              the numbers of segments and of markers of each; then segment, nodes, marker
                 ...              holes, and attributes of regions

Each of them stands for the whole mesh.  https://www.cs.cmu.edu/~quake/triangle.html
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np

from ..fields import region_tag
from .deck import read_lines
from .format import Document, Format
from .gmsh_read import RowOf
from .text_numbers import number_lines
from .text_tables import Reader, Rows, TextTables, groups_by_tag, tagged, whole

ATTRIBUTE, MARKER = "triangle:attribute", "triangle:marker"

# Triangle numbers the mid-side nodes by the corners that they lie opposite to.
_SECOND_ORDER = (0, 1, 2, 5, 3, 4)


@dataclass
class TriangleFiles:
    """The texts of the files by their endings; the segments have no rows, as they name nodes that stay.

    columns  the names of the attributes of nodes
    """

    nodes: TextTables
    elements: TextTables
    segments: list[str] | None
    columns: list[str]


@dataclass(frozen=True)
class TriangleFormat(Format):
    """Attributes are fields, or regions where those of triangles are whole numbers; markers name segments.

    The `rest` of a document is a `TriangleFiles`.
    """

    def read(self, path: Path) -> Document:
        nodes, elements, segments = (_beside(path, ending) for ending in (".node", ".ele", ".poly"))
        for needed, what in ((nodes, "nodes"), (elements, "triangles")):
            if not needed.is_file():
                raise ValueError(f"its {what} should lie in {needed.name}, which is no file")
        node_lines = read_lines(nodes)
        node_rows, points, labels, point_data = _read_nodes(node_lines)
        row_of = RowOf(labels, "node")
        lines = read_lines(elements)
        rows, kind, faces, numbers, cell_data = _read_elements(lines, row_of)
        cells, tags = [(kind, faces)], []
        text = read_lines(segments) if segments.is_file() else None
        if text is not None:
            edges, markers = _read_segments(text, row_of)
            if len(edges):
                cells.append(("line", edges))
                tags.append(markers)
        data = {name: [values, *(np.zeros(len(t), values.dtype) for t in tags)] for name, values in cell_data.items()}
        data |= {MARKER: [np.zeros(len(faces), np.int64), *tags]} if tags else {}
        mesh = meshio.Mesh(points, cells, point_data=point_data, cell_data=data)
        no_rows = [Rows(np.zeros(0, np.int64), 0)] * len(tags)
        columns = [name for name in point_data if name != MARKER]
        node_rows.words = {3 + k: name for k, name in enumerate(columns)}
        rows.words = {1 + faces.shape[1] + k: name for k, name in enumerate(cell_data)}
        files = TriangleFiles(
            TextTables(node_lines, node_rows, [], labels),
            TextTables(lines, Rows(np.zeros(0, np.int64), 0), [rows, *no_rows], labels), text, columns,
        )  # fmt: skip
        sides = groups_by_tag([e for _, e in cells[1:]], tags, "marker")
        others = [_beside(path, ending).name for ending in (".edge", ".neigh", ".area")]
        left = tuple(name for name in others if (path.parent / name).is_file())
        return Document(
            mesh, self.name, rest=files, sides=sides, skipped=left, node_numbers=labels, cell_numbers={kind: numbers}
        )

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        files: TriangleFiles | None = like.rest if like is not None else None
        texts: dict[str, Iterator[str] | list[str]] = {}
        held = files is not None and files.nodes.holds(mesh) and files.elements.holds(mesh)
        if files is not None and like is not None and same_rows and held:
            nothing = meshio.Mesh(like.mesh.points, [], point_data=like.mesh.point_data)
            texts[".node"] = files.nodes.patched(nothing, meshio.Mesh(mesh.points, [], point_data=mesh.point_data))
            texts[".ele"] = _patched_elements(files.elements, like.mesh, mesh)
            texts |= {".poly": files.segments} if files.segments is not None else {}
        else:
            texts = _new_texts(mesh)
        for ending, text in texts.items():
            with open(_beside(path, ending), "w", encoding="utf-8", errors="surrogateescape", newline="") as stream:
                stream.writelines(text)
        if not path.exists():  # a mesh without segments, which was to be written as .poly
            path.write_text("0 2 0 1\n0 1\n0\n")

    def fit(self, mesh: meshio.Mesh) -> tuple[meshio.Mesh, set[str]]:
        """Beside what other formats do, fields lose their names, and cell data has one component."""
        fitted, lost = super().fit(mesh)
        kept = [i for i, block in enumerate(fitted.cells) if block.type in ("triangle", "triangle6", "line")]
        lost |= {f"{block.type} cells" for i, block in enumerate(fitted.cells) if i not in kept}
        if any(fitted.cells[i].type == "triangle6" for i in kept):  # one file has elements of one size
            lost |= {"triangle cells"} if any(fitted.cells[i].type == "triangle" for i in kept) else set()
            kept = [i for i in kept if fitted.cells[i].type != "triangle"]
        fitted.cells = [fitted.cells[i] for i in kept]
        fitted.cell_data = {name: [values[i] for i in kept] for name, values in fitted.cell_data.items()}
        for name in [name for name, values in fitted.cell_data.items() if any(np.ndim(v) > 1 for v in values)]:
            del fitted.cell_data[name]
            lost.add(f"cell data {name!r}")
        names = dict.fromkeys([*fitted.point_data, *fitted.cell_data])
        lost |= {f"the name {name!r}" for name in names if not name.startswith((ATTRIBUTE, MARKER))}
        return fitted, lost

    def left_behind(self, document: Document, target: Format, same_rows: bool) -> list[str]:
        if target is self and same_rows:
            return list(document.skipped)
        holes = ["holes and regions of its .poly"] if _has_holes(document.rest.segments) else []
        return [*document.skipped, *holes]


TRIANGLE = TriangleFormat(
    "triangle",
    (".node", ".ele", ".poly"),
    ("triangle", "line", "higher"),
    point_data="scalars",
    cell_data="all",
    planar=True,
)


def _beside(path: Path, ending: str) -> Path:
    """The file of the same mesh with another ending; capitals stay where the given one has them."""
    return path.with_suffix(ending.upper() if path.suffix.isupper() else ending)


def _read_nodes(lines: list[str]) -> tuple[Rows, np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Where the nodes stand, their positions, their numbers and their data."""
    reader = Reader(lines, "#")
    count, dimension, attributes, markers = _counts(reader, "the numbers of nodes, coordinates, attributes, markers", 4)
    if dimension != 2:
        raise ValueError(f"its nodes have {dimension} coordinates instead of 2")
    at, table = reader.columns(count, 3 + attributes + markers, "the nodes")
    labels = whole(table[:, 0], "the nodes")
    if len(np.unique(labels)) < len(labels):
        raise ValueError("a node has the number of another one")
    name = ATTRIBUTE if attributes == 1 else ATTRIBUTE + "_{}"
    data = {name.format(k + 1): table[:, 3 + k] for k in range(attributes)}
    if markers:
        data[MARKER] = whole(table[:, 3 + attributes], "the markers of nodes")
    return Rows(at, 1), table[:, 1:3], labels, data


def _read_elements(lines: list[str], row_of: RowOf) -> tuple[Rows, str, np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Where the triangles stand, their type, their nodes, their numbers and their data."""
    reader = Reader(lines, "#")
    count, width, attributes = _counts(reader, "the numbers of triangles, nodes, attributes", 3)
    if width not in (3, 6):
        raise ValueError(f"its triangles have {width} nodes instead of 3 or 6")
    at, table = reader.columns(count, 1 + width + attributes, "the triangles")
    nodes = row_of(whole(table[:, 1 : 1 + width], "the triangles"))
    order = _SECOND_ORDER if width == 6 else None
    name, data = ATTRIBUTE if attributes == 1 else ATTRIBUTE + "_{}", {}
    for k in range(attributes):
        values = table[:, 1 + width + k]
        integer = bool((values == np.floor(values)).all() and (np.abs(values) < 1e15).all())
        data[name.format(k + 1)] = values.astype(np.int64) if integer else values
    kind = "triangle" if width == 3 else "triangle6"
    numbers = whole(table[:, 0], "the triangles")
    return Rows(at, 1, order), kind, nodes if order is None else nodes[:, order], numbers, data


def _read_segments(lines: list[str], row_of: RowOf) -> tuple[np.ndarray, np.ndarray]:
    """The edges (K, 2) of the segments, and their markers."""
    reader = Reader(lines, "#")
    nodes, *_ = _counts(reader, "the numbers of nodes", 4)
    reader.table(nodes, 1, "the nodes")
    count, markers = _counts(reader, "the numbers of segments and markers", 2)
    _, table = reader.columns(count, 3 + (markers > 0), "the segments")
    tags = whole(table[:, 3], "the markers of segments") if markers > 0 else np.zeros(count, np.int64)
    return row_of(whole(table[:, 1:3], "the segments")), tags


def _counts(reader: Reader, what: str, count: int) -> list[int]:
    """The counts of a head, of which the last ones may be left out.  Raises ValueError."""
    words = reader.text(what).split()
    if not words or not all(word.isdigit() and len(word) < 16 for word in words[:count]):
        raise ValueError(f"{what} are no whole numbers: {' '.join(words)[:60]!r}")
    return [*(int(word) for word in words[:count]), *[0] * (count - len(words))]


def _patched_elements(tables: TextTables, before: meshio.Mesh, after: meshio.Mesh) -> list[str]:
    """The lines of the triangles; the points stand in another file."""
    flat = np.zeros((0, 2))
    data = [name for rows in tables.cells for name in rows.words.values()]
    old = meshio.Mesh(flat, before.cells, cell_data={name: before.cell_data[name] for name in data})
    new = meshio.Mesh(flat, after.cells, cell_data={name: after.cell_data[name] for name in data})
    return tables.patched(old, new)


def _new_texts(mesh: meshio.Mesh) -> dict[str, Iterator[str] | list[str]]:
    """The texts of a new mesh.  Nodes and triangles are numbered from 1."""
    names = 1 + np.arange(len(mesh.points))
    data = [values for name, values in mesh.point_data.items() if name != MARKER]
    markers = mesh.point_data.get(MARKER)
    columns = [mesh.points[:, 0], mesh.points[:, 1], *data, *([] if markers is None else [markers])]
    table = np.column_stack([names.astype(object), *(np.asarray(column).astype(object) for column in columns)])
    head = f"{len(names)} 2 {len(data)} {int(markers is not None)}\n"
    texts: dict[str, Iterator[str] | list[str]] = {".node": [head, *number_lines(table)]}
    faces = [i for i, block in enumerate(mesh.cells) if block.type != "line"]
    six = any(mesh.cells[i].type == "triangle6" for i in faces)
    fields = [values for name, values in mesh.cell_data.items() if name != MARKER]
    nodes = np.concatenate([mesh.cells[i].data for i in faces]) + 1
    nodes = nodes[:, np.argsort(_SECOND_ORDER)] if six else nodes
    values = [np.concatenate([np.asarray(field[i]).astype(object) for i in faces]) for field in fields]
    rows = np.column_stack([(1 + np.arange(len(nodes))).astype(object), nodes.astype(object), *values])
    texts[".ele"] = [f"{len(nodes)} {nodes.shape[1]} {len(fields)}\n", *number_lines(rows)]
    lines = [i for i, block in enumerate(mesh.cells) if block.type == "line"]
    if lines:
        name = MARKER if MARKER in mesh.cell_data else region_tag(mesh) or MARKER
        edges = np.concatenate([np.column_stack([mesh.cells[i].data + 1, tagged(mesh, name, i)]) for i in lines])
        table = np.column_stack([1 + np.arange(len(edges)), edges])
        texts[".poly"] = ["0 2 0 1\n", f"{len(edges)} 1\n", *number_lines(table), "0\n"]
    return texts


def _has_holes(lines: list[str] | None) -> bool:
    """Has a file of segments rows behind them?"""
    if lines is None:
        return False
    reader = Reader(lines, "#")
    nodes, *_ = _counts(reader, "the numbers of nodes", 4)
    reader.at += nodes
    count, *_ = _counts(reader, "the numbers of segments", 2)
    reader.at += count
    return any(text.split()[0] != "0" for text in reader.texts[reader.at :])
