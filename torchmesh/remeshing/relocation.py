"""Vertices travel from crowded to empty regions, by as many splits as collapses, in the same rows.

A collapse sets a vertex free, and a split elsewhere uses it again.  So the number and order of vertices and triangles
stay, as with flips; but a vertex, with the values of its fields, may travel far.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch, put
from ..mesh.interfaces import holding, released
from ..mesh.ragged import counts_from_offsets, spread
from ..smoothing.smoothing import SmoothOptions
from .condensation import condense
from .criteria import GOOD_MEAN
from .cuts import PairOptions, cut_in_pairs
from .options import RemeshOptions
from .rounds import Pace, Plan, asked_sizes, improved, metric_at, settle_once
from .sizing import scaled_to_fit
from .state import RemeshState

# Relocation is one of the usual stages, so its pace is quicker than that of remeshing.  A mesh of good shapes ends its
# rounds earlier, usually after three cuts, and one shake is enough.
QUICK = Pace(
    between=SmoothOptions(max_iterations=8, energy_tolerance=1e-3, single=True),
    good=GOOD_MEAN,
    shakes=((0.9, 1.3),),
    few_when_good=30,
    looser=5,
    # Edges of 0.7 to 1.4 times their sizes are left alone, so more accurate sizes are not worth loading scipy for.
    accuracy=1e-3,
    # Of 190 usual tangles none had more than 4 rounds.  See `Pace.work` for what this comes to; hostile meshes had 17.
    work=18_000,
    least_rounds=5,
    last_steps=60,
)
QUICK_PAIRS = PairOptions(worth=0.15)


@dataclass(frozen=True, eq=False)
class Relocated:
    """What `relocate` did.

    splits  (B,) int64, the vertices that travelled in meshes that were not condensed
    flips   (B,) int64, the edges flipped
    size    (V,) float64, the edge lengths wanted, which have travelled with the vertices; NaN in condensed meshes
    """

    splits: Tensor
    flips: Tensor
    size: Tensor


def relocate(batch: MeshBatch, options: RemeshOptions) -> tuple[MeshBatch, Relocated]:
    """Let vertices of valid meshes travel towards the sizes of the options.

    Interfaces stay, or move as smoothing asks (`RemeshOptions.interfaces`).  What makes shapes worse is taken back.
    Where the boundary is much too coarse for the vertices, they are condensed at point sources instead
    (`condensation`).  The boundary is not split, whatever the options say, since that would add vertices.
    """
    given, batch = batch, holding(batch, options.interfaces)
    moved, info = condense(batch, options)
    size = torch.full((len(batch.points),), torch.nan, dtype=torch.float64, device=batch.points.device)
    splits, flips, at = torch.zeros_like(info.flips), info.flips, ~info.done
    if not bool(at.any()):
        return released(moved, given), Relocated(splits, flips, size)
    state = relocated(batch.select(at), options, info.rounds[at])
    rows = spread(at, batch.point_offsets)
    size = size.masked_scatter(rows, state.size)
    splits, flips = splits.masked_scatter(at, state.splits), flips.masked_scatter(at, state.flips)
    return released(put(moved, at, state.batch), given), Relocated(splits, flips, size)


def relocated(batch: MeshBatch, options: RemeshOptions, rounds: Tensor | None = None) -> RemeshState:
    """The state of valid meshes after their vertices have travelled, without condensation.

    rounds  (B,) int64, those that the meshes have had already, which count; None: none
    """
    # Where sizes were asked for, good shapes are no reason to stop.
    pace = replace(QUICK, few_when_good=None) if options.sizes_asked else QUICK
    metric, wanted = metric_at(batch, options), counts_from_offsets(batch.triangle_offsets)
    size = scaled_to_fit(batch, asked_sizes(batch, options.sizes, metric, wanted, pace.accuracy))
    plan = Plan(
        options,
        pace,
        cut=lambda state, limits: cut_in_pairs(state, limits, QUICK_PAIRS),
        # Vertices take their sizes along; this halves the time of relocation.
        resize=lambda state, moved: replace(state, batch=moved),
        finish=settle_once,
    )
    state = RemeshState.begin(batch, size, metric=metric, interfaces=options.interfaces)
    return improved(state if rounds is None else replace(state, rounds=rounds), plan)
