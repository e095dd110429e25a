"""Finds the vertices and regions of a file again in the mesh that takes its place.

What is on the left is found again on the right:

    file        mesh that takes its place
    vertex   -> vertex            by the same row, the same coordinates, or the vertex map
    region   -> triangles         that lie between the same boundary and constrained edges
    row      -> row               as long as the counts and the regions are the same
"""

from dataclasses import dataclass

import numpy as np
import torch

from ..errors import InvalidMeshError
from ..mesh import connectivity
from ..mesh.batch import MeshBatch
from ..mesh.vertex_map import VertexMap
from .source import Source


@dataclass(frozen=True)
class Correspondence:
    """How the rows of a file answer to the rows of the mesh that takes their place.

    source      the file, and the mesh that was read from it
    new_vertex  (V_old,) the row of each vertex of the file in the new mesh, -1 if it is gone
    old_vertex  (V,) the row of each vertex of the new mesh in the file, -1 if it has none
    changed     has the mesh other triangles than before
    same_rows   has every triangle the row, and the region, that it had
    faces       (T, 3) the triangles to write, wound as in the file
    example     (T,) for each triangle an old one of the same region, whose region tags it takes; None: the regions
                cannot be told
    vertex_map  gives new vertices their fields; None: it is not known
    """

    source: Source
    new_vertex: np.ndarray
    old_vertex: np.ndarray
    changed: bool
    same_rows: bool
    faces: np.ndarray
    example: np.ndarray | None
    vertex_map: VertexMap | None = None

    @classmethod
    def between(cls, mesh: MeshBatch, source: Source, vertex_map: VertexMap | None = None) -> "Correspondence":
        """Raises InvalidMeshError for a vertex map that leads from or to another number of vertices."""
        content, old = source.content, source.mesh
        before, after = old.triangles.numpy(), mesh.triangles.numpy()
        same_counts = len(after) == len(before) and len(mesh.points) == len(old.points)
        changed = not same_counts or bool((np.sort(before, 1) != np.sort(after, 1)).any())
        if vertex_map is None:
            new_vertex = _new_vertices(old, mesh, changed)
        else:
            _check_map(vertex_map, old, mesh)
            new_vertex = vertex_map.old_to_new.cpu().numpy()
        kept = np.flatnonzero(new_vertex >= 0)
        old_vertex = np.full(len(mesh.points), -1)
        old_vertex[new_vertex[kept]] = kept
        region = _new_regions(mesh, old, content.region, new_vertex) if changed else content.region
        if same_counts:
            region = np.where(region < 0, content.region, region)
        same_rows = same_counts and bool((region == content.region).all())
        faces = _as_wound(content.rows[content.first], before, after, same_counts)
        first_of_region = np.zeros(int(content.region.max(initial=-1)) + 1, np.int64)
        first_of_region[content.region] = np.arange(len(before))
        example = None if bool((region < 0).any()) else first_of_region[region]
        return cls(source, new_vertex, old_vertex, changed, same_rows, faces, example, vertex_map)


def _check_map(vertex_map: VertexMap, old: MeshBatch, mesh: MeshBatch) -> None:
    given, needed = (len(vertex_map.old_to_new), len(vertex_map.new_to_old)), (len(old.points), len(mesh.points))
    if given != needed:
        raise InvalidMeshError(
            f"vertex_map leads from {given[0]} to {given[1]} vertices, but the file has {needed[0]} and the mesh "
            f"{needed[1]}: give the map of this mesh (VertexMap.split gives those of a batch)"
        )


def _as_wound(raw: np.ndarray, before: np.ndarray, after: np.ndarray, same_counts: bool) -> np.ndarray:
    """(T, 3) the triangles `after`, wound and begun at the corner as in the file where that is possible.

    raw     the triangles of the file
    before  the same, as they were read: clockwise ones were turned
    """
    turned = bool((raw != before).any(1).all())  # a file that is clockwise as a whole stays so
    faces = after[:, ::-1] if turned else after
    if not same_counts:
        return faces
    # The same three vertices may come back wound the other way, when one has travelled past the others.
    untouched = np.any([(raw == np.roll(faces, k, 1)).all(1) for k in range(3)], 0)
    untouched &= turned | (raw == before).all(1)
    return np.where(untouched[:, None], raw, faces)


def _new_vertices(old: MeshBatch, mesh: MeshBatch, changed: bool) -> np.ndarray:
    """(V_old,) where each vertex of the file is now.

    The rows stay the same if the triangles do.  Otherwise vertices are found by their coordinates, unless their
    number is the same and most of the fixed ones have moved: then the boundary was moved as a whole.
    """
    here, there = old.points.to(mesh.points.dtype).numpy(), mesh.points.numpy()
    identity = np.arange(len(here))
    if len(here) == len(there) and not changed:
        return identity
    _, first, point = np.unique(np.concatenate([there, here]), axis=0, return_index=True, return_inverse=True)
    row = first[point.reshape(-1)[len(there) :]]
    row = np.where(row < len(there), row, -1)
    if len(here) == len(there):
        anchored = old.fixed.numpy()
        if not (row[anchored] >= 0).all() or 2 * (here == there).all(1)[anchored].sum() > anchored.sum():
            return identity
    return row


def _new_regions(mesh: MeshBatch, old: MeshBatch, region: np.ndarray, new_vertex: np.ndarray) -> np.ndarray:
    """(T,) the region of each new triangle, -1 where it cannot be told.

    Boundary and constrained edges separate the regions and survive every change.  Each component that they enclose
    belongs to the region that lay on the same side of them before.
    """
    if len(np.unique(region)) < 2:
        return np.full(len(mesh.triangles), region[0] if len(region) else -1)
    count = len(mesh.points)
    before, tail, head = _separating(old)
    tail, head = new_vertex[tail.numpy()], new_vertex[head.numpy()]
    kept = (tail >= 0) & (head >= 0)
    keys, sides = (tail * count + head)[kept], region[(before // 3).numpy()[kept]]
    order = keys.argsort()
    keys, sides = keys[order], sides[order]
    now, tail, head = _separating(mesh)
    wanted = (tail * count + head).numpy()
    at = keys.searchsorted(wanted).clip(max=max(len(keys) - 1, 0))
    found = keys[at] == wanted if len(keys) else np.zeros(len(wanted), bool)
    blocked = torch.zeros(3 * len(mesh.triangles), dtype=torch.bool)
    blocked[now] = True
    component = connectivity.triangle_components(mesh.triangles, mesh.twin, blocked).numpy()
    low = np.full(int(component.max()) + 1, np.iinfo(np.int64).max)
    high = np.full(len(low), -1)
    owner = component[(now // 3).numpy()[found]]
    np.minimum.at(low, owner, sides[at[found]])
    np.maximum.at(high, owner, sides[at[found]])
    return np.where(low == high, high, -1)[component]


def _separating(mesh: MeshBatch) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The half-edges on the boundary or on constrained edges, their tails and their heads."""
    twin, count = mesh.twin, len(mesh.points)
    tail, head = connectivity.tails(mesh.triangles), connectivity.heads(mesh.triangles)
    kept = connectivity.edge_keys(mesh.constrained_edges[:, 0], mesh.constrained_edges[:, 1], count)
    row = ((twin < 0) | torch.isin(connectivity.edge_keys(tail, head, count), kept)).nonzero().squeeze(1)
    return row, tail[row], head[row]
