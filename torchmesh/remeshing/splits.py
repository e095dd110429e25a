"""Edge splits in conflict-free rounds: a new vertex halves an edge, and four triangles take the place of two.

           s                       s
         / | \\                   / | \\
       /   |   \\    split      /   |   \\
      u ---h--- w            u --- m --- w      on the boundary, if that is allowed, two replace one
       \\   |   /              \\   |   /
         \\ | /                  \\ | /
           r                       r
"""

from collections.abc import Callable

import torch
from torch import Tensor

from ..mesh.connectivity import next_in_triangle, previous_in_triangle
from ..mesh.predicates import orientation
from ..mesh.ragged import true_rows
from .mutable import Editable, fan_quality, independent, within_budget

# Which of the half-edges (M,) to split, (M,) bool, and their rank (M,); those of lowest rank are split first.
Wish = Callable[[Tensor], tuple[Tensor, Tensor]]


def splittable(e: Editable, h: Tensor, allow_fixed: bool) -> Tensor:
    """(N,) bool: the edges h may be split (locked ones and the boundary if `allow_fixed`), and no triangle inverts."""
    g = e.twin[h]
    may = (g >= 0) & ~e.locked[h] if not allow_fixed else torch.ones_like(g, dtype=torch.bool)
    mx, my = e.middle(h)
    for side in (h, g):
        there = (side >= 0) & may
        rows = true_rows(there)
        start = side[rows]
        u, w, s = e.vertex[start], e.head(start), e.vertex[previous_in_triangle(start)]
        sx, sy = e.x[s], e.y[s]
        first = orientation(e.x[u], e.y[u], mx[rows], my[rows], sx, sy)
        second = orientation(mx[rows], my[rows], e.x[w], e.y[w], sx, sy)
        may[rows[(first <= 0) | (second <= 0)]] = False
    return may


def worst_after(e: Editable, h: Tensor) -> tuple[Tensor, Tensor]:
    """(N,) the worst inverse mean ratio of the triangles at the edges h, now and after the split of each edge."""
    before, after = torch.zeros_like(e.x[:1]).expand(len(h)), torch.zeros_like(e.x[:1]).expand(len(h))
    mx, my = e.middle(h)
    whole = first = second = None
    for side in (h, e.twin[h]):
        start = torch.where(side >= 0, side, h)
        u, w, s = e.vertex[start], e.head(start), e.vertex[previous_in_triangle(start)]
        sx, sy, ux, uy, wx, wy = e.x[s], e.y[s], e.x[u], e.y[u], e.x[w], e.y[w]
        if e.metric is not None:
            at_u, at_w, at_s = e.metric[u], e.metric[w], e.metric[s]
            middle = 0.5 * (at_u + at_w)
            whole, first, second = at_u + at_w + at_s, at_u + middle + at_s, middle + at_w + at_s
        before = torch.maximum(before, fan_quality(sx, sy, ux, uy, wx, wy, whole))
        after = torch.maximum(after, fan_quality(sx, sy, ux, uy, mx, my, first))
        after = torch.maximum(after, fan_quality(sx, sy, mx, my, wx, wy, second))
    return before, after


def split(e: Editable, h: Tensor, new: Tensor, rows: Tensor) -> None:
    """Split the edges h (N,), no two of which are in one triangle.

    new   (N,) rows of the new vertices, which exist and are dead
    rows  (2, N) rows of the new triangles, which exist and are dead; the second row of a boundary edge is not used
    """
    g, lock = e.twin[h], e.locked[h]
    _put_in_the_middle(e, h, new)
    e.fixed[new] = lock | (g < 0)
    inner = true_rows(g >= 0)
    start, slot, middle = torch.cat([h, g[inner]]), torch.cat([rows[0], rows[1, inner]]), torch.cat([new, new[inner]])
    _halve_triangles(e, start, 3 * slot, middle)
    e.twin[h] = e.twin[3 * rows[0]] = -1
    one, two, h_inner, g_inner = 3 * rows[0, inner], 3 * rows[1, inner], h[inner], g[inner]
    e.twin[h_inner], e.twin[two] = two, h_inner
    e.twin[g_inner], e.twin[one] = one, g_inner
    e.locked[3 * rows[0]] = lock
    e.locked[two] = e.locked[g_inner] = lock[inner]


def _put_in_the_middle(e: Editable, h: Tensor, new: Tensor) -> None:
    """Bring the vertices `new` (N,) to life in the middles of the edges h (N,), with the means of their ends."""
    u, w = e.vertex[h], e.head(h)
    e.x[new], e.y[new] = e.middle(h)
    e.size[new] = 0.5 * (e.size[u] + e.size[w])
    if e.metric is not None:
        e.metric[new] = 0.5 * (e.metric[u] + e.metric[w])
    e.mesh[new] = e.mesh[u]
    e.alive[new] = True


