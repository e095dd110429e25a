"""Mid-side nodes of a file that needs a wipe: they go along with the edges that stay.

u ---m--- w    u ---n--- w        two edges that become one have one node, if both nodes are in one position
"""

from pathlib import Path

import meshio
import numpy as np

from ..errors import InvalidMeshError
from ..mesh.clean_log import CleanLog
from .curved_cells import Kinds
from .quads import sides_of

# Cells to write: their type, their vertices, and for each the file's cell, counted over all blocks.
_Blocks = list[tuple[str, np.ndarray, np.ndarray]]


def with_nodes(
    mesh: meshio.Mesh, kinds: Kinds, points: np.ndarray, blocks: _Blocks, log: CleanLog, tolerance: float, path: Path
) -> tuple[np.ndarray, _Blocks]:
    """The points and cells of a cleaned mesh with the nodes that its curved cells have in the file.

    mesh, kinds     the file's, with straight cells
    points, blocks  after `clean`, with all nodes among the points
    log             of `clean`; its rows of vertices are changed where nodes go
    tolerance       nodes no farther apart are in one position

    Raises InvalidMeshError, naming `path`, where a curved cell was divided, or two nodes of an edge lie apart.
    """
    starts = np.cumsum([0, *(len(block.data) for block in mesh.cells)])
    own = [int(starts.searchsorted(origin[0], "right")) - 1 if len(origin) else -1 for _, _, origin in blocks]
    # Every edge of curved cells, by the new rows of its ends, and the new row of its node.
    edges, nodes = [np.zeros((0, 2), np.int64)], [np.zeros(0, np.int64)]
    for k, (kind, data, origin) in zip(own, blocks, strict=True):
        if k < 0 or not kinds.middles[k].shape[1] or kind == "vertex":
            continue
        rows = origin - starts[k]
        given = log.new_vertex[mesh.cells[k].data[rows]]
        if given.shape[1] != data.shape[1] or (np.sort(given, 1) != np.sort(data, 1)).any():
            raise InvalidMeshError(
                f"{path}: a vertex hangs in the side of a {kinds.names[k]} cell, and only straight cells can be divided"
            )
        edges.append(_edges_of(given))
        sides = 1 if given.shape[1] == 2 else given.shape[1]
        nodes.append(log.new_vertex[kinds.middles[k][rows, :sides]].reshape(-1))
    every, node = np.concatenate(edges), np.concatenate(nodes)
    unique, first, edge = np.unique(every, axis=0, return_index=True, return_inverse=True)
    kept = node[first]
    apart = np.linalg.norm(points[node] - points[kept[edge.reshape(-1)]], axis=1) > tolerance
    if apart.any():
        at = int(apart.argmax())
        ends = ", ".join(str(row) for row in log.old_vertex[every[at]].tolist())
        raise InvalidMeshError(
            f"{path}: the edge between the vertices {ends} has two mid-side nodes that lie apart; clean it with "
            "elements of first order, or with a larger tolerance"
        )
    log.did(len(np.setdiff1d(node, kept)), "mid-side node that was there twice became one", "mid-side nodes that were "
            "there twice became one")  # fmt: skip
    made = []
    for k, (kind, data, origin) in zip(own, blocks, strict=True):
        width = 0 if k < 0 or kind == "vertex" else kinds.middles[k].shape[1]
        if not width:
            made.append((kind, data, origin))
            continue
        middles = kept[_rows(unique, _edges_of(data))].reshape(len(data), -1)
        if width == 5:
            middles = np.concatenate([middles, log.new_vertex[kinds.middles[k][origin - starts[k], 4:]]], 1)
        made.append((kinds.names[k], np.concatenate([data, middles], 1), origin))
    return _without_spare(kinds, points, made, log)


def _edges_of(cells: np.ndarray) -> np.ndarray:
    """The edges of each line, triangle or quad, the lower row first, in the order of their nodes."""
    return np.sort(cells, 1) if cells.shape[1] == 2 else sides_of(cells)


def _rows(edges: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The row of each of the edges `wanted` among the ascending `edges`, all with the lower end first."""
    count = int(edges.max(initial=0)) + 1
    return (edges[:, 0] * count + edges[:, 1]).searchsorted(wanted[:, 0] * count + wanted[:, 1])


def _without_spare(kinds: Kinds, points: np.ndarray, blocks: _Blocks, log: CleanLog) -> tuple[np.ndarray, _Blocks]:
    """The points without mid-side nodes that no cell has any more, and the cells by their new rows."""
    spare = np.zeros(len(points), bool)
    for nodes in kinds.middles:
        at = log.new_vertex[nodes.reshape(-1)]
        spare[at[at >= 0]] = True
    for _, data, _ in blocks:
        spare[data] = False
    row = np.where(spare, -1, np.cumsum(~spare) - 1)
    log.old_vertex = log.old_vertex[~spare]
    log.new_vertex = np.where(log.new_vertex >= 0, row[log.new_vertex], -1)
    return points[~spare], [(kind, row[data], origin) for kind, data, origin in blocks]
