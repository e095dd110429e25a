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
from ..mesh.ragged import counts_from_offsets, put_rows, segment_any, segment_count, segment_max, spread
from ..optimising.metric_field import MetricField
from ..status import Status
from .columns import Edits
from .ending import certify, compare_sizes
from .faults import end_the_tangled, find_faults
from .options import ImproveOptions
from .parts import Parts, PartsLog, paste
from .runner import Log, Runner
from .shapes_meant import Meant, Spared, damaged
from .state import State
from .strategies import improve_batch


def improve_damage(state: State, log: Log, options: ImproveOptions) -> State:
    """The whole job on parts round the damage of each mesh; all else, and meshes without damage, keep their bits."""
    mending = Mending.begin(state, options)
    # A pass that puts nothing back is what another call would be, so that a call on its own result changes nothing.
    for turn in range(options.damage.passes):
        begun, mending = mending.state, mending.afresh() if turn else mending
        while (found := mending.next_parts()) is not None:
            parts, tries, how = found
            mending = mending.after(parts, tries, _worked_on(mending, parts, how, log))
        if mending.state.mesh is begun.mesh:
            break
    run, state = Runner(log), mending.ended()
    state = end_the_tangled(find_faults(state, run, options), run, options)
    state = state.ended(state.running, Status.STALLED)
    return certify(compare_sizes(state, run, options), run, options)


@dataclass(frozen=True, eq=False)
class Mending:
    """A state whose damage is being mended.

    state      the meshes as they are now
    options    of the whole job
    meant      the shapes that are meant
    sizes      (V,) the edge lengths that were asked for by vertex, or None
    slides     (V,) bool, the vertices that may slide; None: none may
    tries      (T,) int64, in how many parts the triangle has been tried in vain
    closed     (T,) bool, no more is to be tried for the triangle
    touched    (T,) bool, the triangle is in a part that was put back
    """

    state: State
    options: ImproveOptions
    meant: Meant
    sizes: Tensor | None
    slides: Tensor | None
    tries: Tensor
    closed: Tensor
    touched: Tensor

    @classmethod
    def begin(cls, state: State, options: ImproveOptions) -> "Mending":
        """Before any part was worked on."""
        none = torch.zeros(len(state.mesh.triangles), dtype=torch.bool, device=state.meshes.device)
        asked = state.origin.sizes
        sizes = None if asked is None else state.of_given_vertices(asked)
        slides = None if state.curves is None else state.curves.may_slide(state.mesh.point_offsets)
        return cls(state, options, Meant.of(state), sizes, slides, none.long(), none, none.clone())

    def afresh(self) -> "Mending":
        """The same, as if the meshes that are valid had been given like this."""
        meant = Meant.of(self.state) if self.state.names is None else self.meant
        valid = spread(self.state.valid, self.state.mesh.triangle_offsets)
        return replace(self, meant=meant, tries=torch.where(valid, 0, self.tries), closed=self.closed & ~valid)

    def next_parts(self) -> tuple[Parts, Tensor, "How"] | None:
        """Parts to work on in the same way, (P,) how often they have been tried, and that way; None: none is left."""
        mesh, o = self.state.mesh, self.options.damage
        bad = (
            damaged(self.state, self.meant, self.options)
            & ~self.closed
            & spread(self.state.running, mesh.triangle_offsets)
        )
        if not bool(bad.any()):
            return None
        free = torch.zeros(len(mesh.points), dtype=torch.bool, device=bad.device)
        for times in self.tries[bad].unique().tolist():
            near = corners_of(mesh.triangles, bad & (self.tries == times), len(free))
            for _ in range(o.rings_at(times) - 1):
                near = corners_of(mesh.triangles, touching(mesh.triangles, near), len(free))
            free |= near
        parts = Parts.cut_out(mesh, free)
        tries = segment_max(
            torch.where(bad, self.tries, -1)[parts.triangles].to(torch.float64), parts.mesh.triangle_offsets
        ).long()
        hows = How.of(self, parts)
        # Of each mesh the parts like its first one, so that what becomes of a mesh does not depend on the others.
        owner = parts.owner.tolist()
        first = dict(reversed(list(zip(owner, hows, strict=True))))
        same = [how == hows[0] == first[b] for b, how in zip(owner, hows, strict=True)]
        chosen = torch.tensor(same, device=bad.device)
        return parts.select(chosen), tries[chosen], hows[0]

    def after(self, parts: Parts, tries: Tensor, after: State) -> "Mending":
        """What has been mended once the `parts` have become `after`; `tries` (P,) is how often they had been tried."""
        o, upright = self.options.damage, self.state.quality.upright
        spared = None if self.options.when is None else Spared.of(self.state)
        bad = damaged(self.state, self.meant, self.options, spared)
        poor, inverted = parts.of_triangles(bad & upright), parts.of_triangles(~upright)
        spared = None if spared is None else spared.narrowed(parts, after)
        still = damaged(after, self._meant_in(parts, after), self.options, spared) & after.quality.upright
        left = segment_count(still, after.mesh.triangle_offsets)
        fits = ~parts.clash(after)
        sound = fits & after.valid & after.certified
        # What was valid changes only if fewer triangles are bad, since the boundary may force some to be so.
        better = (sound & ((inverted > 0) | (left < poor))) | (fits & parts.whole & (after.quality.inverted < inverted))
        # For its shapes alone a part grows on only where that has helped.
        hopeful = (tries <= o.growths_for_shapes) | (better & (left < poor))
        open_ = (~sound | ((left > 0) & hopeful)) & (~parts.whole | (~sound & (tries == 0)))
        # A part that is valid grows at once.
        onward = torch.where(sound, tries.clamp_min(1), tries) + 1
        mending = replace(self, state=_with_failures(self.state, parts, after))
        if not bool(better.all()):
            vain = spread(~better, parts.mesh.triangle_offsets)
            mending = mending._told(parts.triangles[vain], spread(onward, parts.mesh.triangle_offsets)[vain],
                                    spread(open_, parts.mesh.triangle_offsets)[vain])  # fmt: skip
        if bool(better.any()):
            mending = mending._put(parts, after, better, onward[better], open_[better])
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
        return self.state.noted(notes).ended(self.state.running & self.state.valid, Status.SETTLED)

    def _told(self, triangles: Tensor, tries: Tensor, more: Tensor) -> "Mending":
        """With new `tries` of some triangles (N,), and closed but for those of which `more` (N,) bool is true."""
        return replace(
            self,
            tries=put_rows(self.tries, triangles, tries),
            closed=put_rows(self.closed, triangles, ~more),
        )

    def _put(self, parts: Parts, after: State, at: Tensor, tries: Tensor, more: Tensor) -> "Mending":
        """With the parts that `at` (P,) bool marks as they are in `after`; `tries` and `more` are of these."""
        state, made = self.state, paste(parts, after, at, self.state.vertex_names)
        part = after.select(at)
        meant, sizes, slides, targets = self.meant, self.sizes, self.slides, state.targets
        if made.names is not None:
            assert part.names is not None
            if meant.of_vertices is not None:
                meant = meant.pasted(made, self._meant_in(parts, after), spread(at, after.mesh.point_offsets))
                targets = None if targets is None else meant.targets
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
            made.by_triangle(self.tries, tries),
            made.by_triangle(self.closed, ~more),
            made.by_triangle(self.touched, torch.ones_like(more)),
        )

    def _meant_in(self, parts: Parts, after: State) -> "Meant":
        """The shapes that are meant in the parts, as they are in `after`."""
        meant = self.meant.narrowed(parts)
        if after.names is None or not isinstance(meant.of_vertices, Tensor):
            return meant
        onward = after.vertex_names.vertex_map()
        usual = None if meant.usual is None else onward.carry(meant.usual)
        return Meant(MetricField(onward.carry(meant.of_vertices)), usual)


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
        stretched = torch.zeros_like(parts.whole)
        metric = mending.meant.of_vertices
        # A bound says that the equilateral triangle is the aim: a mesh that a motion has squeezed is not meant so.
        usual = state.targets is None and mending.options.method == "default" and mending.options.when is None
        if usual and metric is not None:
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