def _halve_triangles(e: Editable, start: Tensor, base: Tensor, middle: Tensor) -> None:
    """Divide the triangles of the half-edges `start` (N,) at the vertices `middle` (N,) on these half-edges.

    base  (N,) the first half-edges of the new triangles, whose twins the caller sets
    """
    after = next_in_triangle(start)
    # The half-edge after `start` goes to the new triangle.  So may its twin, in the same round.
    moved = torch.arange(len(e.twin), device=start.device)
    moved[after] = base + 1
    across = e.twin[after]
    partner = torch.where(across >= 0, moved[across.clamp_min(0)], -1)
    e.vertex[base], e.vertex[base + 1] = middle, e.vertex[after]
    e.vertex[base + 2] = e.vertex[previous_in_triangle(start)]
    e.vertex[after] = middle
    e.twin[base + 1] = partner
    e.twin[partner[across >= 0]] = (base + 1)[across >= 0]
    e.twin[after], e.twin[base + 2] = base + 2, after
    e.locked[base + 1] = e.locked[after]
    e.locked[after] = e.locked[base + 2] = False


# Finds rows for the splits of edges (N,): rows of vertices (N,) and of triangles (2, N).
Room = Callable[[Editable, Tensor], tuple[Tensor, Tensor]]


def split_rounds(
    e: Editable,
    wish: Wish,
    *,
    allow_fixed: bool = False,
    budget: Tensor | None = None,
    room: Room | None = None,
    max_rounds: int = 100,
) -> Tensor:
    """Split the edges that are wished for until none is left; returns the number of splits in each mesh (B,).

    allow_fixed  whether boundary and locked edges may be split
    budget       (B,) int64, how many splits each mesh may have; None means any number
    room         finds rows for new vertices and triangles; None means new rows at the end
    """
    room = room or append
    total = torch.zeros(e.meshes, dtype=torch.int64, device=e.x.device)
    # An edge is looked at again only where something changed at one of its ends, or where it had to wait.
    awake = torch.ones_like(e.alive)
    for _ in range(max_rounds):
        edge = e.edges()
        edge = edge[awake[e.vertex[edge]] | awake[e.head(edge)]]
        if budget is not None:
            edge = edge[(total < budget)[e.mesh[e.vertex[edge]]]]
        if not len(edge):
            break
        edge, rank = _possible(e, edge, wish, allow_fixed)
        if not len(edge):
            break
        chosen = first_in_their_triangles(e, edge, rank)
        if budget is not None:
            rows = true_rows(chosen)
            chosen[rows] = within_budget(e.mesh[e.vertex[edge[rows]]], rank[rows], budget - total)
        awake = torch.zeros_like(awake)
        awake[e.vertex[edge[~chosen]]] = True
        edge = edge[chosen]
        beside = torch.cat([edge, e.twin[edge][e.twin[edge] >= 0]]) // 3
        total += e.per_mesh(edge)
        new, slots = room(e, edge)
        awake = torch.cat([awake, awake.new_zeros(len(e.alive) - len(awake))])
        awake[new] = True
        awake[e.triangles[beside].reshape(-1)] = True
        split(e, edge, new, slots)
    return total


def _possible(e: Editable, edge: Tensor, wish: Wish, allow_fixed: bool) -> tuple[Tensor, Tensor]:
    """Those of the edges (M,) that are wished for and may be split, and their ranks."""
    wanted, rank = wish(edge)
    edge, rank = edge[wanted], rank[wanted]
    may = splittable(e, edge, allow_fixed)
    return edge[may], rank[may]


def first_in_their_triangles(e: Editable, h: Tensor, rank: Tensor) -> Tensor:
    """(N,) bool: the edges that have the lowest rank in each of their triangles."""
    g = e.twin[h]
    faces = torch.stack([h // 3, torch.where(g >= 0, g // 3, -1)], 1)
    return independent(faces, faces, rank, len(e.twin) // 3)


def append(e: Editable, h: Tensor) -> tuple[Tensor, Tensor]:
    """New rows at the end for splits of the edges h (N,): rows of vertices (N,) and of triangles (2, N)."""
    count, device = len(h), h.device
    new = len(e.x) + torch.arange(count, device=device)
    names = e.fresh + torch.arange(count, device=device)
    e.births.append(torch.stack([names, e.origin[e.vertex[h]], e.origin[e.head(h)]], 1))
    e.fresh += count
    e.origin = torch.cat([e.origin, names])
    for name in ("x", "y", "size"):
        setattr(e, name, torch.cat([getattr(e, name), e.x.new_zeros(count)]))
    if e.metric is not None:
        e.metric = torch.cat([e.metric, e.metric.new_zeros((count, 3))])
    e.mesh = torch.cat([e.mesh, e.mesh.new_zeros(count)])
    e.alive = torch.cat([e.alive, e.alive.new_zeros(count)])
    e.fixed = torch.cat([e.fixed, e.fixed.new_zeros(count)])
    rows = len(e.twin) // 3 + torch.arange(2 * count, device=device).reshape(2, count)
    e.vertex = torch.cat([e.vertex, e.vertex.new_full((6 * count,), -1)])
    e.twin = torch.cat([e.twin, e.twin.new_full((6 * count,), -1)])
    e.locked = torch.cat([e.locked, e.locked.new_zeros(6 * count)])
    return new, rows
