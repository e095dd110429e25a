"""A small tangle in a large good mesh: work on the submesh round it alone, and put that back.

    . . . . . . . . . . .     #  damage: inverted, or of poor shape
    . . b b b b b b . . .     +  rings round it, whose free vertices may move
    . . b + + + + b . . .     b  boundary of the submesh: fixed
    . . b + # # + b . . .     .  never touched, nor looked at after the first look at its quality
    . . b + + + + b . . .
    . . b b b b b b . . .

Beyond its own triangles, a submesh costs a few masks over the rows of the mesh.  Each mesh is judged by itself.  One
whose submesh does not come out valid and of good shape is worked on as a whole.
"""

import time
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..mesh import connectivity
from ..mesh.batch import MeshBatch, put
from ..mesh.measure import Quality
from ..mesh.ragged import counts_from_offsets, segment_count, segment_max, segment_sum, spread
from ..mesh.triangle import corners, squared_edge_lengths
from ..remeshing.criteria import crowded
from ..remeshing.options import RemeshOptions
from .options import ImproveOptions, LocalRepair
from .report import Step
from .runner import Job, Log
from .state import State

# The search for what is near the damage divides a mesh into at most so many cells along each axis.
_CELLS = 1000


def on_submeshes(job: Job, options: ImproveOptions) -> Job:
    """`job`, but on submeshes only where large good meshes have small tangles; otherwise `job` itself.

    job  keeps the number and order of vertices and triangles
    """

    def on_parts(state: State, log: Log) -> State:
        found = damaged_submeshes(state.mesh, state.quality, options.local_repair)
        if found is None:
            return job(state, log)
        log.mark("submesh", state, found.cut, seconds=found.seconds)
        every = torch.arange(len(state), device=state.meshes.device)
        part = job(State.of(found.part, options), log.view(every, found.paste, found.step_of_whole))
        again = ~found.well_done(part)
        whole = found.paste_state(state, part)
        if not bool(again.any()):
            return whole
        begun = state.select(again)
        log.mark("whole", whole.put(again, begun), again, kept=False)
        view = log.view(again.nonzero().squeeze(1), lambda mesh: put(whole.mesh, again, mesh))
        note = dict.fromkeys(range(len(begun)), "; a submesh round the damage was tried in vain")
        return whole.put(again, job(begun, view).noted(note))

    return on_parts


