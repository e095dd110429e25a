"""A small tangle in a large good mesh: only the submesh round it is worked on, and put back afterwards.

    . . . . . . . . . . .     #  damage: inverted, or of poor shape
    . . b b b b b b . . .     +  rings round it, whose free vertices may move
    . . b + + + + b . . .     b  boundary of the submesh: fixed
    . . b + # # + b . . .     .  never changed, and not read after its quality has been measured
    . . b + + + + b . . .
    . . b b b b b b . . .

Besides the work on its own triangles, a submesh costs a few masks over the rows of the mesh.  Each mesh is judged by
itself.  If its submesh does not become valid with good shapes, the mesh is worked on as a whole.
"""

import time
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..mesh import connectivity
from ..mesh.batch import MeshBatch, constraint_owner, put
from ..mesh.connectivity import keys_of
from ..mesh.measure import Quality
from ..mesh.ragged import counts_from_offsets, owner_of, put_rows, segment_max, segment_sum, spread, true_rows
from ..mesh.submesh import Submesh, submesh
from ..remeshing.criteria import crowded
from ..remeshing.options import RemeshOptions
from .neighbourhood import Neighbourhood, neighbourhood
from .options import ImproveOptions
from .report import Step
from .runner import Job, Log
from .state import State
from .step_options import LocalRepair


def on_submeshes(job: Job, options: ImproveOptions) -> Job:
    """The job that does `job` on submeshes of large good meshes with small tangles, and on all other meshes as a whole.

    job  must keep the number and order of vertices and triangles
    """

    def on_parts(state: State, log: Log) -> State:
        assert options.local_repair is not None
        found = damaged_submeshes(state.mesh, state.quality, options.local_repair)
        if found is None:
            return job(state, log)
        log.mark("submesh", state, found.cut, seconds=found.seconds)
        every = torch.arange(len(state), device=state.meshes.device)
        part = job(State.of(found.taken.mesh, options), log.view(every, found.paste, found.step_of_whole))
        again = ~found.well_done(part)
        whole = found.paste_state(state, part)
        if not bool(again.any()):
            return whole
        begun = state.select(again)
        log.mark("whole", whole.put(again, begun), again, kept=False)
        view = log.view(true_rows(again), lambda mesh: put(whole.mesh, again, mesh))
        note = dict.fromkeys(range(len(begun)), "; a submesh round the damage was tried in vain")
        return whole.put(again, job(begun, view).noted(note))

    return on_parts


@dataclass(frozen=True, eq=False)
class Submeshes:
    """A batch of B meshes, some of which are replaced by submeshes.

    taken        the batch to be worked on: the submeshes, and the other meshes as they are
    cut          (B,) bool, the meshes that are replaced
    across       (N,) int64, the keys of edges of triangles outside whose ends are both vertices of a submesh
    whole        the whole batch
    outside_sum  (B,) the sum of the inverse mean ratios of the triangles outside; 0 for meshes that are not cut
    outside_max  (B,) their maximum; 1 for meshes that are not cut
    seconds      the time that finding them took
    """

    taken: Submesh
    cut: Tensor
    across: Tensor
    whole: MeshBatch
    outside_sum: Tensor
    outside_max: Tensor
    seconds: float

    def paste(self, part: MeshBatch) -> MeshBatch:
        """The whole batch with the rows of `part`, the result of the work on `taken`, put back."""
        return self.taken.put_back(self.whole, part)

    def paste_state(self, state: State, part: State) -> State:
        """`state` with the result `part` of the work on the submeshes put back."""
        offsets = self.whole.triangle_offsets
        columns = ("area", "inverse_mean_ratio", "upright")
        area, ratio, upright = (
            put_rows(getattr(state.quality, name), self.taken.triangles, getattr(part.quality, name))
            for name in columns
        )
        mean = segment_sum(ratio, offsets) / counts_from_offsets(offsets)
        taken, counts = (counts_from_offsets(mesh.triangle_offsets).tolist() for mesh in (self.taken.mesh, self.whole))
        notes = {
            b: f"; only a submesh, {taken[b]:,} of {counts[b]:,} triangles round the damage, was worked on"
            for b in true_rows(self.cut).tolist()
        }
        return replace(
            state,
            mesh=self.paste(part.mesh),
            quality=replace(
                state.quality,
                area=area,
                inverse_mean_ratio=ratio,
                upright=upright,
                mean=mean,
                max=segment_max(ratio, offsets),
                inverted=part.quality.inverted,
            ),
            status=part.status,
            reasons=part.reasons,
            faults=part.faults,
            impossible=part.impossible,
            notes=part.notes,
            certified=part.certified,
            failures=part.failures,
        ).noted(notes)

    def step_of_whole(self, b: int, step: Step) -> Step:
        """A row of the log about the submesh of mesh `b` as a row about the whole mesh."""
        if not bool(self.cut[b]):
            return step
        taken, count = (int(counts_from_offsets(m.triangle_offsets)[b]) for m in (self.taken.mesh, self.whole))
        mean = (float(self.outside_sum[b]) + taken * step.mean) / count
        return replace(step, mean=mean, max=max(float(self.outside_max[b]), step.max))

    def well_done(self, part: State) -> Tensor:
        """(B,) bool: the mesh was not cut, or its submesh is valid, certified, of good shape, and fits in.

        An inner edge of the submesh must not also be an edge of a triangle outside, or the whole would be no manifold.
        Geometry rules that out where boundaries are simple, but not where a mesh lies over itself.
        """
        mine = part.mesh.triangles[spread(self.cut, part.mesh.triangle_offsets)]
        inner = self.taken.vertices[_inner_edges(mine)]
        clash = inner[torch.isin(keys_of(inner, len(self.whole.points)), self.across), 0]
        good = part.valid & part.certified & ~crowded(part.quality, RemeshOptions())
        good[owner_of(clash, self.whole.point_offsets)] = False
        return good | ~self.cut


