"""Why no valid mesh can exist inside a boundary, whatever the triangles: said at once, with the place.

And, when the triangles are to stay, why no places of the free vertices can help.
"""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Literal

import numpy as np
import torch

from ..mesh import connectivity
from ..mesh.batch import MeshBatch
from ..triangulating.arrays import among, distinct, signs
from ..triangulating.polygon import (
    crossing_pairs,
    loop_edges,
    loops_of,
    nested_holes,
    turns_left,
    unit_exponent,
    winding,
)
from .polygon_kernel import fallen_fixed_triangles, vertices_without_kernel
from .slits import sewing


class ProblemKind(str, Enum):
    """What is wrong; the value says it in words."""

    DUPLICATE_VERTICES = "two fixed vertices in one place"
    BOUNDARY_CROSSING = "the boundary meets itself"
    CONSTRAINT_CROSSING = "a constrained edge meets another or the boundary"
    NO_AREA = "the boundary encloses no positive area"
    HOLE_INSIDE_OUT = "a hole is inside out"
    HOLE_OUTSIDE = "a hole lies outside the outer loop or in another hole"
    VERTEX_OUTSIDE = "a fixed vertex lies outside its region or on an edge"
    FIXED_TRIANGLE = "a triangle of three fixed vertices is inverted or flat"
    FIXED_EDGE = "an edge between two fixed vertices leaves the domain or meets another"
    NO_KERNEL = "the fixed ring round a free vertex leaves it no place"


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


def diagnose(batch: MeshBatch, topology: Literal["keep", "flip"] = "flip", most: int = 20) -> list[Problem]:
    """Everything about the fixed vertices and edges of each mesh that leaves it no valid triangulation.

    topology  "flip": whatever the triangles.  No problem found means that `untangle_by_retriangulation` can
              repair the mesh, rounding permitting, but for pockets with a slit in them.  "keep": with the
              triangles as they are, also the obstructions that moving free vertices cannot mend.  They are
              not all there are: a mesh without a problem may still have no valid places
    most      how many problems of one kind are told of one mesh

    A mesh, or a piece of it, that has no inverted triangle is valid, and nothing is said of it.
    Slits of no width may be there: where two stretches of boundary lie on each other edge by edge, they are
    taken as sewn up, and the vertices told of are the first in their place.
    Pieces of a mesh not joined by edges may lie over each other.  Loops may share vertices.  What
    lies inside what is looked at only in meshes whose edges do not cross.  Signs are exact.
    """
    if topology not in ("keep", "flip"):
        raise ValueError(f"topology must be 'keep' or 'flip', not {topology!r}")
    # All meshes at once as pieces of one; only where something is found is each looked at alone.
    if len(batch) > 1 and not _of_one(batch, topology == "keep", most):
        return []
    problems = []
    for b, mesh in enumerate(batch.split()):
        told: dict[ProblemKind, int] = {}
        for kind, text, vertices, place in _of_one(mesh, topology == "keep", most):
            told[kind] = told.get(kind, 0) + 1
            if told[kind] <= most:
                problems.append(Problem(kind, text, b, vertices, place))
    return problems


_Found = tuple[ProblemKind, str, tuple[int, ...], tuple[float, float]]


