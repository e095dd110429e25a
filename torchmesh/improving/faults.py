"""Faults of the boundary and of what is fixed: found before any work, and told after it.

    +--------------+      #  triangles that stay inverted at a fault, here two neighbours that have passed each other
    |  x        x  |      x  tangles out of reach of the fault: they are mended
    |              |
    +-----><-------+      what is left is told with its place: `Status.PARTLY`

A boundary that merely lies over itself is no fault: a strip of more than one turn is a valid mesh.
"""

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Literal

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch, constraint_owner
from ..mesh.connectivity import boundary_edges
from ..mesh.ragged import counts_from_offsets, segment_any, true_rows
from ..status import Status
from .options import ImproveOptions
from .runner import Runner, Work
from .state import State

if TYPE_CHECKING:
    from ..diagnosing.problems import Problem

# What is said of a tangled mesh that might be mended if its interfaces could move.
INTERFACES_HELD = "; its interfaces are held where they are: interfaces='free' (--interfaces free) lets them move"

# Problems of one mesh that are told, and edges whose flips would help; the others are counted.
_TOLD, _FLIPS_TOLD = 5, 40


def find_faults(state: State, run: Runner, o: ImproveOptions) -> State:
    """Look for faults, which no method can mend.

    A mesh that is impossible as a whole ends here; beside a fault at a place the work goes on.
    """
    return run.quietly("diagnose", partial(_with_faults, o=o), state, state.tangled)


def prove_impossible(state: State, run: Runner, o: ImproveOptions) -> State:
    """Look for a proof that the triangles have no valid positions, in meshes that are tangled still without a fault."""
    at = state.tangled & ~state.impossible & ~state.faulty
    return run.quietly("prove", partial(_with_proofs, o=o), state, at)


def _with_proofs(state: State, o: ImproveOptions) -> State:
    from ..diagnosing.diagnosis import diagnose

    faults, impossible = list(state.faults), state.impossible.clone()
    for problem in diagnose(state.given, "keep", interfaces=state.origin.interfaces, thorough=True):
        if not faults[problem.mesh]:
            faults[problem.mesh] = problem.message
            impossible[problem.mesh] = problem.kind.proves
    return replace(state, faults=tuple(faults), impossible=impossible)


def faults_of(mesh: MeshBatch) -> "list[Problem]":
    """The faults of meshes that triangulation cannot mend, whose places are to be marked; few for each mesh."""
    from ..diagnosing.diagnosis import diagnose

    return diagnose(mesh, "flip")


def end_the_tangled(state: State, run: Runner, o: ImproveOptions) -> State:
    """Say how meshes end that are still tangled: impossible, mended but for the faults that were named, or stalled."""
    left, fewer = state.tangled, state.quality.inverted < state.inverted_given
    more = state.quality.inverted > state.inverted_given
    state = taken_back(state, run, left & (more | (state.faulty & ~fewer)))
    state = state.ended(left & state.impossible & ~fewer, Status.INFEASIBLE)
    state = state.ended(left & state.faulty & fewer, Status.PARTLY)
    return state.ended(state.tangled, Status.STALLED)


def tell_enough_flips(state: State, run: Runner, o: ImproveOptions) -> State:
    """Say of meshes that are tangled in the end with how few flips they can be valid, as far as such are found."""
    some = counts_from_offsets(state.mesh.quad_offsets) > 0
    return run.quietly("flips", _with_enough_flips, state, ~state.valid & ~some)


def _with_enough_flips(state: State) -> State:
    from ..untangling.enough_flips import enough_flips

    # Where the boundary itself is at fault, flips mend nothing.
    hopeless = {problem.mesh for problem in faults_of(state.given)}
    notes = {}
    for b in range(len(state)):
        found = None if b in hopeless or int(state.status[b]) == Status.NOT_FINITE else enough_flips(state.mesh[b])
        if found is not None:
            notes[b] = f"; {found.text(_FLIPS_TOLD)}"
    return state.noted(notes)


