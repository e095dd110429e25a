"""How far vertices go, in local widths, and the tether that holds those of valid meshes near.

   o - - given position
  / \\      The local width is the mean length of the edges at a vertex in the mesh as given.  A vertex of a mesh
(  o  )     that came valid stays within one local width of where it was, or within `ImproveOptions.max_motion`: a
  \\ /      stage that would take some further is run again with these vertices held at the end of their tether.
   -
"""

from dataclasses import replace

import torch
from torch import Tensor

from ..mesh.ragged import (
    counts_from_offsets,
    offsets_from_counts,
    percentiles,
    segment_any,
    segment_count,
    spread,
)
from ..optimising.moves import Monitor
from .options import ImproveOptions
from .report import Travel
from .runner import Stage, Work
from .state import State

# How often a stage is run again before the meshes in which vertices still go too far stay as they were before it.
_TRIES = 6


def travel_of(state: State) -> Travel:
    """How far the vertices of the meshes are from where they were given."""
    if state.names is None and torch.equal(state.mesh.points, state.given.points):
        return Travel(*torch.zeros(3, len(state), dtype=torch.float64, device=state.meshes.device))
    given, widths = state.given, state.widths
    row = torch.arange(len(given.points), device=widths.device)
    if state.names is not None:
        row = state.of_given_vertices(state.names.vertex_map().old_to_new)
    counts = (row >= 0) & (widths > 0) & ~state.of_given_vertices(state.origin.stays)
    far = torch.where(counts, _in_widths(given.points, state.mesh.points[row.clamp_min(0)], widths), 0.0)
    offsets = offsets_from_counts(segment_count(counts, given.point_offsets))
    some = counts_from_offsets(offsets) > 0
    columns = torch.zeros(len(state), 3, dtype=torch.float64, device=far.device)
    if len(state) and bool(some.any()):
        filled = offsets_from_counts(counts_from_offsets(offsets)[some])
        columns[some] = percentiles(far[counts], filled, (50, 95, 100))
    return Travel(*columns.unbind(1))


def tethered(stage: Stage) -> Stage:
    """`stage`, but the vertices of meshes that are tethered stay within some local widths of where they were given."""

    def stage_on_a_tether(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        done, work = stage(state, monitor)
        if not bool(state.tethered.any()):
            return done, work
        given, widths, before = state.anchors, state.widths, None
        held = torch.zeros_like(state.mesh.fixed)
        for turn in range(_TRIES + 1):
            far = _in_widths(given, done.mesh.points, widths)
            too_far = far > state.origin.tether
            if bool(too_far.any()) and before is None:
                before = _in_widths(given, state.mesh.points, widths)
            # What was further away before the stage, as in a mesh that came tangled, may only come nearer.
            too_far &= far > (before if before is not None else 0.0)
            too_far &= spread(state.tethered, state.mesh.point_offsets)
            again = segment_any(too_far, state.mesh.point_offsets)
            if not bool(again.any()):
                break
            if turn == _TRIES:
                return done.put(again, state.select(again)), work
            held |= too_far
            start = _at_the_end_of_the_tether(state, done, too_far, torch.where(too_far, far, 1.0), before)
            short, more = stage(replace(start, held=held).select(again), monitor)
            done, work = done.put(again, replace(short, held=None)), work.plus(more.over(again))
        return done, work

    return stage_on_a_tether


def _at_the_end_of_the_tether(state: State, done: State, too_far: Tensor, far: Tensor, before: Tensor | None) -> State:
    """`done` with the vertices that went `too_far` (V,) bool at the end of their tether, on their way.

    Meshes in which that would invert a triangle are as they were before the stage.
    """
    limit = torch.full_like(far, state.origin.tether) if before is None else before.clamp_min(state.origin.tether)
    share = torch.where(too_far, (1 - 1e-3) * limit / far, 1.0)[:, None]
    # Where a vertex of a mesh that came tangled was further away before, this is where it was, or nearer.
    points = torch.lerp(state.anchors.to(torch.float64), done.mesh.points.to(torch.float64), share)
    points = torch.where(too_far[:, None], points, done.mesh.points.to(torch.float64))
    begun = _on_the_curves(done.at(done.mesh.with_points(points)), too_far, share[:, 0])
    bad = ~begun.valid
    return begun.put(bad, state.select(bad)) if bool(bad.any()) else begun


def _on_the_curves(state: State, too_far: Tensor, share: Tensor) -> State:
    """`state` with the vertices `too_far` (V,) bool that slide at this `share` (V,) of their way along their curves."""
    curves, offsets = state.curves, state.mesh.point_offsets
    if curves is None:
        return state
    rows = curves.rows(offsets)
    back = too_far[rows] & curves.slides
    if not bool(back.any()):
        return state
    from ..smoothing.sliding import on_the_curves

    s = curves.at_knot + torch.where(back, share[rows], 1.0) * (curves.parameter - curves.at_knot)
    s = curves.moved_to(torch.where(back, s, curves.parameter)[curves.slides])
    points = on_the_curves(state.mesh, curves, s, back)
    return replace(state.at(state.mesh.with_points(points)), curves=replace(curves, parameter=s))


def tied(state: State, o: ImproveOptions) -> State:
    """The state in which meshes that have become valid are tethered, too, if `max_motion` is given."""
    return state if o.max_motion is None else replace(state, tethered=state.tethered | state.valid)


def _in_widths(before: Tensor, after: Tensor, widths: Tensor) -> Tensor:
    """(V,) the distances from `before` to `after`, both (V, 2), in local widths; infinite where there is no width."""
    way = (after.to(torch.float64) - before.to(torch.float64)).norm(dim=1)
    return torch.where(way > 0, way / widths, 0.0)