def _of_one(mesh: MeshBatch, keep: bool, most: int, sew: bool = True) -> list[_Found]:
    points = mesh.points.detach().to("cpu", torch.float64).numpy()
    triangles = mesh.triangles.cpu()
    twin = mesh.twin.cpu()
    label = connectivity.triangle_components(triangles, twin)
    fallen = torch.from_numpy(signs(points, *triangles.numpy().T) <= 0)
    # A piece whose triangles are all upright is valid, whatever its boundary does.
    ill = torch.zeros_like(fallen).index_fill_(0, label[fallen], True)[label]
    if not bool(ill.any()):
        return []
    if not bool(ill.all()):
        triangles = triangles[ill]
        twin = connectivity.twins(triangles)
        label = connectivity.triangle_components(triangles, twin)
    count = len(points)
    constraints = mesh.constrained_edges.cpu()
    of_piece = np.zeros(count, np.int64)
    of_piece[triangles.numpy()] = label.numpy()[:, None]
    slit = torch.zeros_like(twin, dtype=torch.bool)
    name = None
    if sew:
        name = sewing(points, triangles.numpy(), connectivity.boundary_edges(triangles, twin).numpy(), of_piece)
    if name is not None:
        sewn = torch.from_numpy(name)
        triangles, constraints = sewn[triangles], sewn[constraints]
        slit, twin = twin < 0, connectivity.twins(triangles)
        slit &= twin >= 0
        label = connectivity.triangle_components(triangles, twin)
    tails, heads = connectivity.tails(triangles), connectivity.heads(triangles)
    inner = twin >= 0
    wall = slit
    if len(constraints):
        walls = connectivity.edge_keys(constraints[:, 0], constraints[:, 1], count)
        wall = slit | (torch.isin(connectivity.edge_keys(tails, heads, count), walls) & inner)
    parted = wall
    if keep:
        held = mesh.fixed.cpu()
        parted = wall | (held[tails] & held[heads] & inner)
    closed = connectivity.triangle_components(triangles, twin, parted) if bool(parted.any()) else label
    region = closed.numpy()
    # The half-edges of borders and walls of all kinds, and of these each edge once.
    rows = (~inner | parted).nonzero().squeeze(1)
    across = twin[rows]
    ends = torch.stack([tails[rows], heads[rows]], 1).numpy()
    once = ((across < 0) | (rows < across)).numpy()
    border, walled = ((across < 0) | slit[rows]).numpy(), wall[rows].numpy()
    what = np.where(border, _BORDER, np.where(walled, _CONSTRAINT, _HELD))[once]
    edges = ends[once]
    faces = triangles.numpy()
    used = np.zeros(count, bool)
    used[faces] = True
    fixed = used & mesh.fixed.cpu().numpy()
    found = _first(_duplicates(points, of_piece, fixed), most)
    if keep:
        on_rim = np.zeros(count, bool)
        on_rim[ends[(across < 0).numpy()]] = True
        found += _obstructions(points, faces, fixed, used & ~on_rim, most)
        if found and len(edges) > _MANY:
            # Held edges by the hundred thousand take seconds, and that the mesh is impossible is known.
            edges, what = edges[what != _HELD], what[what != _HELD]
    found += _crossings(points, edges, what, of_piece, fixed, most)
    if not found:
        # Triangles between held edges have been judged already.
        if keep:
            left = ~fixed[faces].all(1)
            faces, of_face = faces[left], region[left]
        else:
            of_face = region
        unsettled = np.bincount(of_face, minlength=int(region.max()) + 1) > 0
        # An edge with the same region on both sides is not of its rim.
        own, other = region[rows.numpy() // 3], region[across.numpy() // 3]
        rim = ((across < 0).numpy() | (other != own)) & unsettled[own]
        found += _nestings(points, ends[rim], own[rim], faces, of_face, fixed)
        if name is not None and {kind for kind, *_ in found} == {ProblemKind.VERTEX_OUTSIDE}:
            # No slit, but a hole, say, whose side lies on the boundary: told as such.
            return _of_one(mesh, keep, most, sew=False)
    return found


_BORDER, _CONSTRAINT, _HELD, _SINGLE = range(4)


# More edges than this are not all looked at in a mesh that is impossible anyway.
_MANY = 50_000


_NAMES = ("boundary edge", "constrained edge", "edge between fixed vertices")


def _first(found: Iterable[_Found], most: int) -> list[_Found]:
    """At most so many of each kind, which come one kind after the other."""
    groups = itertools.groupby(found, key=lambda f: f[0])
    return [f for _, group in groups for f in itertools.islice(group, most)]


def _obstructions(
    points: np.ndarray, faces: np.ndarray, fixed: np.ndarray, inner: np.ndarray, most: int
) -> Iterator[_Found]:
    """What stands in the way of the triangles as they are, `most` of each kind at most."""
    for row in fallen_fixed_triangles(points, faces, fixed)[:most].tolist():
        place = _at(points[faces[row]].mean(0))
        text = (
            f"triangles row {row} {faces[row].tolist()} at {_text(place)} has three fixed vertices, and is not upright"
        )
        yield ProblemKind.FIXED_TRIANGLE, text, tuple(faces[row].tolist()), place
    for v in vertices_without_kernel(points, faces, fixed, inner, most)[:most].tolist():
        ring = np.setdiff1d(faces[(faces == v).any(1)], [v])
        place = _at(points[ring].mean(0))
        text = f"the vertices round vertex {v}, near {_text(place)}, are fixed and leave it no place"
        yield ProblemKind.NO_KERNEL, text, (v,), place


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
    points: np.ndarray, edges: np.ndarray, what: np.ndarray, of_piece: np.ndarray, fixed: np.ndarray, most: int
) -> list[_Found]:
    """Boundary edges, held edges and fixed vertices of one piece that meet where they should not."""
    single = fixed.copy()
    single[edges] = False
    # Vertices in one place have been told: the first stands for all, so that no pair is told again.
    first = _first_in_place(points, of_piece, np.flatnonzero(fixed))
    segments = np.concatenate(
        [first[edges], np.repeat(np.flatnonzero(single & (first == np.arange(len(first)))), 2).reshape(-1, 2)]
    )
    given = np.concatenate([edges, segments[len(edges) :]])
    kinds = np.concatenate([what, np.full(len(segments) - len(edges), _SINGLE)])
    proper = (segments[:, 0] != segments[:, 1]) | (kinds == _SINGLE)
    _, rows = np.unique(segments.min(1) * len(points) + segments.max(1), return_index=True)
    rows = np.sort(rows[proper[rows]])
    segments, given, kinds = segments[rows], given[rows], kinds[rows]
    found: list[_Found] = []
    told = dict.fromkeys(ProblemKind, 0)
    group = of_piece[segments[:, 0]]
    among_edges = np.flatnonzero(kinds != _SINGLE)
    pairs = among_edges[crossing_pairs(points, segments[among_edges], group[among_edges], enough=10 * most)]
    if len(pairs) < most and len(among_edges) < len(segments):
        pairs = crossing_pairs(points, segments, group, enough=10 * most)
    for i, j in pairs.tolist():
        (a, b), (c, d) = given[[i, j]].tolist()
        kind = (
            ProblemKind.VERTEX_OUTSIDE
            if kinds[j] == _SINGLE
            else (ProblemKind.BOUNDARY_CROSSING, ProblemKind.CONSTRAINT_CROSSING, ProblemKind.FIXED_EDGE)[
                max(kinds[i], kinds[j])
            ]
        )
        told[kind] += 1
        if told[kind] > most:
            continue
        place = _at(points[c]) if c == d else _meeting_place(points, (a, b), (c, d))
        if kinds[j] == _SINGLE:
            text = f"the fixed vertex {c} lies on the {_NAMES[kinds[i]]} [{a}, {b}] at {_text(place)}"
            found.append((kind, text, (c, a, b), place))
            continue
        text = f"the {_NAMES[kinds[i]]} [{a}, {b}] and the {_NAMES[kinds[j]]} [{c}, {d}] meet at about {_text(place)}"
        found.append((kind, text, (a, b, c, d), place))
    return found


