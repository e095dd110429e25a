"""Where the vertices of one mesh lie in another, and with which weights its corners make their values.

in one upright triangle             barycentric weights of its corners
in none, several or inverted ones   the same in a triangulation of the vertices (`domain`)
outside                             the nearest point of the boundary, between the ends of its edge
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch

from ..mesh import connectivity
from ..mesh.batch import MeshBatch
from .domain import domain_triangles
from .pairs import Side, touching_boxes
from .sparse_rows import Entries

# Rounding of a cross product of differences, in units of the sum of its two products.
_ROUNDING = 4 * np.finfo(float).eps


@dataclass(frozen=True, eq=False)
class Location:
    """The weights of all points that were asked for.

    entries  the weights: a row for each point, a column for each vertex
    tangled  (P,) bool: the triangles there overlap, and a triangulation of the vertices took their place
    outside  (P,) bool: the point lies outside the mesh, farther than rounding
    """

    entries: Entries
    tangled: np.ndarray
    outside: np.ndarray


class Found(NamedTuple):
    """Points (N,) in closed triangles (N,), and the weights (3, N) of their corners, which sum to 1."""

    point: np.ndarray
    triangle: np.ndarray
    weights: np.ndarray


def locate(before: MeshBatch, side: Side, x: np.ndarray, y: np.ndarray, mesh: np.ndarray) -> Location:
    """Finds the points x, y (P,) of the meshes `mesh` (P,) in the batch `before`, whose `Side` is `side`."""
    points = np.stack([x, y], 1)
    found, strict, upright = _containing(side, points, mesh)
    home = _best(found, upright)
    clean = np.zeros(len(points), bool)
    clean[home.point] = True
    overlapping = _mesh_of_any(side, ~_upright_triangles(side))
    crowd = np.bincount(found.point[strict & upright], minlength=len(points)) > 1
    crowd[found.point[~upright]] = True
    clean &= ~(crowd & overlapping[mesh])
    tangled = ~clean & overlapping[mesh]
    entries = [_entries(side.triangles, home, clean)]
    left = ~clean
    if tangled.any():
        again = _in_domains(before, side, points, mesh, tangled)
        entries.append(_entries(again[0], again[1], tangled))
        left[again[1].point] = False
        tangled &= ~left
    outside = np.zeros(len(points), bool)
    for b in np.unique(mesh[left]):
        rows = np.flatnonzero(left & (mesh == b))
        h, share, distance = _nearest_on_boundary(side, b, points[rows])
        edges = np.stack([tails(side)[h], heads(side)[h]], 1)
        weights = np.stack([1 - share, share], 1)
        entries.append(Entries(np.repeat(rows, 2), edges.reshape(-1), weights.reshape(-1)))
        outside[rows] = distance > side.slack[b]
    return Location(Entries.joined(entries), tangled, outside)


def _containing(side: Side, points: np.ndarray, mesh: np.ndarray) -> tuple[Found, np.ndarray, np.ndarray]:
    """All pairs of a point and a closed triangle round it; (N,) bool: is it inside, and is the triangle upright.

    No pair is missed for rounding: points that the floating-point numbers cannot tell from those of the triangle are
    counted among them.  Triangles without area are left out.
    """
    i, t = touching_boxes(side, (points, points, mesh), (*side.triangle_boxes(), side.triangle))
    (ax, bx, cx), (ay, by, cy) = (v[side.triangles[t]].T for v in (side.x, side.y))
    px, py = points[i].T
    across, size = [], []
    for ux, uy, vx, vy in ((bx, by, cx, cy), (cx, cy, ax, ay), (ax, ay, bx, by)):
        left, right = (vx - ux) * (py - uy), (vy - uy) * (px - ux)
        across.append(left - right)
        size.append(_ROUNDING * (np.abs(left) + np.abs(right)))
    area = across[0] + across[1] + across[2]
    sign = np.sign(area)
    parts, rounding = np.stack(across) * sign, np.stack(size)
    inside = (parts >= -rounding).all(0) & (area != 0)
    i, t, sign, parts, strict = i[inside], t[inside], sign[inside], parts[:, inside], (parts > rounding).all(0)[inside]
    # Once more with what is left over, so that also in thin triangles the weights give the point (Higham, Accuracy
    # and Stability of Numerical Algorithms, 2002, chapter 12).
    a, b, c = (np.stack([side.x[v], side.y[v]]) for v in side.triangles[t].T)
    double = parts.sum(0)
    b, c = b - a, c - a
    wb, wc = parts[1] / double, parts[2] / double
    rest = points[i].T - a - (wb * b + wc * c)
    signed = sign * double
    wb = wb + (rest[0] * c[1] - rest[1] * c[0]) / signed
    wc = wc + (b[0] * rest[1] - b[1] * rest[0]) / signed
    weights = np.stack([1 - wb - wc, wb, wc])
    return Found(i, t, weights), strict, sign > 0


def _best(found: Found, allowed: np.ndarray) -> Found:
    """Of the triangles (N,) that are `allowed`, for each point the one that it lies deepest in; of equals the first."""
    point, triangle, weights = found.point[allowed], found.triangle[allowed], found.weights[:, allowed]
    order = np.lexsort((triangle, -weights.min(0), point))
    first = order[np.concatenate([[True], np.diff(point[order]) != 0])] if len(order) else order
    return Found(point[first], triangle[first], weights[:, first])


def _entries(triangles: np.ndarray, found: Found, wanted: np.ndarray) -> Entries:
    """Entries for the points that are `wanted` (P,) bool."""
    some = wanted[found.point]
    weights = found.weights[:, some]
    # A point on an edge may have a weight a rounding error below zero; in triangles that are too thin to tell, more.
    below = (weights < 0).any(0)
    if below.any():
        cut = weights[:, below].clip(min=0)
        weights[:, below] = cut / cut.sum(0)
    rows, columns = np.repeat(found.point[some], 3), triangles[found.triangle[some]].reshape(-1)
    return Entries(rows, columns, weights.T.reshape(-1))


def _upright_triangles(side: Side) -> np.ndarray:
    """(T,) bool by the rounded area, which agrees with that of `_containing`."""
    (ax, bx, cx), (ay, by, cy) = (v[side.triangles].T for v in (side.x, side.y))
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) > 0


def _mesh_of_any(side: Side, triangles: np.ndarray) -> np.ndarray:
    """(B,) bool: has the mesh one of the `triangles` (T,) bool."""
    return np.bincount(side.triangle[triangles], minlength=len(side.centre)) > 0


def _in_domains(
    before: MeshBatch, side: Side, points: np.ndarray, mesh: np.ndarray, wanted: np.ndarray
) -> tuple[np.ndarray, Found]:
    """Triangles over the vertices of meshes with `wanted` (P,) points, and where in them these points are."""
    rows = np.flatnonzero(wanted)
    offsets, faces = before.point_offsets.cpu().numpy(), before.triangle_offsets.cpu().numpy()
    edges = before.constrained_edges.cpu().numpy()
    corners, owner = [], []
    for b in np.unique(mesh[rows]):
        start, end = offsets[b], offsets[b + 1]
        own = edges[(edges[:, 0] >= start) & (edges[:, 0] < end)] - start
        xy = np.stack([side.x[start:end], side.y[start:end]], 1)
        made = domain_triangles(xy, side.triangles[faces[b] : faces[b + 1]] - start, own) + start
        corners.append(made)
        owner.append(np.full(len(made), b))
    domain = replace(side, triangles=np.concatenate(corners), triangle=np.concatenate(owner))
    found, _, upright = _containing(domain, points[rows], mesh[rows])
    best = _best(found, upright)
    return domain.triangles, best._replace(point=rows[best.point])


def _nearest_on_boundary(side: Side, b: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The half-edge (N,) on the boundary of mesh b nearest to each point, where on it from 0 to 1, and how far."""
    import shapely

    own = np.flatnonzero(side.triangle == b)
    twin = connectivity.twins(torch.from_numpy(side.triangles[own])).numpy()
    h = 3 * own[0] + np.flatnonzero(twin < 0)
    ends = side.points[np.stack([tails(side)[h], heads(side)[h]], 1)]
    tree = shapely.STRtree(shapely.linestrings(ends))
    i, e = tree.query_nearest(shapely.points(points))
    nearest = np.full(len(points), len(h))
    np.minimum.at(nearest, i, e)
    a, along = ends[nearest, 0], ends[nearest, 1] - ends[nearest, 0]
    square = (along**2).sum(1)
    share = ((points - a) * along).sum(1) / np.where(square > 0, square, 1.0)
    share = share.clip(0, 1)
    distance = np.hypot(*(points - a - share[:, None] * along).T)
    return h[nearest], share, distance


