"""Vertices taken out of a tangle for which there is no room: what no flip, move or pocket can untangle.

With all its vertices, a mesh inside a simple boundary always has valid places in real numbers, but
not in floating-point numbers: far from the origin a domain may have fewer of them than vertices.
Kim 2017 names collapses as what is to follow flips; here they are the last resort of topology "full".

            tangled --> collapse round the fallen triangles --> make pockets anew --> valid?
                              ^                                                        | no
                              +--------------------------------------------------------+

Elsewhere they are no gain: on moved, turned and mapped tangles of 2,000 triangles, collapses and splits
between the flips left 4 to 390 triangles fallen, which pockets had to mend as without, and the mesh in
the end was no better and no sooner there.
"""

from dataclasses import replace

import torch
from torch import Tensor

from ..mesh.batch import put
from ..mesh.measure import quality
from ..mesh.predicates import orientation
from ..mesh.ragged import spread
from ..untangling.retriangulation import retriangulate_cavities
from .collapses import collapse
from .mutable import Editable, independent, living, neighbours
from .remeshing import Remeshing, editable, rebuilt
from .sizing import size_field


def untangle_by_surgery(work: Remeshing, at: Tensor) -> Tensor:
    """Take free vertices out of the meshes `at` (B,) bool of `work` until they are valid; the pockets of each (B,).

    Boundary, constrained edges, regions and fixed vertices stay, and `work` knows the old names of the
    vertices that are left.  Each round takes out vertices of fallen triangles, no two of them neighbours,
    those first that make the sum of |area| least; after one round pockets are tried, after two more again,
    then after four.  A mesh is left tangled only if no vertex can go.
    """
    pockets = torch.zeros(len(at), dtype=torch.int64, device=at.device)
    work.size = size_field(work.batch, "keep") if work.size is None else work.size
    going, rounds = at, 1
    while bool(going.any()):
        part, rows = work.batch.select(going), spread(going, work.batch.point_offsets)
        size, names, *metric = (values[rows] for values in work.fields())
        e = editable(part, size, work.names, names, *metric)
        taken = sum((collapse_round(e) for _ in range(rounds)), torch.zeros_like(pockets[going]))
        part, *fields = rebuilt(part, e)
        if e.metric is not None:
            fields.append(e.metric[living(e)])
        work.exchange(going, part, fields)
        work.collapses[going] += taken
        mended, info = retriangulate_cavities(part)
        left = quality(mended).inverted
        better = left < quality(part).inverted
        if bool(better.any()):
            work.batch = put(work.batch, going, put(part, better, mended.select(better)))
        pockets[going] += torch.where(better, info.cavities, 0)
        still = going.clone()
        still[going] = (taken > 0) & (left > 0)
        going, rounds = still, 2 * rounds
    if isinstance(work.options.sizes, Tensor):
        work.options = replace(work.options, sizes=work.names.vertex_map().carry(work.options.sizes))
    return pockets


def collapse_round(e: Editable) -> Tensor:
    """Collapse free vertices of triangles that are not upright, no two near each other; how many of each mesh (B,)."""
    h, growth, claims = _candidates(e)
    # Nor do two have one head, or two edges could become one: in a tangle no sign forbids that.
    h = h[independent(torch.stack([e.vertex[h], e.head(h)], 1), claims, growth, len(e.x))]
    count = e.per_mesh(h)
    collapse(e, h)
    return count


def fallen(e: Editable) -> Tensor:
    """(T,) bool: the living triangles that are not upright, by exact signs."""
    a, b, c = e.triangles.clamp_min(0).unbind(1)
    return (orientation(e.x[a], e.y[a], e.x[b], e.y[b], e.x[c], e.y[c]) <= 0) & (e.triangles[:, 0] >= 0)


def _candidates(e: Editable) -> tuple[Tensor, Tensor, Tensor]:
    """Collapses that keep the mesh a mesh: half-edges (N,), by how much |area| grows (N,), claims (N, K).

    Growth is relative to the area of the triangles that are there now.
    """
    near = torch.zeros_like(e.alive)
    near[e.triangles[fallen(e)].reshape(-1)] = True
    near &= ~e.fixed
    h = ((e.vertex >= 0) & near[e.vertex.clamp_min(0)] & (e.twin >= 0)).nonzero().squeeze(1)
    u, w = e.vertex[h], e.head(h)
    degree = e.degree()
    ring, closed = neighbours(e.vertex, e.twin, h)
    other, closed_other = neighbours(e.vertex, e.twin, e.twin[h])
    count, count_other = (ring >= 0).sum(1), (other >= 0).sum(1)
    # A vertex where several fans meet has more triangles than the walk has seen.
    whole = closed & (count == degree[u]) & (count_other - (~closed_other).long() == degree[w]) & (count > 2)
    common = ((ring[:, :, None] == other[:, None, :]) & (ring >= 0)[:, :, None]).sum((1, 2))
    rows = (whole & (common == 2)).nonzero().squeeze(1)
    h, u, w, ring, count = h[rows], u[rows], w[rows], ring[rows], count[rows]
    column = torch.arange(ring.shape[1], device=h.device)[None]
    there, last = column < count[:, None], column == count[:, None] - 1
    a, b = ring.clamp_min(0), torch.where(last, ring[:, :1], ring.roll(-1, 1)).clamp_min(0)

    def area(p: Tensor, which: Tensor) -> Tensor:
        px, py = e.x[p][:, None], e.y[p][:, None]
        double = (e.x[a] - px) * (e.y[b] - py) - (e.y[a] - py) * (e.x[b] - px)
        return torch.where(which, double.abs(), 0.0).sum(1)

    # Those on both sides of the edge go; the others have their corner at its head then.
    now, then = area(u, there), area(w, there & ~last & (column > 0))
    growth = torch.where(now > 0, then / torch.where(now > 0, now, 1.0), torch.where(then > 0, torch.inf, 1.0))
    return h, growth, torch.cat([u[:, None], ring], 1)
