"""The quads of a mesh file: their rows, and which of their edges lie between regions.

A tag with one value on all triangles and another on all quads says no more than which is which, as the blocks of Exodus
and the sets of one `*ELEMENT` card each do: no vertex is held for that.  Gmsh and Medit give triangles and quads of one
region the same tag, so that other tags are other regions.
"""

import meshio
import numpy as np

from .fields import Regions

# Data of formats that have one tag for the elements of a region, whatever their kind.
_ACROSS_KINDS = ("gmsh:physical", "gmsh:geometrical", "medit:ref")


def quads_of(mesh: meshio.Mesh, repeats: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(R, 4) the quad rows of all blocks in file order, (Q,) the first row of each quad, and (R,) the quad of each row.

    repeats  whether the file may list an element once for each of its groups
    """
    blocks = [b.data for b in mesh.cells if b.type == "quad" and len(b.data)]
    rows = np.concatenate([np.zeros((0, 4), np.int64), *blocks])
    if not repeats or not len(rows):
        return rows, np.arange(len(rows)), np.arange(len(rows))
    _, first, quad = np.unique(np.sort(rows, 1), axis=0, return_index=True, return_inverse=True)
    order = first.argsort()
    return rows, first[order], order.argsort()[quad.reshape(-1)]


def on_quads(mesh: meshio.Mesh, values: list[np.ndarray]) -> np.ndarray:
    """The part of cell data, given block by block, that belongs to quads: (R, ...) in file order."""
    parts = [v for b, v in zip(mesh.cells, values, strict=True) if b.type == "quad" and len(b.data)]
    return np.concatenate(parts) if parts else np.asarray(values[0])[:0] if values else np.zeros(0)


def sides_of(cells: np.ndarray) -> np.ndarray:
    """(kN, 2) the edges of each triangle or quad (N, k), the lower vertex first."""
    return np.sort(np.stack([cells, np.roll(cells, -1, 1)], 2).reshape(-1, 2), 1)


def interfaces_of_quads(
    mesh: meshio.Mesh, triangles: tuple[np.ndarray, np.ndarray], quads: tuple[np.ndarray, np.ndarray], told: Regions
) -> np.ndarray:
    """(K, 2) the edges of quads that lie between regions, the lower vertex first.

    triangles, quads  the elements (N, k), and the row (N,) of the file that each is first in
    """
    if not len(quads[0]):
        return np.zeros((0, 2), np.int64)
    code = regions_of_all(mesh, triangles[1], quads[1], told)
    edges = np.concatenate([sides_of(triangles[0]), sides_of(quads[0])])
    side = np.concatenate([np.repeat(code[: len(triangles[0])], 3), np.repeat(code[len(triangles[0]) :], 4)])
    of_quad = np.arange(len(edges)) >= 3 * len(triangles[0])
    keys = edges[:, 0] * (int(edges.max()) + 1) + edges[:, 1]
    order = keys.argsort(kind="stable")
    one, two = order[:-1], order[1:]
    differ = (keys[one] == keys[two]) & (side[one] != side[two]) & (of_quad[one] | of_quad[two])
    return edges[one[differ]]


def regions_of_all(mesh: meshio.Mesh, triangles: np.ndarray, quads: np.ndarray, told: Regions) -> np.ndarray:
    """(T + Q,) the number of the region that each triangle, and then each quad, is in.

    triangles, quads  the row of the file that each is first in
    """
    from .fields import on_triangles

    columns = [(name in _ACROSS_KINDS, mesh.cell_data[name]) for name in told.data]
    for name in told.sets:
        members = [np.isin(np.arange(len(b.data)), m) for b, m in zip(mesh.cells, mesh.cell_sets[name], strict=True)]
        columns.append((False, members))
    code = np.zeros(len(triangles) + len(quads), np.int64)
    for across_kinds, column in columns:
        parts = on_triangles(mesh, column)[triangles], on_quads(mesh, column)[quads]
        if not across_kinds and all(len(np.unique(part)) < 2 for part in parts):
            continue
        values, rank = np.unique(np.concatenate(parts), return_inverse=True)
        code = np.unique(code * len(values) + rank.reshape(-1), return_inverse=True)[1].reshape(-1)
    return code


def tells_kinds_alone(mesh: meshio.Mesh, triangles: np.ndarray, quads: np.ndarray, told: Regions) -> tuple[str, ...]:
    """The names of cell data that has one value on all triangles and another on all quads: no border of regions."""
    from .fields import on_triangles

    names = []
    for name in set(told.data).difference(_ACROSS_KINDS) if len(triangles) and len(quads) else ():
        column = mesh.cell_data[name]
        one, other = np.unique(on_triangles(mesh, column)[triangles]), np.unique(on_quads(mesh, column)[quads])
        if len(one) == len(other) == 1 and one[0] != other[0]:
            names.append(name)
    return tuple(names)
