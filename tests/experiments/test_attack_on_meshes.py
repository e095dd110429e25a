"""A small share of the attack on meshes runs; its judge sees what it is there to see."""

import dataclasses

import numpy as np
import pytest
import torch
from exact import inverted

import torchmesh as tm
from experiments.robustness.attack import meshes, tangles
from experiments.robustness.attack.domains import DOMAINS


def some(kind, count=40, **wanted):
    """The trials of a kind among the first ones that have the `wanted` attributes."""
    found = (meshes.Trial.of(0, kind, number) for number in range(count))
    return [t for t in found if t is not None and all(getattr(t, name) == value for name, value in wanted.items())]


@pytest.mark.parametrize("kind", list(meshes.KINDS))
def test_the_first_trials_of_each_kind_find_no_fault(kind):
    done = [meshes.examine(0, kind, number) for number in (1, 2)]
    found = [trial for trial in done if trial is not None]
    assert found
    # The clock is the machine's, not the code's.
    assert [trial for trial in found if trial[1] and not trial[1].endswith(" s")] == []


# What an hour of the attack found once, with what was wrong.
@pytest.mark.parametrize(
    ("seed", "kind", "number"),
    [
        (2811, "cracks", 9),  # sides that rounding had laid over each other were called a hole inside out
        (2811, "cracks", 19),
        (9, "cracks", 1),  # such sides could be triangulated by no polygon's triangulation
        (21, "cracks", 4),
        (2811, "needles", 19),  # their own metric was not positive definite
        (2811, "strips over themselves", 5),  # vertices a million extents away were left there
        (2811, "strips over themselves", 20),
    ],
)
def test_former_faults_are_none(seed, kind, number):
    name, fault = meshes.examine(seed, kind, number)
    # The clock is the machine's, not the code's.
    assert fault == "" or fault.endswith(" s"), name


def test_what_untangling_left_of_a_strip_over_itself_is_triangulated_anew():
    name, fault = meshes.examine(9, "strips over themselves", 1)
    assert fault == "", name


@pytest.mark.parametrize("kind", list(DOMAINS))
def test_domains_are_valid_meshes_and_the_same_for_a_seed(kind):
    made = some(kind, 10)
    assert len(made) > 4
    assert sum(trial.witness is not None for trial in made) > len(made) // 2
    for trial in made:
        if trial.witness is not None:
            assert inverted(trial.witness) == 0
            assert torch.equal(trial.witness.points[trial.witness.fixed], trial.mesh.points[trial.mesh.fixed])
    again = some(kind, 3)
    assert again
    assert all(torch.equal(one.mesh.points, two.mesh.points) for one, two in zip(made, again, strict=False))


@pytest.mark.parametrize("name", list(tangles.THROWS))
def test_throws_give_every_free_vertex_a_position(name):
    points, free = np.random.default_rng(1).uniform(size=(20, 2)), np.arange(3, 9)
    assert tangles.THROWS[name](np.random.default_rng(2), points, free).shape == (6, 2)


def test_the_judge_sees_false_reports():
    trial = next(t for t in some("polygons", options="default") if inverted(t.mesh) and t.witness is not None)
    after, report = tm.improve(trial.mesh)
    assert trial.misjudged(after, report) == ""
    assert "said to be valid" in trial.misjudged(trial.mesh, report)
    assert "not mended" in trial.misjudged(trial.mesh, dataclasses.replace(report, valid=torch.tensor([False])))
    elsewhere = after.points + torch.tensor([1.0, 0.0])
    assert trial.misjudged(after.with_points(elsewhere), report)
    assert trial.misjudged(after.with_points(after.points * torch.inf), report) == "coordinates that are not finite"
    uncertified = dataclasses.replace(report, certified=torch.tensor([False]))
    assert trial.misjudged(after, uncertified) == "valid but not certified"


def test_a_run_counts_its_trials_by_kind(monkeypatch, capsys):
    from experiments.robustness.attack.__main__ import main

    monkeypatch.setattr(meshes.Trial, "fault", lambda self: "wrong")
    assert main(["meshes", "--minutes", "0", "--only", "carved"]) == 1
    told = capsys.readouterr().out
    assert "wrong" in told
    assert "carved: 1" in told
    with pytest.raises(ValueError, match="no kinds of meshes: nothing"):
        next(meshes.trials(0, ["nothing"]))