def damaged_submeshes(batch: MeshBatch, q: Quality, options: LocalRepair) -> Submeshes | None:
    """Submeshes of the large meshes that are tangled in a small part and excellent elsewhere; None if there are none.

    q  the quality of the batch
    """
    started = time.perf_counter()
    large = counts_from_offsets(batch.triangle_offsets) > options.large
    found = {}
    for b in true_rows(large & (q.inverted > 0)).tolist():
        near = _round_damage(batch, q, b, options)
        if near is not None:
            found[b] = near
    return _taken(batch, found, started) if found else None


def _round_damage(
    batch: MeshBatch, q: Quality, b: int, options: LocalRepair
) -> tuple[Neighbourhood, float, float] | None:
    """The neighbourhood of the damage of mesh `b`, and the sum and the maximum of the inverse mean ratios outside it.

    The result is None if the neighbourhood is too large a part of the mesh, or if the rest is not excellent.
    """
    v, t = (slice(*offsets[b : b + 2].tolist()) for offsets in (batch.point_offsets, batch.triangle_offsets))
    count = t.stop - t.start
    bad = true_rows(~q.upright[t] | (q.inverse_mean_ratio[t] > options.poor))
    if len(bad) > options.share * count:
        return None
    faces = batch.triangles[t] - v.start if v.start else batch.triangles[t]
    rings = options.rings + round(options.rings_by_width * len(bad) ** 0.5)
    near = neighbourhood(batch.points[v], faces, bad, rings, int(options.share * count))
    if near is None:
        return None
    inside = len(near.triangles)
    ratio = q.inverse_mean_ratio[t].index_fill(0, near.triangles, 0.0)
    total = float(segment_sum(ratio, torch.tensor([0, count], device=ratio.device)))
    return (near, total, float(ratio.max())) if total <= options.excellent * (count - inside) else None


def _taken(batch: MeshBatch, found: dict[int, tuple[Neighbourhood, float, float]], started: float) -> Submeshes:
    """The batch with some meshes replaced by the neighbourhoods that were `found` in them."""
    device, vertex, face = batch.points.device, batch.point_offsets.tolist(), batch.triangle_offsets.tolist()
    cut = torch.zeros(len(batch), dtype=torch.bool, device=device)
    outside_sum = torch.zeros(len(batch), dtype=torch.float64, device=device)
    outside_max = torch.ones_like(outside_sum)
    vertices = torch.ones(len(batch.points), dtype=torch.bool, device=device)
    triangles = torch.ones(len(batch.triangles), dtype=torch.bool, device=device)
    held, across = torch.zeros_like(vertices), []
    for b, (near, total, worst) in found.items():
        cut[b], outside_sum[b], outside_max[b] = True, total, worst
        vertices[vertex[b] : vertex[b + 1]] = False
        triangles[face[b] : face[b + 1]] = False
        vertices[near.vertices + vertex[b]] = True
        triangles[near.triangles + face[b]] = True
        held[near.vertices[near.shared] + vertex[b]] = True
        across.append(near.across + vertex[b])
    taken = submesh(replace(batch, fixed=batch.fixed | held), triangles, vertices)
    keys = keys_of(torch.cat(across), len(batch.points))
    seconds = time.perf_counter() - started
    return Submeshes(_without_outer_constraints(taken, cut), cut, keys, batch, outside_sum, outside_max, seconds)


def _without_outer_constraints(taken: Submesh, cut: Tensor) -> Submesh:
    """The submeshes without the constrained edges on their boundaries and outside them."""
    part = taken.mesh
    if not len(part.constrained_edges):
        return taken
    mine = part.triangles[spread(cut, part.triangle_offsets)]
    inner = keys_of(_inner_edges(mine), len(part.points))
    stays = ~cut[constraint_owner(part)] | torch.isin(keys_of(part.constrained_edges, len(part.points)), inner)
    return replace(taken, mesh=replace(part, constrained_edges=part.constrained_edges[stays]))


def _inner_edges(triangles: Tensor) -> Tensor:
    """(E, 2) the edges that belong to two of the triangles."""
    twin = connectivity.twins(triangles)
    h = torch.arange(len(twin), device=twin.device)
    return connectivity.edges(triangles, twin)[twin[(twin < 0) | (h < twin)] >= 0]
