"""How the loops of a region lie, and the fixed vertices in it, where no edges cross."""

from collections.abc import Iterator

import numpy as np

from ..triangulating.arrays import among, distinct
from ..triangulating.polygon import loop_edges, loops_of, nested_holes, turns_left, unit_exponent, winding, windings
from .problems import Finding, ProblemKind, position_of, text_of
from .walls import BOUNDARY, Walls


def nestings(walls: Walls, keep: bool) -> Iterator[Finding]:
    """What is wrong with the regions: how their loops lie, and whether their fixed vertices are inside.

    keep  are the triangles to stay, so that those between held edges have been judged already
    """
    faces, of_face, count = walls.triangles, walls.region, len(walls.points)
    if keep:
        left = ~walls.fixed[faces].all(1)
        faces, of_face = faces[left], of_face[left]
    unsettled = np.bincount(of_face, minlength=int(walls.region.max()) + 1) > 0
    # An edge with the same region on both sides is not on the region's boundary.
    taken = (walls.alone | (walls.other != walls.own)) & unsettled[walls.own]
    edges, of_edge = walls.ends[taken], walls.own[taken]
    # Each region has names of its own for its vertices.
    named = edges + count * of_edge[:, None]
    loops = loops_of(named)
    mine: dict[int, list[int]] = {}
    for i, loop in enumerate(loops):
        mine.setdefault(int(loop[0]) // count, []).append(i)
    loops = [loop % count for loop in loops]
    turn = turns_left(walls.points, loops)
    inside = _fixed_inside(walls, edges, of_edge, faces, of_face, named)
    by_region = {int(keys[0]) // count: keys % count for keys in _runs(inside, inside // count)}
    sound = _sound_with_a_hole(walls.points, loops, turn, mine) - by_region.keys()
    needed, faces_of = _triangles_needed(walls, edges, of_edge), np.bincount(walls.region)
    for region in np.flatnonzero(np.bincount(of_face)).tolist():
        rows = mine.get(region, [])
        if not rows:
            v = int(faces[of_face == region][0, 0])
            text = f"the triangles around vertex {v} close up as on a sphere: they have no boundary"
            yield Finding(ProblemKind.NO_AREA, text, (v,), position_of(walls.points[v]))
            continue
        found: list[Finding] = []
        if region not in sound and (len(rows) > 1 or turn[rows[0]] <= 0 or region in by_region):
            mine_inside = by_region.get(region, inside[:0])
            found = list(_nesting(walls.points, [loops[i] for i in rows], turn[rows], mine_inside))
        if not found and faces_of[region] != needed[region]:
            found = [_no_plane(walls, region, edges[of_edge == region], int(needed[region]))]
        yield from found


def _sound_with_a_hole(
    points: np.ndarray, loops: list[np.ndarray], turn: np.ndarray, mine: dict[int, list[int]]
) -> set[int]:
    """The regions with one outer loop and one hole that lies in it; regions have the loops `mine`.

    They are the most, and are judged together.
    """
    pairs = []
    for region, rows in mine.items():
        if len(rows) == 2 and turn[rows[0]] * turn[rows[1]] < 0:
            outer, hole = rows if turn[rows[0]] > 0 else rows[::-1]
            pairs.append((region, loops[outer], _one_off(loops[hole], loops[outer])))
    if len(pairs) < 2:
        return set()
    size = np.array([len(outer) for _, outer, _ in pairs])
    tail = np.concatenate([outer for _, outer, _ in pairs])
    head = np.concatenate([np.roll(outer, -1) for _, outer, _ in pairs])
    times = windings(points, np.array([v for _, _, v in pairs]).repeat(size), np.stack([tail, head], 1))
    first = np.cumsum(size) - size
    return {region for (region, _, _), t in zip(pairs, np.add.reduceat(times, first), strict=True) if t == 1}


def _one_off(hole: np.ndarray, outer: np.ndarray) -> int:
    """The first vertex of the hole that the outer loop does not pass; its first if it passes them all."""
    passed = set(outer.tolist())
    return next((v for v in hole.tolist() if v not in passed), int(hole[0]))


def _triangles_needed(walls: Walls, edges: np.ndarray, of_edge: np.ndarray) -> np.ndarray:
    """(R,) how many triangles each region has if it is a part of the plane and its loops are sound.

    edges, of_edge  (E, 2), (E,) the boundaries of the regions but for stretches that lie on each other, and the regions

    A plane mesh of these vertices with this boundary has, by Euler's formula, 2 I + E - 4 + 2 C triangles: I vertices
    are inside, E edges bound it, and its boundary has C components.  Whatever the triangles are, there are no others.
    """
    count, regions = len(walls.points), len(walls.sides)
    doubled = _doubled(walls)
    bounds = np.concatenate([edges + count * of_edge[:, None], (walls.ends + count * walls.own[:, None])[doubled]])
    inside = distinct((walls.triangles + count * walls.region[:, None]).ravel())
    inside = inside[~among(inside, bounds)]
    components = np.bincount(_roots(bounds) // count, minlength=regions)
    return 2 * np.bincount(inside // count, minlength=regions) + walls.sides - 4 + 2 * components


def _doubled(walls: Walls) -> np.ndarray:
    """(H,) bool, the half-edges of stretches of boundary that lie on each other."""
    return (walls.own == walls.other) & ~walls.alone & (walls.kind == BOUNDARY)


def _no_plane(walls: Walls, region: int, edges: np.ndarray, needed: int) -> Finding:
    """What is wrong with a region whose loops are sound, and which has not the `needed` number of triangles.

    edges  (E, 2) its boundary but for stretches that lie on each other
    """
    faces = walls.triangles[walls.region == region]
    bounds = np.concatenate([edges, walls.ends[_doubled(walls) & (walls.own == region)]])
    v = _pinched(faces, bounds)
    if v is not None:
        place = position_of(walls.points[v])
        text = f"the triangles at vertex {v} at {text_of(place)} close around it, and others end there at the boundary"
    else:
        v = int(faces[0, 0])
        place = position_of(walls.points[v])
        text = f"the {len(faces)} triangles around vertex {v} form a surface that is no part of a plane"
        if (len(faces) - needed) % 4 == 0 and len(faces) > needed:
            handles = (len(faces) - needed) // 4
            text += f": it has {handles} handle{'s' * (handles > 1)}, as a torus has"
    text += f" (a plane mesh with these vertices and this boundary has {needed} triangles, not {len(faces)})"
    return Finding(ProblemKind.NOT_PLANE, text, (v,), place)


def _roots(edges: np.ndarray) -> np.ndarray:
    """(C,) the lowest vertex of each component of the graph with these edges (E, 2).

    Roots are hooked to the lowest root that an edge leads to, and trees are flattened, until nothing changes (Shiloach
    & Vishkin 1982, as in `connectivity.triangle_components`): small meshes need not wait for scipy.
    """
    names, ends = np.unique(edges, return_inverse=True)
    a, b = ends.reshape(-1, 2).T
    root = np.arange(len(names))
    while True:
        one, two = root[a], root[b]
        hooked = root.copy()
        np.minimum.at(hooked, np.maximum(one, two), np.minimum(one, two))
        while not np.array_equal(hooked[hooked], hooked):
            hooked = hooked[hooked]
        if np.array_equal(hooked, root):
            return names[distinct(root)]
        root = hooked


def _pinched(faces: np.ndarray, bounds: np.ndarray) -> int | None:
    """A vertex on the boundary around which some of the triangles (T, 3) close; None if there is none."""
    for v in distinct(bounds).tolist():
        onward: dict[int, int] = {}
        for row in faces[(faces == v).any(1)].tolist():
            k = row.index(v)
            onward[row[(k + 1) % 3]] = row[(k + 2) % 3]
        for begin in list(onward):
            at = onward.pop(begin, None)
            while at is not None and at != begin:
                at = onward.pop(at, None)
            if at == begin:
                return int(v)
    return None


def _fixed_inside(
    walls: Walls, edges: np.ndarray, of_edge: np.ndarray, faces: np.ndarray, of_face: np.ndarray, named: np.ndarray
) -> np.ndarray:
    """(N,) the fixed vertices off their region's boundary, each as its row plus V times its region, ascending."""
    count = len(walls.points)
    of_vertex = np.full(count, -1)
    of_vertex[edges] = of_edge[:, None]
    corners = np.flatnonzero(walls.fixed[faces])
    vertex, of_corner = faces.ravel()[corners], of_face[corners // 3]
    doubtful = of_vertex[vertex] != of_corner
    inside = distinct((vertex + count * of_corner)[doubtful])
    return inside[~among(inside, named)]


def _runs(values: np.ndarray, label: np.ndarray) -> list[np.ndarray]:
    """`values` (N,) cut where their `label` (N,) changes."""
    return [part for part in np.split(values, np.flatnonzero(np.diff(label)) + 1) if len(part)]


def _nesting(points: np.ndarray, loops: list[np.ndarray], turn: np.ndarray, inside: np.ndarray) -> Iterator[Finding]:
    """What is wrong with one region of loops that turn to the left or not, and the fixed vertices in it."""
    left = np.flatnonzero(turn > 0)
    if not len(left):
        longest = loops[int(np.argmax([_extent(points[loop]) for loop in loops]))]
        place = position_of(points[longest[0]])
        text = (
            f"the loop through vertex {longest[0]} at {text_of(place)} runs clockwise: its region has no positive area"
        )
        yield Finding(ProblemKind.NO_AREA, text, (int(longest[0]),), place)
        return
    outer_row = left[int(np.argmax([_extent(points[loops[i]]) for i in left]))] if len(left) > 1 else left[0]
    outer = loop_edges(loops[outer_row])
    sound = True
    for i, hole in enumerate(loops):
        if i == outer_row:
            continue
        alone = hole[~among(hole, outer)]
        at = alone[:1] if len(alone) else hole[:1]
        place = position_of(points[at[0]])
        if turn[i] > 0:
            text = f"the hole through vertex {at[0]} at {text_of(place)} is inside out"
            yield Finding(ProblemKind.HOLE_INSIDE_OUT, text, (int(at[0]),), place)
        elif winding(points, at, outer)[0] != 1:
            text = f"the hole through vertex {at[0]} at {text_of(place)} lies outside the outer loop"
            yield Finding(ProblemKind.HOLE_OUTSIDE, text, (int(at[0]),), place)
        else:
            continue
        sound = False
    nested = nested_holes(points, [loops[i] for i in np.flatnonzero(turn < 0)])
    if nested is not None:
        u, v = int(nested[0][0]), int(nested[1][0])
        place = position_of(points[u])
        text = f"the hole through vertex {u} at {text_of(place)} lies inside the hole through vertex {v}"
        yield Finding(ProblemKind.HOLE_OUTSIDE, text, (u, v), place)
        sound = False
    if sound and len(inside):
        yield from _outside(points, loops, outer_row, inside)


def _outside(points: np.ndarray, loops: list[np.ndarray], outer: int, rows: np.ndarray) -> Iterator[Finding]:
    """Those of a region's fixed vertices `rows` (N,) that are not in it."""
    # Shapely clears the many that are well inside; exact signs judge the rest.
    import shapely

    near_one = np.ldexp(points, -unit_exponent(points))
    rings = [near_one[loop] for loop in loops]
    polygon = shapely.Polygon(rings[outer], rings[:outer] + rings[outer + 1 :])
    shapely.prepare(polygon)
    rows = rows[~shapely.contains_xy(polygon, near_one[rows])]
    boundary = np.concatenate([loop_edges(loop) for loop in loops])
    for v in rows[winding(points, rows, boundary) != 1].tolist():
        place = position_of(points[v])
        text = f"the fixed vertex {v} at {text_of(place)} is not in its region"
        yield Finding(ProblemKind.VERTEX_OUTSIDE, text, (v,), place)


def _extent(xy: np.ndarray) -> float:
    return float(np.ptp(xy, axis=0).max())
