"""Rounded positions: as good as the others, and the same after a change in the last digits."""

import meshes
import torch
from exact import inverted

from torchmesh import MeshBatch, improve, join
from torchmesh.mesh.rounding import rounded, unrounded


def every(mesh: MeshBatch) -> torch.Tensor:
    return torch.ones(len(mesh), dtype=torch.bool)


def test_positions_change_by_little_and_nothing_inverts():
    for mesh in (meshes.delaunay(), meshes.ring(), meshes.equilateral()):
        found = rounded(mesh, every(mesh))
        assert inverted(found) == 0
        assert 0 < float((found.points - mesh.points).abs().max()) < 1e-4
        # The grid is a power of two, so that positions on it stay.
        assert torch.equal(rounded(found, every(mesh)).points, found.points)


def test_a_change_of_rounding_vanishes():
    mesh = meshes.delaunay(200, 4)
    shifted = mesh.with_points(mesh.points + 1e-14 * torch.randn(mesh.points.shape, dtype=torch.float64))
    assert not torch.equal(mesh.points, shifted.points)
    assert torch.equal(rounded(mesh, every(mesh)).points, rounded(shifted, every(mesh)).points)
    first, second = (improve(m)[0] for m in (mesh, shifted))
    assert torch.equal(first.triangles, second.triangles)
    assert torch.allclose(first.points, second.points, rtol=0, atol=1e-12)


def test_a_mesh_that_would_invert_and_one_that_was_not_asked_for_stay():
    good = meshes.delaunay()
    points, triangles = good.points.clone(), good.triangles
    flat = MeshBatch.from_arrays(points, triangles)
    both = join([flat, good])
    found = rounded(both, torch.tensor([True, False]))
    assert torch.equal(found.split()[1].points, good.points)
    back = unrounded(found, found, both, torch.zeros_like(both.fixed))
    assert torch.equal(back.points, both.points)
