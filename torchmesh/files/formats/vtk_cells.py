"""Cells as VTK stores them: one array of nodes, the end of each cell in it, and a number for its type.

types         5        9           3      triangle, quad, line
offsets    0  3        7           9
nodes         0 1 4    1 2 5 4     0 1
"""

from dataclasses import dataclass

import meshio
import numpy as np

# VTK's number of each type: meshio's name for it.  Lagrange's and Bezier's cells are told by their number of nodes.
_VERTEX, _POLYVERTEX, _LINE, _POLYLINE, _TRIANGLE, _STRIP, _POLYGON, _QUAD = 1, 2, 3, 4, 5, 6, 7, 9
_ORDERED = {68: "line", 69: "triangle", 70: "quad", 75: "line", 76: "triangle", 77: "quad"}
_SIZES = {("line", 2): "line", ("line", 3): "line3", ("triangle", 3): "triangle", ("triangle", 6): "triangle6",
          ("quad", 4): "quad", ("quad", 8): "quad8", ("quad", 9): "quad9"}  # fmt: skip
_NAMES: dict[int, str] = dict(meshio._vtk_common.vtk_to_meshio_type)
_NUMBERS = {name: number for number, name in _NAMES.items()}


# The types of numbers that VTK's files have.
_STORABLE = {np.dtype(kind) for kind in ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8")}


@dataclass(frozen=True)
class Block:
    """Cells of one type and size that follow one another.

    kind    meshio's name of their type
    nodes   (n, k) their nodes
    cells   (n,) the row of each among the cells of the file; those of one polyline have one row
    places  (n,) where the nodes of each begin in the array of nodes; -1 for a part of a polyline
    """

    kind: str
    nodes: np.ndarray
    cells: np.ndarray
    places: np.ndarray


def blocks(types: np.ndarray, offsets: np.ndarray, nodes: np.ndarray) -> list[Block]:
    """The cells as blocks.

    types    (n,) VTK's numbers
    offsets  (n + 1,) where the nodes of each cell begin, and the end
    nodes    the nodes of all cells

    Raises ValueError for arrays that do not fit together, and for strips of triangles.
    """
    if types.ndim != 1 or offsets.shape != (len(types) + 1,):
        raise ValueError(f"it has {len(types)} types of cells and {len(offsets) - 1} cells")
    sizes = np.diff(offsets)
    if len(types) and (offsets[0] != 0 or (sizes < 0).any() or offsets[-1] > len(nodes)):
        raise ValueError("the offsets of its cells are out of order, or lead behind their nodes")
    changes = np.flatnonzero((np.diff(types) != 0) | (np.diff(sizes) != 0)) + 1
    found: list[Block] = []
    starts = [0, *changes.tolist()] if len(types) else []
    for begin, end in zip(starts, [*starts[1:], len(types)], strict=False):
        number, size, cells = int(types[begin]), int(sizes[begin]), np.arange(begin, end)
        table = nodes[offsets[begin] : offsets[end]].reshape(end - begin, size)
        places = offsets[begin:end]
        if number == _STRIP:
            raise ValueError("it has strips of triangles; make triangles of them (ParaView: Triangulate)")
        if number in (_POLYLINE, _POLYVERTEX):
            wide = 2 if number == _POLYLINE else 1
            parts = np.stack([table[:, k : size - wide + 1 + k] for k in range(wide)], 2) if size >= wide else table
            row = np.repeat(cells, max(size - wide + 1, 0))
            whole = places if size == wide else np.full(len(row), -1)
            found.append(Block("line" if wide == 2 else "vertex", parts.reshape(-1, wide), row, whole))
            continue
        found.append(Block(_name(number, size), table, cells, places))
    return [block for block in found if len(block.nodes)]


def renewed(nodes: np.ndarray, before: list[Block], after: list[meshio.CellBlock]) -> np.ndarray:
    """The array of nodes with the cells `after`, one block for each of `before`."""
    result = np.array(nodes)
    for block, new in zip(before, after, strict=True):
        whole = block.places >= 0
        result[block.places[whole, None] + np.arange(block.nodes.shape[1])] = new.data[whole]
    return result


def spread(before: list[Block], values: list[np.ndarray], old: np.ndarray) -> np.ndarray:
    """Cell data in the rows of the file: `old`, with the values of each block in its cells."""
    result = np.array(old, np.result_type(old, *values)) if values else old
    for block, own in zip(before, values, strict=True):
        result[block.cells] = own
    return result


def arrays(cells: list[meshio.CellBlock]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Types (n,), offsets (n + 1,) and nodes of new cells."""
    types = [np.full(len(b.data), number_of(b.type)) for b in cells]
    sizes = [np.full(len(b.data), b.data.shape[1]) for b in cells]
    nodes = [np.asarray(b.data, np.int64).reshape(-1) for b in cells]
    none = np.zeros(0, np.int64)
    return (
        np.concatenate([none, *types]),
        np.concatenate([[0], np.cumsum(np.concatenate([none, *sizes]))]),
        np.concatenate([none, *nodes]),
    )


def number_of(kind: str) -> int:
    """VTK's number of a type that meshio has a name for."""
    return _POLYGON if kind == "polygon" else _NUMBERS[kind]


def _name(number: int, size: int) -> str:
    """meshio's name of a type.  Raises ValueError for one that is not known, or has another number of nodes."""
    if number == _POLYGON:
        return {3: "triangle", 4: "quad"}.get(size, "polygon")
    if number in _ORDERED:
        kind = _ORDERED[number]
        if (kind, size) not in _SIZES:
            raise ValueError(f"its {kind}s have {size} nodes: their order is too high")
        return _SIZES[kind, size]
    name = _NAMES.get(number, "")
    if not name:
        raise ValueError(f"cells of the type {number} of VTK are not known")
    return name


def storable(values: np.ndarray) -> np.ndarray:
    """The array in the machine's byte order and in a type that VTK's files have."""
    if values.dtype.kind == "b":
        return values.astype(np.int8)
    native = values.dtype.newbyteorder("=")
    return values.astype(native if native in _STORABLE else np.float64)
