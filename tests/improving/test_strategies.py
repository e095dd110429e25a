"""Which steps and stages each set of options calls for, and in which order."""

import meshes
import pytest
import torch
from both_loops import both, need_compiled_loops

from torchmesh import ImproveOptions, RemeshOptions, SmoothOptions, Status, UntangleOptions, improve, join, target_from
from torchmesh.improving.step_options import Rounds, StartAnew
from torchmesh.improving.strategies import strategy


def steps_of(options: ImproveOptions) -> list[str]:
    return [step.func.__name__ for step in strategy(options)]


TANGLED = ["find_faults", "round_positions", "untangle_by_averaging"]
FLIPS = ["untangle_with_flips", "untangle_by_retriangulation"]
KEPT = ["untangle_with_triangles_kept", "end_the_tangled"]
GOOD = ["flip_and_smooth", "smooth_at_last", "better_the_sound"]
USUAL = [*TANGLED, *FLIPS, *KEPT, *GOOD, "let_vertices_travel", "polish_the_worst"]
END = ["put_back_what_stays", "without_little_gains", "compare_sizes", "certify"]
# What slides, and what comes and goes, is not rounded.
EXACT = [name for name in USUAL if name != "round_positions"]
FULL = ["remove_where_there_is_no_room", "remesh_the_valid"]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (ImproveOptions(), [*TANGLED, "start_anew", *USUAL[len(TANGLED) :], *END]),
        (ImproveOptions.fast(), [*USUAL, *END]),
        (ImproveOptions.paper(), ["find_faults", "paper", "certify"]),
        (
            ImproveOptions(topology="keep"),
            [*TANGLED, *KEPT, "tell_enough_flips", "smooth_slivers", "smooth_at_last", "better_the_sound", *END],
        ),
        (ImproveOptions(topology="full"), [*EXACT[:-1], *FULL, *END[2:]]),
        (
            ImproveOptions(boundary="slide"),
            [*EXACT, *END[1:]],
        ),
        (
            ImproveOptions(topology="keep", smooth=SmoothOptions(targets=target_from(meshes.grid()))),
            [*TANGLED, *KEPT, "tell_enough_flips", "smooth_slivers", "smooth_at_last", *END],
        ),
    ],
    ids=["default", "fast", "paper", "keep", "full", "slide", "targets"],
)
def test_the_steps_of_each_set_of_options(options, expected):
    assert steps_of(options) == expected


def stages(mesh, options: ImproveOptions) -> list[str]:
    _, report = improve(mesh, options)
    assert bool(report.valid.all())
    return [step.stage for step in report.steps[0]]


def without_repeats(names: list[str]) -> list[str]:
    return list(dict.fromkeys(names))


def test_the_stages_that_the_report_names():
    mesh = meshes.moved_hole()
    usual = ["initial", "average", "flip", "untangle-beta"]
    assert without_repeats(stages(mesh, ImproveOptions()))[:4] == usual
    assert "smooth" in stages(mesh, ImproveOptions())
    assert without_repeats(stages(mesh, ImproveOptions.paper())) == ["initial", "flip", "untangle-beta", "smooth"]
    assert without_repeats(stages(mesh, ImproveOptions(topology="keep"))) == [
        "initial", "average", "regularised", "smooth",
    ]  # fmt: skip
    assert stages(mesh, ImproveOptions(topology="full")) == ["initial", "anew"]
    split = ImproveOptions(topology="full", remesh=RemeshOptions(split_boundary=True))
    assert "remesh" in stages(mesh, split)
    valid = meshes.grid()
    sized = ImproveOptions(remesh=RemeshOptions(sizes="uniform"))
    assert "relocate" in stages(valid, sized)
    assert "relocate" not in stages(valid, ImproveOptions.fast())


def test_large_tangles_start_anew_unless_something_speaks_against_it():
    mesh = meshes.moved_hole()
    rounds = Rounds(anew=StartAnew(large=100))
    assert "place-anew" in stages(mesh, ImproveOptions(rounds=rounds))
    assert "relocate" not in stages(mesh, ImproveOptions(rounds=rounds))
    for other in (StartAnew(large=100, share=0.9), StartAnew(large=1000)):
        assert "place-anew" not in stages(mesh, ImproveOptions.fast(rounds=Rounds(anew=other), relocate="auto"))
    assert "place-anew" not in stages(meshes.grid(), ImproveOptions(rounds=rounds))
    for other in (
        ImproveOptions(rounds=Rounds(anew=None)),
        ImproveOptions(relocate=False),
        ImproveOptions(topology="keep"),
        ImproveOptions(topology="full"),
        ImproveOptions(boundary="slide"),
        ImproveOptions(interfaces="free"),
        ImproveOptions(scope="damage"),
        ImproveOptions(max_motion=30.0),
        ImproveOptions(reference=meshes.grid()),
        ImproveOptions(remesh=RemeshOptions(sizes="uniform")),
    ):
        assert "start_anew" not in steps_of(other)


def test_by_torch_alone_nothing_starts_anew_and_no_report_says_so():
    need_compiled_loops()
    options = ImproveOptions(rounds=Rounds(anew=StartAnew(large=100)))
    by_torch, compiled = both(lambda: stages(meshes.moved_hole(), options))
    assert "place-anew" in compiled
    assert "place-anew" not in by_torch


def test_a_mesh_starts_anew_in_a_batch_as_alone():
    batch = [meshes.moved_hole(), meshes.grid(), meshes.jittered(12, 11, cells=2.5), meshes.moved_hole(4.0)]
    options = ImproveOptions(rounds=Rounds(anew=StartAnew(large=100, share=0.01)))
    whole, report = improve(join(batch), options)
    names = [{step.stage for step in steps} for steps in report.steps]
    assert ["place-anew" in of for of in names] == [True, False, False, True]
    for mesh, together in zip(batch, whole.split(), strict=True):
        alone, _ = improve(mesh, options)
        assert torch.equal(alone.points, together.points)
        assert torch.equal(alone.triangles, together.triangles)


def test_a_reference_is_followed_first():
    undeformed = meshes.ring(24, 6)
    _, report = improve(meshes.disturbed(undeformed, 0.15, 3), ImproveOptions(reference=undeformed))
    assert [step.stage for step in report.steps[0]][:2] == ["initial", "femwarp"]
    assert report.worked == ["femwarp"]


def test_the_hopeless_are_told_and_come_back_as_they_were():
    mesh = meshes.ring()
    inside_out = mesh.points.clone()
    inside_out[:16] *= 5
    batch = join([mesh.with_points(inside_out), meshes.jittered()])
    after, report = improve(batch)
    assert report.status.tolist()[0] == Status.INFEASIBLE
    assert torch.equal(after.split()[0].points, inside_out)
    assert report.valid.tolist() == [False, True]


@pytest.mark.parametrize("topology", ["keep", "flip"])
def test_the_loop_of_the_paper_stalls_when_rounds_bring_nothing(topology):
    """One iteration a round is too few for this hole."""
    options = ImproveOptions.paper(topology=topology, untangle=UntangleOptions("beta", beta=0.03, max_iterations=1))
    _, report = improve(meshes.moved_hole(7.0), options)
    assert report.status.tolist() == [Status.STALLED]
    rounds = [step.stage for step in report.steps[0]].count("untangle-beta")
    # Without flips one round without gain is enough; with them the loop waits for more.
    assert rounds == 1 if topology == "keep" else 1 < rounds < options.untangle_rounds
