"""Meshes with as many vertices as they should have: splits, collapses, flips and smoothing in turn.

valid mesh --> sizes --> split long edges, collapse short ones --> flips --> smooth --+--> polish
                 ^                                                                    |
                 +---------------- while edges change or the shapes get better -------+
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..flipping.delaunay import FlipOptions, flip_to_delaunay
from ..mesh.batch import MeshBatch, constrained_half_edges, vertex_mesh
from ..mesh.connectivity import twins
from ..mesh.measure import Quality, quality
from ..mesh.ragged import counts_from_offsets, offsets_from_counts, segment_any, spread
from ..mesh.units import centre_and_unit
from ..mesh.vertex_map import Names, VertexMap, exchange
from ..optimising.metric_field import MetricField
from ..smoothing.smoothing import SmoothOptions, smooth
from .collapses import Outcome, collapse_rounds
from .collapses import Wish as CollapseWish
from .metric_sizing import metric_conformity, metric_quality, metric_size_field, unit_metric
from .mutable import Editable, compact, living
from .options import RemeshOptions
from .sizing import SizeConformity, Sizes, carried, size_conformity, size_field
from .splits import Wish as SplitWish
from .splits import split_rounds, worst_after

# A mesh is done when fewer than one edge is split or collapsed for so many triangles.
_FEW = 500


# A lower mean is worth a maximum that is this much higher: it hangs on one triangle.
_SLACK = 1.02


# The last smoothing brings maxima below its ceiling that are this much above it.
_OVER_CEILING = 1.07


@dataclass(frozen=True, eq=False)
class RemeshInfo:
    """What `remesh` did, per mesh (B,).

    splits, collapses, flips, rounds  int64 numbers
    vertex_map  the `VertexMap` from the given vertices to those of the result
    size        (V_new,) the edge lengths that were wanted, at the new vertices
    conformity  how well the edges follow them
    """

    splits: Tensor
    collapses: Tensor
    flips: Tensor
    rounds: Tensor
    vertex_map: VertexMap
    size: Tensor
    conformity: SizeConformity


def remesh(batch: MeshBatch, options: RemeshOptions | None = None) -> tuple[MeshBatch, RemeshInfo]:
    """Add and remove vertices until edges have the sizes wanted and triangles good shapes.

    Fixed vertices stay, as do boundary and constrained edges (halved at most, with
    `split_boundary`) and the regions they bound.  Kept vertices keep their order; inserted ones
    come after them, mesh by mesh.  A mesh that has inverted triangles comes back as it was.
    """
    work = Remeshing(batch, options or RemeshOptions())
    work.run(~segment_any(~quality(batch).upright, batch.triangle_offsets))
    return work.batch, work.info()


class Remeshing:
    """A batch on its way, with the names of its vertices and the sizes wanted at them.

    rough     above this mean inverse mean ratio a mesh may be stuck in rows, and is shaken up:
    shakes    its edges shorter and longer than these parts of their size go, once for each pair
    accuracy  with which sizes are continued inwards, as in `size_field`
    rest      the smoothing between rounds
    """

    rough = 1.025
    shakes: tuple[tuple[float, float], ...] = ((0.75, 1.5), (0.8, 1.4), (1.0, 1.2))
    accuracy: float | None = None
    rest = SmoothOptions(max_iterations=15, energy_tolerance=1e-3, single=True)

    def __init__(self, batch: MeshBatch, options: RemeshOptions) -> None:
        self.batch, self.options = batch, options
        self.names = Names(len(batch.points), batch.points.device)
        self.wanted = counts_from_offsets(batch.triangle_offsets)
        self.size: Tensor | None = None
        targets = options.smooth.targets
        self.targets = targets if isinstance(targets, MetricField) else None
        # (V, 3) what the targets are at the vertices there are.
        self.metric = None if self.targets is None else self.targets.at_vertices(batch)
        self.longest = options.split_above
        zero = torch.zeros(len(batch), dtype=torch.int64, device=batch.points.device)
        self.splits, self.collapses, self.flips, self.rounds = zero, zero.clone(), zero.clone(), zero.clone()

    def run(self, going: Tensor) -> None:
        """Remesh the meshes `going` (B,) bool, which must be valid."""
        self.size = self._sizes(going)
        self._remesh(going)

    def _remesh(self, going: Tensor) -> None:
        self._rounds(going)
        # Rows of right-angled triangles fit their sizes, and no single split or collapse betters them.
        ceiling = _OVER_CEILING * (self.options.smooth.ceiling or 1.0)
        for shake in self.shakes:
            before = self._quality()
            rough = going & (before.mean > self.rough) & (self.rounds > 0)
            if not bool(rough.any()):
                break
            ordered = self._state()
            self.longest = 2 * self.options.split_above
            self._cut(rough, *shake)
            self.longest = self.options.split_above
            self._settle(rough, self.rest)
            self._rounds(rough)
            after = self._quality()
            worse = (after.mean >= before.mean) | (after.max > before.max.clamp_min(ceiling))
            self._restore(rough & worse, ordered)
        self._polish(going)

    def _quality(self) -> Quality:
        return quality(self.batch) if self.metric is None else metric_quality(self.batch, self.metric)

    def _metric_of(self, rows: Tensor) -> MetricField | None:
        """The metric at some of the vertices, as targets."""
        return None if self.metric is None else MetricField(self.metric[rows])

    def _rounds(self, going: Tensor) -> None:
        """Split, collapse, flip and smooth in turn, until hardly an edge changes or the shapes no longer gain."""
        before = self._quality()
        for turn in range(self.options.max_rounds):
            if not bool(going.any()):
                break
            changed = self._cut(going, self.options.collapse_below, self.options.split_above)
            self._settle(going, self.rest)
            self.rounds[going] += 1
            now = self._quality()
            few = self._few(changed, now)
            stuck = (before.mean - now.mean < 1e-4) & (before.max - now.max < 1e-3 * now.max)
            going = going & ~few & ~(stuck & (turn > 0))
            before = now

    def _few(self, changed: Tensor, now: Quality) -> Tensor:
        """(B,) bool: did so few edges change, (B,) in meshes that are `now` so good, that to go on is not worth it?"""
        return _FEW * changed <= counts_from_offsets(self.batch.triangle_offsets)

    def fields(self) -> list[Tensor]:
        """What each vertex has: the size wanted, its name, and its metric, if there is one."""
        assert self.size is not None
        return [self.size, self.names.of] + ([] if self.metric is None else [self.metric])

    def exchange(self, at: Tensor, part: MeshBatch, fields: list[Tensor]) -> None:
        """Put `part` and what its vertices have in the place of the meshes `at` (B,) bool."""
        pairs = list(zip(self.fields(), fields, strict=True))
        self.batch, self.size, self.names.of, *metric = exchange(self.batch, at, part, pairs)
        self.metric = metric[0] if metric else None

    def _state(self) -> tuple[MeshBatch, list[Tensor], Tensor, Tensor]:
        return self.batch, self.fields(), self.splits.clone(), self.collapses.clone()

    def _restore(self, at: Tensor, state: tuple[MeshBatch, list[Tensor], Tensor, Tensor]) -> None:
        """Take the meshes `at` (B,) bool back to what they were, and what brought them there out of the counts."""
        if bool(at.any()):
            batch, fields, splits, collapses = state
            rows = spread(at, batch.point_offsets)
            self.exchange(at, batch.select(at), [values[rows] for values in fields])
            self.splits = torch.where(at, splits, self.splits)
            self.collapses = torch.where(at, collapses, self.collapses)

    def improve(self, going: Tensor) -> Tensor:
        """Remesh the meshes `going` (B,) bool and take back what made the shapes worse; those kept (B,) bool.

        The mean inverse mean ratio may not grow, nor the maximum by more than a hair, unless it stays below
        the ceiling of the smoothing.  With sizes that the user asked for, it is enough if no triangle is worse
        than the worst there was, or than `options.worst`.
        """
        before = self._quality()
        self.size = self._sizes(going)
        given = self._state()
        self._remesh(going)
        after = self._quality()
        if isinstance(self.options.sizes, str) and self.options.sizes == "boundary":
            ceiling = self.options.smooth.ceiling or 1.0
            good = (after.mean <= before.mean) & (after.max <= (_SLACK * before.max).clamp_min(ceiling))
        else:
            good = after.max <= before.max.clamp_min(self.options.worst)
        good &= after.inverted <= before.inverted
        self._restore(going & ~good, given)
        return going & good

    def _sizes_of(self, rows: Tensor) -> Sizes:
        """The sizes asked for, at some of the given vertices only."""
        sizes = self.options.sizes
        return sizes[rows] if isinstance(sizes, Tensor) else sizes

    def info(self) -> RemeshInfo:
        size = size_field(self.batch, "keep") if self.size is None else self.size
        conformity = (
            size_conformity(self.batch, size)
            if self.metric is None
            else metric_conformity(self.batch, size, self.metric)
        )
        return RemeshInfo(
            self.splits, self.collapses, self.flips, self.rounds, self.names.vertex_map(), size, conformity
        )

    def _size_field(self, part: MeshBatch, sizes: Sizes, rows: Tensor, going: Tensor) -> Tensor:
        """(V',) the sizes of `part`, the meshes `going` (B,), whose vertices are the `rows` (V,) bool."""
        if self.metric is None:
            return size_field(part, sizes, triangles=self.wanted[going], accuracy=self.accuracy)
        return metric_size_field(part, sizes, self.metric[rows], self.wanted[going])

    def _sizes(self, going: Tensor) -> Tensor:
        """(V,) what is wanted in the meshes `going` (B,), what there is in the others, which may be tangled."""
        size = size_field(self.batch, "keep")
        if bool(going.any()):
            part, rows = self.batch.select(going), spread(going, self.batch.point_offsets)
            size[rows] = self._scaled(part, self._size_field(part, self._sizes_of(rows), rows, going))
        return size

    def _scaled(self, part: MeshBatch, size: Tensor) -> Tensor:
        """The sizes that `part` can have: those asked for, since vertices come and go."""
        return size

    def _cut(self, going: Tensor, short: float, long: float) -> Tensor:
        """Split edges above `long` of their size in the meshes `going`, collapse those below `short`; how many (B,)."""
        assert self.size is not None
        part, rows = self.batch.select(going), spread(going, self.batch.point_offsets)
        size, names, *metric = (values[rows] for values in self.fields())
        e = editable(part, size, self.names, names, *metric)
        splits = split_rounds(e, self._too_long(e, long), allow_fixed=self.options.split_boundary)
        collapses = collapse_rounds(e, self._too_short(e, short), self._harmless)
        self.splits[going] += splits
        self.collapses[going] += collapses
        self.names.fresh = e.fresh
        part, *fields = rebuilt(part, e)
        if e.metric is not None:
            fields.append(unit_metric(e.metric[living(e)]))
        self.exchange(going, part, fields)
        changed = torch.zeros_like(self.splits)
        changed[going] = splits + collapses
        return changed

    def _too_long(self, e: Editable, limit: float) -> SplitWish:
        def wish(h: Tensor) -> tuple[Tensor, Tensor]:
            ratio = e.relative_length(h)
            long = (ratio > limit).nonzero().squeeze(1)
            before, after = worst_after(e, h[long])
            wanted = torch.zeros(len(h), dtype=torch.bool, device=h.device)
            wanted[long] = after <= before.clamp_min(self.options.worst)
            return wanted, torch.zeros_like(h).index_copy(0, long, e.shuffled(h[long], -ratio[long]))

        return wish

    def _too_short(self, e: Editable, limit: float) -> CollapseWish:
        def wish(h: Tensor) -> Tensor:
            ratio = e.relative_length(h)
            return torch.where(ratio < limit, ratio, torch.inf)

        return wish

    def _harmless(self, o: Outcome) -> Tensor:
        return (o.after <= o.before.clamp_min(self.options.worst)) & (o.longest < self.longest)

    def _settle(self, going: Tensor, options: SmoothOptions) -> Tensor:
        """Flip, smooth, and read the sizes anew where the vertices are then; the flips of each mesh (B,)."""
        part = self.batch.select(going)
        metric = self._metric_of(spread(going, self.batch.point_offsets))
        part, info = flip_to_delaunay(part, FlipOptions(rule="shape"), metric=metric)
        moved, _ = smooth(part, replace(options, targets=metric))
        self._renew(going, part, moved)
        flips = torch.zeros_like(self.flips)
        flips[going] = info.flips
        self.flips += flips
        return flips

    def _renew(self, going: Tensor, before: MeshBatch, after: MeshBatch) -> None:
        assert self.size is not None
        rows = spread(going, self.batch.point_offsets)
        sizes = self.options.sizes
        if self.metric is not None and self.targets is not None and not isinstance(self.targets.values, Tensor):
            # A tensor's metric moves with its vertices, a function's is asked for where they are.
            self.metric = self.metric.index_copy(0, rows.nonzero().squeeze(1), self.targets.at_vertices(after))
        if isinstance(sizes, Tensor) or (isinstance(sizes, str) and sizes == "keep"):
            size = carried(before, self.size[rows], after.points)
        else:
            size = self._size_field(after, sizes, rows, going)
        size = self._scaled(after, size)
        self.batch, self.size = exchange(self.batch, going, after, [(self.size, size)])

    def _polish(self, going: Tensor) -> None:
        at = going
        for _ in range(5):
            if not bool(at.any()):
                break
            at = at & (self._settle(at, replace(self.rest, max_iterations=20)) > 0)
        if bool(going.any()):
            part = self.batch.select(going)
            metric = self._metric_of(spread(going, self.batch.point_offsets))
            self._renew(going, part, smooth(part, replace(self.options.smooth, targets=metric))[0])


def editable(batch: MeshBatch, size: Tensor, names: Names, of: Tensor, metric: Tensor | None = None) -> Editable:
    """The batch, taken apart for splits and collapses; its vertices are called `of` (V,)."""
    twin = twins(batch.triangles)
    # A power of two changes no sign and keeps every square in range.
    unit = spread(centre_and_unit(batch.points, batch.point_offsets)[1], batch.point_offsets)
    points = batch.points.to(torch.float64) / unit[:, None]
    return Editable(
        points[:, 0].contiguous(), points[:, 1].contiguous(), size / unit, batch.fixed.clone(), vertex_mesh(batch),
        of.clone(), batch.triangles.reshape(-1).clone(), twin, constrained_half_edges(batch),
        torch.ones_like(batch.fixed), batch.points.dtype, names.fresh, names.births, len(batch),
        None if metric is None else metric.clone(),
    )  # fmt: skip


def rebuilt(batch: MeshBatch, e: Editable) -> tuple[MeshBatch, Tensor, Tensor]:
    """The batch that `e` has become, and the sizes and names of its vertices (V,)."""
    kept, faces, locked, vertices, triangles = compact(e)
    unit = centre_and_unit(batch.points, batch.point_offsets)[1][e.mesh[kept]]
    points = (torch.stack([e.x[kept], e.y[kept]], 1) * unit[:, None]).to(batch.points)
    return (
        MeshBatch(
            points, faces, e.fixed[kept], locked, offsets_from_counts(vertices), offsets_from_counts(triangles),
            batch.frames,
        ),
        e.size[kept] * unit,
        e.origin[kept],
    )  # fmt: skip
