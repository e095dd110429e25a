"""Vertices taken out of a tangle that has no room for them: what no flip, move or new cavity can untangle.

With all its vertices, a mesh inside a simple boundary always has valid positions in real numbers, but not in
floating-point numbers: far from the origin a domain may hold fewer of these than it has vertices.  Kim 2017
names collapses as what is to follow flips; here they are the last resort of topology "full".

    tangled --> collapse round inverted triangles --> re-triangulate cavities --> valid?
                   ^                                                               | no
                   +---------------------------------------------------------------+

Elsewhere they are no gain.  On moved, turned and mapped tangles of 2,000 triangles, collapses and splits between
the flips left 4 to 390 triangles inverted.  Cavities had to be re-triangulated as without them, and the mesh was
no better in the end and no sooner there.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch, put
from ..mesh.interfaces import holding
from ..mesh.measure import quality
from ..mesh.predicates import orientation
from ..mesh.ragged import true_rows
from ..mesh.vertex_map import Names
from ..untangling.retriangulation import retriangulate_cavities
from .collapses import collapse
from .mutable import Editable, independent, neighbours
from .options import RemeshOptions
from .rounds import metric_at
from .sizing import size_field
from .state import RemeshState, editable, rebuilt


@dataclass(frozen=True, eq=False)
class Removed:
    """What `remove_vertices` did.

    cavities   (B,) int64, cavities that were re-triangulated
    collapses  (B,) int64, vertices that were taken out
    names      of the vertices that are left
    kept       (V',) int64, the rows that these had in the batch given
    size       (V',) float64, the mean edge length that there was at each
    metric     (V', 3) float64, the metric of the options at each; None: there is none
    """

    cavities: Tensor
    collapses: Tensor
    names: Names
    kept: Tensor
    size: Tensor
    metric: Tensor | None


def remove_vertices(batch: MeshBatch, options: RemeshOptions, names: Names | None = None) -> tuple[MeshBatch, Removed]:
    """Take free vertices out of tangled meshes until they are valid.

    Boundary, constrained edges, regions and fixed vertices stay; no vertex on a constrained edge is taken out, but
    cavities may move it where `options.interfaces` is "free".  Each round takes out vertices of inverted
    triangles, no two of them neighbours, those first that make the sum of |area| least.  Cavities are
    re-triangulated after one round, again after two more, then after four more, and so on.  A mesh is left
    tangled only if no vertex can go.

    names  of the vertices; None: `batch` is where the vertex map begins
    """
    sizes, metric = size_field(batch, "keep"), metric_at(batch, options)
    begun = RemeshState.begin(holding(batch, options.interfaces), sizes, metric=metric, interfaces=options.interfaces)
    state = begun
    cavities = torch.zeros_like(state.rounds)
    going, rounds = state.every(), 1
    while bool(going.any()):
        given = state.select(going)
        e = editable(given)
        taken = sum((collapse_round(e) for _ in range(rounds)), torch.zeros_like(given.collapses))
        part = rebuilt(replace(given, collapses=given.collapses + taken), e)
        mended, info = retriangulate_cavities(part.batch, options.interfaces)
        left, before = quality(mended).inverted, quality(part.batch).inverted
        better = left < before
        if bool(better.any()):
            part = replace(part, batch=put(part.batch, better, mended.select(better)))
        state = state.put(going, part)
        cavities[going] += torch.where(better, info.cavities, 0)
        going, rounds = going.masked_scatter(going, (taken > 0) & (left > 0)), 2 * rounds
    kept = state.names.of
    names = Names.of_rows(len(batch.points), kept.device) if names is None else names
    removed = Removed(cavities, state.collapses, names.select(kept), kept, state.size, state.metric)
    return state.released(batch, begun), removed


def collapse_round(e: Editable) -> Tensor:
    """Collapse free vertices of inverted triangles, no two near each other; how many of each mesh (B,)."""
    h, growth, claims = _candidates(e)
    # No two collapses share a head either: two edges could become one, and in a tangle no sign forbids that.
    h = h[independent(torch.stack([e.vertex[h], e.head(h)], 1), claims, growth, len(e.x))]
    count = e.per_mesh(h)
    collapse(e, h)
    return count


def inverted(e: Editable) -> Tensor:
    """(T,) bool: the living triangles that are inverted, by exact signs."""
    a, b, c = e.triangles.clamp_min(0).unbind(1)
    return (orientation(e.x[a], e.y[a], e.x[b], e.y[b], e.x[c], e.y[c]) <= 0) & (e.triangles[:, 0] >= 0)


def _candidates(e: Editable) -> tuple[Tensor, Tensor, Tensor]:
    """Collapses that keep the mesh a mesh: half-edges (N,), by how much |area| grows (N,), claims (N, K).

    Growth is relative to the area of the triangles that are there now.
    """
    near = torch.zeros_like(e.alive)
    near[e.triangles[inverted(e)].reshape(-1)] = True
    near &= ~e.fixed
    h = true_rows((e.vertex >= 0) & near[e.vertex.clamp_min(0)] & (e.twin >= 0))
    u, w = e.vertex[h], e.head(h)
    degree = e.degree()
    ring, closed = neighbours(e.vertex, e.twin, h)
    other, closed_other = neighbours(e.vertex, e.twin, e.twin[h])
    count, count_other = (ring >= 0).sum(1), (other >= 0).sum(1)
    # A vertex where several fans meet has more triangles than the walk has seen.
    whole = closed & (count == degree[u]) & (count_other - (~closed_other).long() == degree[w]) & (count > 2)
    common = ((ring[:, :, None] == other[:, None, :]) & (ring >= 0)[:, :, None]).sum((1, 2))
    rows = true_rows(whole & (common == 2))
    h, u, w, ring, count = h[rows], u[rows], w[rows], ring[rows], count[rows]
    column = torch.arange(ring.shape[1], device=h.device)[None]
    there, last = column < count[:, None], column == count[:, None] - 1
    a, b = ring.clamp_min(0), torch.where(last, ring[:, :1], ring.roll(-1, 1)).clamp_min(0)

    def area(p: Tensor, which: Tensor) -> Tensor:
        px, py = e.x[p][:, None], e.y[p][:, None]
        double = (e.x[a] - px) * (e.y[b] - py) - (e.y[a] - py) * (e.x[b] - px)
        return torch.where(which, double.abs(), 0.0).sum(1)

    # The triangles on both sides of the edge go; the others then have their corner at its head.
    now, then = area(u, there), area(w, there & ~last & (column > 0))
    growth = torch.where(now > 0, then / torch.where(now > 0, now, 1.0), torch.where(then > 0, torch.inf, 1.0))
    return h, growth, torch.cat([u[:, None], ring], 1)
