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
from .point_sources import SourceOptions, place_sources
from .rounds import Pace, Plan, metric_at, remesh_by_plan, settle_once
from .sizing import scaled_to_fit
from .state import RemeshState

# As thorough as remeshing: few meshes are condensed, and on them it pays.
PACE = Pace(
    between=SmoothOptions(max_iterations=15, energy_tolerance=1e-3, single=True),
    good=GOOD_MEAN,
    shakes=((0.9, 1.3),),
    few_when_good=30,
)
PAIRS = PairOptions(worth=0.0)


@dataclass(frozen=True)
class CondenseOptions:
    """How `condense` works.  With these values maps onto letters ended at means of 1.1 to 1.2, without at 1.2 to 1.7.

    mean     meshes of a higher mean inverse mean ratio are condensed: their shapes are worth more than even sizes
    slack    a lower mean is worth a maximum that is this many times as high
    passes   how often vertices travel and the sizes are asked for where they are then
    sources  where the point sources are, and how sizes grow from them
    """

    mean: float = 1.12
    slack: float = 1.3
    passes: int = 2
    sources: SourceOptions = field(default_factory=SourceOptions)


def condense(
    batch: MeshBatch, remesh: RemeshOptions, options: CondenseOptions | None = None
) -> tuple[MeshBatch, Tensor]:
    """Condense vertices in the valid meshes whose boundary is too coarse for them; the batch, and the flips (B,).

    Number and order of vertices and triangles stay.  A mesh whose mean inverse mean ratio this does not lower,
    or for which `remesh` asks for sizes, comes back as it was.
    """
    options = options or CondenseOptions()
    q = quality(batch)
    at = (q.inverted == 0) & (q.mean > options.mean)
    flips = torch.zeros_like(q.inverted)
    if remesh.sizes_asked or not bool(at.any()):
        return batch, flips
    state, better = _condensed(batch.select(at), remesh, options)
    flips[at] = torch.where(better, state.flips, 0)
    return put(batch, at, state.batch), flips


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
    )
    going, better = state.every(), ~state.every()
    for _ in range(options.passes):
        given = state.select(going)
        given = _with_sizes(given, given.batch)
        done = remesh_by_plan(given, plan)
        before, after = quality(given.batch), quality(done.batch)
        good = (after.mean < before.mean) & (after.max <= options.slack * before.max) & (after.inverted == 0)
        state = state.put(going, done.taken_back(~good, given))
        going = going.masked_scatter(going, good)
        better = better | going
        if not bool(going.any()):
            break
    return state, better


def _with_sizes(state: RemeshState, moved: MeshBatch) -> RemeshState:
    """The state with its vertices as in `moved`, and the sizes of the point sources there."""
    assert state.sources is not None
    return replace(state, batch=moved, size=scaled_to_fit(moved, state.sources.sizes(moved)))
