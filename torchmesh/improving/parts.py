"""Parts cut out of the meshes of a batch, each a mesh of its own, and put back once they were worked on.

    . . . . . . . . . .     #  free vertices of one part; + of another
    . b b b . . b b b .     b  held: the outermost vertices of a part, which other triangles have, too
    . b # b . . b + b .     .  not taken
    . b b b . . b b b .
    . . . . . . . . . .

The triangles of a part hang together by its free vertices, so no two parts share a triangle or a free vertex.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..mesh import connectivity
from ..mesh.batch import MeshBatch, triangle_mesh
from ..mesh.connectivity import keys_of
from ..mesh.quads import diagonals
from ..mesh.ragged import (
    counts_from_offsets,
    offsets_from_counts,
    put_rows,
    segment_ids,
    segment_max,
    segment_sum,
    spread,
    true_rows,
)
from ..mesh.submesh import with_both_halves
from ..mesh.vertex_map import Names, Placed
from .report import Step
from .runner import Log, Work
from .state import State


@dataclass(frozen=True, eq=False)
class Parts:
    """P parts of a batch.

    batch      what they were cut out of
    mesh       the P meshes, with their outermost vertices fixed
    vertices   (V',) int64, the rows of their vertices in the batch; held ones may be in several parts
    triangles  (T',) int64, the rows of their triangles
    free       (V',) bool, the vertices that are not held
    owner      (P,) int64, the mesh that each part is of
    whole      (P,) bool, the part is all of the mesh, or a piece of it that no edge joins to the rest
    """

    batch: MeshBatch
    mesh: MeshBatch
    vertices: Tensor
    triangles: Tensor
    free: Tensor
    owner: Tensor
    whole: Tensor

    @classmethod
    def cut_out(cls, batch: MeshBatch, free: Tensor) -> "Parts":
        """The parts round the vertices `free` (V,) bool: all the triangles at these, parted where no free vertex is."""
        count = len(batch.points)
        touched = connectivity.touching(batch.triangles, free)
        touched = with_both_halves(batch, touched)[0] if len(batch.quads) else touched
        faces = true_rows(touched)
        here = batch.triangles[faces]
        apart = ~(free[connectivity.tails(here)] | free[connectivity.heads(here)])
        if len(batch.quads):
            # Both halves of a quad are in one part.
            apart &= ~diagonals(batch).reshape(-1, 3)[faces].reshape(-1)
        label = connectivity.triangle_components(here, connectivity.twins(here), apart)
        order = label.argsort(stable=True)
        faces, label = faces[order], label[order]
        keys, local = torch.unique(label[:, None] * count + batch.triangles[faces], return_inverse=True)
        vertices, part = keys % count, keys // count
        parts = int(label[-1]) + 1 if len(label) else 0
        offsets = offsets_from_counts(torch.bincount(label, minlength=parts))
        owner = triangle_mesh(batch)[faces[offsets[:-1]]]
        # Constrained edges on the outline of a part bind nothing in it.
        twin = connectivity.twins(local)
        locked = connectivity.half_edges_on(batch.triangles, batch.constrained_edges, count)
        locked = locked.reshape(-1, 3)[faces].reshape(-1)
        h = torch.arange(len(twin), device=twin.device)
        h = h[locked & (h < twin)]
        edges = torch.stack([connectivity.tails(local)[h], connectivity.heads(local)[h]], 1)
        mesh = MeshBatch(
            batch.points[vertices],
            local,
            batch.fixed[vertices] | ~free[vertices],
            edges,
            offsets_from_counts(torch.bincount(part, minlength=parts)),
            offsets,
            batch.frames[owner],
            (local, twin),
            *_quads_in(batch, faces, local, label, parts),
        )
        inside = connectivity.vertex_triangle_counts(local, len(vertices))
        everywhere = connectivity.vertex_triangle_counts(batch.triangles, count)[vertices]
        whole = torch.ones(parts, dtype=torch.bool, device=part.device)
        whole[part[inside < everywhere]] = False
        return cls(batch, mesh, vertices, faces, free[vertices], owner, whole)

    def __len__(self) -> int:
        return len(self.owner)

    def select(self, keep: Tensor) -> "Parts":
        """The parts whose `keep` (P,) bool is true."""
        v, t = spread(keep, self.mesh.point_offsets), spread(keep, self.mesh.triangle_offsets)
        mesh = self.mesh.select(keep)
        return Parts(
            self.batch, mesh, self.vertices[v], self.triangles[t], self.free[v], self.owner[keep], self.whole[keep]
        )

    def of_triangles(self, flags: Tensor) -> Tensor:
        """(P,) int64, how many triangles of each part are among the `flags` (T,) bool over the batch."""
        return segment_sum(flags[self.triangles].to(torch.float64), self.mesh.triangle_offsets).to(torch.int64)

    def clash(self, after: State) -> Tensor:
        """(P,) bool: the part, become `after`, has an edge between held vertices that exists outside it, too.

        Where boundaries are simple that cannot be, by geometry; where a mesh lies over itself it may.
        """
        bad = torch.zeros_like(self.whole)
        count = len(self.batch.points)
        row = self.vertices if after.names is None else _old_rows(after.vertex_names, self.vertices)
        held = torch.zeros(count, dtype=torch.bool, device=row.device).index_fill_(0, self.vertices[~self.free], True)
        before = _edges_of(self.mesh, self.vertices, held)
        now = _edges_of(after.mesh, row, held)
        # An edge of a part is new if the part did not have it.
        known, number = torch.unique(torch.cat([before[1], now[1]]), return_inverse=True)
        parted = torch.cat([before[0], now[0]]) * len(known) + number
        new = ~torch.isin(parted[len(before[0]) :], parted[: len(before[0])])
        owner, keys = now[0][new], now[1][new]
        near = held[self.batch.triangles].sum(1) > 1
        there = connectivity.edges(self.batch.triangles[near], connectivity.twins(self.batch.triangles[near]))
        same, times = torch.unique(keys, return_counts=True)
        taken = torch.cat([keys_of(there, count), same[times > 1]])
        return bad.index_fill_(0, owner[torch.isin(keys, taken)], True)


def _quads_in(batch: MeshBatch, faces: Tensor, local: Tensor, label: Tensor, parts: int) -> tuple[Tensor, Tensor, int]:
    """The quads of the parts, their offsets and the rows that stand for each.

    faces, local, label  (T',) the rows of the triangles, (T', 3) their vertices in the parts, and (T',) their parts
    """
    halves = batch.of_quads[faces] if len(batch.quads) else torch.zeros_like(faces, dtype=torch.bool)
    first, second = local[halves].reshape(-1, 2, 3).unbind(1)
    offsets = offsets_from_counts(torch.bincount(label[halves][::2], minlength=parts))
    return torch.cat([first, second[:, 1:2]], 1), offsets, batch.rows_per_quad


def _edges_of(mesh: MeshBatch, row: Tensor, held: Tensor) -> tuple[Tensor, Tensor]:
    """(E,) the mesh and (E,) the key of each edge between vertices that are `held` (V,) bool.

    row  (V',) the rows of the vertices of `mesh` in the whole batch; -1 for none
    """
    h = torch.arange(len(mesh.twin), device=row.device)
    once = h[(mesh.twin < 0) | (h < mesh.twin)]
    ends = torch.stack([connectivity.tails(mesh.triangles)[once], connectivity.heads(mesh.triangles)[once]], 1)
    whole = row[ends]
    between = (whole >= 0).all(1) & held[whole.clamp_min(0)].all(1)
    return triangle_mesh(mesh)[once[between] // 3], keys_of(whole[between], len(held))


def _old_rows(names: Names, vertices: Tensor) -> Tensor:
    """(V,) the rows in the whole batch of the vertices that have `names` in the parts; -1 for inserted ones."""
    return torch.where(names.of < names.first, vertices[names.of.clamp_max(names.first - 1)], -1)


@dataclass(frozen=True, eq=False)
class Pasted:
    """A batch into which parts were put back.

    mesh       the batch
    names      of its vertices; None: they are the same as before
    triangles  (T,) int64, for each triangle its row before, or -1 - p for those of part p that has been put back
    vertex     (V,) int64, for each vertex its row before, or -1
    inserted   (V,) int64, for each vertex its row in the parts, or -1: those of vertices that were inserted
    """

    mesh: MeshBatch
    names: Names | None
    triangles: Tensor
    vertex: Tensor
    inserted: Tensor

    def by_vertex(self, before: Tensor, in_parts: Tensor) -> Tensor:
        """(V, ...) values of the vertices, `before` (V_old, ...) and `in_parts` those of inserted vertices."""
        if self.names is None:
            return before
        return torch.cat([before, in_parts])[torch.where(self.vertex >= 0, self.vertex, len(before) + self.inserted)]

    def by_triangle(self, before: Tensor, of_parts: Tensor) -> Tensor:
        """(T, ...) values of the triangles, `before` (T_old, ...) and `of_parts` (P, ...) those of all in a part."""
        p = self.triangles < 0
        values = before[self.triangles.clamp_min(0)]
        values[p] = of_parts[-1 - self.triangles[p]]
        return values


def paste(parts: Parts, after: State, at: Tensor, names: Names) -> Pasted:
    """The batch with the `parts` that `at` (P,) bool marks as they are in `after`.

    names  of the vertices of the batch
    """
    if after.names is None:
        return _paste_rows(parts.select(at), after.mesh.select(at))
    return _paste_others(parts, after.select(at), at, names)


def _paste_rows(parts: Parts, after: MeshBatch) -> Pasted:
    """`paste` where vertices and triangles keep their numbers."""
    batch = parts.batch
    moved = true_rows(parts.free)
    mesh = replace(
        batch,
        points=put_rows(batch.points, parts.vertices[moved], after.points[moved]),
        triangles=put_rows(batch.triangles, parts.triangles, parts.vertices[after.triangles]),
        _twin=None,
    )
    part = segment_ids(after.triangle_offsets)
    every = torch.arange(len(batch.triangles), device=moved.device)
    same = torch.arange(len(batch.points), device=moved.device)
    return Pasted(mesh, None, put_rows(every, parts.triangles, -1 - part), same, torch.full_like(same, -1))


def _paste_others(given: Parts, after: State, at: Tensor, names: Names) -> Pasted:
    """`paste` where vertices may have come and gone: those that are left keep their order, new ones come after them."""
    parts, batch, mesh, own = given.select(at), given.batch, after.mesh, after.vertex_names
    device = parts.vertices.device
    # Names in the parts are rows of all their vertices.
    old = _old_rows(own, given.vertices)
    # Vertices: the free ones that are not there any more go.
    kept = torch.ones(len(batch.points), dtype=torch.bool, device=device)
    kept[parts.vertices[parts.free]] = False
    kept[old[old >= 0]] = True
    of_part = parts.owner[segment_ids(mesh.point_offsets)]
    fresh = true_rows(old < 0)
    mesh_of = segment_ids(batch.point_offsets)
    owner = torch.cat([mesh_of[kept], of_part[fresh]])
    order = owner.argsort(stable=True)
    vertex = torch.cat([true_rows(kept), torch.full_like(fresh, -1)])[order]
    inserted = torch.cat([torch.full((int(kept.sum()),), -1, device=device), fresh])[order]
    offsets = offsets_from_counts(torch.bincount(owner, minlength=len(batch)))
    row = torch.arange(len(order), device=device)
    new_row = torch.full((len(batch.points),), -1, device=device)
    new_row[vertex[vertex >= 0]] = row[vertex >= 0]
    part_row = torch.where(old >= 0, new_row[old.clamp_min(0)], 0)
    part_row[inserted[inserted >= 0]] = row[inserted >= 0]
    # Positions: of the vertices that the parts have moved, and of new ones, as they are there.
    points = batch.points[vertex.clamp_min(0)]
    fixed = batch.fixed[vertex.clamp_min(0)]
    there = (old < 0) | given.free[own.of.clamp_max(own.first - 1)]
    points[part_row[there]] = mesh.points[there]
    fixed[part_row[fresh]] = mesh.fixed[fresh]
    # Triangles: those outside first, then those of the parts.
    outside = torch.ones(len(batch.triangles), dtype=torch.bool, device=device)
    outside[parts.triangles] = False
    faces = torch.cat([new_row[batch.triangles[outside]], part_row[mesh.triangles]])
    part = segment_ids(mesh.triangle_offsets)
    face_owner = torch.cat([triangle_mesh(batch)[outside], parts.owner[part]])
    face_order = face_owner.argsort(stable=True)
    rows = torch.cat([true_rows(outside), -1 - part])[face_order]
    whole = MeshBatch(
        points,
        faces[face_order],
        fixed,
        new_row[batch.constrained_edges],
        offsets,
        offsets_from_counts(torch.bincount(face_owner, minlength=len(batch))),
        batch.frames,
    )
    assert bool((whole.constrained_edges >= 0).all())
    return Pasted(whole, _with_births(names, own, given.vertices, vertex, inserted), rows, vertex, inserted)


def _with_births(names: Names, own: Names, vertices: Tensor, vertex: Tensor, inserted: Tensor) -> Names:
    """The names of the vertices after parts were put back, with the history of the parts.

    own  the names in the parts, of which the first are the `vertices` (V',) of the batch
    """

    def renamed(name: Tensor) -> Tensor:
        known = names.of[vertices[name.clamp_max(own.first - 1)]]
        return torch.where(name < own.first, known, names.fresh + name - own.first)

    of = torch.where(vertex >= 0, names.of[vertex.clamp_min(0)], renamed(own.of[inserted.clamp_min(0)]))
    births = (*names.births, *(renamed(birth) for birth in own.births))
    placed = (*names.placed, *(Placed(renamed(p.names), renamed(p.corners), p.weights) for p in own.placed))
    return replace(names.renamed(of, names.fresh + own.fresh - own.first, births), placed=placed)


class PartsLog(Log):
    """A log of parts that writes rows about the whole meshes: what the parts are like, with the rest as it is.

    A stage that works on several parts of a mesh writes one row.
    """

    def __init__(self, log: Log, state: State, parts: Parts, whole: Callable[[State], MeshBatch]) -> None:
        """`state` has the whole meshes; `whole` puts the parts back into them, for the observer."""
        super().__init__(0, log.progress, log.observe)
        self.log, self.parts, self.whole = log, parts, whole
        outside = torch.ones(len(state.mesh.triangles), dtype=torch.bool, device=parts.triangles.device)
        outside[parts.triangles] = False
        offsets = state.mesh.triangle_offsets
        ratio = torch.where(outside, state.quality.inverse_mean_ratio, 0.0)
        self.count = segment_sum(outside.to(torch.float64), offsets)
        self.total, self.max = segment_sum(ratio, offsets), segment_max(ratio, offsets)
        self.inverted = segment_sum((outside & ~state.quality.upright).to(torch.float64), offsets)

    def _of_wholes(self, state: State) -> tuple[Tensor, Tensor, Tensor]:
        """(B,) each: the mean and the maximum ratio of the whole meshes, and the number of their inverted triangles."""
        owner, q = self.parts.owner, state.quality
        counts = counts_from_offsets(state.mesh.triangle_offsets).to(torch.float64)
        total = self.total.index_add(0, owner, q.mean * counts)
        count = self.count.index_add(0, owner, counts)
        inverted = self.inverted.index_add(0, owner, q.inverted.to(torch.float64))
        return total / count, self.max.scatter_reduce(0, owner, q.max, "amax"), inverted

    def amend(self, state: State, at: Tensor) -> None:
        mean, worst, inverted = self._of_wholes(state)
        for b in self.parts.owner[at].unique().tolist():
            self.log.amend_row(b, float(mean[b]), float(worst[b]), int(inverted[b]))

    def _write(self, name: str, state: State, at: Tensor, seconds: float, work: Work) -> None:
        owner = self.parts.owner
        mean, worst, inverted = self._of_wholes(state)
        for b in owner[at].unique().tolist():
            mine = owner[at] == b
            flips, iterations, cavities = (
                int(column[mine].sum()) for column in (work.flips, work.iterations, work.cavities)
            )
            step = Step(
                name, float(mean[b]), float(worst[b]), int(inverted[b]), flips, iterations, seconds,
                cavities, bool(work.kept[mine].any()),
            )  # fmt: skip
            self.log.add(b, step)
        if self.observe is not None:
            self.observe(name, self.whole(state))
