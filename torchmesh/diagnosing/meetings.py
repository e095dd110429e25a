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
    found: list[Finding] = []
    told = dict.fromkeys(ProblemKind, 0)
    for i, j in pairs.tolist():
        (a, b), (c, d) = given[[i, j]].tolist()
        single = kind[j] == _SINGLE
        problem = ProblemKind.VERTEX_OUTSIDE if single else _PROBLEMS[max(kind[i], kind[j])]
        told[problem] += 1
        if told[problem] > most:
            continue
        place = position_of(points[c]) if c == d else _meeting_position(points, (a, b), (c, d))
        one = f"the {_NAMES[kind[i]]} [{a}, {b}]"
        if single:
            text = f"the fixed vertex {c} lies on {one} at {text_of(place)}"
            found.append(Finding(problem, text, (c, a, b), place))
        else:
            text = f"{one} and the {_NAMES[kind[j]]} [{c}, {d}] meet at about {text_of(place)}"
            found.append(Finding(problem, text, (a, b, c, d), place))
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


def _meeting_position(points: np.ndarray, one: tuple[int, int], two: tuple[int, int]) -> tuple[float, float]:
    """About where the two segments meet: their crossing, or the middle of what both have in common."""
    (a, b), (c, d) = points[list(one)], points[list(two)]
    scale = max(np.abs(np.stack([b - a, d - c])).max(), np.finfo(float).tiny)
    p, q, r = (b - a) / scale, (d - c) / scale, (c - a) / scale
    denominator = p[0] * q[1] - p[1] * q[0]
    if abs(denominator) > 1e-12:
        s = (r[0] * q[1] - r[1] * q[0]) / denominator
        return position_of(a + min(max(s, 0.0), 1.0) * (b - a))
    middle = np.stack([a, b, c, d])
    middle = middle[np.argsort(middle @ (np.abs(p) > 0))][1:3]
    return position_of(middle[0] + (middle[1] - middle[0]) / 2)
