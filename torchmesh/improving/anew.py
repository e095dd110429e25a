"""Topology "full" where nothing binds the inside of a mesh: it is made anew in place of being untangled.

A mesh that is tangled, or valid but poor, gets new vertices on a front that starts from its boundary
(`remeshing.anew`).  Its boundary must allow that: it may not cross, touch or lie over itself.  Everything else goes the
way of splits and collapses: where vertices slide, layers or shapes are held, a metric or sizes of vertices are aimed
at, and meshes that are good as they are.  `report.steps` names the stage "anew" where it was taken, `kept` false where
the boundary did not allow it.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..mesh.batch import constraint_owner
from ..mesh.certificate import euler_numbers, same_regions
from ..mesh.ragged import counts_from_offsets, segment_any
from ..optimising.moves import Monitor
from ..status import Status
from .columns import Edits
from .ending import certify, compare_sizes
from .needed import beyond
from .options import ImproveOptions
from .runner import Job, Log, Runner, Stage, Work
from .stages import curves_renumbered
from .state import State
from .step_options import Bound
from .strategies import slide


@dataclass(frozen=True)
class AnewLimits:
    """Which valid meshes are poor enough to be made anew, and what of the result is worked on further.

    mean    meshes of a higher mean inverse mean ratio are made anew; splits and collapses come to about this one
    max     and those with a higher maximum
    slack   a valid mesh may get a maximum that is so many times as high, if its mean falls
    doubt   where the mean is higher than this after all, or the maximum than `max` though the boundary allows less,
            splits and collapses are tried, too
    far_off  the same where a function asks for sizes, which come before shapes: boundary edges whose lengths are far
             from these sizes force such a mean
    worst   the result of splits and collapses is taken where its mean is lower, or its maximum by this factor.  This
            was so for 9 of 2,200 small random tangles, nearly all of them of about 110 triangles
    """

    mean: float = 1.03
    max: float = 1.9
    slack: float = 1.02
    doubt: float = 1.06
    far_off: float = 1.3
    worst: float = 1.25


def can_be_made_anew(options: ImproveOptions) -> bool:
    """Whether the options leave the inside of any mesh free to be made anew."""
    remesh = options.remesh
    by_vertex = isinstance(remesh.sizes, torch.Tensor) or (isinstance(remesh.sizes, str) and remesh.sizes == "keep")
    shaped = options.smooth.targets is not None or remesh.smooth.targets is not None
    return options.topology == "full" and options.scope == "all" and not (shaped or by_vertex or remesh.split_boundary)


def making_anew(job: Job, options: ImproveOptions, limits: AnewLimits | None = None) -> Job:
    """The job that makes meshes anew where it can, and does `job` on the others."""
    limits = limits or AnewLimits()

    def done(state: State, log: Log) -> State:
        at = _served(state, options, limits)
        if not bool(at.any()):
            return job(state, log)
        after, work = Runner(log)("anew", _stage(options, limits), state, at)
        made = at & work.kept & work.took
        if not bool(made.any()):
            return job(replace(state, failures=after.failures), log)
        doubtful = made & _doubtful(after, options, limits)
        others = ~made | doubtful
        if not bool(others.any()):
            return _finished(after, made, log, options)
        # The others go their way as if they were alone, so their vertices do not know yet of those that have come here.
        begun = replace(state, failures=after.failures)
        if bool(doubtful.any()):
            log.mark("given", state, doubtful, kept=False)
        rest = job(begun.select(others), log.of_meshes(state.mesh, others))
        whole = state.put(others, rest)
        poorer = (whole.quality.mean >= after.quality.mean) & (limits.worst * whole.quality.max >= after.quality.max)
        chosen = made & (~doubtful | ~whole.valid | poorer)
        part = _finished(after, chosen, log, options) if bool(chosen.any()) else None
        if part is None:
            return whole
        whole = whole.put(chosen, replace(part, names=part.vertex_names.after(rest.vertex_names)))
        if bool((chosen & doubtful).any()):
            log.mark("anew", whole, chosen & doubtful)
        return whole

    return done


def _doubtful(state: State, options: ImproveOptions, limits: AnewLimits) -> Tensor:
    """(B,) bool: the meshes that were made anew and for which splits and collapses may do better."""
    if callable(options.remesh.sizes):
        # How well edges follow the sizes that are asked for comes before shapes, where the boundary can follow at all.
        return state.quality.mean > limits.far_off
    bad = beyond(state.mesh, state.quality, Bound(ratio=limits.max), state.unchangeable)
    return (state.quality.mean > limits.doubt) | segment_any(bad, state.mesh.triangle_offsets)


def _served(state: State, options: ImproveOptions, limits: AnewLimits) -> Tensor:
    """(B,) bool: the meshes that nothing binds, and that are worth it."""
    nothing = torch.zeros_like(state.valid)
    if state.targets is not None or not state.mesh.points.is_cpu:
        return nothing
    offsets = state.mesh.triangle_offsets
    poor = (state.quality.mean > limits.mean) | (state.quality.max > limits.max)
    at = state.running & (~state.valid | poor) & (counts_from_offsets(offsets) > 0)
    at = at & (counts_from_offsets(state.mesh.quad_offsets) == 0)
    if state.origin.layers is not None:
        at = at & ~segment_any(state.of_given_vertices(state.origin.layers), state.given.point_offsets)
    if state.held is not None:
        at = at & ~segment_any(state.held, state.mesh.point_offsets)
    if state.origin.interfaces == "free":
        at = at & ~nothing.index_fill_(0, constraint_owner(state.mesh), True)
    return at


def _stage(options: ImproveOptions, limits: AnewLimits) -> Stage:
    """Makes meshes anew, and keeps what is valid and no worse."""
    from ..remeshing.anew import AnewOptions, mesh_anew

    remesh, how = options.remesh, AnewOptions()
    how = how if options.polish is not None else replace(how, polish=None)

    def stage(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        found = mesh_anew(state.mesh, remesh, state.vertex_names, how)
        none = torch.zeros_like(state.status)
        if found is None:
            return state, Work.done(state, kept=none > 0)
        part = state.select(found.made)
        edits = Edits(found.inserted, found.removed, found.flips, torch.ones_like(found.flips))
        curves = curves_renumbered(part, found.batch, found.names)
        part = replace(part.at(found.batch), names=found.names, edits=edits, sizes=found.size, curves=curves)
        before = state.quality
        highest = (limits.slack * before.max[found.made]).clamp_min(remesh.smooth.ceiling or 1.0)
        better = (part.quality.mean <= before.mean[found.made]) & (part.quality.max <= highest)
        good = part.valid & (better | ~state.valid[found.made])
        # A mesh with a handle has a boundary like others, but no mesh of the plane has its Euler number.
        good = good & (euler_numbers(part.mesh, part.mesh.twin) == euler_numbers(part.given, part.given.twin))
        # Where a hole has gone over a fixed vertex or out of its region, the boundary alone is another domain's.
        good = good & same_regions(part.given, part.mesh, part.own_map.old_to_new)
        kept = found.made.masked_scatter(found.made, good)
        flips, iterations = (none.masked_scatter(found.made, n) for n in (found.flips, found.iterations))
        work = Work.done(state, flips=flips, iterations=iterations, kept=kept)
        return (state.put(kept, part.select(good)) if bool(good.any()) else state), work

    return stage


def _finished(after: State, made: Tensor, log: Log, options: ImproveOptions) -> State:
    """The meshes `made` (B,) bool of the state, which were made anew, at their end."""
    state = after if bool(made.all()) else after.select(made)
    state, run = state.ended(state.valid, Status.SETTLED), Runner(log.of_meshes(after.mesh, made))
    for step in (*([slide] if options.slides else []), compare_sizes, certify):
        state = step(state, run, options)
    return state
