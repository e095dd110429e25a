"""Small meshes cut out of a batch, and their variants with one edge flipped: a batch in which flips are tried.

A batch of copies costs one pass, and every algorithm of the package treats each copy as a mesh of its own.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from ..flipping.rounds import edge_exists
from ..flipping.rules import Quads, new_signs
from ..mesh.batch import MeshBatch, join, triangle_mesh
from ..mesh.connectivity import next_in_triangle, previous_in_triangle
from ..mesh.kept_edges import constrained_half_edges
from ..mesh.ragged import offsets_from_counts, take, true_rows
from ..mesh.submesh import repeated


def seeds_of(batch: MeshBatch, bad: Tensor, angle: Tensor, reach: int) -> Tensor:
    """(P,) rows of the triangles `bad` (T,) bool that have the smallest angle within `reach` edges, ascending.

    angle  (T,) the smallest angle of each triangle; of equal angles the lower row wins
    """
    rows = true_rows(bad)
    order = rows[angle[rows].argsort(stable=True)]
    last = len(order)
    rank = torch.full((len(batch.triangles),), last, dtype=torch.int64, device=bad.device)
    rank[order] = torch.arange(last, device=bad.device)
    own, corner = rank, [v.contiguous() for v in batch.triangles.unbind(1)]
    for _ in range(reach):
        at_vertex = torch.full((len(batch.points),), last, dtype=torch.int64, device=bad.device)
        for v in corner:
            at_vertex.scatter_reduce_(0, v, rank, "amin")
        a, b, c = (take(at_vertex, v) for v in corner)
        rank = torch.minimum(a, torch.minimum(b, c))
    return true_rows(bad & (rank == own))


@dataclass(frozen=True, eq=False)
class Patches:
    """P small meshes cut out of a batch; their outermost vertices are fixed.

    mesh      the P meshes
    vertices  (V,) the rows of their vertices in the batch
    faces     (T,) the rows of their triangles in the batch
    complete  (V,) bool, all triangles at the vertex are in its patch
    seed      (V,) bool, the corners of the triangle around which the patch was cut out
    """

    mesh: MeshBatch
    vertices: Tensor
    faces: Tensor
    complete: Tensor
    seed: Tensor

    @classmethod
    def cut_out(cls, batch: MeshBatch, seeds: Tensor, rings: int, complete: Tensor) -> "Patches":
        """The triangles `seeds` (P,) with `rings` rings of free vertices around each; no two patches may touch."""
        label, of_face = _labels(batch, seeds, rings)
        faces = true_rows(of_face >= 0)
        faces = faces[of_face[faces].argsort(stable=True)]
        owner, count = of_face[faces], len(batch.points)
        # A vertex on the boundary of two patches is in both.
        keys, local = torch.unique(owner[:, None] * count + batch.triangles[faces], return_inverse=True)
        vertices = keys % count
        mine = label[vertices] == keys // count
        h = true_rows(constrained_half_edges(batch).reshape(-1, 3)[faces].reshape(-1))
        mesh = MeshBatch(
            batch.points[vertices],
            local,
            batch.fixed[vertices] | ~mine,
            torch.stack([local.reshape(-1)[h], local.reshape(-1)[next_in_triangle(h)]], 1),
            offsets_from_counts(torch.bincount(keys // count, minlength=len(seeds))),
            offsets_from_counts(torch.bincount(owner, minlength=len(seeds))),
            batch.frames[triangle_mesh(batch)[seeds]],
        )
        seed = torch.zeros(count, dtype=torch.bool, device=seeds.device)
        seed[batch.triangles[seeds]] = True
        return cls(mesh, vertices, faces, mine & complete[vertices], seed[vertices] & mine)

    @classmethod
    def together(cls, patches: list["Patches"]) -> "Patches":
        """All patches of the list as one; patches of different entries may touch."""
        names = ("vertices", "faces", "complete", "seed")
        return cls(join([p.mesh for p in patches]), *(torch.cat([getattr(p, n) for p in patches]) for n in names))


def _labels(batch: MeshBatch, seeds: Tensor, rings: int) -> tuple[Tensor, Tensor]:
    """The number of the patch in which a vertex (V,) is free, and of the patch of a triangle (T,); -1 for none."""
    label = torch.full((len(batch.points),), -1, dtype=torch.int64, device=seeds.device)
    number = torch.arange(len(seeds), device=seeds.device)
    corner = [v.contiguous() for v in batch.triangles.unbind(1)]
    for v in corner:
        label[v[seeds]] = number
    for ring in range(rings):
        a, b, c = (take(label, v) for v in corner)
        of_face = torch.maximum(a, torch.maximum(b, c))
        if ring < rings - 1:
            for v in corner:
                label.scatter_reduce_(0, v, of_face, "amax")
    return label, of_face


class _Flips(NamedTuple):
    """Flips that are legal, (F,) each: the two half-edges h and g of the edge, its ends u and w, its apexes s and r."""

    h: Tensor
    g: Tensor
    u: Tensor
    w: Tensor
    s: Tensor
    r: Tensor

    def where(self, keep: Tensor) -> "_Flips":
        return _Flips(*(v[keep] for v in self))


def every_flip(batch: MeshBatch, complete: Tensor, near: Tensor | None) -> tuple[MeshBatch, Tensor, Tensor]:
    """Every mesh as it is, followed by the mesh with each edge flipped whose flip is legal, one at a time.

    Returns the M meshes, the mesh (M,) of `batch` that each comes from, and (M,) bool: is it flipped?

    complete  (V,) bool, all triangles at the vertex are in the batch
    near      (V,) bool, flip only edges that end at one of these; None: at any
    """
    flips = _legal_flips(batch, complete, near)
    counts = torch.bincount(triangle_mesh(batch)[flips.h // 3], minlength=len(batch)) + 1
    owner = torch.arange(len(batch), device=counts.device).repeat_interleave(counts)
    first_member = offsets_from_counts(counts)[:-1]
    flipped = torch.ones_like(owner, dtype=torch.bool)
    flipped[first_member] = False
    # The half-edges h ascend, so the flips of a mesh follow each other in the order of its members.
    member = true_rows(flipped)
    out = repeated(batch, owner)
    triangles = out.triangles.clone()
    of = owner[member]
    to_vertex = (out.point_offsets[:-1][member] - batch.point_offsets[of])[:, None]
    to_face = out.triangle_offsets[:-1][member] - batch.triangle_offsets[of]
    h, g, u, w, s, r = flips
    triangles[h // 3 + to_face] = torch.stack([u, r, s], 1) + to_vertex
    triangles[g // 3 + to_face] = torch.stack([r, w, s], 1) + to_vertex
    return replace(out, triangles=triangles), owner, flipped


def _legal_flips(batch: MeshBatch, complete: Tensor, near: Tensor | None) -> _Flips:
    """The flips that keep both triangles upright and make no edge that exists; arguments as of `every_flip`."""
    twin, vertex = batch.twin, batch.triangles.reshape(-1)
    h = true_rows((twin > torch.arange(len(twin), device=twin.device)) & ~constrained_half_edges(batch))
    g = twin[h]
    flips = _Flips(h, g, vertex[h], vertex[g], vertex[previous_in_triangle(h)], vertex[previous_in_triangle(g)])
    if near is not None:
        flips = flips.where(near[flips.u] | near[flips.w])
    _, _, u, w, s, r = flips
    x, y = batch.points.to(torch.float64).unbind(1)
    first, second = new_signs(Quads(x[u], y[u], x[w], y[w], x[s], y[s], x[r], y[r]))
    # One end of the new edge must tell whether the edge exists already.  A vertex can tell if it has one fan.
    tells = complete & (torch.bincount(vertex[twin < 0], minlength=len(x)) < 2)
    flips = flips.where((first > 0) & (second > 0) & (s != r) & (tells[s] | tells[r]))
    from_s = tells[flips.s]
    start = torch.where(from_s, previous_in_triangle(flips.h), previous_in_triangle(flips.g))
    return flips.where(~edge_exists(vertex, twin, start, torch.where(from_s, flips.r, flips.s)))
