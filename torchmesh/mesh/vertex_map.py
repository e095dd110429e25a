"""Which vertices of a remeshed batch come from which of the given batch: maps between old and new rows."""

from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from .batch import MeshBatch, constraint_owner
from .ragged import counts_from_offsets, offsets_from_counts, segment_ids, spread, true_rows


@dataclass(frozen=True, eq=False)
class VertexMap:
    """Which vertices of a mesh come from which vertices of the mesh that it was made of.

    old_to_new  (V_old,) int64, the new row of each old vertex; -1 if it was removed
    new_to_old  (V_new,) int64, the old row of each new vertex; -1 if it was inserted
    rows, sources, weights  (N,) each, ascending in rows: a field at the new vertex rows[i] is the sum of weights[i]
                times the field at the old vertex sources[i].  The only source of a kept vertex is itself.  The
                sources of an inserted vertex are the ends of the edge that it halved, or the sources of these ends
                if they were inserted too; those of a vertex that was placed in a triangle are its corners.  The
                weights of a vertex sum to 1
    """

    old_to_new: Tensor
    new_to_old: Tensor
    rows: Tensor
    sources: Tensor
    weights: Tensor

    def __repr__(self) -> str:
        kept, inserted = int((self.old_to_new >= 0).sum()), int((self.new_to_old < 0).sum())
        return f"VertexMap({kept} vertices kept, {len(self.old_to_new) - kept} removed, {inserted} inserted)"

    def split(self, before: MeshBatch, after: MeshBatch) -> list["VertexMap"]:
        """The map of each mesh of the batch `before` that became the batch `after`."""
        maps = []
        old, new = before.point_offsets.tolist(), after.point_offsets.tolist()
        entries = torch.searchsorted(self.rows, after.point_offsets).tolist()
        for b in range(len(before)):
            onward, back = self.old_to_new[old[b] : old[b + 1]], self.new_to_old[new[b] : new[b + 1]]
            here = slice(entries[b], entries[b + 1])
            maps.append(
                VertexMap(
                    torch.where(onward >= 0, onward - new[b], -1), torch.where(back >= 0, back - old[b], -1),
                    self.rows[here] - new[b], self.sources[here] - old[b], self.weights[here],
                )
            )  # fmt: skip
        return maps

    def of_given(self, given: Tensor) -> "VertexMap":
        """The map from some of the old vertices, the rows `given` (N,) int64, of which all the new ones come."""
        place = torch.full_like(self.old_to_new, -1)
        place[given] = torch.arange(len(given), device=given.device)
        back = torch.where(self.new_to_old >= 0, place[self.new_to_old], -1)
        return replace(self, old_to_new=self.old_to_new[given], new_to_old=back, sources=place[self.sources])

    def carry(self, field: Tensor) -> Tensor:
        """Values at the old vertices (V_old, ...) as values at the new ones (V_new, ...).

        Floating-point values are interpolated.  Others are copied from the source of most weight, and from the first
        of several such.  A vertex that was moved takes its value along.  Raises InvalidMeshError for another number
        of rows.
        """
        if len(field) != len(self.old_to_new):
            raise InvalidMeshError(f"a field over {len(self.old_to_new)} old vertices was asked for, not {len(field)}")
        count = len(self.new_to_old)
        if field.is_floating_point() or field.is_complex():
            shape = (-1,) + (1,) * (field.ndim - 1)
            parts = field[self.sources] * self.weights.to(field.dtype).reshape(shape)
            return field.new_zeros((count, *field.shape[1:])).index_add_(0, self.rows, parts)
        most = self.weights.new_zeros(count).scatter_reduce_(0, self.rows, self.weights, "amax")
        row = torch.arange(len(self.rows), device=self.rows.device)
        first = torch.full_like(self.new_to_old, len(row))
        candidates = self.weights == most[self.rows]
        first.scatter_reduce_(0, self.rows[candidates], row[candidates], "amin")
        return field[self.sources[first]]


@dataclass(frozen=True, eq=False)
class Placed:
    """Vertices that were placed in triangles of earlier ones.

    names    (N,) int64 of the new vertices
    corners  (N, 3) int64, the names of the corners of the triangles
    weights  (N, 3) float64, with which a linear function is read at the new vertices; they sum to 1
    """

    names: Tensor
    corners: Tensor
    weights: Tensor


