"""What a mesh that came valid has gained: if too little, it comes back to the bit, so that `improve` is idempotent."""

import math
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from ..mesh.measure import shapes
from ..mesh.ragged import counts_from_offsets, segment_count, segment_max, segment_min, segment_sum, true_rows
from ..optimising.moves import Monitor
from ..optimising.targets import target_quality
from ..smoothing.polishing import PolishOptions, bad_triangles
from ..status import Status
from .faults import taken_back
from .options import ImproveOptions
from .runner import Runner, Stage, Work
from .state import State
from .step_options import LeastGain


def without_little_gains(state: State, run: Runner, o: ImproveOptions) -> State:
    """The meshes that came valid, and have not gained what is asked, are as they were given."""
    assert o.least_gain is not None
    at = (state.inverted_given == 0) & (state.status == Status.SETTLED)
    if not bool(at.any()):
        return state
    begun, done = state.select(at), state.select(at)
    little = ~gained(begun.at(begun.given), done, o.least_gain, o.polish or PolishOptions())
    return taken_back(state, run, at.index_put((true_rows(at),), little))


def where_it_pays(stage: Stage, least: LeastGain, polish: PolishOptions) -> Stage:
    """Runs `stage`, and keeps its result where the mesh has gained at least so much."""

    def paying(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        found, work = stage(state, monitor)
        better = gained(state, found, least, polish)
        kept = state.put(better, found.select(better)) if bool(better.any()) else state
        return kept, replace(work, kept=better)

    return paying


def gained(before: State, after: State, least: LeastGain, polish: PolishOptions) -> Tensor:
    """(B,) bool: the meshes of `after` are better than `before` by at least one of the gains."""
    old, new = _measured(before, polish), _measured(after, polish)
    mean = old.mean - new.mean > least.mean * (old.mean - 1)
    largest = (old.max > polish.ratio) & (old.max - new.max > least.max * (old.max - 1))
    wider = (old.angle < polish.angle) & (new.angle - old.angle > least.angle)
    return mean | largest | wider | (new.bad < old.bad)


class _Measured(NamedTuple):
    """What gains are measured by, per mesh (B,): `mean` and `max` of the ratios, `angle` in degrees, `bad` triangles.

    Where shapes other than equilateral ones are the aim, the ratios are those that these see, and nothing else counts.
    """

    mean: Tensor
    max: Tensor
    angle: Tensor
    bad: Tensor


def _measured(state: State, polish: PolishOptions) -> _Measured:
    offsets = state.mesh.triangle_offsets
    if state.targets is not None:
        ratio = target_quality(state.mesh, state.targets)
        mean, largest = segment_sum(ratio, offsets) / counts_from_offsets(offsets), segment_max(ratio, offsets)
        return _Measured(mean, largest, torch.full_like(mean, torch.inf), torch.zeros_like(state.status))
    q = state.judged
    every = shapes(state.mesh)[0]
    if state.unchangeable is not None:
        every = torch.where(state.unchangeable, torch.pi / 3, every)
    angle = segment_min(every, offsets) * (180 / math.pi)
    bad = bad_triangles(state.mesh, q, polish)
    return _Measured(q.mean, q.max, angle, segment_count(bad, offsets))
