"""Fixed vertices and edges of one piece that meet where they should not."""

from collections.abc import Iterator

import numpy as np

from ..triangulating.crossings import crossing_pairs
from ..triangulating.touching import PlaneBoundary, first_in_position, wrong_turns
from .problems import Finding, ProblemKind, position_of, text_of
from .walls import Walls

# The kind of a fixed vertex on no wall, which is looked at as a segment of no length; beyond those of `walls`.
_SINGLE = 3

# By the kind of an edge: what it is called, and what it is when the edge of the higher kind of two meets another.
_NAMES = ("boundary edge", "constrained edge", "edge between fixed vertices")
_PROBLEMS = (ProblemKind.BOUNDARY_CROSSING, ProblemKind.CONSTRAINT_CROSSING, ProblemKind.FIXED_EDGE)


def duplicates(walls: Walls) -> Iterator[Finding]:
    """Fixed vertices of one piece in one position."""
    points, piece = walls.points, walls.piece
    rows = np.flatnonzero(walls.fixed)
    rows = rows[np.lexsort((points[rows, 1], points[rows, 0], piece[rows]))]
    same = (points[rows[1:]] == points[rows[:-1]]).all(1) & (piece[rows[1:]] == piece[rows[:-1]])
    for i in np.flatnonzero(same):
        u, v = sorted((int(rows[i]), int(rows[i + 1])))
        place = position_of(points[u])
        text = f"vertices {u} and {v} are both at {text_of(place)}"
        yield Finding(ProblemKind.DUPLICATE_VERTICES, text, (u, v), place)


def crossings(walls: Walls, edges: np.ndarray, kind: np.ndarray, most: int) -> list[Finding]:
    """Edges, and fixed vertices on no wall, that meet where they should not; of each kind `most` at most.

    edges, kind  (E, 2), (E,) the edges of the walls to look at
    """
    points = walls.points
    given, segments, kind = _segments(walls, edges, kind)
    group = walls.piece[segments[:, 0]]
    long = np.flatnonzero(kind != _SINGLE)
    # Of more pairs than are told, those beyond count for nothing; but kinds come mixed, so some more are found.
    pairs = long[crossing_pairs(points, segments[long], group[long], enough=10 * most)]
    if len(pairs) < most and len(long) < len(segments):
        pairs = crossing_pairs(points, segments, group, enough=10 * most)
    i, j = pairs.T
    # A vertex alone stands after all edges.
    worse = np.maximum(kind[i], kind[j])
    told = np.concatenate([np.flatnonzero(worse == k)[:most] for k in range(_SINGLE + 1)])
    told.sort()
    i, j, worse = i[told], j[told], worse[told]
    places = _meeting_positions(points, given[i], given[j])
    found: list[Finding] = []
    for (a, b), (c, d), one, two, k, xy in zip(
        *(v.tolist() for v in (given[i], given[j], kind[i], kind[j], worse, places)), strict=True
    ):
        place = (xy[0], xy[1])
        edge = f"the {_NAMES[one]} [{a}, {b}]"
        if k == _SINGLE:
            text = f"the fixed vertex {c} lies on {edge} at {text_of(place)}"
            found.append(Finding(ProblemKind.VERTEX_OUTSIDE, text, (c, a, b), place))
        else:
            text = f"{edge} and the {_NAMES[two]} [{c}, {d}] meet at about {text_of(place)}"
            found.append(Finding(_PROBLEMS[k], text, (a, b, c, d), place))
    return found


