"""The strategy: which stages a batch goes through, to be read from top to bottom.

      tangled meshes                                     valid meshes
   +-- average: neighbours' means, triangles kept    +-> flips that lower the smoother's energy <-+
   |-- place-anew: large tangles of large meshes     |   smooth (inverse mean ratio) -------------+
   |-- flip and untangle-beta, in turn               |        | no flip is left, or quality settles
   |-- retriangulate cavities                        |        +-> smooth with a ceiling -> polish the worst -> certify
   +-- regularised, newton: triangles kept ----------+

Every mesh goes its own way; the meshes that take the same stage are worked on together, as one batch.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import torch
from torch import Tensor

from ..flipping.delaunay import FlipOptions
from ..mesh.batch import MeshBatch, constraint_owner
from ..mesh.connectivity import corners_of, touching
from ..mesh.means import vertex_size
from ..mesh.neighbourhoods import rewired, surroundings
from ..mesh.ragged import counts_from_offsets, segment_any
from ..mesh.submesh import submesh
from ..optimising.moves import Monitor
from ..remeshing.criteria import CrowdedOptions, crowded
from ..remeshing.options import RemeshOptions
from ..smoothing.polishing import PolishOptions, bad_triangles
from ..smoothing.smoothing import SmoothOptions
from ..status import Status
from ..untangling.gathering import gathered
from ..untangling.options import UntangleOptions
from .ending import certify, compare_sizes
from .faults import end_the_tangled, find_faults, prove_impossible, taken_back, tell_enough_flips
from .gains import where_it_pays, without_little_gains
from .options import ImproveOptions
from .rounding import put_back_what_stays, round_positions
from .runner import Log, Runner, Stage, Work
from .stages import (
    attempt,
    average,
    flip,
    gather,
    newton,
    on_triangles,
    place_anew,
    polish,
    regularised,
    relocate,
    remesh,
    remove_vertices,
    retriangulate,
    smooth,
    untangle_beta,
    warp,
)
from .state import State
from .step_options import LeastGain
from .stopping import Gain, Stall, settled
from .travel import tethered, tied

Step = Callable[[State, Runner], State]


def improve_batch(state: State, log: Log, options: ImproveOptions) -> State:
    """The whole job on a batch, in this process and mesh by mesh as a whole."""
    if options.may_flip:
        # Reading the twins computes them, once; `select`, flips and `put` then hand them on.
        state.mesh.twin  # noqa: B018
    run = Runner(log)
    for step in strategy(options):
        state = step(state, run)
    return state


def strategy(o: ImproveOptions) -> list[Step]:
    """The steps of the whole job, in order."""
    if o.method == "paper":
        return [partial(step, o=o) for step in (find_faults, paper, certify)]
    steps = [find_faults, *([round_positions] if o.rounds_positions else []), untangle_by_averaging]
    if o.starts_anew:
        steps += [start_anew]
    if o.may_flip:
        steps += [untangle_with_flips, untangle_by_retriangulation]
    tells_flips = o.rounds.tells_flips and not o.may_flip
    steps += [untangle_with_triangles_kept, end_the_tangled, *([tell_enough_flips] if tells_flips else [])]
    steps += [flip_and_smooth if o.may_flip else smooth_slivers, smooth_at_last]
    if o.smooth.targets is None:
        steps += [better_the_sound]
    if o.travels:
        steps += [let_vertices_travel]
    if o.polishes:
        steps += [polish_the_worst]
    if o.topology == "full":
        steps += [remove_where_there_is_no_room, remesh_the_valid]
    if o.rounds_positions:
        steps += [put_back_what_stays]
    if o.weighs_gains:
        steps += [without_little_gains]
    return [partial(step, o=o) for step in [*steps, compare_sizes, certify]]


# --- Kim 2017 ---


def paper(state: State, run: Runner, o: ImproveOptions) -> State:
    """Kim 2017, figure 2."""
    state = state.ended(state.tangled & state.impossible, Status.INFEASIBLE)
    stall = Stall.of(state.quality.inverted)
    for turn in range(o.untangle_rounds):
        if not bool(state.tangled.any()):
            break
        step_2 = o.untangle.up_to(20 * 3**turn)
        state, flipped = run("flip", flip(FlipOptions.paper()), state, state.tangled & o.may_flip)
        state, moved = run("untangle-beta", untangle_beta(step_2), state, state.tangled)
        stall = stall.after(state.quality.inverted, flipped.flips, moved.iterations, short=step_2 != o.untangle)
        state = state.ended(state.tangled & stall.reached(o.rounds, o.may_flip), Status.STALLED)
    state = taken_back(state, run, state.faulty & (state.quality.inverted > state.inverted_given))
    state = state.ended(state.tangled, Status.ITERATION_LIMIT)
    state, _ = run("smooth", smooth(o.smooth), state, state.valid)
    return state.ended(state.running, Status.SETTLED)


# --- from tangled to valid ---


def untangle_by_averaging(state: State, run: Runner, o: ImproveOptions) -> State:
    """FEMWARP from the reference, then neighbours' means: scrambled interiors need no more."""
    near = gathered(state.mesh)
    if near is not state.mesh:
        strays = segment_any((near.points != state.mesh.points).any(1), state.mesh.point_offsets)
        state, _ = run("gather", gather(), state, state.tangled & strays)
    if o.reference is not None:
        state, _ = run("femwarp", attempt(warp(), _given), state, state.tangled)
    if bool(state.tangled.any()):
        state, _ = run("average", attempt(average(), _given), state, state.tangled)
    return replace(state, averaged=state.mesh.points)


