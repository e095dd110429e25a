"""Edge flips in conflict-free rounds, on bare tensors: legality, action and the loop over rounds.

            s                        s
          / | \\                    /   \\
        /   |   \\                /       \\
      u  h  |  g  w    flip    u ----------- w     drawn the other way: before the flip the edge
        \\   |   /      <-->      \\       /         u-w is there, after it the edge r-s
          \\ | /                    \\   /
            r                        r

A round flips the edges that rank first in both their triangles, so no two of them share one; its
cost is that of the edges still in question, not of the mesh.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from torch import Tensor

from .connectivity import next_in_triangle, previous_in_triangle
from .predicates import incircle, orientation
from .triangle import Corners, inverse_mean_ratio


class Quads(NamedTuple):
    """The coordinates round N interior edges u-w, each (N,): s on their left, r on their right."""

    ux: Tensor
    uy: Tensor
    wx: Tensor
    wy: Tensor
    sx: Tensor
    sy: Tensor
    rx: Tensor
    ry: Tensor


# What a rule says of the edges in question: which to flip (N,) bool, and their rank (N,), higher first.
Rule = Callable[[Quads], tuple[Tensor, Tensor]]


@runtime_checkable
class VertexRule(Protocol):
    """A rule that must know the vertices u, w, s, r (N,) of the quads, too."""

    def at(self, u: Tensor, w: Tensor, s: Tensor, r: Tensor) -> Rule: ...


def opposite_angle_rank(q: Quads) -> Tensor:
    """(N,) the sum of the unsigned angles at s and r, which see the edge u-w, as a number from 0 to 4.

    It grows with the sum and is 2 where that is pi: the angle of the product of the two corners as
    complex numbers, measured along a square instead of a circle.  Plain arithmetic, so its bits
    do not depend on where in a vector an edge stands, as those of atan2 do.
    """
    dot_s = (q.ux - q.sx) * (q.wx - q.sx) + (q.uy - q.sy) * (q.wy - q.sy)
    dot_r = (q.ux - q.rx) * (q.wx - q.rx) + (q.uy - q.ry) * (q.wy - q.ry)
    cross_s = _double_area(q.ux, q.uy, q.wx, q.wy, q.sx, q.sy).abs()
    cross_r = _double_area(q.wx, q.wy, q.ux, q.uy, q.rx, q.ry).abs()
    real, imaginary = dot_s * dot_r - cross_s * cross_r, dot_s * cross_r + cross_s * dot_r
    size = real.abs() + imaginary.abs()
    slope = real / torch.where(size > 0, size, 1.0)
    return torch.where(imaginary >= 0, 1 - slope, 3 + slope)


def new_signs(q: Quads) -> tuple[Tensor, Tensor]:
    """(N,) exact signs of the two triangles that the flip would make, urs and rws."""
    first, second = _signs(q, "urs", "rws")
    return first, second


def old_signs(q: Quads) -> tuple[Tensor, Tensor]:
    """(N,) exact signs of the two triangles of the edge, uws and wur."""
    first, second = _signs(q, "uws", "wur")
    return first, second


def _signs(q: Quads, *triangles: str) -> Tensor:
    """(K, N) exact signs of the triangles of these corners, in one go."""
    columns = [torch.cat([getattr(q, t[i] + axis) for t in triangles]) for i in range(3) for axis in "xy"]
    return orientation(*columns).view(len(triangles), -1)


def kim_rule(q: Quads) -> tuple[Tensor, Tensor]:
    """Kim 2017, Step 1: flip when the opposite angles sum to more than pi and no new triangle inverts.

    For two upright triangles the sum is compared by the exact in-circle sign, which is the same
    criterion (Delaunay); ranked by the sum.
    """
    total = opposite_angle_rank(q)
    eligible = total > 2 - 1e-12
    rows = eligible.nonzero().squeeze(1)
    few = _some(q, rows)
    left, right = old_signs(few)
    upright = (left > 0) & (right > 0)
    inside = incircle(few.ux, few.uy, few.wx, few.wy, few.sx, few.sy, few.rx, few.ry) > 0
    first, second = new_signs(few)
    eligible = eligible.clone()
    eligible[rows] = torch.where(upright, inside, total[rows] > 2) & (first > 0) & (second > 0)
    return eligible, total


def safe_rule(q: Quads) -> tuple[Tensor, Tensor]:
    """Flips that cannot do harm: towards a lower sum of |area|; among upright pairs, Delaunay.

    A pair's signed areas sum to the same before and after, so its sum of |area| falls exactly when
    its inverted area does.  Inverted area never grows, nor the count of inverted triangles; at
    equal inverted area flat triangles go, and between two upright pairs the Delaunay one wins.
    The three together strictly decrease in lexicographic order: rounds cannot cycle.
    """
    left, right = old_signs(q)
    upright = (left > 0) & (right > 0)
    rank, rounding = _cotangent_deficit(q)
    # The deficit is positive where the in-circle sign is: far from zero it saves asking for that sign.
    rows = (~upright | (rank > -rounding)).nonzero().squeeze(1)
    few = _some(q, rows)
    delaunay = incircle(few.ux, few.uy, few.wx, few.wy, few.sx, few.sy, few.rx, few.ry) > 0
    first, second = new_signs(few)
    made_upright = (first > 0) & (second > 0)
    before = [_double_area(few.ux, few.uy, few.wx, few.wy, few.sx, few.sy)]
    before.append(_double_area(few.wx, few.wy, few.ux, few.uy, few.rx, few.ry))
    after = [_double_area(few.ux, few.uy, few.rx, few.ry, few.sx, few.sy)]
    after.append(_double_area(few.rx, few.ry, few.wx, few.wy, few.sx, few.sy))
    gain = _inverted_area(before) - _inverted_area(after)
    smallest = 1e-14 * torch.stack(before + after).abs().sum(0)
    old_left, old_right = left[rows], right[rows]
    count_before = (old_left < 0).to(torch.int8) + (old_right < 0)
    count_after = (first < 0).to(torch.int8) + (second < 0)
    lower = (gain > smallest) & (count_after <= count_before)
    unflattened = (old_left >= 0) & (old_right >= 0) & made_upright
    is_upright = upright[rows]
    eligible = torch.zeros_like(upright)
    eligible[rows] = torch.where(is_upright, delaunay & made_upright, lower | unflattened)
    # Untangling flips come before Delaunay flips, the largest relative gain first.
    rank[rows] = torch.where(is_upright, rank[rows], 1e30 * (1 + gain / smallest.clamp_min(1e-300)))
    return eligible, rank


def shape_rule(q: Quads) -> tuple[Tensor, Tensor]:
    """Flip between upright pairs when the sum of squared inverse mean ratios falls: the smoother's energy.

    Only edges that are nearly not Delaunay are asked: the longer diagonal of two good triangles.
    """
    near = _cotangent_deficit(q)[0] > -0.5
    rows = near.nonzero().squeeze(1)
    few = _some(q, rows)
    gain = _pair_energy(few, False) - _pair_energy(few, True)
    wins = (gain > 1e-10).nonzero().squeeze(1)
    fewer = _some(few, wins)
    legal = _signs(fewer, "uws", "wur", "urs", "rws").amin(0) > 0
    eligible = torch.zeros_like(near)
    eligible[rows[wins[legal]]] = True
    rank = torch.zeros_like(q.ux)
    rank[rows] = gain
    return eligible, rank


def _some(q: Quads, rows: Tensor) -> Quads:
    return Quads(*(v.index_select(0, rows) for v in q))


def _pair_energy(q: Quads, flipped: bool) -> Tensor:
    if flipped:
        first, second = Corners(q.ux, q.uy, q.rx, q.ry, q.sx, q.sy), Corners(q.rx, q.ry, q.wx, q.wy, q.sx, q.sy)
    else:
        first, second = Corners(q.ux, q.uy, q.wx, q.wy, q.sx, q.sy), Corners(q.wx, q.wy, q.ux, q.uy, q.rx, q.ry)
    # A flat triangle's infinity must not meet another in a difference.
    return inverse_mean_ratio(first).clamp_max(1e30).square() + inverse_mean_ratio(second).clamp_max(1e30).square()


def edge_exists(vertex: Tensor, twin: Tensor, start: Tensor, target: Tensor) -> Tensor:
    """(N,) bool: does the fan of triangles round the tail of each half-edge `start` (N,) have an edge to `target`."""
    gather = torch.index_select
    found = torch.zeros(len(start), dtype=torch.bool, device=start.device)
    rows = torch.arange(len(start), device=start.device)
    here, goal = start, target
    ends = []
    while len(rows):
        behind = previous_in_triangle(here)
        hit = (gather(vertex, 0, next_in_triangle(here)) == goal) | (gather(vertex, 0, behind) == goal)
        found[rows[hit]] = True
        onward = gather(twin, 0, behind)
        ends.append(rows[~hit & (onward < 0)])
        going = (~hit & (onward >= 0) & (onward != gather(start, 0, rows))).nonzero().squeeze(1)
        rows, here, goal = gather(rows, 0, going), gather(onward, 0, going), gather(goal, 0, going)
    # Where the fan is open at one end, on from the start the other way.
    rows = torch.cat(ends) if ends else rows
    here = twin[start[rows]]
    while len(rows):
        inner = here >= 0
        rows, here = rows[inner], next_in_triangle(here[inner])
        goal = target[rows]
        hit = (vertex[next_in_triangle(here)] == goal) | (vertex[previous_in_triangle(here)] == goal)
        found[rows[hit]] = True
        rows, here = rows[~hit], twin[here[~hit]]
    return found


def flip_rounds(
    points: Tensor,
    triangles: Tensor,
    twin: Tensor,
    locked: Tensor,
    rule: Rule | VertexRule,
    *,
    once: bool = False,
    max_rounds: int = 10_000,
    around: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Flip by `rule` until no edge is eligible; returns triangles, twin and a log of the flips.

    points     (V, 2) coordinates
    triangles  (T, 3) int64; not changed, the result is a new tensor
    twin       (3T,) int64; likewise
    locked     (3T,) bool half-edges (both of an edge) that must stay
    once       an edge that a flip made is not flipped again
    around     (T,) bool: ask at first only about the edges of these triangles; None: about all

    The log is (F,) int64, the lower-numbered triangle of each flip, for counting them per mesh.
    """
    gather = torch.index_select
    x, y = points[:, 0].contiguous(), points[:, 1].contiguous()
    vertex, twin, locked = triangles.reshape(-1).clone(), twin.clone(), locked.clone()
    moved = torch.arange(len(vertex), device=vertex.device)
    before = moved.reshape(-1, 3).roll(1, 1).reshape(-1)
    best = torch.full((len(triangles),), len(vertex), dtype=torch.int64, device=vertex.device)
    pinched = torch.bincount(vertex[twin < 0], minlength=len(points)) > 1
    log = []
    if around is None:
        queue = (twin > moved).nonzero().squeeze(1)
    else:
        corner = (around.nonzero() * 3 + torch.arange(3, device=around.device)).reshape(-1)
        queue = _canonical(corner, twin)
    for _ in range(max_rounds):
        queue = queue[~locked.index_select(0, queue)]
        h, rank, barred = _eligible(x, y, vertex, twin, before, pinched, queue, rule)
        if not len(h):
            break
        # Equal ranks stay in the order of their index: h ascends and the sort is stable.
        h = gather(h, 0, rank.argsort(descending=True, stable=True))
        chosen = _first_in_both(h, twin, best)
        chosen &= _first_of_its_key(vertex, twin, before, h, chosen)
        flipped, left = h[chosen], h[~chosen]
        both = torch.cat([flipped, gather(twin, 0, flipped)])
        log.append((both // 3).view(2, -1).amin(0))
        onward = _flip(vertex, twin, locked, moved, before, both, once)
        waiting = gather(moved, 0, torch.cat([left, barred]))
        queue = _canonical(torch.cat([waiting, both, gather(before, 0, both)]), twin)
        moved.scatter_(0, onward, onward)
    flips = torch.cat(log) if log else torch.zeros(0, dtype=torch.int64, device=vertex.device)
    return vertex.reshape(-1, 3), twin, flips


def _double_area(ax: Tensor, ay: Tensor, bx: Tensor, by: Tensor, cx: Tensor, cy: Tensor) -> Tensor:
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def _inverted_area(double_areas: list[Tensor]) -> Tensor:
    return torch.stack(double_areas).clamp_max(0).sum(0).neg()


def _cotangent_deficit(q: Quads) -> tuple[Tensor, Tensor]:
    """(N,) minus the sum of the cotangents of the opposite angles: positive when they exceed pi.

    And (N,) more than rounding may have added to it or taken from it.
    """
    dot_s = (q.ux - q.sx) * (q.wx - q.sx) + (q.uy - q.sy) * (q.wy - q.sy)
    dot_r = (q.ux - q.rx) * (q.wx - q.rx) + (q.uy - q.ry) * (q.wy - q.ry)
    cross_s = _double_area(q.ux, q.uy, q.wx, q.wy, q.sx, q.sy).abs().clamp_min(1e-300)
    cross_r = _double_area(q.wx, q.wy, q.ux, q.uy, q.rx, q.ry).abs().clamp_min(1e-300)
    cot_s, cot_r = dot_s / cross_s, dot_r / cross_r
    # A cross product is off by some last digits of its terms, which are at most 1 + |cot| times as large.
    rounding = 1e-13 * ((1 + cot_s.abs()).square_() + (1 + cot_r.abs()).square_())
    rounding.masked_fill_(torch.minimum(cross_s, cross_r) < 1e-290, torch.inf)
    return -(cot_s + cot_r).clamp(-1e29, 1e29), rounding


def _canonical(h: Tensor, twin: Tensor) -> Tensor:
    """The interior edges among half-edges h, each once, as its lower half-edge, ascending."""
    other = twin.index_select(0, h)
    lower = torch.minimum(h, other)
    if _SPARSE * len(h) < len(twin):
        return lower[other >= 0].unique()
    # To mark them among all is faster than to sort many.
    marks = torch.zeros(len(twin) + 1, dtype=torch.bool, device=h.device)
    marks.index_fill_(0, torch.where(other >= 0, lower, len(twin)), True)
    return marks[:-1].nonzero().squeeze(1)


# Half-edges of the mesh to one in question, above which few are in question.
_SPARSE = 16


def _eligible(
    x: Tensor,
    y: Tensor,
    vertex: Tensor,
    twin: Tensor,
    before: Tensor,
    pinched: Tensor,
    queue: Tensor,
    rule: Rule | VertexRule,
) -> tuple[Tensor, Tensor, Tensor]:
    """The half-edges of the queue that the rule wants flipped and that may be, with their rank.

    And those it wants flipped whose new edge is there already: they wait until it goes.
    before   (3T,) int64, the half-edge before each in its triangle
    pinched  (V,) bool, the vertices where several fans of triangles meet
    """
    rows, ranks = [], []
    for start in range(0, len(queue), _CHUNK):
        part = queue[start : start + _CHUNK]
        wanted, rank = _ask(x, y, vertex, twin, before, part, rule)
        rows.append(part[wanted])
        ranks.append(rank[wanted])
    h, rank = torch.cat(rows or [queue]), torch.cat(ranks or [x[:0]])
    gather = torch.index_select
    last_h, last_g = gather(before, 0, h), gather(before, 0, gather(twin, 0, h))
    s, r = gather(vertex, 0, last_h), gather(vertex, 0, last_g)
    # Walking one fan tells all edges of a vertex that has only one.
    from_r = gather(pinched, 0, s)
    exists = edge_exists(vertex, twin, torch.where(from_r, last_g, last_h), torch.where(from_r, s, r))
    exists |= from_r & gather(pinched, 0, r)
    return h[~exists], rank[~exists], h[exists]


# Edges at a time: what one chunk computes stays in the cache.
_CHUNK = 32768


def _ask(
    x: Tensor, y: Tensor, vertex: Tensor, twin: Tensor, before: Tensor, h: Tensor, rule: Rule | VertexRule
) -> tuple[Tensor, Tensor]:
    """What the rule says of the half-edges h; never to flip an edge whose two triangles share two edges."""
    gather = torch.index_select
    g = gather(twin, 0, h)
    u, w = gather(vertex, 0, h), gather(vertex, 0, g)
    s, r = gather(vertex, 0, gather(before, 0, h)), gather(vertex, 0, gather(before, 0, g))
    quads = Quads(
        gather(x, 0, u), gather(y, 0, u), gather(x, 0, w), gather(y, 0, w),
        gather(x, 0, s), gather(y, 0, s), gather(x, 0, r), gather(y, 0, r),
    )  # fmt: skip
    wanted, rank = (rule.at(u, w, s, r) if isinstance(rule, VertexRule) else rule)(quads)
    return wanted & (s != r), rank


def _first_in_both(h: Tensor, twin: Tensor, best: Tensor) -> Tensor:
    """(N,) bool: which of the half-edges h, given best first, rank first in both their triangles."""
    place = torch.arange(len(h), device=h.device)
    faces = torch.cat([h, twin.index_select(0, h)]).div_(3, rounding_mode="floor")
    best.scatter_reduce_(0, faces, place.repeat(2), "amin")
    one, two = best.index_select(0, faces).chunk(2)
    best.index_fill_(0, faces, len(twin))
    return (one == place) & (two == place)


def _first_of_its_key(vertex: Tensor, twin: Tensor, before: Tensor, h: Tensor, chosen: Tensor) -> Tensor:
    """(N,) bool: false where a better-ranked chosen flip makes the same new edge."""
    gather = torch.index_select
    rows = chosen.nonzero().squeeze(1)
    few = gather(h, 0, rows)
    s, r = gather(vertex, 0, gather(before, 0, torch.cat([few, gather(twin, 0, few)]))).chunk(2)
    keys, order = torch.sort(torch.minimum(s, r) * (int(vertex.max()) + 1) + torch.maximum(s, r), stable=True)
    again = torch.zeros_like(chosen)
    again[rows[order[1:][keys[1:] == keys[:-1]]]] = True
    return ~again


def _flip(
    vertex: Tensor, twin: Tensor, locked: Tensor, moved: Tensor, before: Tensor, both: Tensor, once: bool
) -> Tensor:
    """Flip the edges of half-edges `both` (2N,), one each and then their twins, no two in one triangle, in place.

    The new diagonal takes the slots after them, which are returned; the outer half-edges that were there move
    to those of the others' `both`, and `moved` says so until the caller resets it.
    """
    gather, count = torch.index_select, len(both) // 2
    last = gather(before, 0, both)
    onward = gather(before, 0, last)
    # Of the other triangle of each pair: its apex, and what lies across its moving half-edge.
    apex, across, lock = (gather(v, 0, at).roll(count) for v, at in ((vertex, last), (twin, onward), (locked, onward)))
    vertex.scatter_(0, onward, apex)
    moved.scatter_(0, onward, both.roll(count))
    inner = (across >= 0).nonzero().squeeze(1)
    slot, there = gather(both, 0, inner), gather(moved, 0, gather(across, 0, inner))
    twin.index_fill_(0, both, -1)
    twin.scatter_(0, slot, there).scatter_(0, there, slot)
    twin.scatter_(0, onward, onward.roll(count))
    locked.scatter_(0, both, lock)
    locked.index_fill_(0, onward, once)
    return onward
