"""A mesh file that needs a wipe: `clean` on its triangles and quads, and everything else along with its rows."""

from pathlib import Path

import meshio
import numpy as np

from ..errors import InvalidMeshError
from ..mesh.clean_log import NOTHING, CleanLog
from ..mesh.cleaning import clean
from .content import checked, merged_rows
from .curved_wiped import with_nodes
from .formats.format import Document


def wiped(document: Document, path: Path, tolerance: float = 0.0, sew: bool = False) -> tuple[meshio.Mesh, CleanLog]:
    """The content of a file with its triangles and quads mended, and the log of `clean`.

    path             names the file in errors
    tolerance, sew   as those of `clean`

    Point data keeps the rows of the vertices that stay, cell data those of the cells; the parts of a divided cell have
    the data of the whole.  Other cells stay where their vertices do; those that lost a corner go.  Of two mid-side
    nodes of one edge, in one position, the first stays.  Raises InvalidMeshError as `clean` does, and for cells that
    cannot be dealt with.
    """
    mesh, kinds = checked(document.mesh, path)
    triangles = (b.data for b in mesh.cells if b.type == "triangle")
    rows = np.concatenate([np.zeros((0, 3), np.int64), *triangles]).astype(np.int64)
    first = triangle = np.arange(len(rows))
    if document.repeats_triangles:
        first, triangle = merged_rows(rows)
    quads = np.concatenate([np.zeros((0, 4), np.int64), *(b.data for b in mesh.cells if b.type == "quad")])
    others = np.zeros(len(mesh.points), bool)
    for block, nodes in zip(mesh.cells, kinds.middles, strict=True):
        others[nodes] = True
        if block.type not in ("triangle", "quad"):
            others[block.data] = True
    try:
        points, faces, kept, log = clean(mesh.points, rows[first], quads, tolerance, sew=sew, keep=others)
    except InvalidMeshError as error:
        raise InvalidMeshError(f"{path}: {error}") from None
    blocks = _blocks(mesh, log, faces, kept, first, triangle)
    _note_lost(mesh, blocks, log)
    if kinds.curved:
        points, blocks = with_nodes(mesh, kinds, points, blocks, log, tolerance, path)
    result = meshio.Mesh(points, [meshio.CellBlock(kind, data) for kind, data, _ in blocks])
    ends = np.cumsum([0] + [len(b.data) for b in mesh.cells])
    for name, values in mesh.cell_data.items():
        result.cell_data[name] = [np.concatenate(values)[origin] for _, _, origin in blocks]
    for name, members in mesh.cell_sets.items():
        member = np.zeros(ends[-1], bool)
        for start, of in zip(ends[:-1], members, strict=True):
            member[start + of] = True
        result.cell_sets[name] = [np.flatnonzero(member[origin]) for _, _, origin in blocks]
    result.point_data = {name: values[log.old_vertex] for name, values in mesh.point_data.items()}
    for name, members in mesh.point_sets.items():
        at = log.new_vertex[np.asarray(members, np.int64).reshape(-1)]
        result.point_sets[name] = np.unique(at[at >= 0])
    result.field_data, result.info = mesh.field_data, mesh.info
    # meshio's readers put attributes on a mesh that its type does not declare, such as the families of MED.
    vars(result).update({name: value for name, value in vars(mesh).items() if name not in vars(result)})
    return result, log


def _blocks(
    mesh: meshio.Mesh, log: CleanLog, faces: np.ndarray, quads: np.ndarray, first: np.ndarray, triangle: np.ndarray
) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Cells to write: their type, their vertices, and for each the file's cell, counted over all blocks.

    faces, quads     those that are left, by the log's rows
    first, triangle  the first row (T,) of each triangle, and the triangle (R,) of each row of the file
    """
    # The triangles that came of each given one, as runs: those of quads follow those of triangles.
    given = len(first) + sum(len(b.data) for b in mesh.cells if b.type == "quad")
    order = log.old_triangle.argsort(kind="stable")
    count = np.bincount(log.old_triangle, minlength=given)
    start = np.cumsum(count) - count
    quad_row = np.full(given - len(first), -1)
    quad_row[log.old_quad] = np.arange(len(log.old_quad))
    blocks: list[tuple[str, np.ndarray, np.ndarray]] = []
    row = quad = cell = 0
    for block in mesh.cells:
        here = cell + np.arange(len(block.data))
        if block.type == "triangle":
            of = triangle[row : row + len(here)]
            blocks.append(("triangle", *_parts(faces, order, start, count, of, here)))
            row += len(here)
        elif block.type == "quad":
            at = quad_row[quad : quad + len(here)]
            blocks.append(("quad", quads[at[at >= 0]], here[at >= 0]))
            of = len(first) + np.arange(quad, quad + len(here))
            divided = _parts(faces, order, start, count, of, here)
            blocks += [("triangle", *divided)] if len(divided[0]) else []
            quad += len(here)
        else:
            data = log.new_vertex[block.data]
            stays = (data >= 0).all(1)
            for k in range(1, data.shape[1]):
                stays &= (data[:, k:] != data[:, :-k]).all(1)
            blocks.append((block.type, data[stays], here[stays]))
        cell += len(here)
    return blocks


def _parts(
    faces: np.ndarray, order: np.ndarray, start: np.ndarray, count: np.ndarray, of: np.ndarray, cells: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The triangles (N, 3) that came of the given ones `of` (M,), and for each the file's cell, of `cells` (M,)."""
    times = count[of]
    behind = np.arange(times.sum()) - np.repeat(np.cumsum(times) - times, times)
    return faces[order[np.repeat(start[of], times) + behind]], np.repeat(cells, times)


def _note_lost(mesh: meshio.Mesh, blocks: list[tuple[str, np.ndarray, np.ndarray]], log: CleanLog) -> None:
    """Notes the cells other than triangles and quads that are gone."""
    components = log.lines.pop()
    changed = log.changed
    for kind in sorted({b.type for b in mesh.cells} - {"triangle", "quad"}):
        before = sum(len(b.data) for b in mesh.cells if b.type == kind)
        after = sum(len(data) for name, data, _ in blocks if name == kind)
        log.did(before - after, f"{kind} cell without length or corner was removed", f"{kind} cells were removed")
    if log.changed and not changed:
        log.lines.remove(NOTHING)
    log.lines.append(components)
