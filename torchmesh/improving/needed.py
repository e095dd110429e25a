"""What need not be worked on: meshes within the bound `ImproveOptions.when` come back to the bit.

Triangles that nothing can better do not count: frozen ones, those of layers that are held, and those at boundary
corners that allow no better.
"""

import math
from dataclasses import replace

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.measure import Quality, smallest_angles
from ..mesh.ragged import segment_any, take, true_rows
from ..mesh.triangle import least_ratio
from ..smoothing.boundary_limits import asked_of, fan_limits
from ..status import Status
from .ending import compare_sizes
from .options import ImproveOptions
from .runner import Job, Log, Runner
from .state import State
from .step_options import Bound


def beyond(
    mesh: MeshBatch,
    q: Quality,
    bound: Bound,
    unchangeable: Tensor | None = None,
    limits: tuple[Tensor, Tensor] | None = None,
) -> Tensor:
    """(T,) bool: the triangles that are beyond the bound; inverted ones are.

    q             the quality of the mesh
    unchangeable  (T,) bool, upright triangles that do not count
    limits        what the boundary allows at each vertex; None: `fan_limits` of the mesh
    """
    t = math.radians(bound.angle)
    # In triangles of a lower ratio than any with that angle has, no angle need be measured.
    least = min(least_ratio(t), bound.ratio) if t else bound.ratio
    worse = q.upright & (q.inverse_mean_ratio > least)
    if unchangeable is not None:
        worse &= ~unchangeable
    rows = true_rows(worse)
    if not len(rows):
        return ~q.upright
    angle = smallest_angles(mesh, rows)
    ratio = take(q.inverse_mean_ratio, rows)
    bad = (angle < t) | (ratio > bound.ratio)
    if bool(bad.any()):
        limits = limits_of(mesh) if limits is None else limits
        few = replace(mesh, triangles=take(mesh.triangles, rows), _twin=None)
        asked, most = asked_of(few, limits, t, bound.ratio, bound.limit_share)
        bad = (angle < asked) | (ratio > most)
    return (~q.upright).index_put((rows,), bad)


def limits_of(mesh: MeshBatch) -> tuple[Tensor, Tensor]:
    """What the boundary of a whole mesh allows at its vertices: `fan_limits`."""
    return fan_limits(mesh, torch.ones_like(mesh.fixed))


def where_needed(job: Job, options: ImproveOptions) -> Job:
    """The job that does `job` on the meshes beyond `options.when`; the others end as they are."""
    bound = options.when
    if bound is None:
        return job

    def work(state: State, log: Log) -> State:
        bad = beyond(state.mesh, state.quality, bound, state.unchangeable)
        rest = state.running & ~segment_any(bad, state.mesh.triangle_offsets)
        if not bool(rest.any()):
            return job(state, log)
        done = state
        if not bool(rest.all()):
            done = done.put(~rest, job(state.select(~rest), log.of_meshes(done.mesh, ~rest)))
        part = state.select(rest).naming_after(done)
        note = dict.fromkeys(range(len(part)), "; within the bound, and all is as it was given")
        part = part.noted(note).ended(part.running, Status.VALID)
        # What is as it was given has the frame that was given.
        part = replace(part, certified=part.valid)
        return done.put(rest, compare_sizes(part, Runner(log.of_meshes(done.mesh, rest)), options))

    return work
