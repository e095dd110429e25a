"""Small meshes cut out of a batch, and the variants of them that differ by one flip: batches to try things on.

A batch of copies costs one pass, and each copy is a mesh of its own to every algorithm of the package.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..flipping.rounds import edge_exists
from ..flipping.rules import Quads, new_signs
from ..mesh.batch import MeshBatch, constrained_half_edges, join, triangle_mesh
from ..mesh.connectivity import next_in_triangle, previous_in_triangle
from ..mesh.ragged import offsets_from_counts
from ..mesh.submesh import repeated


def seeds_of(part: MeshBatch, bad: Tensor, angle: Tensor, reach: int) -> Tensor:
    """(P,) rows of the bad triangles that are worse than every other within `reach` edges, ascending."""
    rows = bad.nonzero().squeeze(1)
    order = rows[angle[rows].argsort(stable=True)]
    last = len(order)
    rank = torch.full((len(part.triangles),), last, dtype=torch.int64, device=bad.device)
    rank[order] = torch.arange(last, device=bad.device)
    own, corner = rank, [v.contiguous() for v in part.triangles.unbind(1)]
    for _ in range(reach):
        at_vertex = torch.full((len(part.points),), last, dtype=torch.int64, device=bad.device)
        for v in corner:
            at_vertex.scatter_reduce_(0, v, rank, "amin")
        a, b, c = (at_vertex.index_select(0, v) for v in corner)
        rank = torch.minimum(a, torch.minimum(b, c))
    return (bad & (rank == own)).nonzero().squeeze(1)


@dataclass(frozen=True, eq=False)
class Patches:
    """P small meshes cut out of a batch, whose outermost vertices are fixed.

    mesh      the P meshes;  vertices, faces  (V,), (T,) their rows in the batch
    complete  (V,) bool, all triangles at the vertex are in its patch
    seed      (V,) bool, the corners of the patch's worst triangle
    """

    mesh: MeshBatch
    vertices: Tensor
    faces: Tensor
    complete: Tensor
    seed: Tensor

    @classmethod
    def cut_out(cls, part: MeshBatch, seeds: Tensor, rings: int, complete: Tensor) -> "Patches":
        """The triangles `seeds` (P,) and so many rings of vertices round each, no two patches in touch."""
        label = torch.full((len(part.points),), -1, dtype=torch.int64, device=seeds.device)
        number = torch.arange(len(seeds), device=seeds.device)
        corner = [v.contiguous() for v in part.triangles.unbind(1)]
        for v in corner:
            label[v[seeds]] = number
        for ring in range(rings):
            a, b, c = (label.index_select(0, v) for v in corner)
            of_face = torch.maximum(a, torch.maximum(b, c))
            if ring < rings - 1:
                for v in corner:
                    label.scatter_reduce_(0, v, of_face, "amax")
        faces = (of_face >= 0).nonzero().squeeze(1)
        faces = faces[of_face[faces].argsort(stable=True)]
        owner, count = of_face[faces], len(part.points)
        # A vertex on the rim of two patches is in both.
        keys, place = torch.unique(owner[:, None] * count + part.triangles[faces], return_inverse=True)
        vertices = keys % count
        mine = label[vertices] == keys // count
        point_offsets = offsets_from_counts(torch.bincount(keys // count, minlength=len(seeds)))
        locked = constrained_half_edges(part)
        h = locked.reshape(-1, 3)[faces].reshape(-1).nonzero().squeeze(1)
        ends = torch.stack([place.reshape(-1)[h], place.reshape(-1)[next_in_triangle(h)]], 1)
        mesh = MeshBatch(
            part.points[vertices],
            place,
            part.fixed[vertices] | ~mine,
            ends,
            point_offsets,
            offsets_from_counts(torch.bincount(owner, minlength=len(seeds))),
            part.frames[triangle_mesh(part)[seeds]],
        )
        seed = torch.zeros(count, dtype=torch.bool, device=seeds.device)
        seed[part.triangles[seeds]] = True
        return cls(mesh, vertices, faces, mine & complete[vertices], seed[vertices] & mine)

    @classmethod
    def together(cls, patches: list["Patches"]) -> "Patches":
        """All of them; those of different lists may be in touch."""
        names = ("vertices", "faces", "complete", "seed")
        return cls(join([p.mesh for p in patches]), *(torch.cat([getattr(p, n) for p in patches]) for n in names))


def every_flip(batch: MeshBatch, complete: Tensor, near: Tensor | None) -> tuple[MeshBatch, Tensor, Tensor]:
    """Every mesh as it is and with each of its edges flipped that may be.

    Returns the M meshes, the mesh (M,) of `batch` that each comes from, and (M,) bool: is it flipped?
    complete  (V,) bool, all triangles at the vertex are there
    near      (V,) bool, flip edges that end at one of these only; None: at any
    """
    twin = batch.twin
    vertex = batch.triangles.reshape(-1)
    locked = constrained_half_edges(batch)
    half = torch.arange(len(twin), device=twin.device)
    h = ((twin > half) & ~locked).nonzero().squeeze(1)
    g = twin[h]
    u, w, s, r = vertex[h], vertex[g], vertex[previous_in_triangle(h)], vertex[previous_in_triangle(g)]
    if near is not None:
        close = near[u] | near[w]
        h, g, u, w, s, r = (v[close] for v in (h, g, u, w, s, r))
    x, y = batch.points.to(torch.float64).unbind(1)
    first, second = new_signs(Quads(x[u], y[u], x[w], y[w], x[s], y[s], x[r], y[r]))
    # Whether the new edge is there already, one of its ends must know; it does if it has one fan of triangles.
    knows = complete & (torch.bincount(vertex[twin < 0], minlength=len(x)) < 2)
    legal = (first > 0) & (second > 0) & (s != r) & (knows[s] | knows[r])
    h, g, u, w, s, r = (v[legal] for v in (h, g, u, w, s, r))
    start = torch.where(knows[s], previous_in_triangle(h), previous_in_triangle(g))
    free = ~edge_exists(vertex, twin, start, torch.where(knows[s], r, s))
    h, g, u, w, s, r = (v[free] for v in (h, g, u, w, s, r))
    counts = torch.bincount(triangle_mesh(batch)[h // 3], minlength=len(batch)) + 1
    owner = torch.arange(len(batch), device=h.device).repeat_interleave(counts)
    first_member = offsets_from_counts(counts)[:-1]
    flipped = torch.ones_like(owner, dtype=torch.bool)
    flipped[first_member] = False
    # Edges ascend, so those of a mesh stand together, in the order of its members.
    member = flipped.nonzero().squeeze(1)
    out = repeated(batch, owner)
    triangles = out.triangles.clone()
    of = owner[member]
    to_vertex, to_face = (out.point_offsets[:-1][member] - batch.point_offsets[of],
                          out.triangle_offsets[:-1][member] - batch.triangle_offsets[of])  # fmt: skip
    triangles[h // 3 + to_face] = torch.stack([u, r, s], 1) + to_vertex[:, None]
    triangles[g // 3 + to_face] = torch.stack([r, w, s], 1) + to_vertex[:, None]
    return replace(out, triangles=triangles), owner, flipped
