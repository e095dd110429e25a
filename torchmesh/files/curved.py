"""The mid-side nodes of a file's triangles and quads, for the mesh that takes the place of the file's.

The nodes stay rows of points of the mesh, in no element, so that every row of the file keeps its number.
"""

from dataclasses import replace

import numpy as np
import torch

from ..curving.middles import Middles, follow
from ..curving.placing import After, Before, is_straight, placed
from ..curving.unfolding import Unfolding
from ..mesh import connectivity
from ..mesh.batch import MeshBatch
from ..mesh.quads import halved
from ..mesh.vertex_map import VertexMap
from .correspondence import Correspondence
from .placed import Placed
from .source import Source
from .split_quads import split_rows, with_split_quads


def ends_of_curved(source: Source) -> torch.Tensor:
    """(V,) bool: the ends of edges of the boundary and of interfaces whose nodes are beside the middle."""
    mesh, middles = source.mesh, source.middles
    assert middles is not None
    at = middles.at(_held_edges(mesh))
    bent = np.zeros(len(middles.edges), bool)
    bent[at[at >= 0]] = True
    bent &= ~is_straight(mesh.points.to(torch.float64).numpy(), middles, _epsilon(source))
    ends = torch.zeros(len(mesh.points), dtype=torch.bool)
    ends[torch.from_numpy(middles.edges[bent].reshape(-1))] = True
    return ends


def _held_edges(mesh: MeshBatch) -> np.ndarray:
    """(K, 2) the edges of the boundary, and constrained ones."""
    constrained, mesh = mesh.constrained_edges.numpy(), halved(mesh)
    return np.concatenate([connectivity.boundary_edges(mesh.triangles, mesh.twin).numpy(), constrained])


def _epsilon(source: Source) -> float:
    """The rounding of the coordinates of a file, relative to their size."""
    kind = source.content.mesh.points.dtype
    return float(np.finfo(kind).eps) if kind.kind == "f" else 0.0


def given(source: Source, mesh: MeshBatch | None = None) -> Placed:
    """The curved elements of a file, with positions of its own or of `mesh`, which has its rows."""
    assert source.middles is not None
    return Placed(source.mesh if mesh is None else mesh, source.middles)


def replaced(
    source: Source,
    mesh: MeshBatch,
    vertex_map: VertexMap | None = None,
    before: MeshBatch | None = None,
    *,
    mends: bool = True,
) -> Placed:
    """The mesh that takes the place of the file's, with its mid-side nodes placed.

    vertex_map  where the rows come from; None: they are those of the file
    before      the mesh with the positions that the nodes had; None: that of the file
    mends       are nodes inside moved where a triangle would be inverted
    """
    if len(mesh.quads) < len(source.mesh.quads):
        source = with_split_quads(source, split_rows(source, mesh, vertex_map))
    middles = source.middles
    assert middles is not None
    before = source.mesh if before is None else before
    count = len(source.mesh.points)
    new_vertex = np.arange(count) if vertex_map is None else vertex_map.old_to_new.cpu().numpy()
    faces, points = mesh.triangles.numpy(), mesh.points.to(torch.float64).numpy()
    was, old_faces = before.points.to(torch.float64).numpy(), source.mesh.triangles.numpy()
    curved = _curved_after(source, mesh, vertex_map)
    quads, old_quads = mesh.quads.numpy(), source.mesh.quads.numpy()
    followed = follow(middles, old_faces, points, faces, curved, new_vertex, quads)
    held, epsilon = _held_edges(mesh), _epsilon(source)
    after = After(points, faces, quads, followed, held, _fixed_by_user(source, new_vertex, len(points)))
    made = placed(
        Before(was, old_faces, old_quads, middles, epsilon), after, new_vertex, Unfolding() if mends else None
    )
    return _with_rows(mesh, made, followed.middles, followed.spare, vertex_map)


def _curved_after(source: Source, mesh: MeshBatch, vertex_map: VertexMap | None) -> np.ndarray:
    """(T,) bool: which triangles are curved.  Where the file has both kinds, their rows must be the file's."""
    assert source.middles is not None
    curved = source.middles.curved
    if curved.all():
        return np.ones(len(mesh.triangles), bool)
    if len(mesh.triangles) == len(curved):
        return curved
    example = Correspondence.between(mesh, source, vertex_map).example
    return np.ones(len(mesh.triangles), bool) if example is None else curved[example]


