"""Why no valid mesh can exist inside a boundary, whatever the triangles: said at once, with the place."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np
import shapely
import torch

from . import connectivity
from .mesh import MeshBatch
from .polygons import crossing_pairs, loop_edges, loops_of, nested_holes, turns_left, unit_exponent, winding


class ProblemKind(str, Enum):
    """What is wrong; the value says it in words."""

    DUPLICATE_VERTICES = "two fixed vertices in one place"
    BOUNDARY_CROSSING = "the boundary meets itself"
    CONSTRAINT_CROSSING = "a constrained edge meets another or the boundary"
    NO_AREA = "the boundary encloses no positive area"
    HOLE_INSIDE_OUT = "a hole is inside out"
    HOLE_OUTSIDE = "a hole lies outside the outer loop or in another hole"
    VERTEX_OUTSIDE = "a fixed vertex lies outside its region or on an edge"


@dataclass(frozen=True)
class Problem:
    """One reason why a mesh cannot be valid.

    kind      what is wrong
    message   the same with vertex numbers and the place
    mesh      which mesh of the batch
    vertices  the vertices concerned, numbered within their mesh
    place     about where, in the mesh's length unit
    """

    kind: ProblemKind
    message: str
    mesh: int
    vertices: tuple[int, ...]
    place: tuple[float, float]


def diagnose(batch: MeshBatch) -> list[Problem]:
    """Everything about the fixed vertices and edges of each mesh that leaves it no valid triangulation.

    No problem found means that `untangle_by_pockets` can repair the mesh, rounding permitting.
    Pieces of a mesh not joined by edges may lie over each other.  Loops may share vertices.  What
    lies inside what is looked at only in meshes whose edges do not cross.  Signs are exact.
    """
    problems = []
    for b, mesh in enumerate(batch.split()):
        found = [Problem(kind, text, b, vertices, place) for kind, text, vertices, place in _of_one(mesh)]
        problems += found
    return problems


_Found = tuple[ProblemKind, str, tuple[int, ...], tuple[float, float]]


def _of_one(mesh: MeshBatch) -> list[_Found]:
    points = mesh.points.detach().to("cpu", torch.float64).numpy()
    triangles = mesh.triangles.cpu()
    twin = connectivity.twins(triangles)
    ends = torch.stack([connectivity.tails(triangles), connectivity.heads(triangles)], 1)
    count = len(points)
    constraints = mesh.constrained_edges.cpu()
    walls = connectivity.edge_keys(constraints[:, 0], constraints[:, 1], count)
    wall = torch.isin(connectivity.edge_keys(ends[:, 0], ends[:, 1], count), walls) & (twin >= 0)
    piece = connectivity.triangle_components(triangles, twin).numpy()
    region = connectivity.triangle_components(triangles, twin, wall).numpy()
    once = (twin < 0) | (wall & (torch.arange(len(twin)) < twin))
    rows = once.nonzero().squeeze(1).numpy()
    edges, border = ends.numpy()[rows], (twin < 0).numpy()[rows]
    faces = triangles.numpy()
    fixed = np.zeros(count, bool)
    fixed[faces] = True
    fixed &= mesh.fixed.cpu().numpy()
    of_piece = np.zeros(count, np.int64)
    of_piece[faces] = piece[:, None]
    found = list(_duplicates(points, of_piece, fixed))
    found += _crossings(points, edges, border, of_piece, fixed)
    if not found:
        own = np.repeat(region, 3)
        rim = (twin.numpy() < 0) | (region[twin.numpy() // 3] != own)
        for r in range(int(region.max()) + 1):
            found += _nesting(points, ends.numpy()[rim & (own == r)], faces[region == r], fixed)
    return found


def _duplicates(points: np.ndarray, of_piece: np.ndarray, fixed: np.ndarray) -> Iterator[_Found]:
    """Fixed vertices of one piece in one place."""
    rows = np.flatnonzero(fixed)
    rows = rows[np.lexsort((points[rows, 1], points[rows, 0], of_piece[rows]))]
    same = (points[rows[1:]] == points[rows[:-1]]).all(1) & (of_piece[rows[1:]] == of_piece[rows[:-1]])
    for i in np.flatnonzero(same):
        u, v = sorted((int(rows[i]), int(rows[i + 1])))
        place = _at(points[u])
        yield (ProblemKind.DUPLICATE_VERTICES, f"vertices {u} and {v} are both at {_text(place)}", (u, v), place)


def _crossings(
    points: np.ndarray, edges: np.ndarray, border: np.ndarray, of_piece: np.ndarray, fixed: np.ndarray
) -> Iterator[_Found]:
    """Boundary edges, constrained edges and fixed vertices of one piece that meet where they should not."""
    single = fixed.copy()
    single[edges] = False
    single = np.flatnonzero(single)
    segments = np.concatenate([edges, np.stack([single, single], 1)])
    kinds = np.concatenate([np.where(border, 0, 1), np.full(len(single), 2)])
    for i, j in crossing_pairs(points, segments, of_piece[segments[:, 0]]).tolist():
        (a, b), (c, d) = segments[[i, j]].tolist()
        if any((points[p] == points[q]).all() for p in (a, b) for q in (c, d) if p != q):
            continue  # told as duplicate vertices
        place = _at(points[c]) if c == d else _meeting_place(points, (a, b), (c, d))
        one = ("boundary edge", "constrained edge")[kinds[i]]
        if kinds[j] == 2:
            text = f"the fixed vertex {c} lies on the {one} [{a}, {b}] at {_text(place)}"
            yield ProblemKind.VERTEX_OUTSIDE, text, (c, a, b), place
            continue
        two = ("boundary edge", "constrained edge")[kinds[j]]
        kind = ProblemKind.CONSTRAINT_CROSSING if kinds[i] or kinds[j] else ProblemKind.BOUNDARY_CROSSING
        text = f"the {one} [{a}, {b}] and the {two} [{c}, {d}] meet at about {_text(place)}"
        yield kind, text, (a, b, c, d), place


def _nesting(points: np.ndarray, rim: np.ndarray, faces: np.ndarray, fixed: np.ndarray) -> Iterator[_Found]:
    """What is wrong with one region, whose edges `rim` (E, 2) do not cross: how its loops and vertices lie."""
    if not len(rim):
        place = _at(points[faces[0, 0]])
        text = f"the triangles around vertex {faces[0, 0]} close up as on a sphere: they have no boundary"
        yield ProblemKind.NO_AREA, text, (int(faces[0, 0]),), place
        return
    loops = loops_of(rim)
    turn = np.array([turns_left(points, loop) for loop in loops])
    left = np.flatnonzero(turn > 0)
    if not len(left):
        longest = loops[int(np.argmax([_extent(points[loop]) for loop in loops]))]
        place = _at(points[longest[0]])
        text = f"the loop through vertex {longest[0]} at {_text(place)} runs clockwise: its region has no positive area"
        yield ProblemKind.NO_AREA, text, (int(longest[0]),), place
        return
    outer_row = left[int(np.argmax([_extent(points[loops[i]]) for i in left]))]
    outer = loop_edges(loops[outer_row])
    sound = True
    for i, hole in enumerate(loops):
        if i == outer_row:
            continue
        alone = hole[~np.isin(hole, outer)]
        at = alone[:1] if len(alone) else hole[:1]
        place = _at(points[at[0]])
        if turn[i] > 0:
            text = f"the hole through vertex {at[0]} at {_text(place)} is inside out"
            yield ProblemKind.HOLE_INSIDE_OUT, text, (int(at[0]),), place
        elif winding(points, at, outer)[0] != 1:
            text = f"the hole through vertex {at[0]} at {_text(place)} lies outside the outer loop"
            yield ProblemKind.HOLE_OUTSIDE, text, (int(at[0]),), place
        else:
            continue
        sound = False
    nested = nested_holes(points, [loops[i] for i in np.flatnonzero(turn < 0)])
    if nested is not None:
        u, v = int(nested[0][0]), int(nested[1][0])
        place = _at(points[u])
        text = f"the hole through vertex {u} at {_text(place)} lies inside the hole through vertex {v}"
        yield ProblemKind.HOLE_OUTSIDE, text, (u, v), place
        sound = False
    if sound:
        yield from _outside(points, loops, outer_row, faces, fixed)


def _outside(
    points: np.ndarray, loops: list[np.ndarray], outer: int, faces: np.ndarray, fixed: np.ndarray
) -> Iterator[_Found]:
    """Fixed vertices of a region that are not in it."""
    inner = np.zeros(len(points), bool)
    inner[faces] = True
    inner[np.concatenate(loops)] = False
    rows = np.flatnonzero(inner & fixed)
    if not len(rows):
        return
    # Shapely clears the many that are well inside; exact signs judge the rest.
    near_one = np.ldexp(points, -unit_exponent(points))
    rings = [near_one[loop] for loop in loops]
    polygon = shapely.Polygon(rings[outer], rings[:outer] + rings[outer + 1 :])
    shapely.prepare(polygon)
    rows = rows[~shapely.contains_xy(polygon, near_one[rows])]
    rim = np.concatenate([loop_edges(loop) for loop in loops])
    for v in rows[winding(points, rows, rim) != 1].tolist():
        place = _at(points[v])
        yield (ProblemKind.VERTEX_OUTSIDE, f"the fixed vertex {v} at {_text(place)} is not in its region", (v,), place)


def _extent(xy: np.ndarray) -> float:
    return float(np.ptp(xy, axis=0).max())


def _meeting_place(points: np.ndarray, one: tuple[int, int], two: tuple[int, int]) -> tuple[float, float]:
    """About where the segments meet: their crossing, or the middle of what they share."""
    (a, b), (c, d) = points[list(one)], points[list(two)]
    scale = max(np.abs(np.stack([b - a, d - c])).max(), np.finfo(float).tiny)
    p, q, r = (b - a) / scale, (d - c) / scale, (c - a) / scale
    denominator = p[0] * q[1] - p[1] * q[0]
    if abs(denominator) > 1e-12:
        s = (r[0] * q[1] - r[1] * q[0]) / denominator
        return _at(a + min(max(s, 0.0), 1.0) * (b - a))
    middle = np.stack([a, b, c, d])
    middle = middle[np.argsort(middle @ (np.abs(p) > 0))][1:3]
    return _at(middle[0] + (middle[1] - middle[0]) / 2)


def _at(xy: np.ndarray) -> tuple[float, float]:
    return float(xy[0]), float(xy[1])


def _text(place: tuple[float, float]) -> str:
    return f"({place[0]:.6g}, {place[1]:.6g})"
