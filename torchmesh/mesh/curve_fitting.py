"""Boundary curves fitted through the vertices of chains of edges.

o---o---o---o        chain: edges between two corners, or round without any
  dart ->            dart: one of the two directions of an edge; its twin runs the other way
"""

import torch
from torch import Tensor

from .curves import BoundaryCurves
from .ragged import offsets_from_counts, owner_of, spread, true_rows
from .triangle import arctangent

# Turns below this many radians are rounding: the curve is straight there.
_STRAIGHT = 1e-6

# The height of an edge's arc may grow to about this many times the largest on its chain.
_HEIGHT_FACTOR = 2.0


def fit_curves(
    points: Tensor, edges: Tensor, may_slide: Tensor, corner_angle: float, point_offsets: Tensor
) -> BoundaryCurves:
    """Curves along the `edges` (E, 2) on which vertices slide, with the vertices on them as they are now.

    points         (V, 2) float64
    edges          (E, 2) int64 boundary and constrained edges, each once
    may_slide      (V,) bool: the others are corners
    corner_angle   degrees; a vertex where the chain turns by more is a corner
    point_offsets  (B+1,)

    Corners are also the ends and meetings of edges, and any bend, however slight, between two
    straight lines.
    """
    count = len(points)
    edges = edges[may_slide[edges].any(1)]
    tail, head = torch.cat([edges[:, 0], edges[:, 1]]), torch.cat([edges[:, 1], edges[:, 0]])
    darts = torch.arange(len(tail), device=tail.device)
    twin = torch.cat([darts[len(edges) :], darts[: len(edges)]])
    # Two darts leave a vertex inside a chain: their sum less the one is the other.
    both = torch.zeros(count, dtype=torch.int64, device=tail.device).index_add_(0, tail, darts)
    degree = torch.bincount(tail, minlength=count)
    one = torch.full_like(both, len(tail)).scatter_reduce_(0, tail, darts, "amin")
    inner = may_slide & (degree == 2)
    vertex = true_rows(inner)
    turn, straight, corner = _bends(points, head[one[vertex]], vertex, head[both[vertex] - one[vertex]], corner_angle)
    slider = inner & ~corner
    following = torch.where(slider[head], both[head] - twin, -1)
    darts, chain = _chains(tail, following, twin, slider[tail] | slider[head], point_offsets)
    # A chain of m darts has m + 1 stations: their tails and the last one's head.
    ends = offsets_from_counts(torch.bincount(chain) + 1)
    station = torch.arange(len(darts), device=tail.device) + chain
    rows = torch.zeros(int(ends[-1]), dtype=torch.int64, device=tail.device)
    rows[station], rows[ends[1:] - 1] = tail[darts], head[darts[station + 2 == ends[1:][chain]]]
    return _through(points, rows, ends, slider, straight, turn, point_offsets)


def _bends(points: Tensor, a: Tensor, b: Tensor, c: Tensor, corner_angle: float) -> tuple[Tensor, Tensor, Tensor]:
    """How chains turn at the vertices b (N,) between a and c: (V,) radians, (V,) bool straight, (V,) bool a corner."""
    turn = points.new_zeros(len(points))
    straight, corner = (torch.zeros(len(points), dtype=torch.bool, device=points.device) for _ in range(2))
    turn[b] = _turn(points[a], points[b], points[c])
    straight[b] = turn[b] <= _STRAIGHT
    corner[b] = (turn[b] > corner_angle * (torch.pi / 180)) | (~straight[b] & straight[a] & straight[c])
    return turn, straight, corner


def _chains(
    tail: Tensor, following: Tensor, twin: Tensor, wanted: Tensor, point_offsets: Tensor
) -> tuple[Tensor, Tensor]:
    """(M,) the darts of the chains in order, mesh by mesh and chain by chain, and (M,) their chains.

    following  (D,) as in `_walks`;  wanted (D,) bool, darts with an end that slides
    """
    start, rank = _walks(following, twin)
    # Each chain is walked in both directions: the one that starts from the lower dart counts.
    kept = true_rows((start < start[twin]) & wanted)
    mesh = owner_of(tail[kept], point_offsets)
    order = rank[kept].argsort(stable=True)
    order = order[start[kept[order]].argsort(stable=True)]
    order = order[mesh[order].argsort(stable=True)]
    darts = kept[order]
    begins = torch.ones(len(darts), dtype=torch.bool, device=tail.device)
    begins[1:] = start[darts[1:]] != start[darts[:-1]]
    return darts, begins.to(torch.int64).cumsum(0) - 1


