"""Who touches whom, computed from `triangles` alone and passed along.

Half-edge h = 3 * triangle + corner runs from that corner to the next one; the corner it does not
touch is opposite.  Its twin is the half-edge of the neighbour across the same edge.

                 opposite(h)
                   /    \\                 twin(twin(h)) = h
                  /  h   \\                twin(h) = -1 on the boundary
           tail  o ------> o  head
                  \\ twin /
"""

import torch
from torch import Tensor

from ..kernels import geometry, ragged
from ..kernels.library import library_for
from .detached import loops_may_read
from .ragged import take, true_rows

_INT32 = torch.iinfo(torch.int32).max

# Loops of fewer edges take less time in Python than the call of a compiled loop.
_FEW_EDGES = 32


def next_in_triangle(h: Tensor) -> Tensor:
    """The half-edge after h in its triangle."""
    return h + 1 - 3 * (h.fmod(3) == 2)


def previous_in_triangle(h: Tensor) -> Tensor:
    """The half-edge before h in its triangle."""
    return h - 1 + 3 * (h.fmod(3) == 0)


def tails(triangles: Tensor) -> Tensor:
    """(3T,) the vertex each half-edge starts from."""
    return triangles.reshape(-1)


def heads(triangles: Tensor) -> Tensor:
    """(3T,) the vertex each half-edge runs to."""
    return triangles.roll(-1, 1).reshape(-1)


def edge_keys(u: Tensor, v: Tensor, vertices: int) -> Tensor:
    """One int64 per undirected edge {u, v}: the smaller row times `vertices` plus the larger."""
    return torch.minimum(u, v) * vertices + torch.maximum(u, v)


def keys_of(edges: Tensor, vertices: int) -> Tensor:
    """(N,) int64 the `edge_keys` of the edges (N, 2)."""
    return edge_keys(edges[:, 0], edges[:, 1], vertices)


def twins(triangles: Tensor) -> Tensor:
    """(3T,) int64 twin of each half-edge, -1 on the boundary.

    `triangles` (T, 3) must be an oriented manifold: each edge in one triangle, or in two that run
    along it in opposite directions.
    """
    if library_for(triangles) is not None:
        return geometry.twins(triangles)
    u, v = tails(triangles), heads(triangles)
    low, apart = torch.minimum(u, v), (u - v).abs_()
    size, span = (int(x.max()) + 1 if len(x) else 1 for x in (low, apart))
    # Vertices of one triangle stand near each other in a batch: small keys, which are sorted in half the time.
    keys = low.mul_(span).add_(apart)
    keys, order = (keys.to(torch.int32) if size * span <= _INT32 else keys).sort()
    first = true_rows(keys[1:] == keys[:-1])
    left, right = take(order, first), take(order, first + 1)
    return torch.full_like(u, -1).scatter_(0, left, right).scatter_(0, right, left)


def edges(triangles: Tensor, twin: Tensor) -> Tensor:
    """(E, 2) each undirected edge once, as its lower half-edge runs."""
    h = torch.arange(len(twin), device=twin.device)
    once = true_rows((twin < 0) | (h < twin))
    return torch.stack([take(ends(triangles), once) for ends in (tails, heads)], 1)


def boundary_edges(triangles: Tensor, twin: Tensor) -> Tensor:
    """(E_b, 2) the edges of one triangle only, with the mesh on their left."""
    boundary = true_rows(twin < 0)
    flat = triangles.reshape(-1)
    return torch.stack([flat[boundary], flat[next_in_triangle(boundary)]], 1)


def boundary_vertices(triangles: Tensor, twin: Tensor, vertices: int) -> Tensor:
    """(V,) bool: the vertex lies on an edge that has one triangle only."""
    mask = torch.zeros(vertices, dtype=torch.bool, device=triangles.device)
    mask[boundary_edges(triangles, twin).reshape(-1)] = True
    return mask


def half_edges_on(triangles: Tensor, edges: Tensor, vertices: int) -> Tensor:
    """(3T,) bool: the half-edges, both of an edge, that lie on the `edges` (K, 2)."""
    if len(edges) and loops_may_read(triangles):
        return geometry.half_edges_on(triangles, edges, vertices)
    found = torch.zeros(triangles.numel(), dtype=torch.bool, device=triangles.device)
    if not len(edges):
        return found
    ends = torch.zeros(vertices, dtype=torch.bool, device=triangles.device)
    ends[edges.reshape(-1)] = True
    tail, head = tails(triangles), heads(triangles)
    near = true_rows(ends[tail] & ends[head])
    keys, known = edge_keys(tail[near], head[near], vertices), keys_of(edges, vertices).sort().values
    # A search in sorted keys takes a third of the time of `torch.isin`, which sorts both.
    found[near] = known[torch.searchsorted(known, keys).clamp_max_(len(known) - 1)] == keys
    return found


def touching(triangles: Tensor, vertices: Tensor) -> Tensor:
    """(T,) bool: the triangles with a corner among `vertices` (V,) bool."""
    if loops_may_read(vertices):
        return ragged.touching(triangles, vertices)
    a, b, c = (take(vertices, v.contiguous()) for v in triangles.unbind(1))
    return a | b | c


