"""Edge collapses in conflict-free rounds: a free vertex is removed, and its neighbour takes over its triangles.

           s                       s
         / | \\                   / | \\
       /   |   \\               /   |   \\
     .--- u --h-> w  collapse .----- w        u must be free; w stays where it is
       \\   |   /              \\   |   /
         \\ | /                  \\ | /
           r                       r

No two vertices that are removed in one round are neighbours, so no two collapses share a triangle.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ..mesh.connectivity import next_in_triangle, previous_in_triangle
from ..mesh.ragged import true_rows
from .mutable import Editable, all_upright, fan_quality, independent, length, within_budget

# How often a round chooses among the collapses that are still possible; each choice leaves about a third of them.
_CHOICES = 3


class Outcome(NamedTuple):
    """What N collapses would do.  Each removes a vertex p, which has at most K triangles p a b.

    before   (N,) the worst inverse mean ratio of the triangles at p
    after    (N,) the worst inverse mean ratio of these triangles after the collapse, by floating-point numbers;
             infinite where a triangle inverts or the link condition fails
    longest  (N,) the longest new edge, relative to the size wanted
    a, b     (N, K) the other corners of the triangles at p
    kept     (N, K) bool, whether the triangle stays
    claims   (N, K + 1) p and its neighbours, with -1 as padding
    """

    before: Tensor
    after: Tensor
    longest: Tensor
    a: Tensor
    b: Tensor
    kept: Tensor
    claims: Tensor

    def select(self, rows: Tensor) -> "Outcome":
        """The outcomes of the collapses `rows`."""
        return Outcome(*(v[rows] for v in self))


def proposals(e: Editable, edge: Tensor) -> tuple[Tensor, Tensor]:
    """All collapses of the edges (M,), of each free end onto the other end.

    Returns half-edges (N,), whose tails would be removed, and for each of them the row of its edge (N,).
    """
    owner = true_rows(e.twin[edge] >= 0)
    here, there = edge[owner], e.twin[edge[owner]]
    loose, also = ~e.fixed[e.vertex[here]], ~e.fixed[e.vertex[there]]
    return torch.cat([here[loose], there[also]]), torch.cat([owner[loose], owner[also]])


def evaluate(e: Editable, h: Tensor) -> Outcome:
    """What the collapse of each half-edge h (N,) would do."""
    u, w = e.vertex[h], e.head(h)
    out, beside = e.around(torch.cat([u, w])).chunk(2)
    there = out >= 0
    a, b = e.head(out), e.vertex[previous_in_triangle(out)]
    kept = there & (a != w[:, None]) & (b != w[:, None])
    boundary = true_rows((e.twin < 0) & (e.vertex >= 0))
    fans, last = torch.bincount(e.vertex[boundary], minlength=len(e.x)), torch.full_like(e.mesh, -1)
    # A boundary vertex has one neighbour that is the head of none of its half-edges.
    last[e.head(boundary)] = e.vertex[boundary]
    neighbours = torch.cat([torch.where(beside >= 0, e.head(beside), -1), last[w][:, None]], 1)
    common = ((a[:, :, None] == neighbours[:, None]) & there[:, :, None]).sum((1, 2))
    # Nothing is collapsed onto a boundary vertex where several fans of triangles meet.
    legal = (fans[u] == 0) & (fans[w] < 2) & (there.sum(1) > 2) & (common == 2)
    ux, uy, wx, wy = (v[:, None] for v in (e.x[u], e.y[u], e.x[w], e.y[w]))
    ax, ay, bx, by = e.x[a], e.y[a], e.x[b], e.y[b]
    now = then = halfway = None
    if e.metric is not None:
        at_u, at_w, at_a = e.metric[u][:, None], e.metric[w][:, None], e.metric[a]
        now, then, halfway = at_u + at_a + e.metric[b], at_w + at_a + e.metric[b], 0.5 * (at_w + at_a)
    before, after = fan_quality(ux, uy, ax, ay, bx, by, now), fan_quality(wx, wy, ax, ay, bx, by, then)
    relative = 2 * length(ax - wx, ay - wy, halfway) / (e.size[w][:, None] + e.size[a])
    return Outcome(
        torch.where(there, before, 0.0).amax(1),
        torch.where(legal, torch.where(kept, after, 0.0).amax(1), torch.inf),
        torch.where(there, relative, 0.0).amax(1),
        a,
        b,
        kept,
        torch.cat([u[:, None], torch.where(there, a, -1)], 1),
    )


def still_upright(e: Editable, h: Tensor, outcome: Outcome) -> Tensor:
    """(N,) bool, by exact signs: all the triangles that stay after the collapse of h (N,) are upright."""
    w = e.head(h)
    return all_upright(e, e.x[w], e.y[w], outcome.a, outcome.b, outcome.kept)


def collapse(e: Editable, h: Tensor) -> None:
    """Collapse the half-edges h (N,), no two of which share a triangle; their tails are removed."""
    g = e.twin[h]
    u, w = e.vertex[h], e.vertex[g]
    h1, h2, g1, g2 = next_in_triangle(h), previous_in_triangle(h), next_in_triangle(g), previous_in_triangle(g)
    new = torch.arange(len(e.x), device=h.device)
    new[u] = w
    e.vertex = torch.where(e.vertex >= 0, new[e.vertex], -1)
    # The twins of the outer half-edges of the removed triangles become twins of each other.  Two removed
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


# Takes half-edges (M,) to numbers (M,): the edges with the lowest ones are collapsed first, those with infinity never.
# The number of an edge may change only with its ends.
Wish = Callable[[Tensor], Tensor]


# Which of the outcomes to accept, (N,) bool.
Judge = Callable[[Outcome], Tensor]


def collapse_rounds(
    e: Editable,
    wish: Wish,
    judge: Judge,
    *,
    budget: Tensor | None = None,
    worth: float = 0.0,
    max_rounds: int = 1000,
) -> Tensor:
    """Collapse the edges that are wished for and judged good until none is left; returns the number in each mesh (B,).

    At every vertex, a round considers the edge that wants most to be collapsed.

    budget  (B,) int64, how many collapses each mesh may have; None means any number
    worth   a mesh is done after a round that does less than this part of all its collapses
    """
    total = torch.zeros(e.meshes, dtype=torch.int64, device=e.x.device)
    going = torch.ones_like(total, dtype=torch.bool) if budget is None else budget > 0
    # Edges, as their lower half-edge, that were not wished for or refused, and at whose ends nothing has changed since.
    asleep = torch.zeros(len(e.twin), dtype=torch.bool, device=e.x.device)
    every = torch.arange(len(e.twin), device=e.x.device)
    for _ in range(max_rounds):
        edge = e.edges()
        edge, key = _asked(e, edge[going[e.mesh[e.vertex[edge]]] & ~asleep[edge]], wish, asleep)
        if not len(edge):
            break
        h, key, claims = _chosen(e, edge, key, judge, asleep)
        if budget is not None:
            rows = within_budget(e.mesh[e.vertex[h]], key, budget - total)
            h, claims = h[rows], claims[rows]
        touched = torch.zeros_like(e.alive)
        touched[claims[claims >= 0]] = True
        done = e.per_mesh(h)
        collapse(e, h)
        asleep &= ~touched[e.vertex.clamp_min(0)] & ~touched[e.head(every).clamp_min(0)]
        total += done
        going = going & (done >= worth * total)
        if budget is not None:
            going &= total < budget
    return total


def _asked(e: Editable, edge: Tensor, wish: Wish, asleep: Tensor) -> tuple[Tensor, Tensor]:
    """Those of the edges (M,) that want most to be collapsed at one of their ends, and their keys, lowest first.

    asleep  (3T,) bool; the edges that are not wished for are marked in it
    """
    want = wish(edge)
    wanted = want.isfinite()
    asleep[edge[~wanted]] = True
    asked = true_rows(wanted)
    edge, key = edge[asked], e.shuffled(edge[asked], want[asked])
    first = _first_at_an_end(e, edge, key)
    return edge[first], key[first]


def _chosen(e: Editable, edge: Tensor, key: Tensor, judge: Judge, asleep: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Good collapses of some of the edges (M,), which can be done together.

    asleep  (3T,) bool; the edges that are refused are marked in it, and the others are not

    Returns half-edges (N,), the keys (N,) of their edges, and the vertices that they claim (N, K + 1).
    """
    h, owner = proposals(e, edge)
    outcome = evaluate(e, h)
    asleep[edge] = True
    rows = true_rows(judge(outcome) & outcome.after.isfinite())
    rows = rows[_best_of_each(owner[rows], outcome.after[rows], len(edge))]
    asleep[edge[owner[rows]]] = False
    rows = rows[_apart(e.vertex[h[rows]], outcome.claims[rows], key[owner[rows]], len(e.x))]
    upright = still_upright(e, h[rows], outcome.select(rows))
    asleep[edge[owner[rows[~upright]]]] = True
    rows = rows[upright]
    return h[rows], key[owner[rows]], outcome.claims[rows]