def _first_in_place(points: np.ndarray, of_piece: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(V,) for the vertices `rows` the first of them in the same place of the same piece, for others themselves."""
    first = np.arange(len(points))
    rows = rows[np.lexsort((rows, points[rows, 1], points[rows, 0], of_piece[rows]))]
    if len(rows):
        new = (points[rows[1:]] != points[rows[:-1]]).any(1) | (of_piece[rows[1:]] != of_piece[rows[:-1]])
        starts = np.concatenate([[True], new])
        first[rows] = rows[starts][np.cumsum(starts) - 1]
    return first


def _nestings(
    points: np.ndarray, rim: np.ndarray, of_edge: np.ndarray, faces: np.ndarray, of_face: np.ndarray, fixed: np.ndarray
) -> Iterator[_Found]:
    """What is wrong with the regions, whose edges `rim` (E, 2) do not cross: how their loops and vertices lie.

    of_edge (E,), of_face (T,): the region of each edge of the rim and of each of the `faces` (T, 3)
    """
    count = len(points)
    # Each region has names of its own for its vertices.
    named = rim + count * of_edge[:, None]
    loops = loops_of(named)
    mine: dict[int, list[int]] = {}
    for i, loop in enumerate(loops):
        mine.setdefault(int(loop[0]) // count, []).append(i)
    loops = [loop % count for loop in loops]
    turn = turns_left(points, loops)
    of_vertex = np.full(count, -1)
    of_vertex[rim] = of_edge[:, None]
    corners = np.flatnonzero(fixed[faces])
    vertex, of_corner = faces.ravel()[corners], of_face[corners // 3]
    doubtful = of_vertex[vertex] != of_corner
    inside = distinct((vertex + count * of_corner)[doubtful])
    inside = inside[~among(inside, named)]
    anchors = {int(keys[0]) // count: keys % count for keys in _runs(inside, inside // count)}
    for region in np.flatnonzero(np.bincount(of_face)).tolist():
        rows = mine.get(region, [])
        if not rows:
            v = int(faces[of_face == region][0, 0])
            text = f"the triangles around vertex {v} close up as on a sphere: they have no boundary"
            yield ProblemKind.NO_AREA, text, (v,), _at(points[v])
        elif len(rows) > 1 or turn[rows[0]] <= 0 or region in anchors:
            yield from _nesting(points, [loops[i] for i in rows], turn[rows], anchors.get(region, inside[:0]))


def _runs(values: np.ndarray, label: np.ndarray) -> list[np.ndarray]:
    """`values` (N,) cut where their `label` (N,) changes."""
    return [part for part in np.split(values, np.flatnonzero(np.diff(label)) + 1) if len(part)]


def _nesting(points: np.ndarray, loops: list[np.ndarray], turn: np.ndarray, inside: np.ndarray) -> Iterator[_Found]:
    """What is wrong with one region of loops that turn to the left or not, and the fixed vertices in it."""
    left = np.flatnonzero(turn > 0)
    if not len(left):
        longest = loops[int(np.argmax([_extent(points[loop]) for loop in loops]))]
        place = _at(points[longest[0]])
        text = f"the loop through vertex {longest[0]} at {_text(place)} runs clockwise: its region has no positive area"
        yield ProblemKind.NO_AREA, text, (int(longest[0]),), place
        return
    outer_row = left[int(np.argmax([_extent(points[loops[i]]) for i in left]))] if len(left) > 1 else left[0]
    outer = loop_edges(loops[outer_row])
    sound = True
    for i, hole in enumerate(loops):
        if i == outer_row:
            continue
        alone = hole[~among(hole, outer)]
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
    if sound and len(inside):
        yield from _outside(points, loops, outer_row, inside)


def _outside(points: np.ndarray, loops: list[np.ndarray], outer: int, rows: np.ndarray) -> Iterator[_Found]:
    """Those of a region's fixed vertices `rows` (N,) that are not in it."""
    # Shapely clears the many that are well inside; exact signs judge the rest.
    import shapely

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