@dataclass(frozen=True, eq=False)
class Submeshes:
    """A batch of B meshes some of which are replaced by submeshes, V' vertices and T' triangles in all.

    part          the batch to be worked on: submeshes, and the other meshes as they are
    cut           (B,) bool, the meshes replaced
    vertices      (V',) int64, ascending: the rows of the part's points in the whole batch
    triangles     (T',) int64, ascending: the rows of the part's triangles in the whole batch
    across        (N,) int64 keys of the edges between vertices of a submesh that triangles outside have
    whole         the whole batch
    outside_sum   (B,) of the inverse mean ratio over the triangles outside; 0 for meshes not cut
    outside_max   (B,) likewise the maximum; 1 for meshes not cut
    seconds       what it took to find them
    """

    part: MeshBatch
    cut: Tensor
    vertices: Tensor
    triangles: Tensor
    across: Tensor
    whole: MeshBatch
    outside_sum: Tensor
    outside_max: Tensor
    seconds: float

    def paste(self, part: MeshBatch) -> MeshBatch:
        """The whole batch with the rows of `part`, which `self.part` has become, in their places."""
        points = self.whole.points.index_copy(0, self.vertices, part.points)
        triangles = self.whole.triangles.index_copy(0, self.triangles, self.vertices[part.triangles])
        return replace(self.whole, points=points, triangles=triangles)

    def paste_state(self, state: State, part: State) -> State:
        """`state`, of which the submeshes were taken, with what `part` has become of them."""
        offsets = self.whole.triangle_offsets
        columns = ("area", "inverse_mean_ratio", "upright")
        area, ratio, upright = (
            getattr(state.quality, name).index_copy(0, self.triangles, getattr(part.quality, name)) for name in columns
        )
        mean = segment_sum(ratio, offsets) / counts_from_offsets(offsets)
        taken, counts = (counts_from_offsets(mesh.triangle_offsets).tolist() for mesh in (self.part, self.whole))
        notes = {
            b: f"; only a submesh, {taken[b]:,} of {counts[b]:,} triangles round the damage, was worked on"
            for b in self.cut.nonzero().squeeze(1).tolist()
        }
        return replace(
            state,
            mesh=self.paste(part.mesh),
            quality=Quality(area, ratio, upright, mean, segment_max(ratio, offsets), part.quality.inverted),
            status=part.status,
            reasons=part.reasons,
            notes=part.notes,
            certified=part.certified,
        ).noted(notes)

    def step_of_whole(self, b: int, step: Step) -> Step:
        """A row about the submesh of mesh `b`, said about the whole mesh."""
        if not bool(self.cut[b]):
            return step
        taken, count = (int(counts_from_offsets(m.triangle_offsets)[b]) for m in (self.part, self.whole))
        mean = (float(self.outside_sum[b]) + taken * step.mean) / count
        return replace(step, mean=mean, max=max(float(self.outside_max[b]), step.max))

    def well_done(self, part: State) -> Tensor:
        """(B,) bool: the mesh was not cut, or its submesh is valid, certified, of good shape, and fits in.

        An edge that a triangle outside has, too, cannot be one inside, or the whole would be no manifold.
        Where boundaries are simple that is so by geometry; where a mesh lies over itself it need not be.
        """
        rows = spread(self.cut, part.mesh.triangle_offsets)
        mine = part.mesh.triangles[rows]
        twin = connectivity.twins(mine)
        inner = self.vertices[connectivity.edges(mine, twin)[_inner_edges(twin)]]
        clash = inner[torch.isin(_keys(inner, len(self.whole.points)), self.across), 0]
        good = part.valid & part.certified & ~crowded(part.quality, RemeshOptions())
        good[torch.bucketize(clash, self.whole.point_offsets[1:], right=True)] = False
        return good | ~self.cut


def damaged_submeshes(batch: MeshBatch, q: Quality, options: LocalRepair) -> Submeshes | None:
    """Submeshes of the large meshes that are tangled in a small part and excellent elsewhere; None: there are none.

    q  the quality of the batch
    """
    started = time.perf_counter()
    large = counts_from_offsets(batch.triangle_offsets) > options.large
    places = {}
    for b in (large & (q.inverted > 0)).nonzero().squeeze(1).tolist():
        place = _round_damage(batch, q, b, options)
        if place is not None:
            places[b] = place
    return _taken(batch, places, started) if places else None


def _round_damage(
    batch: MeshBatch, q: Quality, b: int, options: LocalRepair
) -> "tuple[Neighbourhood, float, float] | None":
    """The neighbourhood of the damage of mesh `b`, with the sum and the maximum of the ratios outside it.

    None if it is too large a part of the mesh, or the rest is not excellent.
    """
    v, t = (slice(*offsets[b : b + 2].tolist()) for offsets in (batch.point_offsets, batch.triangle_offsets))
    count = t.stop - t.start
    bad = (~q.upright[t] | (q.inverse_mean_ratio[t] > options.poor)).nonzero().squeeze(1)
    if len(bad) > options.share * count:
        return None
    faces = batch.triangles[t] - v.start if v.start else batch.triangles[t]
    rings = options.rings + round(options.rings_by_width * len(bad) ** 0.5)
    place = neighbourhood(batch.points[v], faces, bad, rings)
    inside = len(place.triangles)
    if inside > options.share * count:
        return None
    ratio = q.inverse_mean_ratio[t].index_fill(0, place.triangles, 0.0)
    total = float(segment_sum(ratio, torch.tensor([0, count], device=ratio.device)))
    return (place, total, float(ratio.max())) if total <= options.excellent * (count - inside) else None


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """A part of one mesh round its damage; rows are those of the mesh.

    vertices   (v,) int64, ascending
    rim        (v,) bool: those that triangles outside may have, too
    triangles  (t,) int64, ascending: all the triangles at vertices that are not on the rim
    across     (n, 2) int64: the edges between its vertices that other triangles have
    """

    vertices: Tensor
    rim: Tensor
    triangles: Tensor
    across: Tensor


