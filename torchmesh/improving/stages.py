"""The stages: each function here returns one that a runner can run.

    flip             step 1 of Kim 2017            smooth           step 3: shapes
    untangle_beta    step 2                        relocate         vertices travel to empty regions
    regularised      step 2, other functional      polish           the worst triangles, patch by patch
    average          scrambled interiors           remove_vertices  topology "full", last resort
    warp             FEMWARP from the reference    remesh           topology "full": splits and collapses
    retriangulate    cavities, exactly             attempt          keeps a result only where it is better
    place_anew       vertices of large tangles

A stage works on all the meshes that it is given.  Modules that only few meshes need are imported where they are first
used: averaging, re-triangulation, sliding, relocation, remeshing.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import torch
from torch import Tensor

from ..flipping.delaunay import FlipOptions, flip_to_delaunay
from ..mesh.batch import MeshBatch
from ..mesh.connectivity import touching
from ..mesh.curves import BoundaryCurves
from ..mesh.interfaces import holding
from ..mesh.quads import HALVES, triangles_alone, with_triangles_alone
from ..mesh.ragged import counts_from_offsets
from ..mesh.vertex_map import Names
from ..optimising.metric_field import MetricField
from ..optimising.moves import Monitor
from ..remeshing.options import RemeshOptions
from ..remeshing.sizing import size_field
from ..smoothing import polishing, smoothing
from ..smoothing.smoothing import SmoothOptions
from ..untangling import untangling
from ..untangling.options import UntangleOptions
from ..warping.femwarp import femwarp
from .columns import Edits
from .runner import Stage, Work
from .state import State

if TYPE_CHECKING:
    from ..untangling.averaging import AverageOptions

_PLACED_ANEW = "; free vertices got new positions, by the sizes of the boundary"

Settings = TypeVar("Settings", UntangleOptions, SmoothOptions, polishing.PolishOptions, "AverageOptions")


def flip(options: FlipOptions) -> Stage:
    """Flips edges; if the targets are a metric field, the rule "shape" flips towards them."""

    def stage(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        around = None if state.lively is None else touching(state.mesh.triangles, state.lively)
        towards = state.targets if options.rule == "shape" else None
        metric = towards if isinstance(towards, MetricField) else None
        mesh, info = flip_to_delaunay(state.mesh, options, around=around, metric=metric)
        return state.at(mesh), Work.done(state, flips=info.flips)

    return stage


def untangle_beta(options: UntangleOptions) -> Stage:
    """Moves vertices until no triangle is inverted, or until untangle-beta can do no more."""

    def stage(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        mesh, info = untangling.untangle(state.mesh, _at_interfaces(options, state), monitor=monitor)
        return state.at(mesh), Work.done(state, iterations=info.iterations)

    return stage


def regularised(options: UntangleOptions) -> Stage:
    """Moves vertices by the regularised functional, towards the shapes of the reference if there is one."""

    def stage(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        settings = _at_interfaces(options, state)
        mesh, info = untangling.untangle(state.mesh, settings, reference=state.reference, monitor=monitor)
        return state.at(mesh), Work.done(state, iterations=info.iterations)

    return stage


def newton(options: UntangleOptions) -> Stage:
    """Moves vertices by the second-order ways; the shapes of the reference, or targets of triangles, come first."""

    def stage(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        shapes = state.targets if isinstance(state.targets, Tensor) else None
        rest = {"targets": shapes} if state.reference is None and not len(state.mesh.quads) else {}
        settings = _at_interfaces(options, state)
        mesh, info = untangling.untangle(state.mesh, settings, reference=state.reference, monitor=monitor, **rest)
        return state.at(mesh), Work.done(state, iterations=info.iterations)

    return stage


def gather() -> Stage:
    """Brings free vertices that lie far outside to the edge of their mesh."""
    from ..untangling.gathering import gathered

    return lambda state, monitor: (state.at(gathered(state.mesh)), Work.done(state))


def average() -> Stage:
    """Moves the vertices of scrambled interiors to the means of their neighbours."""
    from ..untangling import averaging

    def stage(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        options = _at_interfaces(averaging.AverageOptions(), state)
        return state.at(averaging.average(state.mesh, options)), Work.done(state)

    return stage


def warp() -> Stage:
    """Warps the interior of the reference to the present boundary, by FEMWARP."""

    def stage(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        assert state.reference is not None
        held = holding(state.mesh, state.origin.interfaces).fixed
        warped = femwarp(replace(state.reference, fixed=held), state.mesh.points)
        return state.at(state.mesh.with_points(warped.points)), Work.done(state)

    return stage


def retriangulate() -> Stage:
    """Re-triangulates tangled cavities with exact signs."""
    from ..untangling.retriangulation import retriangulate_cavities

    def stage(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        mesh, info = retriangulate_cavities(state.mesh, state.origin.interfaces)
        return replace(state.at(mesh), reasons=tuple(info.reasons)), Work.done(state, cavities=info.cavities)

    return stage


def place_anew(share: float) -> Stage:
    """Gives the free vertices of tangled regions new positions, from their boundary alone, where that can be done.

    share  regions in which no more than this share of the triangles is inverted stay
    """
    from ..remeshing.anew_in_rows import anew_in_rows

    def stage(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        kept = torch.zeros_like(state.valid)
        for b in range(len(state)):
            one = torch.arange(len(state)) == b
            before = state.select(one)
            mesh = anew_in_rows(before.mesh, before.quality, share)
            after = None if mesh is None else before.at(mesh)
            # Where regions lie over each other, an edge of the one may be an edge of the other already.
            if after is None or int((after.mesh.twin < 0).sum()) != int((before.mesh.twin < 0).sum()):
                continue
            if bool(after.quality.inverted < before.quality.inverted):
                after = replace(after, anew=after.valid).noted({0: _PLACED_ANEW})
                state, kept = state.put(one, after), kept | one
        return state, Work.done(state, kept=kept)

    return stage


def smooth(options: SmoothOptions) -> Stage:
    """Moves the lively vertices until triangles have good shapes; all vertices if none are named, or if some slide."""

    def stage(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        curves = state.curves
        free = state.lively if curves is None else None
        if state.held is not None:
            free = ~state.held if free is None else free & ~state.held
            curves = None if curves is None else curves.holding(state.held, state.mesh.point_offsets)
        towards = replace(_at_interfaces(options, state), targets=state.targets, quad_targets=state.quad_shapes)
        mesh, info = smoothing.smooth(state.mesh, towards, free=free, monitor=monitor, curves=curves)
        if info.curves is not None and state.curves is not None:
            # What was held may slide again in the next stage.
            curves = replace(info.curves, slides=state.curves.slides)
        return replace(state.at(mesh), curves=curves), Work.done(state, iterations=info.iterations)

    return stage


def relocate(options: RemeshOptions, keep_sizes: bool) -> Stage:
    """Lets vertices travel from crowded to empty regions; every row stays.

    keep_sizes  whether the sizes, which travel with the vertices, are kept for the report
    """
    from ..remeshing import relocation

    def stage(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        mesh, info = relocation.relocate(state.mesh, sized(options, state))
        return replace(state.at(mesh), sizes=info.size if keep_sizes else None), Work.done(state, flips=info.flips)

    return stage


def polish(options: polishing.PolishOptions) -> Stage:
    """Improves the worst triangles, each with its neighbourhood."""

    def stage(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        mesh, info = polishing.polish(_holding(state), _at_interfaces(options, state))
        return state.at(replace(mesh, fixed=state.mesh.fixed)), Work.done(state, flips=info.flips)

    return stage


def remove_vertices(options: RemeshOptions) -> Stage:
    """Removes vertices for which a domain has no room between floating-point numbers."""
    from ..remeshing import vertex_removal

    def stage(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        mesh, removed = vertex_removal.remove_vertices(state.mesh, sized(options, state), state.vertex_names)
        edits = replace(Edits.none(state.status), collapses=removed.collapses)
        done = _edited(state, mesh, removed.names, removed.size, removed.metric, edits)
        return done, Work.done(state, cavities=removed.cavities)

    return stage


def remesh(options: RemeshOptions) -> Stage:
    """Splits and collapses edges where that improves the mesh."""
    from ..remeshing import remeshing

    def stage(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        mesh, done = remeshing.remesh_valid(state.mesh, sized(options, state), state.vertex_names)
        edits = Edits(done.splits, done.collapses, done.flips, done.rounds)
        return _edited(state, mesh, done.names, done.size, done.metric, edits), Work.done(state, flips=done.flips)

    return stage


def on_triangles(stage: Stage) -> Stage:
    """Runs `stage`, which knows no quads, on the triangles alone: quads stay, with their vertices."""

    def narrowed(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        if not len(state.mesh.quads):
            return stage(state, monitor)
        some = counts_from_offsets(state.mesh.triangle_offsets) > HALVES * counts_from_offsets(state.mesh.quad_offsets)
        work = Work.done(state)
        if not bool(some.any()):
            return state, work
        part = state.select(some)
        found, done = stage(replace(part, curves=None).at(triangles_alone(part.mesh)), monitor)
        part = part.at(with_triangles_alone(part.mesh, found.mesh))
        part = replace(part, reasons=found.reasons, sizes=found.sizes)
        return state.put(some, part), work.put(some, done)

    return narrowed


def attempt(stage: Stage, origin: Callable[[State], MeshBatch] = lambda state: state.mesh) -> Stage:
    """Runs `stage` from the mesh that `origin` gives, and keeps its result where it has fewer inverted triangles."""

    def attempted(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        found, work = stage(state.at(origin(state)), monitor)
        better = found.quality.inverted < state.quality.inverted
        kept = state.put(better, found.select(better)) if bool(better.any()) else state
        # The reasons are kept where the attempt failed, too, since the report says why.
        return replace(kept, reasons=found.reasons), replace(work, kept=better)

    return attempted


def _at_interfaces(options: Settings, state: State) -> Settings:
    """The options of a step with what was asked for the vertices on interfaces."""
    return replace(options, interfaces=state.origin.interfaces)


def _holding(state: State) -> MeshBatch:
    """The mesh with the vertices fixed that this stage must not move."""
    return state.mesh if state.held is None else replace(state.mesh, fixed=state.mesh.fixed | state.held)


def sized(options: RemeshOptions, state: State) -> RemeshOptions:
    """The options of remeshing with the targets and interfaces of `state`, and with the sizes at its vertices."""
    if state.origin.interfaces == "free":
        options = replace(options, interfaces="free")
    if state.targets is not None:
        options = replace(options, smooth=replace(options.smooth, targets=state.targets))
    if isinstance(options.sizes, torch.Tensor):
        asked = state.origin.sizes
    elif isinstance(options.sizes, str) and options.sizes == "keep" and state.origin.reference is not None:
        asked = size_field(state.origin.reference, "keep")
    else:
        return options
    assert asked is not None
    if state.names is None:
        return replace(options, sizes=state.of_given_vertices(asked))
    return replace(options, sizes=state.names.vertex_map().carry(asked))


def _edited(state: State, mesh: MeshBatch, names: Names, sizes: Tensor, metric: Tensor | None, edits: Edits) -> State:
    """The state with the remeshed `mesh`, and with everything that has rows of vertices renumbered."""
    curves = curves_renumbered(state, mesh, names)
    return replace(
        state.at(mesh),
        names=names,
        edits=edits if state.edits is None else state.edits.plus(edits),
        sizes=sizes,
        targets=state.targets if metric is None else MetricField(metric),
        curves=curves,
    )


def curves_renumbered(state: State, mesh: MeshBatch, names: Names) -> BoundaryCurves | None:
    """The curves of the state for the vertices of `mesh`, which have these names; None: nothing slides."""
    if state.curves is None:
        return None
    row = torch.full((names.fresh,), -1, device=mesh.points.device)
    row[names.of] = torch.arange(len(mesh.points), device=row.device)
    return state.curves.renumbered(row[state.vertex_names.of], state.mesh.point_offsets, mesh.point_offsets)