def _apart(tail: Tensor, claims: Tensor, key: Tensor, count: int) -> Tensor:
    """(M,) rows of collapses, low keys first, such that no tail (N,) of one is among the claims (N, K) of another."""
    rows, chosen = torch.arange(len(tail), device=tail.device), []
    # The last entry stands for -1.
    taken = torch.zeros(count + 1, dtype=torch.bool, device=tail.device)
    for _ in range(_CHOICES):
        first = independent(tail[rows][:, None], claims[rows], key[rows], count)
        chosen.append(rows[first])
        taken[claims[rows[first]]] = True
        rows = rows[~taken[tail[rows]]]
    return torch.cat(chosen)


def _first_at_an_end(e: Editable, edge: Tensor, key: Tensor) -> Tensor:
    """(M,) bool: the edges that have the lowest key at one of their ends."""
    u, w = e.vertex[edge], e.head(edge)
    best = torch.full((len(e.x),), torch.iinfo(torch.int64).max, dtype=torch.int64, device=edge.device)
    best.scatter_reduce_(0, torch.cat([u, w]), key.repeat(2), "amin")
    return (best[u] == key) | (best[w] == key)


def _best_of_each(owner: Tensor, value: Tensor, count: int) -> Tensor:
    """(N,) bool: for each owner its row of lowest value, and the first of several such."""
    best = value.new_full((count,), torch.inf).scatter_reduce_(0, owner, value, "amin")
    level = true_rows(value == best[owner])
    first = torch.full((count,), len(owner), dtype=torch.int64, device=owner.device)
    first.scatter_reduce_(0, owner[level], level, "amin")
    rows = torch.arange(len(owner), device=owner.device)
    return first[owner] == rows