def _through(
    points: Tensor, rows: Tensor, ends: Tensor, slider: Tensor, straight: Tensor, turn: Tensor, point_offsets: Tensor
) -> BoundaryCurves:
    """The curves through the vertices `rows` (K,), chain after chain; `ends` (C+1,) are the chains' offsets."""
    owner = owner_of(rows, point_offsets)
    first, last = spread(ends[:-1], ends), spread(ends[1:] - 1, ends)
    here = torch.arange(len(rows), device=rows.device)
    closed = (rows[first] == rows[last]) & slider[rows[first]]
    after = torch.where(here == last, torch.where(closed, first + 1, last), here + 1)
    before = torch.where(here == first, torch.where(closed, last - 1, first), here - 1)
    knots = points[rows]
    onward = torch.where(here == last, here, here + 1)
    along = knots[onward] - knots
    length = (along[:, 0] * along[:, 0] + along[:, 1] * along[:, 1]).sqrt()
    unit = along / torch.where(length > 0, length, 1.0)[:, None]
    line = (straight[rows] | straight[rows[onward]]) & (here != last)
    leave, arrive = _tangents(unit, length, line, first, last, before, closed)
    # Chord lengths and turnings are summed chain by chain, so that they do not depend on the chains before.
    at_knot = _running_sum(torch.where(here == first, 0.0, length[here - 1]), here - first)
    turned = turn[rows]
    turned = torch.where(slider[rows], turned, torch.where(here == first, turned[onward], turned[here - 1]))
    half = torch.where(line | (here == last), 0.0, 0.5 * (turned + turned[onward]))
    bend = _running_sum(torch.where(here == first, 0.0, half[here - 1]), here - first)
    height = spread(torch.segment_reduce(length * half / 8, "max", offsets=ends, initial=0.0), ends)
    return BoundaryCurves(
        rows - point_offsets[owner],
        slider[rows] & ~(closed & (here == last)),
        after,
        before,
        first,
        last,
        torch.where(closed, at_knot[last], 0.0),
        line,
        knots,
        leave,
        arrive,
        at_knot,
        bend,
        _HEIGHT_FACTOR * height,
        at_knot.clone(),
        offsets_from_counts(torch.bincount(owner, minlength=len(point_offsets) - 1)),
    )


def _tangents(
    unit: Tensor, length: Tensor, line: Tensor, first: Tensor, last: Tensor, before: Tensor, closed: Tensor
) -> tuple[Tensor, Tensor]:
    """(K, 2) tangents at both ends of the segments after the knots, from the directions and lengths of the segments.

    Where two segments meet, the tangent is that of the circle through their three knots: its angles
    to the two chords have sines as their lengths.  A straight line's direction goes before that.
    """
    here = torch.arange(len(unit), device=unit.device)
    segment_in = torch.where(here == last, last - 1, before)  # of an open chain's first knot: none
    segment_out = torch.where(here == last, torch.where(closed, first, last), here)
    joint = closed | ((here != first) & (here != last))
    circle = unit[segment_in] * length[segment_out][:, None] + unit[segment_out] * length[segment_in][:, None]
    tangent = torch.where(line[segment_in][:, None], unit[segment_in], circle)
    tangent = torch.where(line[segment_out][:, None], unit[segment_out], tangent)
    size = (tangent[:, 0] * tangent[:, 0] + tangent[:, 1] * tangent[:, 1]).sqrt()
    tangent = tangent / torch.where(size > 0, size, 1.0)[:, None]
    onward = torch.where(here == last, here, here + 1)
    leave, arrive = tangent, tangent[onward]
    # At the end of an open chain: the other end's tangent mirrored, as an arc has it.
    leave = torch.where(joint[:, None], leave, _mirrored(arrive, unit))
    arrive = torch.where(joint[onward][:, None], arrive, _mirrored(leave, unit))
    leave, arrive = (torch.where(line[:, None], unit, t) for t in (leave, arrive))
    return tuple(_handle(t, unit) for t in (leave, arrive))  # type: ignore[return-value]


def _mirrored(tangent: Tensor, chord: Tensor) -> Tensor:
    """(K, 2) tangents mirrored in their chords' directions."""
    return 2 * _dot(tangent, chord)[:, None] * chord - tangent


def _handle(tangent: Tensor, chord: Tensor) -> Tensor:
    """(K, 2) tangents as long as those of an arc over the chord: a = angle between them, 1 / cos^2(a / 2)."""
    cosine = _dot(tangent, chord).clamp_min(0)
    return torch.where((tangent == chord).all(1)[:, None], tangent, tangent * (2 / (1 + cosine))[:, None])


def _dot(u: Tensor, v: Tensor) -> Tensor:
    return u[:, 0] * v[:, 0] + u[:, 1] * v[:, 1]


def _turn(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    """(N,) unsigned angle by which the way from a over b to c turns, in radians."""
    u, v = b - a, c - b
    return arctangent((u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).abs(), _dot(u, v))


def _walks(following: Tensor, twin: Tensor) -> tuple[Tensor, Tensor]:
    """(D,) where each dart's walk starts and how many darts come before it; a round walk starts from its lowest.

    following  (D,) the next dart, or -1 at the end of the walk
    twin       (D,) the dart the other way: the walk before a dart is that after its twin, backwards

    By pointer doubling: each pass doubles the distance looked over.
    """
    darts = torch.arange(len(following), device=following.device)
    passes = len(darts).bit_length()
    lowest, hop = darts, torch.where(following >= 0, following, darts)
    for _ in range(passes):
        lowest, hop = torch.minimum(lowest, lowest[hop]), hop[hop]
    round_walk = following[hop] >= 0
    behind = following[twin]
    behind = torch.where(behind >= 0, twin[behind.clamp_min(0)], -1)
    behind = torch.where(round_walk & (lowest == darts), -1, behind)
    start, rank = torch.where(behind >= 0, behind, darts), (behind >= 0).to(torch.int64)
    for _ in range(passes):
        rank, start = rank + rank[start], start[start]
    return start, rank


def _running_sum(values: Tensor, rank: Tensor) -> Tensor:
    """(K,) sums of `values` from each run's beginning, where `rank` is 0, up to and with each row.

    By doubling, so that a row's bits depend on its own run only.
    """
    total = values
    here = torch.arange(len(values), device=values.device)
    step = 1
    while step <= int(rank.max() if len(rank) else 0):
        reached = rank >= step
        total = torch.where(reached, total + total[(here - step).clamp_min(0)], total)
        step *= 2
    return total