def neighbourhood(points: Tensor, triangles: Tensor, damage: Tensor, rings: int) -> Neighbourhood:
    """The `damage` (D,) int64, rows of `triangles` (T, 3), and so many rings of vertices round it.

    points  (V, 2), by which what cannot be near is left out of the search; the result does not depend on them
    """
    x, y = points[:, 0].contiguous(), points[:, 1].contiguous()
    low, high = zip(*([float(v) for v in c.aminmax()] for c in (x, y)), strict=True)
    extent = max(high[0] - low[0], high[1] - low[1])
    longest = torch.stack(squared_edge_lengths(corners(points, triangles[damage])), 1).amax(1).sqrt()
    # All the damage may be in one point.
    reach = max(rings * float(longest.median()), extent / _CELLS)
    while True:
        near = _nearby(x - low[0], y - low[1], extent, triangles[damage], reach)
        if (place := _grown(triangles, damage, rings, near)) is not None:
            return place
        reach *= 2


def _grown(triangles: Tensor, damage: Tensor, rings: int, near: Tensor) -> Neighbourhood | None:
    """The neighbourhood, if all of its vertices are `near` (V,) bool, so that no triangle at them is missed."""
    # Rows of the mesh become rows of the triangles and vertices looked at, and in the end are turned back.
    faces = _touching(triangles, near).nonzero().squeeze(1)
    here = triangles.index_select(0, faces)
    rows = torch.zeros_like(near).index_fill_(0, here.reshape(-1), True).nonzero().squeeze(1)
    number = torch.empty(len(near), dtype=torch.int64, device=near.device)
    number[rows] = torch.arange(len(rows), device=near.device)
    here = number[here]
    free = torch.zeros_like(rows, dtype=torch.bool).index_fill_(0, number[triangles[damage]].reshape(-1), True)
    for _ in range(rings - 1):
        free = _corners(here, _touching(here, free), len(rows))
    taken = _touching(here, free)
    mine = _corners(here, taken, len(rows))
    if not bool(near[rows[mine]].all()):
        return None
    outside = here[~taken]
    edges = torch.cat([outside[:, [0, 1]], outside[:, [1, 2]], outside[:, [2, 0]]])
    across = edges[mine[edges].all(1)]
    return Neighbourhood(rows[mine], ~free[mine], faces[taken], rows[across])


def _touching(triangles: Tensor, vertices: Tensor) -> Tensor:
    """(T,) bool: the triangles (T, 3) with a corner among `vertices` (V,) bool."""
    a, b, c = (vertices.index_select(0, v.contiguous()) for v in triangles.unbind(1))
    return a | b | c


def _corners(triangles: Tensor, these: Tensor, count: int) -> Tensor:
    """(count,) bool: the corners of `these` (T,) bool of the triangles (T, 3)."""
    mask = torch.zeros(count, dtype=torch.bool, device=triangles.device)
    return mask.index_fill_(0, triangles[these].reshape(-1), True)


