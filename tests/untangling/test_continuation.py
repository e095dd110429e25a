"""The continuation in epsilon ends: after its limit, or where a mesh no longer gains."""

import meshes
import pytest
import torch
from exact import inverted

from torchmesh import Status, UntangleOptions, join, untangle
from torchmesh.untangling.continuation import _Stall


def test_continuations_are_limited():
    mesh = meshes.jittered(8, 7, 0.9, 1)
    options = UntangleOptions(max_continuations=1, max_iterations=2, size_sweeps=(20,), newton=None)
    moved, info = untangle(mesh, options)
    assert info.iterations.item() <= 2
    assert inverted(moved) > 0
    assert info.status.tolist() == [Status.ITERATION_LIMIT]


def test_what_no_longer_gets_better_ends_before_the_limit():
    mesh = meshes.hopeless()
    options = UntangleOptions(size_sweeps=(100,), max_continuations=100_000)
    moved, info = untangle(mesh, options)
    assert inverted(moved) > 0
    assert info.status.tolist() == [Status.STALLED]


def test_a_stalled_mesh_leaves_the_others_of_its_batch_alone():
    batch = [meshes.jittered(8, 7, 0.5, 0), meshes.hopeless(), meshes.jittered(8, 7, 0.9, 1)]
    moved, info = untangle(join(batch))
    assert info.status[1] == Status.STALLED
    for b, mesh in enumerate(batch):
        alone, by_itself = untangle(mesh)
        assert torch.equal(moved.split()[b].points, alone.points)
        for name in ("status", "iterations", "evaluations"):
            assert getattr(info, name)[b] == getattr(by_itself, name)


@pytest.mark.parametrize(
    ("before", "now", "stalls"),
    [
        ((-1.0, 10), (-0.95, 10), True),
        ((-1.0, 10), (-0.85, 10), False),  # the lowest determinant rises
        ((-1.0, 10), (-0.95, 8), False),  # fewer are inverted
        ((-1e-3, 10), (-1e-3, 10), False),  # within reach of epsilon
        ((-1.0, 10), (0.5, 0), False),
    ],
)
def test_a_mesh_stalls_when_it_gained_nothing_over_the_patience(before, now, stalls):
    options = UntangleOptions()
    stall = _Stall(3, options, torch.ones(1, dtype=torch.float64))
    row, eps = torch.tensor([1]), torch.tensor([1e-2], dtype=torch.float64)

    def ask(turn, lowest, count):
        return stall.reached(turn, row, eps, torch.tensor([lowest], dtype=torch.float64), torch.tensor([count])).item()

    assert not any(ask(turn, *before) for turn in range(options.stall_patience))
    assert ask(options.stall_patience, *now) is stalls


def test_the_steps_of_a_mesh_that_cannot_be_untangled_are_bounded_by_work():
    import meshes

    from torchmesh.status import Status
    from torchmesh.untangling.options import UntangleOptions
    from torchmesh.untangling.untangling import untangle

    mesh = meshes.grid(6, 6)
    points = mesh.points.clone()
    points[:, 0] = torch.where(mesh.fixed, -points[:, 0], points[:, 0])  # the boundary is inside out
    mesh = mesh.with_points(points)
    options = UntangleOptions(size_sweeps=(100,), max_iterations=10, work=1, least_steps=30, stall_depth=1e9)
    _, info = untangle(mesh, options)
    assert info.status.item() in (Status.ITERATION_LIMIT, Status.STALLED)
    assert int(info.iterations) <= 40
