"""Untangle-beta pushes triangles up to the area beta, and nothing else."""

import meshes
import pytest
import torch
from exact import inverted
from tangles import MENDABLE, METHODS

from torchmesh import MeshBatch, UntangleOptions, join, quality, untangle
from torchmesh.mesh.triangle import corners, signed_area
from torchmesh.untangling.beta import usual_area


def smallest_share(mesh):
    """The smallest area in units of the mean of |area|."""
    area = quality(mesh).area
    return (area.min() / area.abs().mean()).item()


def test_beta_is_the_area_that_triangles_are_pushed_to():
    mesh = MENDABLE["lightly jittered"]()
    mean = quality(mesh).area.abs().mean().item()
    for beta in (0.01, 0.1, 0.3):
        moved, info = untangle(mesh, UntangleOptions("beta", beta=beta, max_iterations=3000))
        lack = (beta * mean - quality(moved).area).clamp_min(0) / mean
        moving = (~mesh.fixed)[mesh.triangles].any(1)
        assert info.energy.item() == pytest.approx(lack[moving].square().sum().item(), abs=1e-12)
        # The minimum is zero: every triangle gets its beta, up to the root of what the stopping test leaves.
        assert quality(moved).area.min().item() / mean > 0.9 * beta


def test_beta_is_relative_to_the_mesh_and_absolute_on_request():
    mesh = MENDABLE["jittered"]()
    doubled = mesh.with_points(2 * mesh.points)
    mean = quality(mesh).area.abs().mean().item()
    relative = UntangleOptions("beta", beta=0.2)
    assert torch.equal(untangle(doubled, relative)[0].points, 2 * untangle(mesh, relative)[0].points)
    same, four_times = (UntangleOptions("beta", absolute_beta=f * 0.2 * mean, max_iterations=3000) for f in (1, 4))
    assert torch.equal(untangle(doubled, four_times)[0].points, 2 * untangle(mesh, same)[0].points)
    # On the doubled mesh the same number asks for a quarter.
    little, much = (quality(untangle(doubled, o)[0]).area.min().item() / (4 * mean) for o in (same, four_times))
    assert little == pytest.approx(0.05, rel=0.15)
    assert much == pytest.approx(0.2, rel=0.15)


def test_beta_leaves_alone_what_is_larger_already():
    # One vertex is thrown; the far triangles have all their area.
    mesh = meshes.grid(10, 10)
    points = mesh.points.clone()
    points[60] = torch.tensor([0.72, 0.55])
    tangled = mesh.with_points(points)
    assert inverted(tangled) > 0
    moved, _ = untangle(tangled, UntangleOptions("beta", beta=0.1))
    assert inverted(moved) == 0
    near = set(mesh.triangles[quality(tangled).area < 0.1 * 0.005].reshape(-1).tolist())
    changed = set((moved.points != tangled.points).any(1).nonzero().squeeze(1).tolist())
    # Who is pushed pushes its neighbours; two rings around the tangle are all that can have moved.
    for _ in range(2):
        near |= {v for row in mesh.triangles.tolist() if near & set(row) for v in row}
    assert changed
    assert changed <= near


def test_meshes_of_a_batch_keep_their_own_beta():
    mesh = MENDABLE["jittered"]()
    batch = join([mesh, MeshBatch.from_arrays(1000 * mesh.points, mesh.triangles)])
    moved, _ = untangle(batch, METHODS["beta"])
    assert [inverted(m) for m in moved.split()] == [0, 0]


def graded_tangle():
    """A grid whose columns grow twentyfold from left to right, with a vertex of the wide part pulled across."""
    mesh = meshes.grid(120, 6)
    t = mesh.points / mesh.points.amax(0)
    points = torch.stack([t[:, 0] + 20 * t[:, 0] ** 4, t[:, 1]], 1)
    inner = ((~mesh.fixed) & (t[:, 0] > 0.9)).nonzero().squeeze(1)
    points[inner[5], 0] += 3
    return mesh.with_points(points)


def test_local_beta_counts_in_what_is_usual_nearby():
    mesh = graded_tangle()
    mean = float(signed_area(corners(mesh.points, mesh.triangles)).abs().mean())
    usual = usual_area(mesh, UntangleOptions("beta", local=True))
    x = mesh.points[:, 0][mesh.triangles].mean(1)
    assert torch.allclose(usual_area(mesh, UntangleOptions("beta")), torch.tensor(mean, dtype=torch.float64))
    assert bool((usual <= mean * (1 + 1e-12)).all())
    assert float(usual[x < 0.2].max()) < 0.3 * mean
    assert float(usual[x > 15].min()) == pytest.approx(mean)


def test_reach_bounds_what_moves():
    mesh = meshes.grid(12, 12)
    points = mesh.points.clone()
    vertex = int((~mesh.fixed).nonzero()[30])
    points[vertex] += torch.tensor([1.6, 0.3])
    mesh = mesh.with_points(points)
    counts = []
    for reach in (1, 2, None):
        moved, _ = untangle(mesh, UntangleOptions("beta", beta=0.3, reach=reach, max_iterations=30))
        counts.append(int((moved.points != mesh.points).any(1).sum()))
    assert 0 < counts[0] < counts[1] <= counts[2]