def overlaps(walls: Walls, plane: PlaneBoundary) -> Iterator[Finding]:
    """Walls of no length, and boundary edges that lie on each other with the domain on one side.

    walls  as they are
    plane  their boundary, which touches itself, as of `Walls.in_plane`
    """
    points, ends = walls.points, walls.ends[walls.once]
    for u, v in np.sort(ends[(points[ends[:, 0]] == points[ends[:, 1]]).all(1)], 1).tolist():
        place = position_of(points[u])
        text = f"vertices {u} and {v} are both at {text_of(place)}, with an edge between them that must stay "
        text += "(torchmesh clean mends this on a boundary)"
        yield Finding(ProblemKind.DUPLICATE_VERTICES, text, (u, v), place)
    for a, b in walls.ends[walls.alone][plane.twice].tolist():
        place = position_of(points[a] + (points[b] - points[a]) / 2)
        text = f"the boundary edge [{a}, {b}] lies on the same side of another at about {text_of(place)}"
        yield Finding(ProblemKind.BOUNDARY_CROSSING, text, (a, b), place)


def wrong_touchings(walls: Walls, plane: PlaneBoundary) -> Iterator[Finding]:
    """Where a boundary that meets itself in vertices only crosses itself there; arguments as of `overlaps`."""
    points, edges = walls.points, walls.ends[walls.alone]
    for p in wrong_turns(points, plane) if plane.sound else []:
        place = position_of(points[p])
        here = np.flatnonzero(plane.first[plane.stops] == p)
        if len(here):
            a, b = edges[plane.parted[here[0]]].tolist()
            text = f"the boundary vertex {p} touches the boundary edge [{a}, {b}] from inside at {text_of(place)}"
            yield Finding(ProblemKind.BOUNDARY_CROSSING, text, (p, a, b), place)
        else:
            u, v = np.flatnonzero((plane.first == p) & walls.used)[:2].tolist()
            text = f"the boundary crosses itself at vertices {u} and {v}, which are both at {text_of(place)}"
            yield Finding(ProblemKind.BOUNDARY_CROSSING, text, (u, v), place)


def _segments(walls: Walls, edges: np.ndarray, kind: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(S, 2) the ends of what may meet as they are called, (S, 2) the same with one name a position, (S,) the kind.

    The `edges` (E, 2), then fixed vertices on none of them, both ends the same.  Vertices in one position
    have been told: the first stands for all, so that no pair is told again.
    """
    single = walls.fixed.copy()
    single[edges] = False
    first = first_in_position(walls.points, np.flatnonzero(walls.fixed), walls.piece)
    alone = np.repeat(np.flatnonzero(single & (first == np.arange(len(first)))), 2).reshape(-1, 2)
    given, segments = np.concatenate([edges, alone]), np.concatenate([first[edges], alone])
    kind = np.concatenate([kind, np.full(len(alone), _SINGLE)])
    proper = (segments[:, 0] != segments[:, 1]) | (kind == _SINGLE)
    _, rows = np.unique(segments.min(1) * len(first) + segments.max(1), return_index=True)
    rows = np.sort(rows[proper[rows]])
    return given[rows], segments[rows], kind[rows]


def _meeting_positions(points: np.ndarray, one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """(P, 2) about where the segments `one` and `two` (P, 2) meet: their crossing, or the middle of what is common.

    A segment of no length meets the other where it lies.
    """
    a, b, c, d = (points[rows] for rows in (*one.T, *two.T))
    scale = np.maximum(np.abs(b - a).max(1), np.abs(d - c).max(1)).clip(np.finfo(float).tiny)[:, None]
    p, q, r = (b - a) / scale, (d - c) / scale, (c - a) / scale
    cross = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
    across = np.abs(cross) > 1e-12
    s = (r[:, 0] * q[:, 1] - r[:, 1] * q[:, 0]) / np.where(across, cross, 1.0)
    crossing = a + s.clip(0.0, 1.0)[:, None] * (b - a)
    # The four ends in their order along the line: the second and the third bound what is common.
    ends = np.stack([a, b, c, d], 1)
    order = np.argsort((ends * (np.abs(p) > 0)[:, None]).sum(2), 1)
    second, third = (np.take_along_axis(ends, order[:, k, None, None], 1)[:, 0] for k in (1, 2))
    place = np.where(across[:, None], crossing, second + (third - second) / 2)
    return np.where((two[:, 0] == two[:, 1])[:, None], c, place)
