"""Edge collapses in conflict-free rounds: a free vertex goes, its neighbour takes its triangles over.

           s                       s
         / | \\                   / | \\
       /   |   \\               /   |   \\
     .--- u --h-> w  collapse .----- w        u must be free; w stays where it is, or, if it is
       \\   |   /              \\   |   /       free too, may go to the middle of the edge
         \\ | /                  \\ | /
           r                       r

A round does the collapses that rank first at every vertex round them, so no two share a triangle.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from .connectivity import next_in_triangle, previous_in_triangle
from .editing import Editable, all_upright, fan_quality, independent, length, neighbours, within_budget


class Collapses(NamedTuple):
    """N collapses in question: remove the tail of h (N,), with its head then at x, y (N,).

    moves  (N,) bool, the head goes elsewhere (else x, y is where it is)
    """

    h: Tensor
    x: Tensor
    y: Tensor
    moves: Tensor


class Outcome(NamedTuple):
    """What collapses would do.

    before   (N,) worst inverse mean ratio of the triangles they touch
    after    (N,) that afterwards; infinite where a triangle inverts or the link condition fails
    longest  (N,) the longest new edge, relative to the size wanted
    claims   (N, K) the vertices no other collapse of the round may remove or move, -1 as padding
    centres  (N, 2) those that this one does, -1 as padding
    """

    before: Tensor
    after: Tensor
    longest: Tensor
    claims: Tensor
    centres: Tensor


def proposals(e: Editable, edge: Tensor, middles: bool) -> tuple[Collapses, Tensor]:
    """All collapses of the `edge`s (M,): each free end onto the other; both, if free, onto the middle.

    And the row of `edge` that each is of.
    """
    owner = (e.twin[edge] >= 0).nonzero().squeeze(1)
    here, there = edge[owner], e.twin[edge[owner]]
    loose, also = ~e.fixed[e.vertex[here]], ~e.fixed[e.vertex[there]]
    both = loose & also if middles else torch.zeros_like(loose)
    mx, my = e.middle(here[both])
    h = torch.cat([here[loose], there[also], here[both]])
    head = e.head(h)
    x, y, moves = e.x[head], e.y[head], torch.zeros(len(h), dtype=torch.bool, device=h.device)
    middle = slice(len(h) - len(mx), None)
    x[middle], y[middle], moves[middle] = mx, my, True
    return Collapses(h, x, y, moves), torch.cat([owner[loose], owner[also], owner[both]])


def evaluate(e: Editable, c: Collapses, degree: Tensor) -> Outcome:
    """What each collapse would do, by floating point; degree (V,) from `e.degree()`."""
    u, w = e.vertex[c.h], e.head(c.h)
    round_u, closed_u = neighbours(e.vertex, e.twin, c.h)
    round_w, closed_w = neighbours(e.vertex, e.twin, e.twin[c.h])
    count_u, count_w = (round_u >= 0).sum(1), (round_w >= 0).sum(1)
    # A vertex where several fans meet has more triangles than the walk has seen.
    whole = closed_u & (count_u == degree[u]) & (count_w - (~closed_w).long() == degree[w]) & (count_u > 2)
    common = ((round_u[:, :, None] == round_w[:, None, :]) & (round_u >= 0)[:, :, None]).sum((1, 2))
    legal = whole & (common == 2) & (closed_w | ~c.moves)
    ring = _Fan.of(e, round_u, count_u)
    there = there_u = there_w = None
    if e.metric is not None:
        there_u, there_w = e.metric[u], e.metric[w]
        there = torch.where(c.moves[:, None], 0.5 * (there_u + there_w), there_w)
    after, before = ring.worst(c.x, c.y, True, there), ring.worst(e.x[u], e.y[u], False, there_u)
    longest = ring.longest(c.x, c.y, e.size[w], there)
    claims = torch.cat([u[:, None], round_u], 1)
    moving = c.moves.nonzero().squeeze(1)
    if len(moving):
        other = _Fan.of(e, round_w[moving], count_w[moving])
        there, there_w = (None if m is None else m[moving] for m in (there, there_w))
        far = other.longest(c.x[moving], c.y[moving], e.size[w[moving]], there)
        after[moving] = torch.maximum(after[moving], other.worst(c.x[moving], c.y[moving], True, there))
        before[moving] = torch.maximum(before[moving], other.worst(e.x[w[moving]], e.y[w[moving]], False, there_w))
        longest[moving] = torch.maximum(longest[moving], far)
        claims = torch.cat([claims, torch.where(c.moves[:, None], round_w, -1)], 1)
    centres = torch.stack([u, torch.where(c.moves, w, -1)], 1)
    return Outcome(before, torch.where(legal, after, torch.inf), longest, claims, centres)


def still_upright(e: Editable, c: Collapses) -> Tensor:
    """(N,) bool by exact signs: are all the triangles that these collapses leave upright?"""
    good = torch.ones(len(c.h), dtype=torch.bool, device=c.h.device)
    sides = [(c.h, torch.ones_like(good)), (e.twin[c.h], c.moves)]
    for start, asked in sides:
        rows = asked.nonzero().squeeze(1)
        ring, _ = neighbours(e.vertex, e.twin, start[rows])
        fan = _Fan.of(e, ring, (ring >= 0).sum(1))
        good[rows] &= all_upright(e, c.x[rows], c.y[rows], fan.a, fan.b, fan.kept)
    return good


def collapse(e: Editable, c: Collapses) -> None:
    """Do these collapses, no two of which share a triangle."""
    h, g = c.h, e.twin[c.h]
    u, w = e.vertex[h], e.vertex[g]
    h1, h2, g1, g2 = next_in_triangle(h), previous_in_triangle(h), next_in_triangle(g), previous_in_triangle(g)
    new = torch.arange(len(e.x), device=h.device)
    new[u] = w
    e.vertex = torch.where(e.vertex >= 0, new[e.vertex], -1)
    # The outer half-edges of the dead triangles live on as the twins of their inner ones; two dead
    # triangles may be neighbours.
    gone, partner = torch.cat([h1, g2]), torch.cat([e.twin[h2], e.twin[g1]])
    stands_for = torch.arange(len(e.twin), device=h.device)
    stands_for[gone] = partner
    across = e.twin[gone]
    e.locked[partner] = e.locked[gone]
    e.twin[partner] = torch.where(across >= 0, stands_for[across.clamp_min(0)], -1)
    inner = across >= 0
    e.twin[e.twin[partner[inner]]] = partner[inner]
    dead = torch.cat([h, h1, h2, g, g1, g2])
    e.vertex[dead] = e.twin[dead] = -1
    e.locked[dead] = False
    e.alive[u] = False
    e.size[w] = torch.where(c.moves, 0.5 * (e.size[u] + e.size[w]), e.size[w])
    if e.metric is not None:
        e.metric[w] = torch.where(c.moves[:, None], 0.5 * (e.metric[u] + e.metric[w]), e.metric[w])
    e.x[w], e.y[w] = c.x, c.y


# How much an edge (half-edges (M,)) wants to go: (M,) numbers, infinite if not at all, lowest first.
Wish = Callable[[Tensor], Tensor]
# Of outcomes, which to accept, (N,) bool.
Judge = Callable[[Collapses, Outcome], Tensor]


def collapse_rounds(
    e: Editable,
    wish: Wish,
    judge: Judge,
    *,
    middles: bool = False,
    budget: Tensor | None = None,
    max_rounds: int = 1000,
) -> Tensor:
    """Collapse what is wished for and judged good until nothing is left; the number in each mesh (B,).

    A round asks, at every vertex, about the edge that wants most to go.

    middles  may both ends go to the middle of an edge, where both are free?
    budget   (B,) int64, how many collapses each mesh may have; None: any number
    """
    total = torch.zeros(e.meshes, dtype=torch.int64, device=e.x.device)
    # Half-edges (the lower of each edge) that were refused, and round which nothing has changed since.
    asleep = torch.zeros(len(e.twin), dtype=torch.bool, device=e.x.device)
    for _ in range(max_rounds):
        edge = e.edges()
        edge = edge[~asleep[edge]]
        want = wish(edge)
        if budget is not None:
            want = torch.where((total < budget)[e.mesh[e.vertex[edge]]], want, torch.inf)
        asked = want.isfinite().nonzero().squeeze(1)
        edge, key = edge[asked], e.shuffled(edge[asked], want[asked])
        first = _first_at_an_end(e, edge, key)
        edge, key = edge[first], key[first]
        if not len(edge):
            break
        c, owner = proposals(e, edge, middles)
        outcome = evaluate(e, c, e.degree())
        rows = (judge(c, outcome) & outcome.after.isfinite()).nonzero().squeeze(1)
        rows = rows[still_upright(e, _rows(c, rows))]
        rows = rows[_best_of_each(owner[rows], outcome.after[rows], len(edge))]
        chosen = rows[independent(outcome.centres[rows], outcome.claims[rows], key[owner[rows]], len(e.x))]
        if budget is not None:
            owners = e.mesh[e.vertex[c.h[chosen]]]
            chosen = chosen[within_budget(owners, key[owner[chosen]], budget - total)]
        refused = torch.ones(len(edge), dtype=torch.bool, device=edge.device)
        refused[owner[rows]] = False
        asleep[edge[refused]] = True
        touched = torch.zeros_like(e.alive)
        claims = outcome.claims[chosen]
        touched[claims[claims >= 0]] = True
        done = _rows(c, chosen)
        total += e.per_mesh(done.h)
        collapse(e, done)
        asleep &= ~touched[e.vertex.clamp_min(0)] & ~touched[e.vertex[e.twin]]
    return total


def _rows(c: Collapses, rows: Tensor) -> Collapses:
    return Collapses(*(v[rows] for v in c))


def _first_at_an_end(e: Editable, edge: Tensor, key: Tensor) -> Tensor:
    """(M,) bool: the edges whose key is the lowest at one of their ends."""
    u, w = e.vertex[edge], e.head(edge)
    best = torch.full((len(e.x),), torch.iinfo(torch.int64).max, dtype=torch.int64, device=edge.device)
    best.scatter_reduce_(0, torch.cat([u, w]), key.repeat(2), "amin")
    return (best[u] == key) | (best[w] == key)


def _best_of_each(owner: Tensor, value: Tensor, count: int) -> Tensor:
    """(N,) bool: of the rows of each owner, the one of lowest value, the first of equals."""
    best = value.new_full((count,), torch.inf).scatter_reduce_(0, owner, value, "amin")
    level = (value == best[owner]).nonzero().squeeze(1)
    first = torch.full((count,), len(owner), dtype=torch.int64, device=owner.device)
    first.scatter_reduce_(0, owner[level], level, "amin")
    rows = torch.arange(len(owner), device=owner.device)
    return first[owner] == rows


class _Fan(NamedTuple):
    """The triangles p a b round N vertices p, as (N, K); two of them (the first and the last) may go.

    there  (N, K) bool, the triangle is one;  kept  likewise, and it stays
    """

    x: Tensor
    y: Tensor
    size: Tensor
    metric: Tensor | None
    a: Tensor
    b: Tensor
    there: Tensor
    kept: Tensor

    @classmethod
    def of(cls, e: Editable, ring: Tensor, count: Tensor) -> "_Fan":
        column = torch.arange(ring.shape[1], device=ring.device)[None]
        there = column < count[:, None]
        last = column == count[:, None] - 1
        b = torch.where(last, ring[:, :1], ring.roll(-1, 1))
        return cls(e.x, e.y, e.size, e.metric, ring.clamp_min(0), b.clamp_min(0), there, there & ~last & (column > 0))

    def worst(self, px: Tensor, py: Tensor, kept: bool, there: Tensor | None) -> Tensor:
        """(N,) the largest inverse mean ratio, of those `kept` or of all, with the vertex at px, py (N,).

        there  (N, 3) the metric at that place; None: that of the plane
        """
        if not self.a.shape[1]:
            return torch.zeros_like(px)
        metric = None
        if self.metric is not None and there is not None:
            metric = there[:, None] + self.metric[self.a] + self.metric[self.b]
        ratio = fan_quality(
            px[:, None], py[:, None], self.x[self.a], self.y[self.a], self.x[self.b], self.y[self.b], metric
        )
        return torch.where(self.kept if kept else self.there, ratio, 0.0).amax(1)

    def longest(self, px: Tensor, py: Tensor, size: Tensor, there: Tensor | None) -> Tensor:
        """(N,) the longest edge from px, py to the ring but for its first vertex, relative to the sizes wanted."""
        dx, dy = self.x[self.a] - px[:, None], self.y[self.a] - py[:, None]
        metric = None
        if self.metric is not None and there is not None:
            metric = 0.5 * (there[:, None] + self.metric[self.a])
        relative = 2 * length(dx, dy, metric) / (size[:, None] + self.size[self.a])
        if not self.a.shape[1]:
            return torch.zeros_like(px)
        away = self.there.clone()
        away[:, :1] = False
        return torch.where(away, relative, 0.0).amax(1)
