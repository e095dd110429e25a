"""Cells of the second order in files, taken apart into straight ones and mid-side nodes.

    file                    mesh that is improved            file
    0 1 2 | 3 4 5   ---->   0 1 2, and by edge: 3 4 5  ----> 0 1 2 | 3 4 5      in the type and order of the file

VTK, Gmsh, Exodus, Abaqus, Nastran and MED have one order of nodes: corners, then the node of each side in turn, and
then the one in the middle of a quad of nine.
"""

import copy
from dataclasses import dataclass

import meshio
import numpy as np

# The types of cells with mid-side nodes, and the type of their corners.
_CURVED = (("triangle", 6), ("quad", 8), ("quad", 9), ("line", 3))
_SECOND = {"triangle6": "triangle", "quad8": "quad", "quad9": "quad", "line3": "line"}
_CORNERS = {"triangle": 3, "quad": 4, "line": 2}


@dataclass(frozen=True)
class Kinds:
    """What straight cells were in the file.

    names    the type of each block of cells
    middles  the mid-side nodes of each block: (n, 3) of triangles, (n, 4) or (n, 5) of quads, (n, 1) of lines, (n, 0)
             of cells without
    """

    names: list[str]
    middles: list[np.ndarray]

    @property
    def curved(self) -> bool:
        """Has the file triangles or quads with mid-side nodes?"""
        return any(nodes.shape[1] > 1 for nodes in self.middles)

    def changed(self, kept: list[np.ndarray], more: list[int]) -> "Kinds":
        """Of the rows of each block that are kept, and of so many straight triangles in each of further blocks."""
        nodes = [own[rows] for own, rows in zip(self.middles, kept, strict=True)]
        return Kinds([*self.names, *["triangle"] * len(more)], nodes + [np.zeros((n, 0), np.int64) for n in more])

    def of_triangles(self, mesh: meshio.Mesh) -> np.ndarray:
        """(R, 3) the mid-side nodes of all rows of triangles, -1 where there are none."""
        rows = [np.zeros((0, 3), np.int64)]
        for block, nodes in zip(mesh.cells, self.middles, strict=True):
            if block.type == "triangle":
                rows.append(nodes if nodes.shape[1] == 3 else np.full((len(block.data), 3), -1))
        return np.concatenate(rows)

    def of_quads(self, mesh: meshio.Mesh) -> np.ndarray:
        """(S, 5) the mid-side nodes of all rows of quads, and their middles; -1 where there are none."""
        rows = [np.zeros((0, 5), np.int64)]
        for block, nodes in zip(mesh.cells, self.middles, strict=True):
            if block.type == "quad" and len(block.data):
                rows.append(np.pad(nodes, ((0, 0), (0, 5 - nodes.shape[1])), constant_values=-1))
        return np.concatenate(rows)


def straightened(mesh: meshio.Mesh) -> tuple[meshio.Mesh, Kinds]:
    """The mesh with cells of the second order as straight ones, and what they were.

    Lines of the second order stay as they are in a file without triangles or quads of it.
    """
    names, middles, cells = [], [], []
    second = any(_corner_type(b) in _CURVED[:3] for b in mesh.cells)
    for block in mesh.cells:
        kind, width = _corner_type(block)
        corners = _CORNERS.get(kind, width)
        if width != corners and not (second and (kind, width) in _CURVED):
            kind, corners = block.type, width
        names.append(block.type)
        middles.append(block.data[:, corners:] if block.data.ndim == 2 else np.zeros((len(block.data), 0), np.int64))
        data = block.data[:, :corners] if block.data.ndim == 2 else block.data
        cells.append(meshio.CellBlock(kind, np.ascontiguousarray(data)))
    made = copy.copy(mesh)
    made.cells = cells
    return made, Kinds(names, middles)


def _corner_type(block: meshio.CellBlock) -> tuple[str, int]:
    """The type of a block's corners, if its cells are of the second order, else its own; its width."""
    width = block.data.shape[1] if block.data.ndim == 2 else 0
    if block.type in _SECOND:
        return _SECOND[block.type], width
    return block.type, width
