"""Edge flips in conflict-free rounds, on bare tensors: legality, action and the loop over rounds.

            s                        s
          / | \\                    /   \\
        /   |   \\                /       \\
      u  h  |  g  w    flip    u ----------- w     drawn the other way: before the flip the edge
        \\   |   /      <-->      \\       /         u-w is there, after it the edge r-s
          \\ | /                    \\   /
            r                        r

A round flips the edges that rank first in both their triangles, so no two of them share a triangle.  The cost of a
round grows with the number of edges that are still in question, not with the size of the mesh.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from ..kernels.flips import KIM, METRIC, SAFE, SHAPE, edges_of, flip_in_rounds
from ..kernels.library import library_for
from ..mesh.connectivity import next_in_triangle, previous_in_triangle
from ..mesh.ragged import take, true_rows
from .metric_rule import MetricRule
from .rules import Quads, Rule, VertexRule, kim_rule, safe_rule, shape_rule

# A queue with fewer than 1/16 of all half-edges is sorted; a longer one is marked in a mask, which is then faster.
_SPARSE = 16


# Edges at a time: what one chunk computes stays in the cache.
_CHUNK = 32768


def edge_exists(vertex: Tensor, twin: Tensor, start: Tensor, target: Tensor) -> Tensor:
    """(N,) bool: does the vertex that the half-edge `start` (N,) leaves have an edge to `target` (N,)?

    Only the edges of one fan are seen: the triangles that one reaches from `start` by turning about its tail.
    """
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
        going = true_rows(~hit & (onward >= 0) & (onward != gather(start, 0, rows)))
        rows, here, goal = gather(rows, 0, going), gather(onward, 0, going), gather(goal, 0, going)
    # A fan that ended at the boundary is followed from the start in the other direction, too.
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


class _HalfEdges(NamedTuple):
    """The half-edges of all meshes, (3T,) each.  Flips write into `vertex`, `twin`, `locked` and `moved`.

    vertex    the vertex that the half-edge leaves
    twin      the other half of its edge, -1 on the boundary
    locked    bool, its edge must stay
    previous  the half-edge before it in its triangle
    moved     the slot to which the round has moved it; its own slot between two rounds
    """

    vertex: Tensor
    twin: Tensor
    locked: Tensor
    previous: Tensor
    moved: Tensor

    @classmethod
    def of(cls, triangles: Tensor, twin: Tensor, locked: Tensor) -> "_HalfEdges":
        """Copies of these arrays."""
        vertex = triangles.reshape(-1).clone()
        moved = torch.arange(len(vertex), device=vertex.device)
        return cls(vertex, twin.clone(), locked.clone(), moved.reshape(-1, 3).roll(1, 1).reshape(-1), moved)

    def apexes(self, h: Tensor, g: Tensor) -> tuple[Tensor, Tensor]:
        """The vertices opposite the edge in the triangles of the half-edges h and g."""
        gather = torch.index_select
        return gather(self.vertex, 0, gather(self.previous, 0, h)), gather(self.vertex, 0, gather(self.previous, 0, g))


class _Question(NamedTuple):
    """What stays the same through all rounds: coordinates x, y (V,), the rule, and `pinched`.

    pinched  (V,) bool, the vertices where several fans of triangles meet
    """

    x: Tensor
    y: Tensor
    pinched: Tensor
    rule: Rule | VertexRule


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
    twin       (3T,) int64; not changed either
    locked     (3T,) bool half-edges (both of an edge) that must stay
    once       an edge that a flip made is not flipped again
    around     (T,) bool: ask at first only about the edges of these triangles; None: about all

    The log is (F,) int64, the lower-numbered triangle of each flip, so that flips can be counted per mesh.
    """
    known = _compiled(rule, twin)
    if known is not None:
        half_edges = triangles.reshape(-1).clone(), twin.clone(), locked.clone()
        asked = None if around is None else edges_of(around, twin)
        xy = points[:, 0].contiguous(), points[:, 1].contiguous()
        flips = flip_in_rounds(xy, half_edges, asked, *known, once, max_rounds)
        return half_edges[0].reshape(-1, 3), half_edges[1], flips
    gather = torch.index_select
    edges = _HalfEdges.of(triangles, twin, locked)
    pinched = torch.bincount(edges.vertex[twin < 0], minlength=len(points)) > 1
    question = _Question(points[:, 0].contiguous(), points[:, 1].contiguous(), pinched, rule)
    best = torch.full((len(triangles),), len(edges.vertex), dtype=torch.int64, device=triangles.device)
    log = []
    if around is None:
        queue = true_rows(edges.twin > edges.moved)
    else:
        queue = _each_edge_once(_half_edges_of(around), edges.twin)
    for _ in range(max_rounds):
        queue = queue[~take(edges.locked, queue)]
        h, rank, barred = _eligible(edges, question, queue)
        if not len(h):
            break
        # Equal ranks stay in the order of their index: h ascends and the sort is stable.
        h = gather(h, 0, rank.argsort(descending=True, stable=True))
        chosen = _first_in_both(h, edges.twin, best)
        chosen &= _first_of_its_new_edge(edges, h, chosen)
        flipped, left = h[chosen], h[~chosen]
        both = torch.cat([flipped, gather(edges.twin, 0, flipped)])
        log.append((both // 3).view(2, -1).amin(0))
        diagonals = _flip(edges, both, once)
        waiting = gather(edges.moved, 0, torch.cat([left, barred]))
        queue = _each_edge_once(torch.cat([waiting, both, gather(edges.previous, 0, both)]), edges.twin)
        edges.moved.scatter_(0, diagonals, diagonals)
    flips = torch.cat(log) if log else torch.zeros(0, dtype=torch.int64, device=triangles.device)
    return edges.vertex.reshape(-1, 3), edges.twin, flips


_KNOWN: dict[Rule, int] = {safe_rule: SAFE, kim_rule: KIM, shape_rule: SHAPE}


def _compiled(rule: Rule | VertexRule, twin: Tensor) -> tuple[int, Tensor | None] | None:
    """The number by which the compiled loop knows the rule, and its metric; None where torch is to do the work."""
    # The compiled loop numbers half-edges in 32 bits.
    if len(twin) >= 2**31 or library_for(twin) is None:
        return None
    if type(rule) is MetricRule:
        return METRIC, rule.metric.to(torch.float64)
    number = None if isinstance(rule, VertexRule) else _KNOWN.get(rule)
    return None if number is None else (number, None)


def _half_edges_of(triangles: Tensor) -> Tensor:
    """The half-edges of the `triangles` (T,) bool."""
    return (triangles.nonzero() * 3 + torch.arange(3, device=triangles.device)).reshape(-1)


def _each_edge_once(h: Tensor, twin: Tensor) -> Tensor:
    """The interior edges among half-edges h, each once, as its lower half-edge, ascending."""
    other = take(twin, h)
    lower = torch.minimum(h, other)
    if _SPARSE * len(h) < len(twin):
        return lower[other >= 0].unique()
    marks = torch.zeros(len(twin) + 1, dtype=torch.bool, device=h.device)
    marks.index_fill_(0, torch.where(other >= 0, lower, len(twin)), True)
    return true_rows(marks[:-1])


def _eligible(edges: _HalfEdges, question: _Question, queue: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The half-edges of the queue that the rule wants flipped and that may be flipped, with their rank.

    And the half-edges that the rule wants flipped but whose new edge exists already: they wait until it goes.
    """
    rows, ranks = [], []
    for start in range(0, len(queue), _CHUNK):
        part = queue[start : start + _CHUNK]
        wanted, rank = _ask(edges, question, part)
        rows.append(part[wanted])
        ranks.append(rank[wanted])
    h, rank = torch.cat(rows or [queue]), torch.cat(ranks or [question.x[:0]])
    gather = torch.index_select
    last_h, last_g = gather(edges.previous, 0, h), gather(edges.previous, 0, gather(edges.twin, 0, h))
    s, r = gather(edges.vertex, 0, last_h), gather(edges.vertex, 0, last_g)
    # Turning about a vertex shows all its edges if it has one fan; of two pinched vertices neither can be trusted.
    from_r = gather(question.pinched, 0, s)
    exists = edge_exists(edges.vertex, edges.twin, torch.where(from_r, last_g, last_h), torch.where(from_r, s, r))
    exists |= from_r & gather(question.pinched, 0, r)
    return h[~exists], rank[~exists], h[exists]


def _ask(edges: _HalfEdges, question: _Question, h: Tensor) -> tuple[Tensor, Tensor]:
    """What the rule says of the half-edges h.  An edge whose two triangles share two edges is never flipped."""
    gather, (x, y) = torch.index_select, (question.x, question.y)
    g = gather(edges.twin, 0, h)
    u, w = gather(edges.vertex, 0, h), gather(edges.vertex, 0, g)
    s, r = edges.apexes(h, g)
    quads = Quads(
        gather(x, 0, u), gather(y, 0, u), gather(x, 0, w), gather(y, 0, w),
        gather(x, 0, s), gather(y, 0, s), gather(x, 0, r), gather(y, 0, r),
    )  # fmt: skip
    rule = question.rule
    wanted, rank = (rule.at(u, w, s, r) if isinstance(rule, VertexRule) else rule)(quads)
    return wanted & (s != r), rank


def _first_in_both(h: Tensor, twin: Tensor, best: Tensor) -> Tensor:
    """(N,) bool: which of the half-edges h, given best first, rank first in both their triangles.

    best  (T,) working space, filled with a number above every rank, and left so
    """
    order = torch.arange(len(h), device=h.device)
    faces = torch.cat([h, take(twin, h)]).div_(3, rounding_mode="floor")
    best.scatter_reduce_(0, faces, order.repeat(2), "amin")
    one, two = take(best, faces).chunk(2)
    best.index_fill_(0, faces, len(twin))
    return (one == order) & (two == order)


def _first_of_its_new_edge(edges: _HalfEdges, h: Tensor, chosen: Tensor) -> Tensor:
    """(N,) bool: false where a better-ranked chosen flip makes the same new edge."""
    gather = torch.index_select
    rows = true_rows(chosen)
    few = gather(h, 0, rows)
    s, r = edges.apexes(few, gather(edges.twin, 0, few))
    keys, order = torch.sort(torch.minimum(s, r) * (int(edges.vertex.max()) + 1) + torch.maximum(s, r), stable=True)
    again = torch.zeros_like(chosen)
    again[rows[order[1:][keys[1:] == keys[:-1]]]] = True
    return ~again


def _flip(edges: _HalfEdges, both: Tensor, once: bool) -> Tensor:
    """Flip edges in place; returns the slots (2N,) of the half-edges of the new diagonals.

    both  (2N,) one half-edge of each edge and then their twins, no two in one triangle

    A triangle's slots are `both`, `onward` and `last`, in this order.  The new diagonal takes the slot `onward`.  The
    outer half-edge that was there moves to the slot `both` of the other triangle, and `edges.moved` records this
    until the caller resets it.
    """
    gather, count = torch.index_select, len(both) // 2
    vertex, twin, locked, previous, moved = edges
    last = gather(previous, 0, both)
    onward = gather(previous, 0, last)
    # From the other triangle of each pair: its apex, and the twin and the lock of the half-edge that moves over.
    apex, across, lock = (gather(v, 0, at).roll(count) for v, at in ((vertex, last), (twin, onward), (locked, onward)))
    vertex.scatter_(0, onward, apex)
    moved.scatter_(0, onward, both.roll(count))
    inner = true_rows(across >= 0)
    slot, there = gather(both, 0, inner), gather(moved, 0, gather(across, 0, inner))
    twin.index_fill_(0, both, -1)
    twin.scatter_(0, slot, there).scatter_(0, there, slot)
    twin.scatter_(0, onward, onward.roll(count))
    locked.scatter_(0, both, lock)
    locked.index_fill_(0, onward, once)
    return onward