def start_anew(state: State, run: Runner, o: ImproveOptions) -> State:
    """Large tangles that averaging leaves in large meshes: the boundary says best where the vertices belong.

    Without compiled loops untangling takes less time, and this stage is left out.
    """
    limits, triangles = o.rounds.anew, counts_from_offsets(state.mesh.triangle_offsets)
    if limits is None:
        return state
    at = state.tangled & ~state.faulty & ~state.impossible & (triangles >= limits.large)
    at = at & (state.quality.inverted > limits.share * triangles)
    at = at & (counts_from_offsets(state.mesh.quad_offsets) == 0)
    if not bool(at.any()):
        return state
    from ..remeshing.anew_in_rows import is_quick

    return run("place-anew", place_anew(limits.share), state, at)[0] if is_quick(state.mesh) else state


def untangle_with_flips(state: State, run: Runner, o: ImproveOptions) -> State:
    """Steps 1 and 2 in turn, by a flip rule that can only lower the inverted area."""
    gain = Gain.of(state.quality.inverted)
    for _ in range(o.untangle_rounds):
        going = state.tangled & gain.lasts(o.rounds)
        if not bool(going.any()):
            break
        state, _ = run("flip", flip(FlipOptions(max_rounds=o.rounds.flip_rounds)), state, going)
        state, _ = run("untangle-beta", untangle_beta(o.untangle), state, going & state.tangled)
        gain = gain.after(state.quality.inverted, o.rounds)
    return state


def untangle_by_retriangulation(state: State, run: Runner, o: ImproveOptions) -> State:
    """Tangled cavities are triangulated anew, which always succeeds if the boundary does not cross itself."""
    if bool(state.tangled.any()):
        state, _ = run("retriangulate", attempt(on_triangles(retriangulate())), state, state.tangled)
    return state


def untangle_with_triangles_kept(state: State, run: Runner, o: ImproveOptions) -> State:
    """The regularised functional, first from the positions that were given, then from those that averaging gave."""
    # Where edges may flip, the other ways have mended what can be mended beside a fault.
    hopeful, before = state.tangled & ~(state.impossible & o.may_flip), state.quality.inverted
    bounded = state.faulty | o.may_flip
    if o.at_interfaces == "free":
        # Cavities hardly help where an interface is out of place: this may work longer on meshes that have interfaces.
        walled = torch.zeros_like(bounded).index_fill_(0, constraint_owner(state.mesh), True)
        bounded &= state.faulty | ~walled
    # Cavities never help quads, whose edges stay: the same holds for meshes with quads.
    with_quads = counts_from_offsets(state.mesh.quad_offsets) > 0
    bounded &= state.faulty | ~with_quads
    unbounded = UntangleOptions(newton=None)
    for at, options in ((hopeful & bounded, o.rounds.last_untangling), (hopeful & ~bounded, unbounded)):
        if not bool(at.any()):
            continue
        state, _ = run("regularised", attempt(regularised(options), _given), state, at)
        assert state.averaged is not None
        elsewhere = segment_any((state.averaged != state.given.points).any(1), state.given.point_offsets)
        again = regularised(replace(options, size_sweeps=(100,)))
        state, _ = run("regularised", attempt(again, _averaged), state, state.tangled & at & elsewhere)
    # What the other ways leave of quads is tried by second-order ways, too, if anything can move.
    free = segment_any(~state.mesh.fixed, state.mesh.point_offsets)
    kept = with_quads & free if o.may_flip else torch.ones_like(with_quads)
    if bool((kept & state.tangled).any()):
        if not o.may_flip:
            state = prove_impossible(state, run, o)
        sound = o.rounds.newton_of_quads if o.may_flip else o.rounds.newton
        for at, ways in ((~state.faulty, sound), (state.faulty, o.rounds.newton_beside_faults)):
            if ways is None:
                continue
            options = UntangleOptions("newton", newton=ways)
            at = at & kept & state.tangled & ~state.impossible
            state, _ = run("newton", attempt(newton(options), _given), state, at)
    if o.may_flip:
        # Where fewer triangles are inverted than before, cavities round them are smaller, and may have a boundary that
        # does not cross itself, as in strips that lie over themselves.
        fewer = state.quality.inverted < before
        state, _ = run(
            "flip", attempt(flip(FlipOptions(max_rounds=o.rounds.flip_rounds))), state, state.tangled & fewer
        )
        state, _ = run("retriangulate", attempt(on_triangles(retriangulate())), state, state.tangled & fewer)
    return replace(state, averaged=None)


