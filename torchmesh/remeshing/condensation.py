"""Vertices for which a coarse boundary has no room, condensed round the points where there is most room.

A boundary's edges may be so long that the vertices inside, spread evenly, make needles along all of it.  Sizes
that grow from a few point sources take up any number of vertices (`point_sources`); vertices travel towards
them as in relocation.
"""

from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch, put
from ..mesh.measure import quality
from ..smoothing.smoothing import SmoothOptions
from .criteria import GOOD_MEAN
from .cuts import PairOptions, cut_in_pairs
from .options import RemeshOptions
from .point_sources import SourceOptions, place_sources, share_with_room
from .rounds import Pace, Plan, metric_at, remesh_by_plan, settle_once
from .sizing import scaled_to_fit
from .state import RemeshState

# As thorough as remeshing: few meshes are condensed, and on them it pays.
PACE = Pace(
    between=SmoothOptions(max_iterations=15, energy_tolerance=1e-3, single=True),
    good=GOOD_MEAN,
    shakes=((0.9, 1.3),),
    few_when_good=30,
    looser=5,
    # Without bounds, and after a relocation, maps onto letters and spirals took 20 to 30 rounds.  With them they take a
    # third of the time, and their means are higher by 0.01 on average (experiments/quality/boundary_spacing.py).
    work=18_000,
    least_rounds=5,
    last_steps=60,
)
PAIRS = PairOptions(worth=0.0)


@dataclass(frozen=True)
class CondenseOptions:
    """How `condense` works.  With these values maps onto letters ended at means of 1.1 to 1.2, without at 1.2 to 1.7.

    mean     meshes of a higher mean inverse mean ratio are condensed: their shapes are worth more than even sizes
    room     if the sizes of the boundary have room for no more than this part of their triangles.  Letters with room
             for two thirds gained nothing, maps with room for less than a third much
    slack    a result with a lower mean is taken if its maximum is at most this many times the maximum before
    passes   how often vertices travel and the sizes are asked for where they are then
    gain     another pass follows only where the excess of the mean over 1 fell by this part
    sources  where the point sources are, and how sizes grow from them
    """

    mean: float = 1.12
    room: float = 0.4
    slack: float = 1.3
    passes: int = 2
    gain: float = 0.02
    sources: SourceOptions = field(default_factory=SourceOptions)


@dataclass(frozen=True, eq=False)
class Condensed:
    """What `condense` did, per mesh (B,).

    done    bool, the mesh was condensed
    flips   int64, edges flipped
    rounds  int64, rounds of cuts, also of meshes that came back as they were
    """

    done: Tensor
    flips: Tensor
    rounds: Tensor


def condense(
    batch: MeshBatch, remesh: RemeshOptions, options: CondenseOptions | None = None
) -> tuple[MeshBatch, Condensed]:
    """Condense vertices in the valid meshes whose boundary is too coarse for them.

    Number and order of vertices and triangles stay.  A mesh whose mean inverse mean ratio this does not lower,
    or for which `remesh` asks for sizes, comes back as it was.
    """
    options = options or CondenseOptions()
    q = quality(batch)
    at = (q.inverted == 0) & (q.mean > options.mean)
    none = torch.zeros_like(q.inverted)
    if not remesh.sizes_asked and bool(at.any()):
        at = at.masked_scatter(at, share_with_room(batch.select(at)) <= options.room)
    if remesh.sizes_asked or not bool(at.any()):
        return batch, Condensed(torch.zeros_like(at), none, none)
    state, better = _condensed(batch.select(at), remesh, options)
    flips, rounds = (none.masked_scatter(at, n) for n in (torch.where(better, state.flips, 0), state.rounds))
    return put(batch, at, state.batch), Condensed(torch.zeros_like(at).masked_scatter(at, better), flips, rounds)


def _condensed(batch: MeshBatch, remesh: RemeshOptions, options: CondenseOptions) -> tuple[RemeshState, Tensor]:
    """The state after as many passes as help, and which meshes became better (B,) bool."""
    plan = Plan(
        remesh,
        PACE,
        cut=lambda state, limits: cut_in_pairs(state, limits, PAIRS),
        resize=_with_sizes,
        finish=settle_once,
    )
    state = RemeshState.begin(
        batch,
        torch.ones(len(batch.points), dtype=torch.float64, device=batch.points.device),
        metric=metric_at(batch, remesh),
        sources=place_sources(batch, options.sources),
        interfaces=remesh.interfaces,
    )
    going, better = state.every(), ~state.every()
    for _ in range(options.passes):
        given = state.select(going)
        given = _with_sizes(given, given.batch)
        done = remesh_by_plan(given, plan)
        before, after = quality(given.batch), quality(done.batch)
        good = (after.mean < before.mean) & (after.max <= options.slack * before.max) & (after.inverted == 0)
        state = state.put(going, done.taken_back(~good, given))
        better = better | torch.zeros_like(going).masked_scatter(going, good)
        more = good & (before.mean - after.mean > options.gain * (before.mean - 1))
        going = going.masked_scatter(going, more)
        if not bool(going.any()):
            break
    return state, better


def _with_sizes(state: RemeshState, moved: MeshBatch) -> RemeshState:
    """The state with its vertices as in `moved`, and the sizes of the point sources there."""
    assert state.sources is not None
    return replace(state, batch=moved, size=scaled_to_fit(moved, state.sources.sizes(moved)))
