"""The work on valid meshes at rounded positions, so that decisions do not hang on rounding errors."""

from dataclasses import replace

from ..mesh.rounding import rounded, unrounded
from .faults import taken_back
from .options import ImproveOptions
from .runner import Runner
from .state import State


def round_positions(state: State, run: Runner, o: ImproveOptions) -> State:
    """Meshes that came valid are worked on at rounded positions, so that decisions do not hang on rounding errors."""
    mesh = rounded(state.mesh, state.running & (state.inverted_given == 0))
    return state if mesh is state.mesh else replace(state.at(mesh), rounded=mesh.points)


def put_back_what_stays(state: State, run: Runner, o: ImproveOptions) -> State:
    """What stays, or did not move on the rounded positions, is where it was given; all is, if that does not fit."""
    if state.rounded is None:
        return state
    given = state.given
    stays = state.of_given_vertices(state.origin.stays) | state.mesh.fixed
    begun = given.with_points(state.rounded)
    back = state.at(unrounded(state.mesh, begun, given, stays))
    state, came_valid = replace(back, rounded=None), state.inverted_given == 0
    run.log.amend(state, came_valid)
    return taken_back(state, run, came_valid & ~state.valid)
