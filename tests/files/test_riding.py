"""Values that ride while a mesh follows its boundary, and stay in their places while it is smoothed."""

import meshes
import torch

from torchmesh import MeshBatch, deform, quality
from torchmesh.files.riding import RidingTransfer, traced_back


def carried(mesh: MeshBatch, goal: torch.Tensor):
    """The mesh at the goal, and the steps in which its values rode."""
    after, report = deform(mesh, goal, trail="apart")
    report.check()
    assert report.trail is not None
    return after, [(p.before, p.after) for p in report.trail[0] if p.end > p.start]


def test_a_mesh_that_shifts_as_a_whole_is_traced_back_by_the_shift():
    for mesh in (meshes.jittered(cells=0.3), meshes.mixed(8, 7, 3)):
        shift = torch.tensor([3.0, 1.0])
        after, steps = carried(mesh, mesh.points + shift)
        back = traced_back(after, steps)
        assert not torch.allclose(after.points, mesh.points + shift, rtol=0, atol=1e-3), "it was smoothed on arrival"
        assert torch.allclose(back.points, after.points - shift, rtol=0, atol=1e-12)
        assert torch.equal(back.points[mesh.fixed], mesh.points[mesh.fixed])


def test_many_steps_and_flips_keep_constants_and_what_is_on_the_boundary():
    mesh = MeshBatch.from_arrays(*meshes.holed_arrays())
    on_hole = (mesh.points - torch.tensor([4.0, 5.0])).norm(dim=1) < 1.1
    goal = torch.where(on_hole[:, None], mesh.points + torch.tensor([5.0, 0.3]), mesh.points)
    after, steps = carried(mesh, goal)
    assert len(steps) > 1
    assert not torch.equal(after.triangles, mesh.triangles)
    transfer = RidingTransfer(steps, mesh, after, "interpolate")
    x = mesh.points[:, 0].double().numpy()
    made = transfer.at_points("x", x, torch.arange(len(x)).numpy())
    assert (made[mesh.fixed.numpy()] == x[mesh.fixed.numpy()]).all()
    assert x.min() <= made.min() <= made.max() <= x.max()
    ones = torch.ones(len(mesh.triangles), dtype=torch.float64).numpy()
    assert abs(transfer.in_triangles("one", ones) - 1).max() < 1e-12
    assert (transfer.summary.interpolated, transfer.summary.averaged) == (["x"], ["one"])


def test_without_smoothing_all_comes_back_to_the_bit():
    mesh = meshes.equilateral()
    end = mesh.with_points(mesh.points * 2)
    assert torch.equal(traced_back(end, [(mesh, end)]).points, mesh.points.double())
    assert RidingTransfer([(mesh, end)], mesh, end, "interpolate").unchanged
    assert int(quality(end).inverted[0]) == 0
