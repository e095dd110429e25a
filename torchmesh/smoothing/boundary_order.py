"""Boundary vertices that have passed each other on a straight side, put back in order along it.

a-->--c<-b-->--d        The boundary runs from a over b and c to d, but b lies beyond c.  Sliding takes
                        vertices along their side only as it is, so they are first put in order: their
a-->--b->-c-->--d       positions are exchanged.  Vertices in one position are set apart.
"""

import numpy as np
import torch
from torch import Tensor

from ..mesh import connectivity
from ..mesh.alone import errors_alone
from ..mesh.batch import MeshBatch, put, vertex_mesh
from ..mesh.ragged import spread

# A vertex lies on the line of a side if its distance from it is below this part of the side: rounding, and no more.
_STRAIGHT = 1e-9


def in_order(batch: MeshBatch, hold: Tensor | None = None) -> tuple[MeshBatch, Tensor]:
    """The batch with the vertices of straight sides in the order of the boundary, and how many (B,) have moved.

    hold  (V,) bool, vertices that stay; a side with such a vertex between its ends stays as it is
    """
    moved = torch.zeros(len(batch), dtype=torch.int64, device=batch.points.device)
    points = batch.points.detach().to("cpu", torch.float64).numpy().copy()
    edges = connectivity.boundary_edges(batch.triangles, batch.twin).cpu().numpy()
    onward, back = (np.full(len(points), -1) for _ in range(2))
    onward[edges[:, 0]], back[edges[:, 1]] = edges[:, 1], edges[:, 0]
    # Where several stretches of boundary meet, there is no one way on.
    many = (np.bincount(edges[:, 0], minlength=len(points)) > 1) | (np.bincount(edges[:, 1], minlength=len(points)) > 1)
    held = many if hold is None else many | hold.cpu().numpy()
    done = np.zeros(len(points), bool)
    for b in _turning_back(points, edges[:, 1], back, onward).tolist():
        side = [] if done[b] or many[b] else _side(points, b, back, onward, many)
        done[side[1:-1]] = True
        inner = np.array(side[1:-1], dtype=np.int64)
        if len(side) < 4 or held[inner].any():
            continue
        places = _placed(points[side])
        if places is not None:
            points[inner] = places
    new = torch.from_numpy(points).to(batch.points)
    there = (new != batch.points).any(1)
    if not bool(there.any()):
        return batch, moved
    moved.index_add_(0, vertex_mesh(batch)[there], torch.ones_like(moved[:1]).expand(int(there.sum())))
    return batch.with_points(torch.where(there[:, None], new, batch.points)), moved


def in_order_or_errors(batch: MeshBatch, hold: Tensor | None = None) -> tuple[MeshBatch, Tensor, dict[int, Exception]]:
    """As `in_order`, but a mesh in which there is an error stays as it is; the errors by the rows of their meshes."""
    try:
        return *in_order(batch, hold), {}
    except Exception:
        errors = errors_alone(batch, lambda mesh, rows: in_order(mesh, None if hold is None else hold[rows]))
        if not errors:
            raise
    sound = torch.ones(len(batch), dtype=torch.bool, device=batch.points.device)
    sound[list(errors)] = False
    moved = torch.zeros(len(batch), dtype=torch.int64, device=batch.points.device)
    if not bool(sound.any()):
        return batch, moved, errors
    after, counts = in_order(batch.select(sound), None if hold is None else hold[spread(sound, batch.point_offsets)])
    return put(batch, sound, after), moved.masked_scatter(sound, counts), errors


def _turning_back(points: np.ndarray, vertices: np.ndarray, back: np.ndarray, onward: np.ndarray) -> np.ndarray:
    """Those of the boundary `vertices` (N,) at which the boundary turns right back, or stands still."""
    u, w = points[vertices] - points[back[vertices]], points[onward[vertices]] - points[vertices]
    with np.errstate(all="ignore"):
        scale = np.maximum(np.abs(u).max(1) * np.abs(w).max(1), np.finfo(float).tiny)
        cross, dot = u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0], (u * w).sum(1)
    return np.unique(vertices[(np.abs(cross) <= _STRAIGHT * scale) & (dot <= 0)])


def _side(points: np.ndarray, b: int, back: np.ndarray, onward: np.ndarray, many: np.ndarray) -> list[int]:
    """The vertices of the straight stretch of boundary through the neighbours of vertex `b`, in order; [] if none."""
    side = [int(back[b]), b, int(onward[b])]
    ends = points[side]
    long = np.abs(ends - ends[:1]).max(1).argmax()
    way = ends[long] - ends[0]
    length = np.abs(way).max()
    if not 0 < length < np.inf:
        way = ends[2] - ends[1]
        length = np.abs(way).max()
    if not 0 < length < np.inf:
        return []
    way = way / length / np.linalg.norm(way / length)

    def on_line(v: int) -> bool:
        d = (points[v] - points[b]) / length
        return bool(abs(d[0] * way[1] - d[1] * way[0]) <= _STRAIGHT * max(1.0, np.abs(d).max()))

    for grow, end, at in ((onward, -1, len), (back, 0, lambda _: 0)):
        while not many[side[end]] and (v := int(grow[side[end]])) not in (side[0], side[-1]) and on_line(v):
            side.insert(at(side), v)
    return side


def _placed(xy: np.ndarray) -> np.ndarray | None:
    """(N - 2, 2) positions in order for all but the first and last of the vertices (N, 2) of a side.

    The positions are those that are there, but for vertices in one position.  None if some lie beyond the ends.
    """
    way = xy[-1] - xy[0]
    axis = int(np.abs(way).argmax())
    if way[axis] == 0:
        return None
    t = (xy[:, axis] - xy[0, axis]) / way[axis]
    inner = t[1:-1]
    if (inner < 0).any() or (inner > 1).any():
        return None
    order = np.argsort(inner, kind="stable")
    places, along = xy[1:-1][order], np.concatenate([[0.0], inner[order], [1.0]])
    known = np.flatnonzero(np.concatenate([[True], np.diff(along) > 0]) & (along < 1))
    known = np.append(known, len(along) - 1)
    spread = np.interp(np.arange(len(along)), known, along[known])[1:-1]
    apart = spread != along[1:-1]
    places[apart] = xy[0] + spread[apart, None] * way
    return places