def taken_back(state: State, run: Runner, at: Tensor) -> State:
    """The meshes `at` (B,) bool come back as they were given, if anything has changed in them."""
    if state.names is not None or not bool(at.any()):
        return state
    mesh, given = state.mesh, state.given
    changed = segment_any((mesh.points != given.points).any(1), mesh.point_offsets)
    changed |= segment_any((mesh.triangles != given.triangles).any(1), mesh.triangle_offsets)
    return run("as given", lambda part, _: (part.at(part.given), Work.done(part)), state, at & changed)[0]


def _with_faults(state: State, o: ImproveOptions) -> State:
    """The tangled meshes of `state` with their faults; those that are impossible as a whole have ended."""
    from ..diagnosing.diagnosis import diagnose

    may_change: Literal["keep", "flip"] = "flip" if o.may_flip else "keep"
    found: dict[int, list[Problem]] = {}
    for problem in diagnose(state.mesh, may_change, interfaces=state.origin.interfaces):
        found.setdefault(problem.mesh, []).append(problem)
    impossible, everywhere = _proved(state.mesh, found), torch.zeros_like(state.valid)
    for b, problems in found.items():
        everywhere[b] = impossible[b] & (not all(problem.kind.local for problem in problems))
    faults = tuple(_text(found.get(b, [])) for b in range(len(state)))
    state = replace(state, faults=faults, impossible=impossible).ended(everywhere, Status.INFEASIBLE)
    return state.noted(dict.fromkeys(_stuck_by_interfaces(state, impossible, may_change), INTERFACES_HELD))


def _proved(mesh: MeshBatch, found: "dict[int, list[Problem]]") -> Tensor:
    """(B,) bool: the problems of the mesh prove that no valid mesh exists, or the turns of its boundary do."""
    from ..diagnosing.problems import ProblemKind
    from ..diagnosing.turning import turns_too_little

    proved = torch.zeros(len(mesh), dtype=torch.bool, device=mesh.points.device)
    stay = _edges_that_stay(mesh) if found else set()
    for b, problems in found.items():
        first = int(mesh.point_offsets[b])
        proved[b] = any(
            problem.kind in (ProblemKind.FIXED_TRIANGLE, ProblemKind.FIXED_QUAD, ProblemKind.NO_KERNEL)
            or (
                problem.kind is ProblemKind.DUPLICATE_VERTICES
                and tuple(sorted(v + first for v in problem.vertices)) in stay
            )
            for problem in problems
        ) or all(problem.kind.proves for problem in problems)
    doubtful = torch.zeros_like(proved)
    doubtful[torch.tensor(list(found), dtype=torch.int64, device=proved.device)] = True
    doubtful &= ~proved
    if not bool(doubtful.any()):
        return proved
    return proved.masked_scatter(doubtful, turns_too_little(mesh.select(doubtful)))


def _edges_that_stay(mesh: MeshBatch) -> set[tuple[int, ...]]:
    """The edges of the boundary and the constrained edges, each as its vertices in ascending order."""
    edges = torch.cat([boundary_edges(mesh.triangles, mesh.twin), mesh.constrained_edges])
    return set(map(tuple, edges.sort(1).values.tolist()))


def _text(problems: "list[Problem]") -> str:
    """The problems of one mesh in words, or ""."""
    more = f"; and {len(problems) - _TOLD} more of the kind" if len(problems) > _TOLD else ""
    return "; ".join(problem.message for problem in problems[:_TOLD]) + more


def _stuck_by_interfaces(state: State, hopeless: Tensor, may_change: Literal["keep", "flip"]) -> list[int]:
    """Those of the meshes `hopeless` (B,) bool in which nothing is in the way but interfaces that are held."""
    from ..diagnosing.diagnosis import diagnose

    has = torch.zeros_like(hopeless).index_fill_(0, constraint_owner(state.mesh), True)
    rows = true_rows(hopeless & has).tolist()
    if state.origin.interfaces == "free" or not rows:
        return []
    left = {problem.mesh for problem in diagnose(state.mesh.select(hopeless & has), may_change, interfaces="free")}
    return [b for i, b in enumerate(rows) if i not in left]
