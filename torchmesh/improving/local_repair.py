"""A small tangle in a large good mesh: work on its neighbourhood alone, and put that back.

    . . . . . . . . . . .     #  damage: inverted, or of poor shape
    . . r r r r r r . . .     +  rings round it, whose free vertices may move
    . . r + + + + r . . .     r  rim: fixed in the excerpt
    . . r + # # + r . . .     .  never touched, nor looked at after the first look at its quality
    . . r + + + + r . . .
    . . r r r r r r . . .

What an excerpt costs beyond its own triangles is one look at the quality of the mesh and a few masks
over its rows.  Each mesh is judged by itself.  One whose excerpt does not come out valid and of good shape
goes the usual road as a whole.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..mesh import connectivity
from ..mesh.batch import MeshBatch, put
from ..mesh.measure import Quality, quality
from ..mesh.ragged import counts_from_offsets, segment_count, segment_max, segment_sum, spread
from ..mesh.triangle import corners, squared_edge_lengths
from ..remeshing.criteria import crowded
from ..remeshing.options import RemeshOptions
from .report import Report

# A mesh with no more triangles than this is worked on as a whole: an excerpt would not save much.
_LARGE = 20_000


# A triangle with a higher inverse mean ratio is damage, and the mean of those outside the excerpt is at
# most this: what flips and smoothing of the whole mesh could better is left to them.
_POOR, _EXCELLENT = 1.5, 1.03


# The excerpt is at most this part of the mesh.
_SHARE = 0.1


# Rings of vertices round the damage, and more of them the wider it is: a tangle of n triangles is about
# 0.7 sqrt(n) edges across, and needs that room again to come to good shapes.
_RINGS, _RINGS_BY_WIDTH = 8, 0.7


# Cells along the mesh at most to look for what is near the damage.
_CELLS = 1000


Observe = Callable[[str, MeshBatch], None]


Work = Callable[[MeshBatch, Observe | None], tuple[MeshBatch, Report]]


@dataclass(frozen=True, eq=False)
class Excerpts:
    """A batch of B meshes some of which are replaced by excerpts, V' vertices and T' triangles in all.

    part          the batch to be worked on: excerpts, and the other meshes as they are
    cut           (B,) bool, the meshes replaced
    vertices      (V',) int64, ascending: the rows of the part's points in the whole batch
    triangles     (T',) int64, ascending: the rows of the part's triangles in the whole batch
    across        (N,) int64 keys of the edges between vertices of an excerpt that triangles outside have
    whole         the whole batch
    quality       of the whole batch
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
    quality: Quality
    outside_sum: Tensor
    outside_max: Tensor
    seconds: float

    def paste(self, part: MeshBatch) -> MeshBatch:
        """The whole batch with the rows of `part`, which `self.part` has become, in their places."""
        points = self.whole.points.index_copy(0, self.vertices, part.points)
        triangles = self.whole.triangles.index_copy(0, self.triangles, self.vertices[part.triangles])
        return replace(self.whole, points=points, triangles=triangles)

    def well_done(self, part: MeshBatch, report: Report) -> Tensor:
        """(B,) bool: the mesh was not cut, or its excerpt is valid, certified, of good shape, and fits in.

        An edge that a triangle outside has, too, cannot be one inside, or the whole would be no manifold.
        Where boundaries are simple that is so by geometry; where a mesh lies over itself it need not be.
        """
        rows = spread(self.cut, part.triangle_offsets)
        mine = part.triangles[rows]
        twin = connectivity.twins(mine)
        inner = self.vertices[connectivity.edges(mine, twin)[_inner_edges(twin)]]
        clash = inner[torch.isin(_keys(inner, len(self.whole.points)), self.across), 0]
        good = report.valid & report.certified & ~crowded(report.quality, RemeshOptions())
        good[torch.bucketize(clash, self.whole.point_offsets[1:], right=True)] = False
        return good | ~self.cut

    def report(self, report: Report) -> Report:
        """What `report` says about the part, said about the whole batch; spends `self.quality`."""
        known, offsets = self.quality, self.whole.triangle_offsets
        for column in ("area", "inverse_mean_ratio", "upright"):
            getattr(known, column).index_copy_(0, self.triangles, getattr(report.quality, column))
        counts = counts_from_offsets(offsets)
        ratio = known.inverse_mean_ratio
        q = Quality(
            known.area,
            ratio,
            known.upright,
            segment_sum(ratio, offsets) / counts,
            segment_max(ratio, offsets),
            report.quality.inverted,
        )
        steps, messages = list(report.steps), list(report.messages)
        inside = counts_from_offsets(self.part.triangle_offsets)
        numbers = (counts, inside, self.outside_sum, self.outside_max, known.mean, known.max)
        for b in self.cut.nonzero().squeeze(1).tolist():
            count, taken, total, worst, mean, most = (column[b].item() for column in numbers)
            first, *rest = report.steps[b]
            first = replace(first, mean=mean, max=most)
            steps[b] = [first, replace(first, stage="excerpt", seconds=self.seconds)] + [
                replace(step, mean=(total + taken * step.mean) / count, max=max(worst, step.max)) for step in rest
            ]
            messages[b] += f"; only an excerpt, {taken:,} of {count:,} triangles round the damage, was worked on"
        return replace(report, quality=q, steps=steps, messages=messages)


def improve_by_excerpts(batch: MeshBatch, work: Work, observe: Observe | None = None) -> tuple[MeshBatch, Report]:
    """`work` on a batch, of large good meshes with small tangles only on excerpts.

    work     improves a batch, calling what is its second argument after every stage; moves no fixed vertex,
             flips no boundary or constrained edge, and keeps the order of vertices
    observe  called with every stage and the whole batch: "initial", "excerpt", those of the work,
             and "whole" where excerpts did not do

    The report is about the whole meshes.
    """
    found = excerpts(batch)
    if found is None:
        return work(batch, observe)

    def watch(stage: str, part: MeshBatch) -> None:
        assert observe is not None
        whole = found.paste(part)
        observe(stage, whole)
        if stage == "initial":
            observe("excerpt", whole)

    part, report = work(found.part, None if observe is None else watch)
    again = ~found.well_done(part, report)
    result, report = found.paste(part), found.report(report)
    if not bool(again.any()):
        return result, report

    def watch_again(stage: str, part: MeshBatch) -> None:
        assert observe is not None
        observe("whole" if stage == "initial" else stage, put(result, again, part))

    part, second = work(batch.select(again), None if observe is None else watch_again)
    merged = put(result, again, part)
    return merged, replace(_amended(report, again, second), quality=quality(merged, known=(result, report.quality)))


def _amended(first: Report, again: Tensor, second: Report) -> Report:
    """The `first` report but for its quality, with the meshes `again` (B,) bool as the `second` found them."""
    steps, messages = list(first.steps), list(first.messages)
    for i, b in enumerate(again.nonzero().squeeze(1).tolist()):
        start, *rest = second.steps[i]
        steps[b] = [*steps[b], replace(start, stage="whole", kept=False), *rest]
        messages[b] = f"{second.messages[i]}; an excerpt round the damage was tried in vain"
    columns = {name: getattr(first, name).clone() for name in ("status", "valid", "certified", "moved")}
    for name, column in columns.items():
        column[again] = getattr(second, name)
    return replace(first, steps=steps, messages=messages, **columns)


def excerpts(batch: MeshBatch) -> Excerpts | None:
    """Excerpts of the large meshes that are tangled in a small part and excellent elsewhere; None: there are none."""
    started = time.perf_counter()
    if not bool((counts_from_offsets(batch.triangle_offsets) > _LARGE).any()):
        return None
    q = quality(batch)
    vertex, face = batch.point_offsets.tolist(), batch.triangle_offsets.tolist()
    candidates = (counts_from_offsets(batch.triangle_offsets) > _LARGE) & (q.inverted > 0)
    places = {}
    for b in candidates.nonzero().squeeze(1).tolist():
        t = slice(face[b], face[b + 1])
        bad = (~q.upright[t] | (q.inverse_mean_ratio[t] > _POOR)).nonzero().squeeze(1)
        if len(bad) > _SHARE * (t.stop - t.start):
            continue
        faces = batch.triangles[t] - vertex[b] if vertex[b] else batch.triangles[t]
        place = neighbourhood(batch.points[vertex[b] : vertex[b + 1]], faces, bad)
        inside = len(place.triangles)
        if inside > _SHARE * (t.stop - t.start):
            continue
        ratio = q.inverse_mean_ratio[t].index_fill(0, place.triangles, 0.0)
        total = float(segment_sum(ratio, torch.tensor([0, len(ratio)], device=ratio.device)))
        if total <= _EXCELLENT * (len(ratio) - inside):
            places[b] = (place, total, float(ratio.max()))
    if not places:
        return None
    return _taken(batch, q, places, started)


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


def neighbourhood(points: Tensor, triangles: Tensor, damage: Tensor) -> Neighbourhood:
    """The `damage` (D,) int64, rows of `triangles` (T, 3), and the rings of vertices round it that it needs.

    points  (V, 2), by which what cannot be near is left out of the search; the result does not depend on them
    """
    rings = _RINGS + round(_RINGS_BY_WIDTH * len(damage) ** 0.5)
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


def _taken(
    batch: MeshBatch, q: Quality, places: dict[int, tuple[Neighbourhood, float, float]], started: float
) -> Excerpts:
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
    return Excerpts(part, cut, vertices, triangles, keys, batch, q, outside_sum, outside_max, seconds)


def _without_rim_constraints(part: MeshBatch, cut: Tensor) -> MeshBatch:
    """`part` less the constrained edges that are not inside the excerpts, but on their rims or beyond."""
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