@dataclass(frozen=True, eq=False)
class Names:
    """Names of vertices, which stay the same while rows change; a vertex of the given mesh is named by its first row.

    of      (V,) int64, the name of each vertex
    first   the number of vertices at the beginning
    fresh   the next name that is free
    births  tensors (N, 3) int64: the name of an inserted vertex, and the names of the ends of the edge that it halved
    placed  the vertices that were placed in triangles instead
    """

    of: Tensor
    first: int
    fresh: int
    births: tuple[Tensor, ...] = ()
    placed: tuple[Placed, ...] = ()

    @classmethod
    def of_rows(cls, vertices: int, device: torch.device) -> "Names":
        """The names at the beginning, when there are `vertices` vertices."""
        return cls(torch.arange(vertices, device=device), vertices, vertices)

    def select(self, rows: Tensor) -> "Names":
        """The names of the vertices `rows`, (V,) bool or (N,) int64, with the whole history."""
        return replace(self, of=self.of[rows])

    def renamed(self, of: Tensor, fresh: int | None = None, births: tuple[Tensor, ...] | None = None) -> "Names":
        """The names `of` other vertices, with the same history unless another is given."""
        return replace(
            self, of=of, fresh=self.fresh if fresh is None else fresh, births=self.births if births is None else births
        )

    def later(self, other: "Names") -> "Names":
        """These names or the `other` ones, whichever have the longer history; both must share their beginning."""
        return self if self.fresh >= other.fresh else other

    def with_placed(self, of: Tensor, placed: Placed) -> "Names":
        """The names `of` other vertices, the last ones of which, with the next free names, were `placed`."""
        return replace(self, of=of, fresh=self.fresh + len(placed.names), placed=(*self.placed, placed))

    def after(self, other: "Names") -> "Names":
        """These names, where inserted vertices are called otherwise than those that `other` names.

        Both begin with the same vertices.  What comes has the history of both.
        """
        shift = other.fresh - self.first

        def moved(names: Tensor) -> Tensor:
            return torch.where(names >= self.first, names + shift, names)

        births = (*other.births, *(moved(birth) for birth in self.births))
        placed = (*other.placed, *(Placed(moved(p.names), moved(p.corners), p.weights) for p in self.placed))
        return Names(moved(self.of), self.first, self.fresh + shift, births, placed)

    def vertex_map(self) -> VertexMap:
        """The map from the vertices at the beginning to the present ones, which is made once."""
        return self._map

    @cached_property
    def _map(self) -> VertexMap:
        kept = self.of < self.first
        old_to_new = torch.full((self.first,), -1, device=self.of.device)
        rows = torch.arange(len(self.of), device=self.of.device)
        old_to_new[self.of[kept]] = rows[kept]
        parents, shares = self._parents()
        sources, weights = self.of.clone(), torch.ones(len(rows), dtype=torch.float64, device=self.of.device)
        while True:
            young = sources >= self.first
            if not bool(young.any()):
                break
            birth = sources[young] - self.first
            share = shares[birth] * weights[young, None]
            there = share != 0
            rows = torch.cat([rows[~young], rows[young].repeat(shares.shape[1])[there.T.reshape(-1)]])
            weights = torch.cat([weights[~young], share.T[there.T]])
            sources = torch.cat([sources[~young], parents[birth].T[there.T]])
            # Each pair gets one entry.  Sums of halves are exact, so the order of summation does not matter for them.
            pairs, entry = torch.unique(rows * self.fresh + sources, return_inverse=True)
            weights = weights.new_zeros(len(pairs)).index_add_(0, entry, weights)
            rows, sources = pairs // self.fresh, pairs % self.fresh
        return VertexMap(old_to_new, torch.where(kept, self.of, -1), rows, sources, weights)

    def _parents(self) -> tuple[Tensor, Tensor]:
        """(N, 2 or 3) the names of which each vertex that is no first one came, and their weights."""
        count, columns, device = self.fresh - self.first, 3 if self.placed else 2, self.of.device
        parents = torch.full((count, columns), -1, device=device)
        weights = torch.zeros((count, columns), dtype=torch.float64, device=device)
        for birth in self.births:
            row = birth[:, 0] - self.first
            parents[row, :2] = birth[:, 1:]
            weights[row, :2] = 0.5
        for placed in self.placed:
            row = placed.names - self.first
            parents[row], weights[row] = placed.corners, placed.weights
        return parents, weights