def _fixed_by_user(source: Source, new_vertex: np.ndarray, count: int) -> np.ndarray:
    """(count,) bool: rows that the point data `fixed` marks, or that cells bind which are no triangles."""
    content = source.content
    rows = content.pinned if content.fixed is None else content.pinned | content.fixed
    fixed = np.zeros(count, bool)
    at = new_vertex[rows]
    fixed[at[at >= 0]] = True
    return fixed


def _with_rows(
    mesh: MeshBatch, points: np.ndarray, middles: Middles, spare: np.ndarray, vertex_map: VertexMap | None
) -> Placed:
    """The mesh with the points and nodes, less the spare nodes; where nodes came or went, with another vertex map."""
    made = np.arange(len(mesh.points), len(points))
    at = torch.from_numpy(points).to(mesh.points.dtype)
    if not len(made) and not len(spare):
        return Placed(mesh.with_points(at), middles, vertex_map)
    keep = np.ones(len(points), bool)
    keep[spare] = False
    row = np.where(keep, np.cumsum(keep) - 1, -1)
    node_of = np.full(len(points), -1)
    node_of[middles.nodes] = np.arange(len(middles.nodes))
    ends = middles.edges[node_of[made]]
    kept = torch.from_numpy(keep)
    fixed = torch.cat([mesh.fixed, torch.ones(len(made), dtype=torch.bool)])[kept]
    offsets = mesh.point_offsets.new_tensor([0, int(keep.sum())])
    renumbered = torch.from_numpy(row)
    result = replace(
        mesh, points=at[kept], triangles=renumbered[mesh.triangles], quads=renumbered[mesh.quads], fixed=fixed,
        constrained_edges=renumbered[mesh.constrained_edges], point_offsets=offsets, _twin=None,
    )  # fmt: skip
    order = row[middles.edges]
    centres = np.where(middles.centres >= 0, row[middles.centres], -1)
    moved = Middles(order, row[middles.nodes], middles.curved, middles.quads, centres)
    return Placed(result, moved, _extended(vertex_map, len(mesh.points), ends, row, keep))


def _extended(
    vertex_map: VertexMap | None, count: int, ends: np.ndarray, row: np.ndarray, keep: np.ndarray
) -> VertexMap:
    """The vertex map with the nodes that were made, which lie between the vertices `ends` (N, 2), and without others.

    row   (count + N,) the row of each point after, -1 where it goes
    """
    if vertex_map is None:
        every = torch.arange(count)
        vertex_map = VertexMap(every, every, every, every, torch.ones(count, dtype=torch.float64))
    renumbered = torch.from_numpy(row)
    old_to_new = torch.where(vertex_map.old_to_new >= 0, renumbered[vertex_map.old_to_new.clamp_min(0)], -1)
    new_to_old = torch.cat([vertex_map.new_to_old, torch.full((len(ends),), -1)])[torch.from_numpy(keep)]
    rows, sources, weights = [vertex_map.rows], [vertex_map.sources], [vertex_map.weights]
    for end in ends.T:
        # The sources of an end, with half their weights.
        wanted = torch.from_numpy(np.ascontiguousarray(end))
        start = torch.searchsorted(vertex_map.rows, wanted)
        stop = torch.searchsorted(vertex_map.rows, wanted, right=True)
        times = stop - start
        entry = torch.repeat_interleave(start - torch.cumsum(times, 0) + times, times) + torch.arange(int(times.sum()))
        rows.append(torch.repeat_interleave(torch.arange(count, count + len(ends)), times))
        sources.append(vertex_map.sources[entry])
        weights.append(0.5 * vertex_map.weights[entry])
    all_rows, all_sources, all_weights = renumbered[torch.cat(rows)], torch.cat(sources), torch.cat(weights)
    there = all_rows >= 0
    all_rows, all_sources, all_weights = all_rows[there], all_sources[there], all_weights[there]
    order = torch.argsort(all_rows, stable=True)
    return VertexMap(old_to_new, new_to_old, all_rows[order], all_sources[order], all_weights[order])
