"""FreeFem's planar meshes (.msh), which share their extension with Gmsh's.

    5 4 4          the numbers of vertices, triangles and edges
    0 0 1          x, y, label
    1 2 5 7        three vertices, counted from 1, and the label of the region
    1 2 1          two vertices and the label of the border

https://doc.freefem.org/documentation/mesh-generation.html
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np

from .format import Document, counted_by_type
from .text_numbers import number_lines
from .text_tables import Reader, Rows, TextFormat, TextTables, groups_by_tag, tagged, whole

LABEL = "freefem:label"

_HEAD = re.compile(rb"\s*\d+[ \t]+\d+[ \t]+\d+[ \t]*\r?\n")


@dataclass(frozen=True)
class FreeFemFormat(TextFormat):
    """Labels are the cell data and point data `freefem:label`; the border with label 3 is called label-3."""

    def recognises(self, head: bytes) -> bool:
        return _HEAD.match(head) is not None

    def parse(self, lines: list[str], path: Path) -> Document:
        reader = Reader(lines)
        vertices, triangles, edges = reader.whole("the numbers of vertices, triangles and edges", 3)
        at, points = reader.columns(vertices, 3, "the vertices")
        faces_at, faces = reader.columns(triangles, 4, "the triangles")
        edges_at, borders = reader.columns(edges, 3, "the edges")
        faces, borders = whole(faces, "the triangles"), whole(borders, "the edges")
        cells = [("triangle", faces[:, :3] - 1), ("line", borders[:, :2] - 1)]
        mesh = meshio.Mesh(
            points[:, :2],
            cells,
            point_data={LABEL: whole(points[:, 2], "the labels of vertices")},
            cell_data={LABEL: [faces[:, 3], borders[:, 2]]},
        )
        tables = TextTables(lines, Rows(at, 0), [Rows(faces_at, 0), Rows(edges_at, 0)], 1 + np.arange(vertices))
        rest = [f"lines such as {reader.texts[reader.at][:60]!r}"] if reader.left else []
        sides = groups_by_tag([cells[1][1]], [borders[:, 2]], "label")
        return Document(
            mesh, self.name, rest=tables, sides=sides, skipped=tuple(rest), node_numbers=tables.labels,
            cell_numbers=counted_by_type(mesh, 1),
        )  # fmt: skip

    def new_lines(self, mesh: meshio.Mesh, like: Document | None) -> Iterator[str]:
        tables = [
            np.column_stack([block.data + 1, tagged(mesh, LABEL, i, int(block.type == "line"))])
            for i, block in enumerate(mesh.cells)
        ]
        faces = [table for table, block in zip(tables, mesh.cells, strict=True) if block.type == "triangle"]
        edges = [table for table, block in zip(tables, mesh.cells, strict=True) if block.type == "line"]
        labels = mesh.point_data.get(LABEL)
        if labels is None:  # as FreeFem does it, vertices of the border have a label of the border
            labels = np.zeros(len(mesh.points), np.int64)
            for table in edges:
                labels[table[:, :2] - 1] = table[:, 2:]
        yield f"{len(mesh.points)} {sum(map(len, faces))} {sum(map(len, edges))}\n"
        yield from number_lines(np.column_stack([mesh.points.astype(object), labels.astype(object)]))
        for table in (*faces, *edges):
            yield from number_lines(table)


# The extension .freefem is ours: it says that a new file is not to be one of Gmsh's.
FREEFEM = FreeFemFormat(
    "freefem", (".freefem", ".msh"), ("triangle", "line"), point_data="none", cell_data="regions", region_name=LABEL,
    planar=True,
)  # fmt: skip