def tails(side: Side) -> np.ndarray:
    """(3T,) the vertex that each half-edge starts from."""
    return side.triangles.reshape(-1)


def heads(side: Side) -> np.ndarray:
    """(3T,) the vertex that each half-edge runs to."""
    return np.roll(side.triangles, -1, 1).reshape(-1)


def nearest_triangles(side: Side, x: np.ndarray, y: np.ndarray, mesh: np.ndarray) -> np.ndarray:
    """(P,) for each point of the meshes `mesh` a triangle round it, or the one at the nearest edge of the boundary."""
    points = np.stack([x, y], 1)
    home = np.full(len(points), -1)
    if not len(points):
        return home
    found, _, upright = _containing(side, points, mesh)
    for allowed in (~upright, upright):
        best = _best(found, allowed)
        home[best.point] = best.triangle
    for b in np.unique(mesh[home < 0]):
        rows = np.flatnonzero((home < 0) & (mesh == b))
        home[rows] = _nearest_on_boundary(side, b, points[rows])[0] // 3
    return home


def nearest_vertices(side: Side, x: np.ndarray, y: np.ndarray, mesh: np.ndarray) -> np.ndarray:
    """(P,) for each point of the meshes `mesh` the nearest vertex of the mesh, of equals the first."""
    import shapely

    nearest = np.full(len(x), len(side.x))
    for b in np.unique(mesh):
        rows, own = np.flatnonzero(mesh == b), np.flatnonzero(side.vertex == b)
        tree = shapely.STRtree(shapely.points(side.x[own], side.y[own]))
        i, v = tree.query_nearest(shapely.points(x[rows], y[rows]))
        np.minimum.at(nearest, rows[i], own[v])
    return nearest
