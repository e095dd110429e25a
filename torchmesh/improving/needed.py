"""What need not be worked on: meshes within the bound `ImproveOptions.when` come back to the bit.

Triangles that nothing can better do not count: frozen ones, those of layers that are held, and those at boundary
corners that allow no better.
"""

import math
from dataclasses import replace
from typing import NamedTuple

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
    return _but_for_limits(mesh, q, bound, _worse(mesh, q, bound, unchangeable), limits)


def _but_for_limits(
    mesh: MeshBatch, q: Quality, bound: Bound, few: "_Worse", limits: tuple[Tensor, Tensor] | None
) -> Tensor:
    """(T,) bool: the inverted triangles, and those of `few` that are beyond what their boundary allows."""
    bad = few.bad
    if bool(bad.any()):
        limits = limits_of(mesh) if limits is None else limits
        those = replace(mesh, triangles=take(mesh.triangles, few.rows), _twin=None)
        asked, most = asked_of(those, limits, math.radians(bound.angle), bound.ratio, bound.limit_share)
        bad = (few.angle < asked) | (few.ratio > most)
    return (~q.upright).index_put((few.rows,), bad)


class _Worse(NamedTuple):
    """The triangles `rows` (N,) that may be beyond a bound, their angles and ratios, and which are, boundary or not."""

    rows: Tensor
    angle: Tensor
    ratio: Tensor
    bad: Tensor


def _worse(mesh: MeshBatch, q: Quality, bound: Bound, unchangeable: Tensor | None) -> _Worse:
    t = math.radians(bound.angle)
    # In triangles of a lower ratio than any with that angle has, no angle need be measured.
    least = min(least_ratio(t), bound.ratio) if t else bound.ratio
    worse = q.upright & (q.inverse_mean_ratio > least)
    if unchangeable is not None:
        worse &= ~unchangeable
    rows = true_rows(worse)
    angle, ratio = smallest_angles(mesh, rows), take(q.inverse_mean_ratio, rows)
    return _Worse(rows, angle, ratio, (angle < t) | (ratio > bound.ratio))


def meshes_beyond(mesh: MeshBatch, q: Quality, bound: Bound, unchangeable: Tensor | None = None) -> Tensor:
    """(B,) bool: the meshes with triangles `beyond` the bound; arguments as there."""
    few = _worse(mesh, q, bound, unchangeable)
    if not bool(few.bad.any()):
        return segment_any(~q.upright, mesh.triangle_offsets)
    boundary = torch.zeros_like(mesh.fixed)
    # What the boundary allows matters at the boundary alone, and takes longer to find out.
    boundary[mesh.triangles.reshape(-1)[mesh.twin < 0]] = True
    away = few.bad & ~boundary[take(mesh.triangles, few.rows)].any(1)
    surely, perhaps = (
        segment_any((~q.upright).index_put((few.rows,), some), mesh.triangle_offsets) for some in (away, few.bad)
    )
    if torch.equal(surely, perhaps):
        return surely
    return segment_any(_but_for_limits(mesh, q, bound, few, None), mesh.triangle_offsets)


def limits_of(mesh: MeshBatch) -> tuple[Tensor, Tensor]:
    """What the boundary of a whole mesh allows at its vertices: `fan_limits`."""
    return fan_limits(mesh, torch.ones_like(mesh.fixed))


def where_needed(job: Job, options: ImproveOptions) -> Job:
    """The job that does `job` on the meshes beyond `options.when`; the others end as they are."""
    bound = options.when
    if bound is None:
        return job

    def work(state: State, log: Log) -> State:
        rest = state.running & ~meshes_beyond(state.mesh, state.quality, bound, state.unchangeable)
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