def _worked_on(mending: Mending, parts: Parts, how: How, log: Log) -> State:
    """The parts after the whole job on them as meshes of their own."""
    state, options = mending.state, _options_for(mending, parts, how)
    hold = ~parts.free
    if mending.slides is not None:
        # What does not slide in the whole does not in a part either, where a corner may not be seen.
        hold = hold | ~mending.slides[parts.vertices]
    part = State.of(parts.mesh, options, hold)
    part = replace(part, tethered=part.valid & mending.options.stays_near)
    if options.max_motion is not None and state.names is None:
        anchors, widths = state.anchors[parts.vertices], state.widths[parts.vertices]
        part = replace(part, origin=replace(part.origin, anchors=anchors, anchor_widths=widths))
    names, every = state.vertex_names, torch.ones_like(parts.whole)

    def whole(now: State) -> MeshBatch:
        return paste(parts, now, every, names).mesh

    return improve_batch(part, PartsLog(log, state, parts, whole), options)


def _options_for(mending: Mending, parts: Parts, how: How) -> ImproveOptions:
    """The options for the parts as meshes of their own."""
    options, state = mending.options, mending.state
    aim = mending.meant.narrowed(parts).targets if how.stretched or state.targets is not None else None
    reference = None
    if how.referred:
        assert state.reference is not None
        reference = replace(parts.mesh, points=state.reference.points[parts.vertices])
    sizes = options.remesh.sizes if mending.sizes is None else mending.sizes[parts.vertices]
    return replace(
        options,
        scope="all",
        when=None,
        local_repair=None,
        smooth=replace(options.smooth, targets=aim),
        remesh=replace(options.remesh, sizes=sizes),
        reference=reference,
        workers=1,
    )


def _with_failures(state: State, parts: Parts, after: State) -> State:
    """The state of the whole meshes, with the errors of the stages in their parts."""
    failures = list(state.failures)
    for b, more in zip(parts.owner.tolist(), after.failures, strict=True):
        failures[b] += tuple(failure for failure in more if failure not in failures[b])
    return replace(state, failures=tuple(failures))


def _summed(state: State, parts: Parts, after: State, at: Tensor) -> Edits | None:
    """What came and went in the whole meshes, with that in the parts that `at` (P,) bool marks."""
    if after.edits is None:
        return state.edits
    edits = Edits.none(state.status) if state.edits is None else state.edits
    owner = parts.owner[at]
    sums = (getattr(edits, f.name).index_add(0, owner, getattr(after.edits, f.name)[at]) for f in fields(edits))
    return Edits(*sums)
