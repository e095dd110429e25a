"""`improve` on its own result changes nothing, and what gained too little comes back to the bit."""

import meshes
import pytest
import torch

from torchmesh import ImproveOptions, MetricField, SmoothOptions, improve, join, quality
from torchmesh.improving.step_options import LeastGain


def same(a, b) -> bool:
    return torch.equal(a.points, b.points) and torch.equal(a.triangles, b.triangles)


def twice_as_long(places: torch.Tensor) -> torch.Tensor:
    return torch.tensor([2.0, 0.0, 0.5]).expand(len(places), 3)


WAYS = {
    "flip": ImproveOptions(),
    "keep": ImproveOptions(topology="keep"),
    "damage": ImproveOptions(scope="damage"),
    "fast": ImproveOptions.fast(),
    "targets": ImproveOptions(
        smooth=SmoothOptions(
            ceiling=1.5, targets=MetricField(lambda p: torch.tensor([2.0, 0.0, 0.5]).expand(len(p), 3))
        )
    ),
}


@pytest.mark.parametrize("way", list(WAYS))
def test_improve_is_idempotent(way):
    given = join([make() for make in meshes.TANGLED.values()])
    once, first = improve(given, WAYS[way])
    twice, second = improve(once, WAYS[way])
    assert not same(given, once)
    for a, b, valid in zip(once.split(), twice.split(), first.valid.tolist(), strict=True):
        assert not valid or same(a, b)
    assert second.moved[first.valid].tolist() == [0] * int(first.valid.sum())
    # What is said of the end is true of what came back.
    assert torch.equal(second.quality.mean, quality(twice).mean)
    assert [rows[-1].mean for rows in second.steps] == second.quality.mean.tolist()
    assert torch.equal(second.certified, first.certified)


def test_what_gains_enough_is_changed():
    mesh = meshes.grid()
    poor = mesh.with_points(mesh.points + torch.where(mesh.fixed[:, None], 0.0, 0.3 * meshes.grid().points.std() * 0.2))
    better, report = improve(poor)
    assert float(report.quality.mean[0]) < float(quality(poor).mean[0])
    assert not same(better, poor)


def test_without_a_least_gain_every_change_counts():
    once, _ = improve(meshes.delaunay())
    eager, _ = improve(once, ImproveOptions(least_gain=None))
    assert not same(once, eager)


@pytest.mark.parametrize("wrong", [{"mean": -0.1}, {"max": 1.0}, {"angle": -1.0}])
def test_wrong_gains_are_refused_by_name(wrong):
    with pytest.raises(ValueError, match=f"LeastGain.{next(iter(wrong))}"):
        LeastGain(**wrong)
