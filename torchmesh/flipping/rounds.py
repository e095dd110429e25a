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

import torch
from torch import Tensor

from ..mesh.connectivity import next_in_triangle, previous_in_triangle
from .rules import Quads, Rule, VertexRule


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
