"""Only what is damaged is worked on, and as much round it as mending takes: `scope="damage"`.

    damage: inverted, or much worse than the shape that is meant there
       |
    rings of vertices round it --> parts --> the whole job on each part --> valid, and of the shapes meant?
       ^                                                                     | no                | yes
       +--------------------- more rings, until the part is the whole mesh --+                put back

Every other vertex and triangle keeps its bits.  The shape that is meant is that of the targets or of the reference, if
there are any, and else the local median shape: a mesh that is stretched throughout is as it was meant.
"""

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.connectivity import corners_of, touching
from ..mesh.ragged import counts_from_offsets, segment_any, segment_count, segment_max, spread
from ..optimising.median_metric import median_metric
from ..optimising.metric_field import MetricField
from ..optimising.targets import Targets, metric_from, target_quality
from ..status import Status
from .options import Damage, ImproveOptions
from .parts import Parts, PartsLog, paste
from .runner import Log, Runner
from .state import Edits, State
from .strategies import certify, compare_sizes, improve_batch, tell_the_hopeless


def improve_damage(state: State, log: Log, options: ImproveOptions) -> State:
    """The whole job on parts round the damage of each mesh; all else, and meshes without damage, keep their bits."""
    mending = Mending.begin(state, options)
    while (found := mending.next_parts()) is not None:
        parts, level, how = found
        mending = mending.after(parts, level, _worked_on(mending, parts, how, log))
    run, state = Runner(log), mending.ended()
    state = tell_the_hopeless(state, run, options)
    state = state.ended(state.running, Status.STALLED)
    return certify(compare_sizes(state, run, options), run, options)