def _nearby(x: Tensor, y: Tensor, extent: float, damaged: Tensor, reach: float) -> Tensor:
    """(V,) bool: at least the vertices within `reach` of a corner of the `damaged` (D, 3), and not many more.

    Those in the same cell of a square grid, or in one of the eight round it; x and y (V,) from 0 to `extent`.
    """
    if not reach < extent:
        return torch.ones_like(x, dtype=torch.bool)
    # With one more cell on every side, so that each has eight round it.
    cells = int(extent / reach) + 4
    cell = (y / reach + 1).to(torch.int32) * cells + (x / reach + 1).to(torch.int32)
    marked = torch.zeros(cells * cells, dtype=torch.bool, device=x.device)
    marked[cell[damaged.reshape(-1)].long()] = True
    marked = marked.reshape(cells, cells)
    wide = marked | marked.roll(1, 0) | marked.roll(-1, 0)
    wide = wide | wide.roll(1, 1) | wide.roll(-1, 1)
    return wide.reshape(-1).index_select(0, cell)


def _taken(batch: MeshBatch, places: dict[int, tuple[Neighbourhood, float, float]], started: float) -> Submeshes:
    """The batch with the meshes of `places` replaced by their neighbourhoods."""
    device, vertex, face = batch.points.device, batch.point_offsets.tolist(), batch.triangle_offsets.tolist()
    cut = torch.zeros(len(batch), dtype=torch.bool, device=device)
    outside_sum = torch.zeros(len(batch), dtype=torch.float64, device=device)
    outside_max = torch.ones_like(outside_sum)
    keep_vertex = torch.ones(len(batch.points), dtype=torch.bool, device=device)
    keep_face = torch.ones(len(batch.triangles), dtype=torch.bool, device=device)
    rims, across = [], []
    for b, (place, total, worst) in places.items():
        cut[b], outside_sum[b], outside_max[b] = True, total, worst
        keep_vertex[vertex[b] : vertex[b + 1]] = False
        keep_face[face[b] : face[b + 1]] = False
        keep_vertex[place.vertices + vertex[b]] = True
        keep_face[place.triangles + face[b]] = True
        rims.append(place.vertices[place.rim] + vertex[b])
        across.append(place.across + vertex[b])
    vertices, triangles = keep_vertex.nonzero().squeeze(1), keep_face.nonzero().squeeze(1)
    before = torch.nn.functional.pad(keep_vertex.cumsum(0), (1, 0))
    fixed = batch.fixed.index_select(0, vertices)
    fixed[before[torch.cat(rims)]] = True
    part = replace(
        batch,
        points=batch.points.index_select(0, vertices),
        triangles=before[batch.triangles.index_select(0, triangles)],
        fixed=fixed,
        constrained_edges=before[batch.constrained_edges[keep_vertex[batch.constrained_edges].all(1)]],
        point_offsets=before[batch.point_offsets],
        triangle_offsets=torch.nn.functional.pad(segment_count(keep_face, batch.triangle_offsets).cumsum(0), (1, 0)),
    )
    part = _without_rim_constraints(part, cut)
    seconds = time.perf_counter() - started
    keys = _keys(torch.cat(across), len(batch.points))
    return Submeshes(part, cut, vertices, triangles, keys, batch, outside_sum, outside_max, seconds)


def _without_rim_constraints(part: MeshBatch, cut: Tensor) -> MeshBatch:
    """`part` less the constrained edges that are not inside the submeshes, but on their boundaries or beyond."""
    if not len(part.constrained_edges):
        return part
    mine = part.triangles[spread(cut, part.triangle_offsets)]
    twin = connectivity.twins(mine)
    inner = _keys(connectivity.edges(mine, twin)[_inner_edges(twin)], len(part.points))
    owner = torch.bucketize(part.constrained_edges[:, 0].contiguous(), part.point_offsets[1:], right=True)
    stays = ~cut[owner] | torch.isin(_keys(part.constrained_edges, len(part.points)), inner)
    return replace(part, constrained_edges=part.constrained_edges[stays])


def _inner_edges(twin: Tensor) -> Tensor:
    """(E,) bool: which of `connectivity.edges` have two triangles."""
    h = torch.arange(len(twin), device=twin.device)
    return twin[(twin < 0) | (h < twin)] >= 0


def _keys(edges: Tensor, vertices: int) -> Tensor:
    return connectivity.edge_keys(edges[:, 0], edges[:, 1], vertices)
