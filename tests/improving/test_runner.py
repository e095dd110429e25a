"""The runner hands a stage the meshes that take it, and its log is all that changes."""

import meshes
import pytest
import torch

from torchmesh import ImproveOptions, join
from torchmesh.flipping.delaunay import FlipOptions
from torchmesh.improving.runner import Log, Runner, Work, what_failed
from torchmesh.improving.stages import attempt, average, flip
from torchmesh.improving.state import State


def states():
    batch = join([meshes.jittered(seed=0), meshes.grid(), meshes.jittered(seed=1)])
    return State.of(batch, ImproveOptions())


def shift(amount: float):
    def stage(state, monitor):
        points = state.mesh.points + amount
        return state.at(state.mesh.with_points(points)), Work.done(state, flips=torch.full_like(state.status, 7))

    return stage


def test_only_the_meshes_asked_for_take_a_stage():
    state, log = states(), Log(3)
    after, work = Runner(log)("shift", shift(1.0), state, torch.tensor([True, False, True]))
    moved = [not torch.equal(a.points, b.points) for a, b in zip(state.mesh.split(), after.mesh.split(), strict=True)]
    assert moved == [True, False, True]
    assert work.took.tolist() == [True, False, True]
    assert work.flips.tolist() == [7, 0, 7]
    assert [[s.stage for s in steps] for steps in log.steps] == [["shift"], [], ["shift"]]
    assert log.steps[0][0].inverted == int(after.quality.inverted[0])


def test_a_stage_that_no_mesh_takes_is_not_run_nor_logged():
    state, log = states(), Log(3)

    def never(state, monitor):
        raise AssertionError("it ran")

    after, work = Runner(log)("never", never, state, torch.zeros(3, dtype=torch.bool))
    assert after is state
    assert not work.took.any()
    assert log.steps == [[], [], []]


def test_an_attempt_is_kept_only_where_it_leaves_fewer_inverted_triangles():
    state, log = states(), Log(3)
    every = torch.ones(3, dtype=torch.bool)
    # A valid mesh cannot get better; the others are scrambled interiors, which averaging mends.
    after, work = Runner(log)("average", attempt(average()), state, every)
    assert work.kept.tolist() == [True, False, True]
    assert after.valid.tolist() == [True, True, True]
    assert torch.equal(after.mesh.split()[1].points, state.mesh.split()[1].points)
    worse, work = Runner(log)("shift", attempt(shift(1.0)), state, every)
    assert work.kept.tolist() == [False, False, False]
    assert torch.equal(worse.mesh.points, state.mesh.points)


def test_views_write_into_the_log_that_they_are_of():
    state, seen = states(), []
    log = Log(3, observe=lambda stage, batch: seen.append((stage, len(batch))))
    some = torch.tensor([2, 0])
    view = log.view(some, lambda part: state.mesh)
    part = state.select(torch.tensor([True, False, True]))
    Runner(view)("flip", flip(FlipOptions()), part, torch.tensor([True, False]))
    assert [[s.stage for s in steps] for steps in log.steps] == [[], [], ["flip"]]
    assert seen == [("flip", 3)]


def test_progress_is_told_before_a_stage_and_within_a_minimisation():
    told = []
    state = states()
    log = Log(3, progress=told.append)
    monitor = log.begin("smooth", state, torch.tensor([True, True, False]))
    for iteration in range(21):
        monitor(iteration, torch.tensor([1.0, 2.0]))
    assert [p.iteration for p in told] == [0, 0, 10, 20]
    assert told[0].meshes == 2
    assert told[-1].energy == 3.0


def test_an_error_inside_a_stage_touches_the_guilty_mesh_only():
    batch = join([meshes.jittered(seed=s) for s in (3, 0, 4, 1, 5)])
    state, log = State.of(batch, ImproveOptions()), Log(5)
    marked = state.given.split()[3].points

    def fails(part, monitor):
        if any(torch.equal(mesh.points, marked) for mesh in part.mesh.split()):
            raise ZeroDivisionError("on\n  purpose")
        return shift(1.0)(part, monitor)

    run, every = Runner(log), torch.ones(5, dtype=torch.bool)
    after, work = run("shift", fails, state, every)
    expected, _ = Runner(Log(5))("shift", shift(1.0), state, every)
    for b, (mesh, wanted, given) in enumerate(
        zip(after.mesh.split(), expected.mesh.split(), batch.split(), strict=True)
    ):
        assert torch.equal(mesh.points, given.points if b == 3 else wanted.points)
    assert work.took.tolist() == [True, True, True, False, True]
    assert work.flips.tolist() == [7, 7, 7, 0, 7]
    assert [s.kept for steps in log.steps for s in steps] == [True, True, True, False, True]
    assert after.failures[3] == (("shift", "ZeroDivisionError: on purpose"),)
    assert after.has_failed_in("shift").tolist() == [False, False, False, True, False]
    # It does not take the stage again, but others.
    again, work = run("shift", fails, after, every)
    assert work.took.tolist() == [True, True, True, False, True]
    _, work = run("other", shift(1.0), again, every)
    assert work.took.all()
    # What failed is kept through selections.
    assert again.select(torch.tensor([False, False, False, True, True])).failures == (after.failures[3], ())


def test_an_error_of_the_watcher_is_passed_on():
    def told(progress):
        if progress.iteration:
            raise KeyError("stop")

    def stage(state, monitor):
        monitor(10, torch.ones(3))
        raise AssertionError("the watcher did not stop it")

    state = states()
    with pytest.raises(KeyError, match="stop"):
        Runner(Log(3, told))("smooth", stage, state, torch.ones(3, dtype=torch.bool))


def test_errors_are_told_in_one_short_line():
    assert what_failed(ValueError("a\nb")) == "ValueError: a b"
    assert what_failed(ValueError()) == "ValueError"
    assert len(what_failed(ValueError("x" * 500))) == 200
