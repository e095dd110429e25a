"""The last steps of every strategy: how well edges follow their sizes, and whether the meshes are valid for certain."""

from dataclasses import fields, replace
from functools import partial

import torch

from ..mesh.certificate import same_frame
from ..optimising.metric_field import MetricField
from ..remeshing.metric_sizing import metric_conformity
from ..remeshing.sizing import SizeConformity, size_conformity, size_field
from ..status import Status
from .options import ImproveOptions
from .runner import Runner
from .state import State


def compare_sizes(state: State, run: Runner, o: ImproveOptions) -> State:
    """Measure how well edges follow the sizes that were asked for, in the valid meshes; NaN stands for the others."""
    if o.topology != "full" and state.sizes is None:
        return state
    if state.sizes is None or o.topology == "full":
        state = run.quietly("sizes", _with_own_sizes, state, torch.ones_like(state.valid))
    state = run.quietly("sizes", partial(_compared, o=o), state, state.valid)
    nothing = torch.full_like(state.quality.mean, torch.nan)
    sizes = state.mesh.points.new_full((len(state.mesh.points),), torch.nan, dtype=torch.float64)
    return replace(
        state,
        sizes=sizes if state.sizes is None else state.sizes,
        conformity=state.conformity or SizeConformity(*(nothing for _ in fields(SizeConformity))),
    )


def _with_own_sizes(state: State) -> State:
    """The state in which a mesh that was not remeshed has the sizes that it has."""
    there = size_field(state.mesh, "keep")
    return replace(state, sizes=there if state.sizes is None else torch.where(state.sizes.isnan(), there, state.sizes))


def _compared(state: State, o: ImproveOptions) -> State:
    """The valid meshes of `state` with how well their edges follow their sizes."""
    assert state.sizes is not None
    asked = o.remesh.sizes
    by_vertex = o.topology == "full" or not (callable(asked) or (isinstance(asked, str) and asked == "uniform"))
    if isinstance(state.targets, MetricField):
        found = metric_conformity(state.mesh, state.sizes, state.targets.at_vertices(state.mesh))
    else:
        found = size_conformity(state.mesh, state.sizes if by_vertex else asked)
    return replace(state, conformity=found)


def certify(state: State, run: Runner, o: ImproveOptions) -> State:
    """Say of every mesh whether it is valid and its frame is what it was, by exact signs and edges computed anew."""
    state = run.quietly("certify", _certified, state, torch.ones_like(state.valid))
    failures = [bool(failures) for failures in state.failures]
    failed = torch.tensor(failures, dtype=torch.bool, device=state.meshes.device)
    return state.ended(failed, Status.FAILED)


def _certified(state: State) -> State:
    names = None if state.names is None else state.own_map
    stays = state.of_given_vertices(state.origin.stays)
    return replace(state, certified=state.valid & same_frame(state.given, state.mesh, stays, names))
