"""A batch on its way through the stages, with everything that belongs to its rows.

    State --- select(at) ---> the State of some of its meshes --- a stage ---> another State
      ^                                                                             |
      +--------------------------------- put(at, ...) ------------------------------+

Nothing in a state ever changes: a stage gives back another one.  What the caller gave is kept whole beside it, and
the rows of some meshes are taken out of it when a stage asks for them.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import torch
from torch import Tensor

from ..errors import what_failed
from ..mesh.batch import MeshBatch, put
from ..mesh.curves import BoundaryCurves
from ..mesh.frozen import frozen_triangles
from ..mesh.interfaces import holding
from ..mesh.measure import Quality, quality
from ..mesh.ragged import rows_of, segment_count, segment_max, segment_sum, spread, take, true_rows
from ..mesh.vertex_map import Names, VertexMap, exchange
from ..optimising.metric_field import MetricField
from ..optimising.targets import Targets, as_targets, narrow, narrow_quads, quad_targets_from
from ..remeshing.sizing import SizeConformity
from ..status import Status
from .columns import Edits, put_conformity, put_quality, put_where, select_conformity, select_quality
from .given import Given
from .options import ImproveOptions

_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class State:
    """B meshes on their way.

    mesh       the batch as it is now
    origin     what the caller gave, whole: these are the meshes `meshes` of it
    meshes     (B,) int64, ascending
    quality    of `mesh`
    status     (B,) int64 `Status`: RUNNING until it is known how the mesh ends
    reasons    for each mesh why the last attempt went no further, or ""
    faults     for each mesh what is wrong with its boundary or with what is fixed, or ""
    impossible  (B,) bool, it is proved that no valid mesh exists
    inverted_given  (B,) int64 inverted triangles of the mesh as given
    notes      for each mesh what the report says besides, or ""
    failures   for each mesh the stages that ended with an error, and the errors
    certified  (B,) bool, set at the end: the mesh is valid and its frame is the one given
    tethered   (B,) bool, the vertices stay near: the mesh came valid and nothing was asked for that takes them far
    curves     the curves along which vertices slide, and where they are on them; None: none slides
    targets    what shapes to aim at; None: equilateral triangles
    rounded    (V, 2) the positions from which valid meshes are worked on; None: those that were given
    averaged   (V, 2) where averaging took the vertices that were given; None: it was not tried
    held       (V,) bool, vertices that must not move in a stage; None: none
    lively     (V,) bool, vertices round which flips and smoothing may still gain; None: all
    sizes      (V,) edge lengths that were asked for and have travelled with the vertices; None: none were
    conformity  how well edges follow them, set at the end; None: no sizes were asked for
    names      topology "full": which vertices of the given batch these are; None: all, in their order
    edits      topology "full": what came and went
    anew       (B,) bool, the vertices have been placed anew, by the sizes of the boundary; None: in no mesh
    """

    mesh: MeshBatch
    origin: Given
    meshes: Tensor
    quality: Quality
    status: Tensor
    reasons: tuple[str, ...]
    faults: tuple[str, ...]
    impossible: Tensor
    inverted_given: Tensor
    notes: tuple[str, ...]
    certified: Tensor
    tethered: Tensor
    curves: BoundaryCurves | None = None
    targets: Targets | None = None
    rounded: Tensor | None = None
    averaged: Tensor | None = None
    held: Tensor | None = None
    lively: Tensor | None = None
    sizes: Tensor | None = None
    conformity: SizeConformity | None = None
    names: Names | None = None
    edits: Edits | None = None
    anew: Tensor | None = None
    failures: tuple[tuple[tuple[str, str], ...], ...] = ()

    def __post_init__(self) -> None:
        if not self.failures:
            object.__setattr__(self, "failures", ((),) * len(self.meshes))

    @classmethod
    def of(
        cls,
        batch: MeshBatch,
        options: ImproveOptions,
        hold: Tensor | None = None,
        known: Quality | None = None,
    ) -> "State":
        """The state of a batch before any stage.

        hold   (V,) bool, vertices that do not slide
        known  the quality of the batch, if the caller has it
        """
        curves, errors = None, dict[int, Exception]()
        if options.slides:
            from ..smoothing.sliding import curves_or_errors

            curves, errors = curves_or_errors(
                batch,
                options.smooth.corner_angle,
                hold,
                boundary=options.at_boundary,
                interfaces=options.at_interfaces,
            )
        sizes = options.remesh.sizes
        stays = holding(batch, options.at_interfaces).fixed
        given = Given(
            batch,
            options.reference,
            sizes if isinstance(sizes, Tensor) else None,
            stays if curves is None else stays & ~curves.may_slide(batch.point_offsets),
            options.at_interfaces,
            tether=options.tether,
            quad_shapes=_quad_shapes(batch, options),
        )
        count, device = len(batch), batch.points.device
        q = quality(batch) if known is None else known
        return cls(
            mesh=batch,
            origin=given,
            meshes=torch.arange(count, device=device),
            quality=q,
            status=torch.full((count,), Status.RUNNING, device=device),
            reasons=("",) * count,
            faults=("",) * count,
            impossible=torch.zeros(count, dtype=torch.bool, device=device),
            inverted_given=q.inverted,
            notes=("",) * count,
            certified=torch.zeros(count, dtype=torch.bool, device=device),
            tethered=(q.inverted == 0) & options.stays_near,
            curves=curves,
            targets=as_targets(options.smooth.targets),
            failures=tuple((("curves", what_failed(errors[b])),) if b in errors else () for b in range(count)),
        )

    def __len__(self) -> int:
        return len(self.meshes)

    @property
    def valid(self) -> Tensor:
        """(B,) bool: no triangle of the mesh is inverted."""
        return self.quality.inverted == 0

    @cached_property
    def judged(self) -> Quality:
        """The quality by which it is decided what to do: that of the triangles that something can change.

        A triangle of a layer that is held, or one that is frozen, counts as ideal and does not enter the mean.
        """
        out = self.unchangeable
        if out is None:
            return self.quality
        q, offsets = self.quality, self.mesh.triangle_offsets
        ratio = torch.where(out, 1.0, q.inverse_mean_ratio)
        left = segment_count(~out, offsets)
        mean = segment_sum(torch.where(out, 0.0, ratio), offsets) / left.clamp_min(1)
        mean = torch.where(left > 0, mean, 1.0)
        return replace(q, inverse_mean_ratio=ratio, mean=mean, max=segment_max(ratio, offsets))

    @cached_property
    def unchangeable(self) -> Tensor | None:
        """(T,) bool, the triangles of layers that are held, and those that are frozen; None: there are none."""
        out = None
        if len(self.mesh.constrained_edges) and self.curves is None:
            out = frozen_triangles(self.mesh, holding(self.mesh, self.origin.interfaces).fixed)
        if self.origin.layers is None:
            return out
        names = self.vertex_names
        layers = (names.of < names.first) & self.origin.layers[names.of.clamp_max(names.first - 1)]
        inside = layers[self.mesh.triangles].all(1)
        return inside if out is None else out | inside

    @property
    def running(self) -> Tensor:
        """(B,) bool: it is not yet known how the mesh ends."""
        return self.status == Status.RUNNING

    @property
    def tangled(self) -> Tensor:
        """(B,) bool: the mesh has an inverted triangle, and there is still hope for it."""
        return ~self.valid & self.running

    @property
    def faulty(self) -> Tensor:
        """(B,) bool: something is wrong with the boundary of the mesh, or with what is fixed."""
        return torch.tensor([bool(text) for text in self.faults], dtype=torch.bool, device=self.meshes.device)

    @property
    def given(self) -> MeshBatch:
        """These meshes as the caller gave them."""
        return self.origin.mesh.select(self._of_origin())

    @property
    def reference(self) -> MeshBatch | None:
        """These meshes undeformed, if the caller gave them."""
        return None if self.origin.reference is None else self.origin.reference.select(self._of_origin())

    @property
    def quad_shapes(self) -> Tensor | None:
        """(4Q, 2, 2) what the corners of the quads of these meshes aim at; None: the corner of a square."""
        return narrow_quads(self.origin.quad_shapes, self.origin.mesh, self._of_origin())

    @property
    def widths(self) -> Tensor:
        """(V,) how wide these meshes were at the vertices given: the mean length of the edges there."""
        return self.of_given_vertices(self.origin.widths)

    @property
    def anchors(self) -> Tensor:
        """(V, 2) the positions from which the motion of vertices is measured."""
        at = self.origin.anchors
        return self.given.points if at is None else self.of_given_vertices(at)

    @property
    def vertex_names(self) -> Names:
        """Which vertices of the given batch these are."""
        if self.names is not None:
            return self.names
        every = Names.of_rows(len(self.origin.mesh.points), self.meshes.device)
        return every.select(spread(self._of_origin(), self.origin.mesh.point_offsets))

    @property
    def own_map(self) -> VertexMap:
        """The map from the vertices of these meshes as given to those that they have, in rows of these meshes."""
        whole = self.vertex_names.vertex_map()
        if len(self) == len(self.origin.mesh):
            return whole
        return whole.of_given(
            self.of_given_vertices(torch.arange(len(self.origin.mesh.points), device=self.meshes.device))
        )

    def of_given_vertices(self, rows: Tensor) -> Tensor:
        """Those of the rows (V, ...) over all the vertices given that belong to these meshes."""
        if len(self) == len(self.origin.mesh):
            return rows
        return take(rows, rows_of(self._of_origin().to(rows.device), self.origin.mesh.point_offsets.to(rows.device)))

    def _of_origin(self) -> Tensor:
        mask = torch.zeros(len(self.origin.mesh), dtype=torch.bool, device=self.meshes.device)
        return mask.index_fill_(0, self.meshes, True)

    def at(self, mesh: MeshBatch) -> "State":
        """The state with other positions or triangles, measured."""
        return replace(self, mesh=mesh, quality=quality(mesh, known=(self.mesh, self.quality)))

    def ended(self, at: Tensor, status: Status) -> "State":
        """The state where it is known that the meshes `at` (B,) bool end with `status`."""
        return replace(self, status=torch.where(at, int(status), self.status))

    def explained(self, faults: dict[int, str]) -> "State":
        """The state with the faults of some meshes, by their row."""
        return replace(self, faults=tuple(faults.get(b, old) for b, old in enumerate(self.faults)))

    def noted(self, notes: dict[int, str]) -> "State":
        """The state with something added to the notes of some meshes, by their row."""
        return replace(self, notes=tuple(old + notes.get(b, "") for b, old in enumerate(self.notes)))

    def failed(self, stage: str, error: str) -> "State":
        """The state where it is known that a stage ended with an error, in all meshes."""
        return replace(self, failures=tuple((*old, (stage, error)) for old in self.failures))

    def has_failed_in(self, stage: str) -> Tensor:
        """(B,) bool: the stage ended with an error in the mesh."""
        if not any(self.failures):
            return torch.zeros(len(self), dtype=torch.bool, device=self.meshes.device)
        found = [any(name == stage for name, _ in failures) for failures in self.failures]
        return torch.tensor(found, dtype=torch.bool, device=self.meshes.device)

    def select(self, at: Tensor) -> "State":
        """The meshes `at` (B,) bool, with their rows of everything."""
        if bool(at.all()):
            return self
        vertices = spread(at, self.mesh.point_offsets)
        rows = true_rows(vertices)
        chosen = true_rows(at).tolist()

        def by_vertex(values: Tensor | None) -> Tensor | None:
            return None if values is None else take(values, rows)

        return State(
            mesh=self.mesh.select(at),
            origin=self.origin,
            meshes=self.meshes[at],
            quality=select_quality(self.quality, at, spread(at, self.mesh.triangle_offsets)),
            status=self.status[at],
            reasons=tuple(self.reasons[b] for b in chosen),
            faults=tuple(self.faults[b] for b in chosen),
            impossible=self.impossible[at],
            inverted_given=self.inverted_given[at],
            notes=tuple(self.notes[b] for b in chosen),
            certified=self.certified[at],
            tethered=self.tethered[at],
            curves=None if self.curves is None else self.curves.select(at),
            targets=narrow(self.targets, self.mesh, at),
            rounded=by_vertex(self.rounded),
            averaged=by_vertex(self.averaged),
            held=by_vertex(self.held),
            lively=by_vertex(self.lively),
            sizes=by_vertex(self.sizes),
            conformity=select_conformity(self.conformity, at),
            names=None if self.names is None else self.names.select(vertices),
            edits=None if self.edits is None else self.edits.select(at),
            anew=None if self.anew is None else self.anew[at],
            failures=tuple(self.failures[b] for b in chosen),
        )

    def naming_after(self, other: "State") -> "State":
        """This state, in which inserted vertices get names that `other`, of the same origin, has not given to its own.

        The second of two runs that start from one state begins with this, so that no vertex of the one has the name of
        a vertex of the other when their results are put together.
        """
        return self if other.names is None else replace(self, names=other.names.renamed(self.vertex_names.of))

    def put(self, at: Tensor, part: "State") -> "State":
        """This state with the meshes `at` (B,) bool replaced by those of `part`, which came of `select(at)`.

        What steers the work on all meshes (`averaged`, `lively`) is not taken over.
        """
        if len(part) == len(self):
            return part
        if part.names is not None or self.names is not None:
            return self._exchanged(at, part)
        whole = self._with_rows_of_meshes(at, part)
        triangles = spread(at, self.mesh.triangle_offsets)
        sizes = self.sizes
        if part.sizes is not None:
            sizes = part.sizes.new_full((len(self.mesh.points),), torch.nan) if sizes is None else sizes
            sizes = put_where(sizes, spread(at, self.mesh.point_offsets), part.sizes)
        return replace(
            whole,
            mesh=put(self.mesh, at, part.mesh),
            quality=put_quality(self.quality, at, triangles, part.quality),
            curves=self.curves if self.curves is None or part.curves is None else self.curves.put(at, part.curves),
            sizes=sizes,
        )

    def _with_rows_of_meshes(self, at: Tensor, part: "State") -> "State":
        """This state with what has one row a mesh taken from `part`."""
        row = {b: i for i, b in enumerate(true_rows(at).tolist())}

        def mixed(old: tuple[_T, ...], new: tuple[_T, ...]) -> tuple[_T, ...]:
            return tuple(new[row[b]] if b in row else entry for b, entry in enumerate(old))

        anew = self.anew
        if part.anew is not None:
            anew = torch.zeros_like(at) if anew is None else anew
            anew = put_where(anew, at, part.anew)
        return replace(
            self,
            anew=anew,
            status=put_where(self.status, at, part.status),
            certified=put_where(self.certified, at, part.certified),
            conformity=put_conformity(self.conformity, at, part.conformity),
            impossible=put_where(self.impossible, at, part.impossible),
            reasons=mixed(self.reasons, part.reasons),
            faults=mixed(self.faults, part.faults),
            notes=mixed(self.notes, part.notes),
            failures=mixed(self.failures, part.failures),
        )

    def _exchanged(self, at: Tensor, part: "State") -> "State":
        """As `put`, where the numbers of vertices and triangles may have changed."""
        names, mine = self.vertex_names, part.vertex_names
        sizes = self.mesh.points.new_full((len(self.mesh.points),), torch.nan, dtype=torch.float64)
        sizes = sizes if self.sizes is None else self.sizes
        new_sizes = sizes.new_full((len(part.mesh.points),), torch.nan) if part.sizes is None else part.sizes
        pairs = [(names.of, mine.of), (sizes, new_sizes)]
        if isinstance(self.targets, MetricField) and isinstance(part.targets, MetricField):
            pairs.append((self.targets.at_vertices(self.mesh), part.targets.at_vertices(part.mesh)))
        mesh, of, sizes, *metric = exchange(self.mesh, at, part.mesh, pairs)
        edits = Edits.none(self.status) if self.edits is None else self.edits
        return replace(
            self._with_rows_of_meshes(at, part),
            mesh=mesh,
            quality=quality(mesh),
            targets=MetricField(metric[0]) if metric else self.targets,
            curves=self.curves if self.curves is None or part.curves is None else self.curves.put(at, part.curves),
            sizes=sizes,
            names=mine.renamed(of),
            edits=edits if part.edits is None else edits.put(at, part.edits),
            rounded=None,
            averaged=None,
            lively=None,
        )


def _quad_shapes(batch: MeshBatch, options: ImproveOptions) -> Tensor | None:
    """What the corners of quads aim at: what was asked for, or under shapes="auto" what they are in the reference."""
    if not len(batch.quads):
        return None
    if options.smooth.quad_targets is not None or options.reference is None or not options.keeps_shapes:
        return options.smooth.quad_targets
    return quad_targets_from(options.reference)