def _given(state: State) -> MeshBatch:
    return gathered(state.given)


def _averaged(state: State) -> MeshBatch:
    assert state.averaged is not None
    return state.given.with_points(state.averaged)


# --- from valid to good ---


def smooth_slivers(state: State, run: Runner, o: ImproveOptions) -> State:
    """Meshes with triangles that are all but flat are smoothed by q first: in q^2 these would outweigh all others."""
    state = tied(state, o)
    first = SmoothOptions(power=1, max_iterations=200, energy_tolerance=1e-3)
    return run("smooth", tethered(smooth(first)), state, state.valid & (state.judged.max > o.refine.sliver))[0]


def flip_and_smooth(state: State, run: Runner, o: ImproveOptions) -> State:
    """Flips and smoothing in turn, near the vertices that still move, until neither helps."""
    state = smooth_slivers(state, run, o)
    rough = SmoothOptions(power=o.smooth.power, max_iterations=10, energy_tolerance=1e-3, single=True)
    going, size = state.valid, vertex_size(state.mesh)
    state = replace(state, lively=torch.ones_like(state.mesh.fixed))
    for turn in range(o.smooth_rounds):
        before = state
        # Before the first smoothing only a few rounds of flips pay: smoothing changes which flips help.
        most = FlipOptions().max_rounds if turn else o.refine.first_flip_rounds
        state, flipped = run("flip", flip(FlipOptions(rule="shape", max_rounds=most)), state, going)
        if turn > 1:
            state = replace(state, lively=_round_flips(before, state))
        state = smooth_in_fitting_precision(state, run, o, rough, going)
        if turn:
            moved = (state.mesh.points - before.mesh.points).square().sum(1)
            state = replace(state, lively=moved > (o.refine.rest * size).square())
        # `judged` measures towards equilateral triangles, so towards other targets it cannot say when to stop.
        if turn and o.smooth.targets is None:
            going = going & ~settled(before, state, o)
        going = going & (flipped.flips > 0)
        if not bool(going.any()):
            break
    return replace(state, lively=None)


def _round_flips(before: State, after: State) -> Tensor:
    """(V,) bool: the lively vertices, those whose triangles flipped, and the neighbours of both."""
    assert after.lively is not None
    near = after.lively | rewired(before.mesh, after.mesh)
    return corners_of(after.mesh.triangles, touching(after.mesh.triangles, near), len(near))


def smooth_in_fitting_precision(
    state: State, run: Runner, o: ImproveOptions, options: SmoothOptions, at: Tensor, least: LeastGain | None = None
) -> State:
    """Smooth the meshes `at`, those with very poor triangles in double precision whatever the options say.

    least  meshes that would gain less than this stay as they are
    """

    def stage(options: SmoothOptions) -> Stage:
        done = tethered(smooth(options))
        return done if least is None else where_it_pays(done, least, o.polish or PolishOptions())

    if options.single:
        # The eighth power of a sliver's ratio, in the ceiling, leaves the range of single precision.
        poor = at & (state.judged.max > o.refine.coarse)
        state, _ = run("smooth", stage(replace(options, single=False)), state, poor)
        at = at & ~poor
    return run("smooth", stage(options), state, at)[0]


def smooth_at_last(state: State, run: Runner, o: ImproveOptions) -> State:
    """The smoothing that cares for the worst triangles, too."""
    last = (
        replace(o.smooth, max_iterations=min(o.smooth.max_iterations, o.refine.last_steps)) if o.may_flip else o.smooth
    )
    if o.may_flip or not o.weighs_gains:
        state = smooth_in_fitting_precision(state, run, o, last, state.valid)
    else:
        state = smooth_while_it_pays(state, run, o, last)
    return state.ended(state.running, Status.SETTLED)