@dataclass(frozen=True, eq=False)
class Mending:
    """A state whose damage is being mended.

    state      the meshes as they are now
    options    of the whole job
    meant      the shapes that are meant: a metric at each vertex, or matrices of triangles that stay
    sizes      (V,) the edge lengths that were asked for by vertex, or None
    slides     (V,) bool, the vertices that may slide; None: none may
    level      (T,) int64, in how many parts the triangle has been tried in vain
    closed     (T,) bool, no more is to be tried for the triangle
    touched    (T,) bool, the triangle is in a part that was put back
    """

    state: State
    options: ImproveOptions
    meant: Targets
    sizes: Tensor | None
    slides: Tensor | None
    level: Tensor
    closed: Tensor
    touched: Tensor

    @classmethod
    def begin(cls, state: State, options: ImproveOptions) -> "Mending":
        """Before any part was worked on."""
        none = torch.zeros(len(state.mesh.triangles), dtype=torch.bool, device=state.meshes.device)
        asked = state.origin.sizes
        sizes = None if asked is None else state.of_given_vertices(asked)
        slides = None if state.curves is None else state.curves.may_slide(state.mesh.point_offsets)
        return cls(state, options, meant_shapes(state), sizes, slides, none.long(), none, none.clone())

    def next_parts(self) -> tuple[Parts, Tensor, "How"] | None:
        """Parts to work on in the same way, (P,) how often they have grown, and that way; None: there are none left."""
        mesh, o = self.state.mesh, self.options.damage
        bad = damaged(self.state, self.meant, o) & ~self.closed
        if not bool(bad.any()):
            return None
        free = torch.zeros(len(mesh.points), dtype=torch.bool, device=bad.device)
        for level in self.level[bad].unique().tolist():
            near = corners_of(mesh.triangles, bad & (self.level == level), len(free))
            for _ in range(o.rings_at(level) - 1):
                near = corners_of(mesh.triangles, touching(mesh.triangles, near), len(free))
            free |= near
        parts = Parts.cut_out(mesh, free)
        level = segment_max(
            torch.where(bad, self.level, -1)[parts.triangles].to(torch.float64), parts.mesh.triangle_offsets
        ).long()
        hows = How.of(self, parts)
        # Of each mesh the parts like its first one, so that what becomes of a mesh does not depend on the others.
        owner = parts.owner.tolist()
        first = dict(reversed(list(zip(owner, hows, strict=True))))
        same = [how == hows[0] == first[b] for b, how in zip(owner, hows, strict=True)]
        chosen = torch.tensor(same, device=bad.device)
        return parts.select(chosen), level[chosen], hows[0]

    def after(self, parts: Parts, level: Tensor, after: State) -> "Mending":
        """What has been mended once the `parts` have become `after`; `level` (P,) is how often they had grown."""
        o = self.options.damage
        bad = damaged(self.state, self.meant, o)
        before = parts.of_triangles(bad & self.state.quality.upright), parts.of_triangles(~self.state.quality.upright)
        ratio = target_quality(after.mesh, self.meant_in(parts, after))
        worse = (ratio > o.worse) & after.quality.upright
        offsets = after.mesh.triangle_offsets
        poor, inverted = segment_count(worse, offsets), after.quality.inverted
        highest = segment_max(torch.where(worse, ratio, 1.0), offsets)
        was = torch.where(bad, target_quality(self.state.mesh, self.meant), 1.0)[parts.triangles]
        rounder = (poor < before[0]) | ((poor == before[0]) & (highest < segment_max(was, parts.mesh.triangle_offsets)))
        fits = ~parts.clash(after)
        sound = fits & (inverted == 0) & after.certified
        better = (sound & ((before[1] > 0) | rounder)) | (fits & parts.whole & (inverted < before[1]))
        # For its shapes alone a part does not grow far.
        open_ = (~sound | ((poor > 0) & (level < o.growths_for_shapes))) & ~parts.whole
        mending = self
        if not bool(better.all()):
            vain = spread(~better, parts.mesh.triangle_offsets)
            mending = mending._told(parts.triangles[vain], spread(level + 1, parts.mesh.triangle_offsets)[vain],
                                    spread(open_, parts.mesh.triangle_offsets)[vain])  # fmt: skip
        if bool(better.any()):
            mending = mending._put(parts, after, better, (level + 1)[better], open_[better])
        return mending

    def ended(self) -> State:
        """The state, with a note of how much was worked on, and with the status of the meshes that are valid."""
        counts = segment_count(self.touched, self.state.mesh.triangle_offsets).tolist()
        notes = {}
        for b, (some, every) in enumerate(
            zip(counts, counts_from_offsets(self.state.mesh.triangle_offsets).tolist(), strict=True)
        ):
            if some < every:
                notes[b] = f"; only {some:,} of {every:,} triangles, round the damage, were worked on"
            if not some and int(self.state.quality.inverted[b]) == 0:
                notes[b] = "; nothing was mended, and all is as it was given"
        return self.state.noted(notes).ended(self.state.valid, Status.SETTLED)

    def _told(self, triangles: Tensor, level: Tensor, more: Tensor) -> "Mending":
        """With a new level of some triangles (N,), and closed but for those of which `more` (N,) bool is true."""
        return replace(
            self,
            level=self.level.index_copy(0, triangles, level),
            closed=self.closed.index_copy(0, triangles, ~more),
        )

    def _put(self, parts: Parts, after: State, at: Tensor, level: Tensor, more: Tensor) -> "Mending":
        """With the parts that `at` (P,) bool marks as they are in `after`; `level` and `more` are of these."""
        state, made = self.state, paste(parts, after, at, self.state.vertex_names)
        part = after.select(at)
        meant, sizes, slides, targets = self.meant, self.sizes, self.slides, state.targets
        if made.names is not None:
            assert part.names is not None
            if isinstance(meant, MetricField) and isinstance(meant.values, Tensor):
                there = self.meant_in(parts, after)
                assert isinstance(there, MetricField)
                here = there.at_vertices(after.mesh)[spread(at, after.mesh.point_offsets)]
                meant = MetricField(made.by_vertex(meant.values, here))
            if isinstance(targets, MetricField) and isinstance(targets.values, Tensor):
                targets = meant
            if sizes is not None:
                inherited = after.vertex_names.vertex_map().carry(sizes[parts.vertices])
                sizes = made.by_vertex(sizes, inherited[spread(at, after.mesh.point_offsets)])
            if slides is not None:
                slides = made.by_vertex(slides, torch.zeros(len(part.mesh.points), dtype=torch.bool, device=at.device))
        new = state.at(made.mesh) if made.names is None else replace(state.at(made.mesh), names=made.names)
        return Mending(
            replace(new, targets=targets, edits=_summed(state, parts, after, at)),
            self.options,
            meant,
            sizes,
            slides,
            made.by_triangle(self.level, level),
            made.by_triangle(self.closed, ~more),
            made.by_triangle(self.touched, torch.ones_like(more)),
        )

    def meant_in(self, parts: Parts, after: State | None = None) -> Targets:
        """The shapes that are meant in the parts, as they were cut out, or as they are in `after`."""
        meant = self.meant
        if isinstance(meant, Tensor):
            return meant[parts.triangles]
        if not isinstance(meant.values, Tensor):
            return meant
        values = meant.values[parts.vertices]
        if after is not None and after.names is not None:
            values = after.vertex_names.vertex_map().carry(values)
        return MetricField(values)


