"""Rounds of remeshing: edges are split and collapsed, flipped, and vertices smoothed, until little changes.

    sizes --> cut --> flips --> smooth --> sizes where the vertices are now --+--> last smoothing
               ^                                                              |
               +----- while enough edges change and the shapes get better ----+

The kinds of remeshing differ in how a cut is made, where sizes come from, how the end is reached, and how
thorough they are: a `Plan` says so.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import torch
from torch import Tensor

from ..flipping.delaunay import FlipOptions, flip_to_delaunay
from ..mesh.batch import MeshBatch
from ..optimising.metric_field import MetricField
from ..smoothing.smoothing import SmoothOptions, smooth
from .cuts import Limits
from .metric_sizing import metric_size_field
from .options import RemeshOptions
from .sizing import Sizes, size_field
from .state import RemeshState

# Splits and collapses of one round: the state after them, and how many edges of each mesh changed (B,) int64.
Cut: TypeAlias = Callable[[RemeshState, Limits], tuple[RemeshState, Tensor]]

# The state with its vertices at the positions of the batch, and the sizes wanted there.
Resize: TypeAlias = Callable[[RemeshState, MeshBatch], RemeshState]


@dataclass(frozen=True)
class Pace:
    """How thorough remeshing is.  Inverse mean ratios are 1 for an ideal triangle.

    between       the smoothing between two cuts
    good          a mean inverse mean ratio; a mesh above it is shaken
    shakes        pairs of lengths relative to the size wanted.  Rows of right-angled triangles fit their sizes, and
                  no single split or collapse betters them.  A mesh above the mean `good` is therefore cut once with
                  each pair in place of `collapse_below` and `split_above`, and goes through the rounds again; the
                  better result is kept
    over_ceiling  what came of a shake may have a maximum of this many times the ceiling of the last smoothing,
                  which brings it below; one more airfoil so ended below a mean of 1.03
    few           rounds end when fewer than one edge changed for so many triangles
    few_when_good  the same where the mean is at most `good`; None: the same as `few`
    gain_mean     rounds end when the mean fell by less than this
    gain_of_mean  or by less than this part of its excess over 1
    gain_max      and the maximum by less than this part of itself
    last_rounds   rounds of flips and smoothing before the last smoothing at most, while edges flip
    last_iterations  iterations of each of these smoothings at most
    looser        the last smoothing ends at so many times its energy tolerance
    work          bound of the work on a mesh, in triangles: its rounds in all, those after shakes among them, times the
                  sum of its triangles and `overhead`; None: no bound
    overhead      a round of a small mesh takes as long as a larger mesh's triangles by this number (measured: half of
                  the time of a round on 1,700 triangles does not depend on their number)
    least_rounds  so many rounds a mesh has whatever its size
    last_steps    iterations of the last smoothing at most, where rows stay; None: as many as its options say
    accuracy      how accurately the sizes of the boundary are continued inwards (`InwardOptions.accuracy`)
    slack         where the mean falls, the maximum may become this many times as high: it hangs on one triangle
    """

    between: SmoothOptions
    good: float
    shakes: tuple[tuple[float, float], ...]
    over_ceiling: float = 1.07
    few: int = 500
    few_when_good: int | None = None
    gain_mean: float = 1e-4
    gain_of_mean: float = 1e-3
    gain_max: float = 1e-3
    last_rounds: int = 5
    last_iterations: int = 20
    looser: float = 1.0
    work: int | None = None
    overhead: int = 1750
    least_rounds: int = 4
    last_steps: int | None = None
    accuracy: float | None = None
    slack: float = 1.02


@dataclass(frozen=True, eq=False)
class Plan:
    """A kind of remeshing.

    options  what was asked of it
    pace     how thorough it is
    cut      makes the splits and collapses of one round
    resize   puts the vertices to other positions, with the sizes wanted there
    finish   the last flips and smoothing
    """

    options: RemeshOptions
    pace: Pace
    cut: Cut
    resize: Resize
    finish: Callable[[RemeshState, "Plan"], RemeshState]


def remesh_by_plan(state: RemeshState, plan: Plan) -> RemeshState:
    """The whole course: rounds, shakes, and the end."""
    return plan.finish(_shaken(_rounds(state, plan), plan), plan)


def asked_sizes(
    batch: MeshBatch, sizes: Sizes, metric: Tensor | None, wanted: Tensor, accuracy: float | None = None
) -> Tensor:
    """(V,) float64 the sizes asked for at the vertices of `batch`, which aim at `wanted` (B,) triangles.

    metric  (V, 3) in which they are lengths; None: that of the plane
    """
    if metric is None:
        return size_field(batch, sizes, triangles=wanted, accuracy=accuracy)
    return metric_size_field(batch, sizes, metric, wanted)


def metric_at(batch: MeshBatch, options: RemeshOptions) -> Tensor | None:
    """(V, 3) the metric that the options name, at the vertices of `batch`; None: they name none."""
    targets = options.smooth.targets
    return targets.at_vertices(batch) if isinstance(targets, MetricField) else None


def settle(state: RemeshState, plan: Plan, smoothing: SmoothOptions) -> RemeshState:
    """Flip edges, smooth, and read the sizes where the vertices are then."""
    metric = None if state.metric is None else MetricField(state.metric)
    flipped, info = flip_to_delaunay(state.batch, FlipOptions(rule="shape"), metric=metric)
    state = replace(state, batch=flipped, flips=state.flips + info.flips)
    return plan.resize(state, smoothed(state, smoothing))


def smoothed(state: RemeshState, smoothing: SmoothOptions) -> MeshBatch:
    """The batch of the state after smoothing towards its metric, with its interfaces free if the state says so."""
    metric = None if state.metric is None else MetricField(state.metric)
    interfaces = "free" if state.free_interfaces else smoothing.interfaces
    return smooth(state.batch, replace(smoothing, targets=metric, interfaces=interfaces))[0]


def settle_once(state: RemeshState, plan: Plan) -> RemeshState:
    """An end for meshes that keep their rows: flip, and smooth to `looser` times the tolerance."""
    smoothing, pace = plan.options.smooth, plan.pace
    most = smoothing.max_iterations if pace.last_steps is None else min(pace.last_steps, smoothing.max_iterations)
    tolerance = pace.looser * smoothing.energy_tolerance
    return settle(state, plan, replace(smoothing, energy_tolerance=tolerance, max_iterations=most))


def improved(state: RemeshState, plan: Plan) -> RemeshState:
    """The state after remeshing by the plan, with what made the shapes of a mesh worse taken back.

    The mean inverse mean ratio may not grow, nor the maximum by more than the slack, unless it stays below the
    ceiling of the smoothing.  With sizes that the user asked for, it is enough if no triangle is worse than the
    worst there was, or than `options.worst`.
    """
    options, before = plan.options, state.quality()
    done = remesh_by_plan(state, plan)
    after = done.quality()
    if options.sizes_asked:
        good = after.max <= before.max.clamp_min(options.worst)
    else:
        highest = (plan.pace.slack * before.max).clamp_min(options.smooth.ceiling or 1.0)
        good = (after.mean <= before.mean) & (after.max <= highest)
    return done.taken_back(~(good & (after.inverted <= before.inverted)), state)


def _rounds(state: RemeshState, plan: Plan) -> RemeshState:
    """Cut and settle in turn, until hardly an edge changes or the shapes no longer gain."""
    before, pace = state.quality(), plan.pace
    going = _has_rounds_left(state, pace)
    for turn in range(plan.options.max_rounds):
        if not bool(going.any()):
            break
        part, edges = plan.cut(state.select(going), Limits.of(plan.options))
        part = settle(part, plan, pace.between)
        state = state.put(going, replace(part, rounds=part.rounds + 1))
        now = state.quality()
        changed = torch.zeros_like(state.rounds).masked_scatter(going, edges)
        few = pace.few * changed <= state.triangles
        if pace.few_when_good is not None:
            few |= (now.mean <= pace.good) & (pace.few_when_good * changed <= state.triangles)
        least = (pace.gain_of_mean * (before.mean - 1)).clamp_min(pace.gain_mean)
        stuck = (before.mean - now.mean < least) & (before.max - now.max < pace.gain_max * now.max)
        going = going & ~few & ~(stuck & (turn > 0)) & _has_rounds_left(state, pace)
        before = now
    return state


def _has_rounds_left(state: RemeshState, pace: Pace) -> Tensor:
    """(B,) bool: the mesh has had fewer rounds than the pace allows."""
    if pace.work is None:
        return state.every()
    return state.rounds < (pace.work // (state.triangles + pace.overhead)).clamp_min(pace.least_rounds)


def _shaken(state: RemeshState, plan: Plan) -> RemeshState:
    """Change more edges in the meshes whose mean is still high, start again from there, and keep what is better."""
    pace, options = plan.pace, plan.options
    ceiling = pace.over_ceiling * (options.smooth.ceiling or 1.0)
    for short, long in pace.shakes:
        before = state.quality()
        rough = (before.mean > pace.good) & (state.rounds > 0) & _has_rounds_left(state, pace)
        if not bool(rough.any()):
            break
        given = state.select(rough)
        limits = Limits(short, long, longest=2 * options.split_above, worst=options.worst)
        tried = _rounds(settle(plan.cut(given, limits)[0], plan, pace.between), plan)
        after, mean, worst = tried.quality(), before.mean[rough], before.max[rough]
        worse = (after.mean >= mean) | (after.max > worst.clamp_min(ceiling))
        state = state.put(rough, tried.taken_back(worse, given))
    return state