def exchange(batch: MeshBatch, at: Tensor, part: MeshBatch, fields: list[tuple[Tensor, Tensor]]) -> tuple:
    """`batch` with the meshes `at` (B,) bool replaced by the meshes of `part`, which may have other sizes.

    fields  pairs of a field (V, ...) over the vertices of `batch` and one over those of `part`

    Returns the new batch, and for each pair of fields the field (V_new, ...) over it.
    """
    vertex = _source_rows(batch.point_offsets, at, part.point_offsets)
    face = _source_rows(batch.triangle_offsets, at, part.triangle_offsets)
    counts = _counts(batch.point_offsets, at, part.point_offsets)
    offsets = offsets_from_counts(counts)
    face_offsets = offsets_from_counts(_counts(batch.triangle_offsets, at, part.triangle_offsets))
    faces = torch.cat([_local(batch), _local(part)])[face] + spread(offsets[:-1], face_offsets)[:, None]
    edges, owners = [], []
    for mesh, rows in ((batch, torch.arange(len(batch), device=at.device)), (part, true_rows(at))):
        owner = constraint_owner(mesh)
        stays = ~at[owner] if mesh is batch else torch.ones_like(owner, dtype=torch.bool)
        shift = offsets[rows[owner]] - mesh.point_offsets[owner]
        edges.append((mesh.constrained_edges + shift[:, None])[stays])
        owners.append(rows[owner][stays])
    order = torch.cat(owners).argsort(stable=True)
    fixed = torch.cat([batch.fixed, part.fixed])[vertex]
    points = torch.cat([batch.points, part.points])[vertex]
    twin = None
    if batch.known_twin is not None and part.known_twin is not None:
        local = torch.cat([_local_twins(batch), _local_twins(part)]).reshape(-1, 3)[face]
        twin = torch.where(local < 0, -1, local + 3 * spread(face_offsets[:-1], face_offsets)[:, None]).reshape(-1)
    whole = MeshBatch(
        points, faces, fixed, torch.cat(edges)[order], offsets, face_offsets, batch.frames,
        None if twin is None else (faces, twin), *_exchanged_quads(batch, at, part, offsets),
        max(batch.rows_per_quad, part.rows_per_quad),
    )  # fmt: skip
    return whole, *(torch.cat(pair)[vertex] for pair in fields)


def _exchanged_quads(batch: MeshBatch, at: Tensor, part: MeshBatch, offsets: Tensor) -> tuple[Tensor, Tensor]:
    """The quads and their offsets in the new batch, whose points have these `offsets` (B+1,)."""
    rows = _source_rows(batch.quad_offsets, at, part.quad_offsets)
    ends = offsets_from_counts(_counts(batch.quad_offsets, at, part.quad_offsets))
    local = [m.quads - spread(m.point_offsets[:-1], m.quad_offsets)[:, None] for m in (batch, part)]
    return torch.cat(local)[rows] + spread(offsets[:-1], ends)[:, None], ends


def _counts(offsets: Tensor, at: Tensor, part: Tensor) -> Tensor:
    """(B,) the numbers of rows of the new batch, from the offsets of the old one and of `part`."""
    counts = counts_from_offsets(offsets).clone()
    counts[at] = counts_from_offsets(part)
    return counts


def _source_rows(offsets: Tensor, at: Tensor, part: Tensor) -> Tensor:
    """(N,) for each row of the new batch, its row in the rows of the old batch followed by the rows of `part`."""
    start = offsets[:-1].clone()
    start[at] = offsets[-1] + part[:-1]
    new = offsets_from_counts(_counts(offsets, at, part))
    return torch.arange(int(new[-1]), device=at.device) + spread(start - new[:-1], new)


def _local(batch: MeshBatch) -> Tensor:
    """(T, 3) the triangles, with vertices numbered within each mesh."""
    return batch.triangles - batch.point_offsets[segment_ids(batch.triangle_offsets)][:, None]


def _local_twins(batch: MeshBatch) -> Tensor:
    """(3T,) the twins, with half-edges numbered within each mesh."""
    shift = 3 * spread(batch.triangle_offsets[:-1], 3 * batch.triangle_offsets)
    return torch.where(batch.twin < 0, -1, batch.twin - shift)