@dataclass(frozen=True)
class How:
    """In what way a part is worked on.

    stretched  towards the local median shape, since this is far from equilateral
    referred   with the reference, whose triangles it still has
    """

    stretched: bool
    referred: bool

    @classmethod
    def of(cls, mending: Mending, parts: Parts) -> list["How"]:
        """How each of the parts is to be worked on."""
        state, offsets = mending.state, parts.mesh.triangle_offsets
        aimed = state.targets is not None or state.origin.reference is not None
        stretched = torch.zeros_like(parts.whole)
        if not aimed and mending.options.method == "default":
            assert isinstance(mending.meant, MetricField)
            metric = mending.meant.at_vertices(state.mesh)
            long = (0.5 * (metric[:, 0] + metric[:, 2]) > mending.options.damage.stretched)[parts.vertices]
            stretched = 2 * segment_count(long, parts.mesh.point_offsets) > counts_from_offsets(
                parts.mesh.point_offsets
            )
        referred = torch.zeros_like(parts.whole)
        if state.origin.reference is not None and state.names is None:
            assert state.reference is not None
            other = (state.reference.triangles != state.mesh.triangles).any(1)
            referred = ~segment_any(other[parts.triangles], offsets)
        return [cls(*pair) for pair in zip(stretched.tolist(), referred.tolist(), strict=True)]


def meant_shapes(state: State) -> Targets:
    """The shapes that are meant in the meshes: those of targets or of a reference, or else the local median shape."""
    if state.targets is not None:
        return state.targets
    if state.reference is not None:
        return metric_from(state.reference, state.mesh)
    return MetricField(median_metric(state.mesh, state.quality.upright))


def damaged(state: State, meant: Targets, options: Damage) -> Tensor:
    """(T,) bool: the triangles that are inverted, or much worse than the shape that is meant at their place."""
    return ~state.quality.upright | (target_quality(state.mesh, meant) > options.worse)


def _worked_on(mending: Mending, parts: Parts, how: How, log: Log) -> State:
    """The parts after the whole job on them as meshes of their own."""
    state, options = mending.state, _options_for(mending, parts, how)
    hold = ~parts.free
    if mending.slides is not None:
        # What does not slide in the whole does not in a part either, where a corner may not be seen.
        hold = hold | ~mending.slides[parts.vertices]
    part = State.of(parts.mesh, options, hold)
    part = replace(part, tethered=part.valid & mending.options.stays_near)
    names, every = state.vertex_names, torch.ones_like(parts.whole)

    def whole(now: State) -> MeshBatch:
        return paste(parts, now, every, names).mesh

    return improve_batch(part, PartsLog(log, state, parts, whole), options)


def _options_for(mending: Mending, parts: Parts, how: How) -> ImproveOptions:
    """The options for the parts as meshes of their own."""
    options, state = mending.options, mending.state
    aim = mending.meant_in(parts) if how.stretched or state.targets is not None else None
    reference = None
    if how.referred:
        assert state.reference is not None
        reference = replace(parts.mesh, points=state.reference.points[parts.vertices])
    sizes = options.remesh.sizes if mending.sizes is None else mending.sizes[parts.vertices]
    return replace(
        options,
        scope="all",
        local_repair=None,
        smooth=replace(options.smooth, targets=aim),
        remesh=replace(options.remesh, sizes=sizes),
        reference=reference,
        workers=1,
    )


def _summed(state: State, parts: Parts, after: State, at: Tensor) -> Edits | None:
    """What came and went in the whole meshes, with that in the parts that `at` (P,) bool marks."""
    if after.edits is None:
        return state.edits
    edits = Edits.none(state.status) if state.edits is None else state.edits
    owner = parts.owner[at]
    sums = (getattr(edits, f.name).index_add(0, owner, getattr(after.edits, f.name)[at]) for f in fields(edits))
    return Edits(*sums)