def corners_of(triangles: Tensor, these: Tensor, vertices: int) -> Tensor:
    """(V,) bool: the corners of `these` (T,) bool of the triangles."""
    if loops_may_read(these):
        return ragged.corners_of(triangles, these, vertices)
    mask = torch.zeros(vertices, dtype=torch.bool, device=triangles.device)
    return mask.index_fill_(0, take(triangles, true_rows(these)).reshape(-1), True)


def vertex_triangle_counts(triangles: Tensor, vertices: int) -> Tensor:
    """(V,) int64 number of triangles at each vertex."""
    return torch.bincount(triangles.reshape(-1), minlength=vertices)


def euler_number(triangles: Tensor, twin: Tensor) -> int:
    """V - E + F over the used vertices: 1 for a disc, 1 - (number of holes) for one with holes."""
    used = len(triangles.unique())
    return used - len(edges(triangles, twin)) + len(triangles)


def triangle_components(triangles: Tensor, twin: Tensor, blocked: Tensor | None = None) -> Tensor:
    """(T,) int64 component of each triangle, neighbours across edges; edges `blocked` (3T,) bool on both sides part.

    Numbered by their first triangles.  Of two components that touch, the one of higher root is hooked to the
    lower root, all at once, then every tree is flattened (Shiloach & Vishkin, An O(log n) parallel
    connectivity algorithm, Journal of Algorithms 3, 1982); about five rounds do a million triangles.
    """
    if library_for(twin) is not None:
        return geometry.triangle_components(twin, blocked)
    h = true_rows(twin > torch.arange(len(twin), device=twin.device))
    across = take(twin, h)
    if blocked is not None:
        passed = true_rows(~(blocked[h] & blocked[across]))
        h, across = h[passed], across[passed]
    one, two = h // 3, across // 3
    rows = torch.arange(len(triangles), device=twin.device)
    root = rows.clone()
    while len(one):
        root.scatter_reduce_(0, torch.maximum(one, two), torch.minimum(one, two), "amin")
        above = take(root, root)
        while not torch.equal(above, root):
            root, above = above, take(above, above)
        one, two = take(root, one), take(root, two)
        apart = true_rows(one != two)
        one, two = take(one, apart), take(two, apart)
    return take((root == rows).cumsum(0) - 1, root)


def vertex_components(triangles: Tensor, twin: Tensor, vertices: int) -> tuple[Tensor, int]:
    """(V,) int64 the component of each of the `vertices`, and the number of components.

    Two triangles are in one component if they have a vertex in common, or if a chain of such triangles joins them.
    Components are numbered in the order of their first triangles.  A vertex in no triangle has the component -1.
    """
    component = triangle_components(triangles, twin)
    corner, of_corner = triangles.reshape(-1), component.repeat_interleave(3)
    label = torch.full((vertices,), -1, device=triangles.device).scatter_(0, corner, of_corner)
    count = int(component.max()) + 1 if len(component) else 0
    # These components hang together by edges.  Two of them that meet in a vertex alone become one.
    there = take(label, corner)
    meet = true_rows(of_corner != there)
    if len(meet):
        least = edge_components(torch.stack([of_corner[meet], there[meet]], 1), count)
        number = (least == torch.arange(count, device=least.device)).cumsum(0) - 1
        label = torch.where(label >= 0, number[least[label]], -1)
        count = int(number[-1]) + 1
    return label, count


def edge_components(pairs: Tensor, count: int) -> Tensor:
    """(V,) int64 the least of the vertices that the edges `pairs` (E, 2) join each of the `count` vertices to."""
    label = torch.arange(count, device=pairs.device)
    while len(pairs):
        least = label[pairs].amin(1)
        lower = label.scatter_reduce(0, pairs.reshape(-1), least.repeat_interleave(2), "amin")
        lower = lower[lower]
        if torch.equal(lower, label):
            break
        label = lower
    return label


def boundary_loops(boundary: Tensor) -> list[Tensor]:
    """The closed walks along `boundary` (E, 2) directed edges, each a tensor of vertices in order.

    Where several loops meet in one vertex they are taken apart at it, so that no loop passes a
    vertex twice.
    """
    if len(boundary) > _FEW_EDGES and loops_may_read(boundary):
        loops = geometry.boundary_loops(boundary)
        if loops is not None:
            return loops
    pairs = boundary.tolist()
    onward = dict(pairs)
    if len(onward) == len(pairs):
        # No vertex is passed twice.
        order: list[int] = []
        sizes = []
        for v, _ in pairs:
            begin = len(order)
            while v in onward:
                order.append(v)
                v = onward.pop(v)
            if len(order) > begin:
                sizes.append(len(order) - begin)
        return list(torch.tensor(order, dtype=torch.int64, device=boundary.device).split(sizes))
    loops = []
    following: dict[int, list[int]] = {}
    for u, v in pairs:
        following.setdefault(u, []).append(v)
    for first, _ in pairs:
        walk = [first] if first in following else []
        position = {first: 0}
        while walk:
            u = walk[-1]
            v = following[u].pop()
            if not following[u]:
                del following[u]
            if v in position:
                start = position[v]
                loops.append(torch.tensor(walk[start:], device=boundary.device))
                for w in walk[start + 1 :]:
                    del position[w]
                walk = walk[: start + 1]
                if v not in following:
                    del position[v]
                    walk.pop()
            else:
                position[v] = len(walk)
                walk.append(v)
    return loops
