"""Meshes with as many vertices as they should have: splits, collapses, flips and smoothing in turn.

`remesh` is what users call.  `remesh_valid` is the step of `improve` that also takes back what made shapes worse.
"""

from dataclasses import dataclass, replace

from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.detached import without_autograd
from ..mesh.interfaces import holding
from ..mesh.measure import quality
from ..mesh.quads import refuse_quads
from ..mesh.ragged import counts_from_offsets, segment_any, spread
from ..mesh.vertex_map import Names, VertexMap
from ..optimising.metric_field import MetricField
from ..smoothing.smoothing import SmoothOptions
from .cuts import cut_freely
from .metric_sizing import metric_conformity
from .options import RemeshOptions
from .rounds import Pace, Plan, asked_sizes, improved, metric_at, remesh_by_plan, settle, smoothed
from .sizing import SizeConformity, carried, size_conformity, size_field
from .state import RemeshState

# The shakes stand hardest first.  With three of them, all variants measured but those with stretched boundaries ended
# below a mean of 1.03.
THOROUGH = Pace(
    between=SmoothOptions(max_iterations=15, energy_tolerance=1e-3, single=True),
    good=1.025,
    shakes=((0.75, 1.5), (0.8, 1.4), (1.0, 1.2)),
)


@dataclass(frozen=True, eq=False)
class RemeshInfo:
    """What `remesh` did, per mesh (B,).

    splits, collapses, flips, rounds  int64 numbers
    vertex_map  the `VertexMap` from the given vertices to those of the result
    size        (V_new,) the edge lengths that were wanted, at the new vertices
    conformity  how well the edges follow them
    """

    splits: Tensor
    collapses: Tensor
    flips: Tensor
    rounds: Tensor
    vertex_map: VertexMap
    size: Tensor
    conformity: SizeConformity

    @classmethod
    def of(cls, state: RemeshState) -> "RemeshInfo":
        """What was done to come to this state."""
        batch, size, metric = state.batch, state.size, state.metric
        conformity = size_conformity(batch, size) if metric is None else metric_conformity(batch, size, metric)
        counts = state.splits, state.collapses, state.flips, state.rounds
        return cls(*counts, state.names.vertex_map(), size, conformity)


@without_autograd
def remesh(batch: MeshBatch, options: RemeshOptions | None = None) -> tuple[MeshBatch, RemeshInfo]:
    """Add and remove vertices until edges have the sizes wanted and triangles good shapes.

    Fixed vertices stay, as do boundary and constrained edges with their ends (halved at most, with
    `split_boundary`) and the regions they bound.  Kept vertices keep their order; inserted ones
    come after them, mesh by mesh.  A mesh that has inverted triangles comes back as it was.

    The result carries no gradient, whatever the points require; `nn`, `losses`, `metrics` and `femwarp` have one.
    """
    refuse_quads(batch, "remesh (unlike improve under topology 'full')")
    options = options or RemeshOptions()
    given, batch = batch, holding(batch, options.interfaces)
    there, metric = size_field(batch, "keep"), metric_at(batch, options)
    state = RemeshState.begin(batch, there, metric=metric, interfaces=options.interfaces)
    begun = state
    valid = ~segment_any(~quality(batch).upright, batch.triangle_offsets)
    if bool(valid.any()):
        sizes = options.sizes
        if isinstance(sizes, Tensor):
            sizes = sizes[spread(valid, batch.point_offsets)]
        part = state.select(valid)
        part = replace(part, size=asked_sizes(part.batch, sizes, part.metric, part.wanted))
        state = state.put(valid, remesh_by_plan(part, _plan(options)))
    return state.released(given, begun), RemeshInfo.of(state)


def remesh_valid(batch: MeshBatch, options: RemeshOptions, names: Names | None = None) -> tuple[MeshBatch, RemeshState]:
    """Remesh valid meshes, and take back what made their shapes worse (see `improved`); the batch, and its state.

    options  tensors in them are over the vertices of `batch`
    names    of the vertices; None: `batch` is where the vertex map begins
    """
    metric = metric_at(batch, options)
    size = asked_sizes(batch, options.sizes, metric, counts_from_offsets(batch.triangle_offsets))
    held = holding(batch, options.interfaces)
    begun = RemeshState.begin(held, size, names=names, metric=metric, interfaces=options.interfaces)
    state = improved(begun, _plan(options))
    return state.released(batch, begun), state


def _plan(options: RemeshOptions) -> Plan:
    return Plan(
        options,
        THOROUGH,
        cut=lambda state, limits: cut_freely(state, limits, options.split_boundary),
        resize=lambda state, moved: _resized(state, moved, options),
        finish=_finish,
    )


def _resized(state: RemeshState, moved: MeshBatch, options: RemeshOptions) -> RemeshState:
    """The state with its vertices as in `moved`, the metric and the sizes read anew where they are."""
    metric, targets = state.metric, options.smooth.targets
    if isinstance(targets, MetricField) and not isinstance(targets.values, Tensor):
        # A metric given as a tensor moves with its vertices; a function is asked where they are.
        metric = targets.at_vertices(moved)
    if isinstance(options.sizes, Tensor) or (isinstance(options.sizes, str) and options.sizes == "keep"):
        size = carried(state.batch, state.size, moved.points)
    else:
        size = asked_sizes(moved, options.sizes, metric, state.wanted)
    return replace(state, batch=moved, size=size, metric=metric)


def _finish(state: RemeshState, plan: Plan) -> RemeshState:
    """Flip and smooth while edges flip, then smooth to the end."""
    at, smoothing = state.every(), replace(plan.pace.between, max_iterations=plan.pace.last_iterations)
    for _ in range(plan.pace.last_rounds):
        if not bool(at.any()):
            break
        part = settle(state.select(at), plan, smoothing)
        flipped = part.flips > state.flips[at]
        state = state.put(at, part)
        at = at.masked_scatter(at, flipped)
    return plan.resize(state, smoothed(state, plan.options.smooth))
