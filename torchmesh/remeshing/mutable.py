"""Meshes whose vertices and triangles come and go, as bare tensors that know their half-edge twins.

The rows of a removed triangle hold -1 until `compact` lays the remaining ones of each mesh end to end again.
New rows are added at the end, or take removed rows of the same mesh where numbers must stay.  The modules
`splits` and `collapses` change such meshes.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from ..mesh.connectivity import next_in_triangle, previous_in_triangle
from ..mesh.predicates import orientation
from ..mesh.ragged import true_rows
from ..mesh.triangle import SQRT3

# Ranks that differ by less than an eighth count as equal in `shuffled`.
_STEPS = 8


@dataclass(eq=False)
class Editable:
    """Meshes whose rows may be removed and added; they are changed in place.

    "Dead" are removed rows, "living" the others.

    x, y      (V,) float64, in any power of two times the caller's unit
    size      (V,) float64, the edge length wanted at each vertex, in the same unit
    fixed     (V,) bool
    mesh      (V,) int64, the mesh of each vertex
    origin    (V,) int64, what the caller calls the vertex; a new vertex gets `fresh` and counts it up
    vertex    (3T,) int64 tail of each half-edge, -1 in dead triangles
    twin      (3T,) int64
    locked    (3T,) bool, half-edges (both of an edge) that must stay
    alive     (V,) bool
    dtype     precision of the caller's coordinates; new positions are rounded to it
    fresh     the next name to give to a vertex
    births    list of (N, 3): name of the new vertex and of the two ends of the edge it halves
    meshes    how many there are
    metric    (V, 3) float64, the metric at each vertex, of determinant 1; None: that of the plane
    """

    x: Tensor
    y: Tensor
    size: Tensor
    fixed: Tensor
    mesh: Tensor
    origin: Tensor
    vertex: Tensor
    twin: Tensor
    locked: Tensor
    alive: Tensor
    dtype: torch.dtype
    fresh: int
    births: list[Tensor]
    meshes: int
    metric: Tensor | None = None

    @property
    def triangles(self) -> Tensor:
        """(T, 3) rows of vertices, -1 in dead triangles."""
        return self.vertex.reshape(-1, 3)

    def edges(self) -> Tensor:
        """The living edges, each once, as its lower half-edge, ascending."""
        h = torch.arange(len(self.twin), device=self.twin.device)
        return true_rows(((self.twin < 0) | (h < self.twin)) & (self.vertex >= 0))

    def head(self, h: Tensor) -> Tensor:
        """The vertex each half-edge runs to."""
        return self.vertex[next_in_triangle(h)]

    def relative_length(self, h: Tensor) -> Tensor:
        """(N,) length of the edges h over the mean of the sizes wanted at their ends."""
        u, w = self.vertex[h], self.head(h)
        dx, dy = self.x[w] - self.x[u], self.y[w] - self.y[u]
        metric = None if self.metric is None else 0.5 * (self.metric[u] + self.metric[w])
        return 2 * length(dx, dy, metric) / (self.size[u] + self.size[w])

    def shuffled(self, h: Tensor, rank: Tensor) -> Tensor:
        """(N,) int64 keys that order the edges h by `rank` (N,) coarsely, and nearly at random among equals.

        In a smooth order neighbours wait for each other; in a random order many can go in one round.  The keys
        are drawn from the bits of the coordinates, so that a mesh has the same ones alone as in a batch.
        """
        u, w = self.vertex[h], self.head(h)
        bits = [v.view(torch.int64) for v in (self.x[u], self.y[u], self.x[w], self.y[w])]
        mixed = torch.zeros_like(bits[0])
        for word in bits:
            # Multiplier of Knuth's linear congruential generator MMIX; the high bits are the good ones.
            mixed = (mixed ^ (word >> 29) ^ word) * 6364136223846793005 + 1442695040888963407
        coarse = (rank.clamp(-1e4, 1e4) * _STEPS).to(torch.int64)
        return (coarse << 40) + ((mixed >> 20) & ((1 << 40) - 1))

    def degree(self) -> Tensor:
        """(V,) int64 living triangles at each vertex."""
        return torch.bincount(self.vertex + 1, minlength=len(self.x) + 1)[1:]

    def per_mesh(self, h: Tensor) -> Tensor:
        """(B,) how many of the half-edges h each mesh has."""
        return torch.bincount(self.mesh[self.vertex[h]], minlength=self.meshes)

    def around(self, v: Tensor) -> Tensor:
        """(N, K) the half-edges from each of the vertices v (N,), ascending, -1 as padding."""
        # The last entry stands for the -1 of dead triangles.
        asked = torch.zeros(len(self.x) + 1, dtype=torch.bool, device=v.device)
        asked[v] = True
        h = true_rows(asked[self.vertex])
        h = h[self.vertex[h].argsort(stable=True)]
        count = torch.bincount(self.vertex[h], minlength=len(self.x))
        column = torch.arange(max(1, int(count.max())), device=v.device)
        place = (count.cumsum(0) - count)[v][:, None] + column
        return torch.where(column < count[v][:, None], h[place.clamp_max(len(h) - 1)], -1)

    def rounded(self, values: Tensor) -> Tensor:
        """Coordinates as the caller can store them."""
        return values.to(self.dtype).to(values.dtype)

    def middle(self, h: Tensor) -> tuple[Tensor, Tensor]:
        """(N,) x and y of the middles of the edges h."""
        u, w = self.vertex[h], self.head(h)
        return self.rounded(0.5 * (self.x[u] + self.x[w])), self.rounded(0.5 * (self.y[u] + self.y[w]))


def neighbours(vertex: Tensor, twin: Tensor, start: Tensor) -> tuple[Tensor, Tensor]:
    """The vertices round the tail of each half-edge `start` (N,), counter-clockwise from its head.

    Returns them as (N, K), padded with -1, and closed (N,) bool: do the triangles close a ring?
    Where they do not, those on the clockwise side of `start` come after the others, outwards.
    """
    rows = torch.arange(len(start), device=start.device)
    closed = torch.zeros(len(start), dtype=torch.bool, device=start.device)
    columns = []
    here, ended = start, []
    while len(rows):
        column = torch.full_like(start, -1)
        column[rows] = vertex[next_in_triangle(here)]
        columns.append(column)
        behind = previous_in_triangle(here)
        onward = twin[behind]
        back = onward == start[rows]
        closed[rows[back]] = True
        stop = onward < 0
        if bool(stop.any()):
            ended.append((rows[stop], vertex[behind[stop]]))
        going = ~back & ~stop
        rows, here = rows[going], onward[going]
    if ended:
        rows, last = (torch.cat(v) for v in zip(*ended, strict=True))
        column = torch.full_like(start, -1)
        column[rows] = last
        columns.append(column)
        here = twin[start[rows]]
        while len(rows):
            inner = here >= 0
            rows, here = rows[inner], next_in_triangle(here[inner])
            if not len(rows):
                break
            column = torch.full_like(start, -1)
            column[rows] = vertex[next_in_triangle(here)]
            columns.append(column)
            here = twin[here]
    if not columns:
        return start.new_zeros((len(start), 0)), closed
    return torch.stack(columns, 1), closed


def length(dx: Tensor, dy: Tensor, metric: Tensor | None = None) -> Tensor:
    """(...) length of the steps; metric (..., 3) in which they are measured, None: that of the plane."""
    if metric is None:
        return (dx * dx + dy * dy).sqrt()
    m11, m12, m22 = metric.unbind(-1)
    return (m11 * dx * dx + 2 * m12 * dx * dy + m22 * dy * dy).sqrt()


def fan_quality(
    px: Tensor, py: Tensor, ax: Tensor, ay: Tensor, bx: Tensor, by: Tensor, metric: Tensor | None = None
) -> Tensor:
    """Inverse mean ratio (Munson 2007) of the triangles p a b, infinite where they are inverted.

    metric  (..., 3) in which it is measured, of any determinant; None: that of the plane
    """
    ux, uy, vx, vy = ax - px, ay - py, bx - px, by - py
    double_area = ux * vy - uy * vx
    if metric is not None:
        m11, m12, m22 = metric.unbind(-1)
        ratio = (
            m11 * (ux * ux + vx * vx - ux * vx)
            + m22 * (uy * uy + vy * vy - uy * vy)
            + m12 * (2 * (ux * uy + vx * vy) - (ux * vy + uy * vx))
        ) / (SQRT3 * (m11 * m22 - m12 * m12).sqrt())
        upright = double_area > 0
        return torch.where(upright, ratio / torch.where(upright, double_area, 1.0), torch.inf)
    # |u|^2 + |v|^2 + |u - v|^2 over 2 sqrt(3) times the double area.
    squares = ux * ux + uy * uy + vx * vx + vy * vy - (ux * vx + uy * vy)
    upright = double_area > 0
    return torch.where(upright, squares / (SQRT3 * torch.where(upright, double_area, 1.0)), torch.inf)


def all_upright(e: Editable, px: Tensor, py: Tensor, a: Tensor, b: Tensor, there: Tensor) -> Tensor:
    """(N,) bool by exact signs: are the triangles p a_i b_i (N, K) upright wherever `there` (N, K)?"""
    rows, columns = there.nonzero(as_tuple=True)
    a, b = a[rows, columns], b[rows, columns]
    sign = orientation(px[rows], py[rows], e.x[a], e.y[a], e.x[b], e.y[b])
    good = torch.ones(len(px), dtype=torch.bool, device=px.device)
    good[rows[sign <= 0]] = False
    return good


def independent(centres: Tensor, claims: Tensor, rank: Tensor, count: int) -> Tensor:
    """(N,) bool: the rows of lower rank than any other that has a centre (N, C) among their claims (N, K).

    Centres and claims are below `count`, or -1 for none; equal ranks go by row, so a mesh's choice is
    the same whatever else is in the batch.
    """
    order = rank.argsort(stable=True)
    place = torch.empty_like(order)
    place[order] = torch.arange(len(order), device=order.device)
    row, column = (centres >= 0).nonzero(as_tuple=True)
    best = torch.full((count + 1,), len(order), dtype=torch.int64, device=order.device)
    best.scatter_reduce_(0, centres[row, column], place[row], "amin")
    # The last entry stands for -1.
    return (best[claims] >= place[:, None]).all(1)


def within_budget(owner: Tensor, rank: Tensor, budget: Tensor) -> Tensor:
    """(N,) bool: the rows of lowest rank (N,) of each mesh `owner` (N,), as many as its budget (B,) has."""
    order = rank.argsort(stable=True)
    order = order[owner[order].argsort(stable=True)]
    counts = torch.bincount(owner, minlength=len(budget))
    place = torch.arange(len(owner), device=owner.device) - (counts.cumsum(0) - counts)[owner[order]]
    inside = torch.zeros(len(owner), dtype=torch.bool, device=owner.device)
    inside[order] = place < budget[owner[order]]
    return inside


def compact(e: Editable) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """The living rows, with those of each mesh together.

    Returns the old row of each vertex (V,), the triangles in new rows (T, 3), the locked edges that
    are not on the boundary (K, 2), and the vertices and triangles of each mesh (B,).
    Within a mesh rows keep their order.
    """
    kept = true_rows(e.alive)
    kept = kept[e.mesh[kept].argsort(stable=True)]
    new = torch.full_like(e.mesh, -1)
    new[kept] = torch.arange(len(kept), device=kept.device)
    faces = e.triangles[e.triangles[:, 0] >= 0]
    owner = e.mesh[faces[:, 0]]
    faces = new[faces[owner.argsort(stable=True)]]
    h = true_rows((e.vertex >= 0) & e.locked & (e.twin >= 0))
    h = h[h < e.twin[h]]
    edges = new[torch.stack([e.vertex[h], e.head(h)], 1)]
    edges = edges[e.mesh[e.vertex[h]].argsort(stable=True)]
    counts = torch.bincount(e.mesh[kept], minlength=e.meshes), torch.bincount(owner, minlength=e.meshes)
    return kept, faces, edges, *counts