def smooth_while_it_pays(state: State, run: Runner, o: ImproveOptions, last: SmoothOptions) -> State:
    """The last smoothing, and again in meshes that are poor, until they gain too little by it.

    Meshes that came valid must gain by the first one, too: what a call ends with is what the next call begins with.
    """
    poor = state.valid & (state.judged.max > (o.polish or PolishOptions()).ratio)
    again = poor & (state.inverted_given == 0)
    state = smooth_in_fitting_precision(state, run, o, last, state.valid & ~again)
    again = poor
    for _ in range(o.refine.kept_again):
        if not bool(again.any()):
            break
        before, state = state, smooth_in_fitting_precision(state, run, o, last, again, o.least_gain)
        moved = segment_any((state.mesh.points != before.mesh.points).any(1), state.mesh.point_offsets)
        again = again & moved
    return state


def let_vertices_travel(state: State, run: Runner, o: ImproveOptions) -> State:
    """Vertices travel from crowded to empty regions where shapes stayed poor, or sizes were asked for."""
    # Under topology "full" splits and collapses lead to the sizes, so they are not asked for here.
    asked = RemeshOptions() if o.topology == "full" else o.remesh
    if not (o.relocate or asked.sizes_asked):
        return state
    at = crowded(state.judged, asked, state.mesh.triangle_offsets) & ~state.tethered
    if state.anew is not None and not asked.sizes_asked:
        # They are where the sizes of the boundary want them; what is poor there is so for want of room.
        at = at & ~(state.anew & (state.judged.mean <= CrowdedOptions().mean))
    if bool(at.any()):
        state, work = run("relocate", on_triangles(relocate(o.remesh, asked.sizes_asked)), state, at)
        if o.slides:
            state = smooth_in_fitting_precision(state, run, o, o.smooth, work.took & state.valid)
    return state


def polish_the_worst(state: State, run: Runner, o: ImproveOptions) -> State:
    """The triangles that are still worse than is asked are worked on one by one."""
    if o.polish is None:
        return state
    bad = bad_triangles(state.mesh, state.judged, o.polish)
    return run(
        "polish", tethered(on_triangles(polish(o.polish))), state, segment_any(bad, state.mesh.triangle_offsets)
    )[0]


def better_the_sound(state: State, run: Runner, o: ImproveOptions) -> State:
    """Beside the faults of meshes that are mended in part, shapes become good, too."""
    return run("smooth", _beside_the_inverted(o), state, state.status == Status.PARTLY)[0]


def _beside_the_inverted(o: ImproveOptions) -> Stage:
    """Flips and smoothing of the triangles that are apart from the inverted ones, whose surroundings stay."""

    def stage(state: State, monitor: Monitor | None) -> tuple[State, Work]:
        mesh = state.mesh
        sound = ~touching(mesh.triangles, surroundings(mesh, ~state.quality.upright, o.rounds.rings_round_faults))
        if not bool(sound.any()):
            return state, Work.done(state)
        held = mesh.fixed | corners_of(mesh.triangles, ~sound, len(mesh.points))
        taken = submesh(replace(mesh, fixed=held), sound)
        log = Log(len(state))
        part = State.of(taken.mesh, replace(o, boundary="fixed", smooth=replace(o.smooth, boundary="fixed")))
        part = flip_and_smooth(part, Runner(log), o) if o.may_flip else part
        part = smooth_in_fitting_precision(part, Runner(log), o, o.smooth, part.valid)
        counts = ([sum(getattr(s, n) for s in steps) for steps in log.steps] for n in ("flips", "iterations"))
        flips, iterations = (torch.tensor(c, dtype=torch.int64, device=held.device) for c in counts)
        return state.at(taken.put_back(mesh, part.mesh)), Work.done(state, flips=flips, iterations=iterations)

    return stage


# --- vertices that come and go ---


def remove_where_there_is_no_room(state: State, run: Runner, o: ImproveOptions) -> State:
    """The last resort of topology "full" for meshes that nothing has mended."""
    # Beside a fault, room is not what is missing.
    stuck = ~state.valid & (state.status == Status.STALLED) & ~state.faulty
    if bool(stuck.any()):
        state, _ = run("vertex-removal", remove_vertices(o.remesh), state, stuck)
    return state.ended(stuck & state.valid, Status.SETTLED)


def remesh_the_valid(state: State, run: Runner, o: ImproveOptions) -> State:
    """Splits and collapses towards the sizes asked for; what slides then slides once more."""
    at = state.valid
    if not bool(at.any()):
        return state
    state, _ = run("remesh", remesh(o.remesh), state, at)
    if o.slides:
        state = slide(state, run, o)
    return polish_the_worst(state, run, o) if o.smooth.targets is None else state


def slide(state: State, run: Runner, o: ImproveOptions) -> State:
    """Smoothing after vertices have come and gone, in which those of boundaries and interfaces slide."""
    state = smooth_in_fitting_precision(state, run, o, o.smooth, state.valid)
    state, _ = run("flip", flip(FlipOptions(rule="shape")), state, state.valid)
    return smooth_in_fitting_precision(state, run, o, o.smooth, state.valid)
