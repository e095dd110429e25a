"""Motions there and back: with a reference a mesh comes back as it was."""

import meshes
import pytest
import torch
from exact import inverted

from torchmesh import Bound, DeformOptions, InvalidMeshError, MeshBatch, deform, join, minimum_angle


def channel() -> MeshBatch:
    return MeshBatch.from_arrays(*meshes.holed_arrays())


def at(mesh: MeshBatch, right: float) -> torch.Tensor:
    on_hole = (mesh.points - torch.tensor([4.0, 5.0])).norm(dim=1) < 1.1
    return torch.where(on_hole[:, None], mesh.points + torch.tensor([right, 0.0]), mesh.points)


def there_and_back(mesh: MeshBatch, options: DeformOptions) -> MeshBatch:
    now = mesh
    for right in (3.0, 6.0, 9.0, 6.0, 3.0, 0.0):
        now, report = deform(now, at(mesh, right), options=options)
        report.check()
        assert inverted(now) == 0
    return now


def test_with_the_undeformed_mesh_as_reference_a_mesh_comes_back_as_it_was():
    mesh = channel()
    bound = Bound(angle=12.0)
    assert float(minimum_angle(mesh)[0]) > 12
    without = there_and_back(mesh, DeformOptions(when=bound))
    assert not torch.equal(without.triangles, mesh.triangles)
    back = there_and_back(mesh, DeformOptions(reference=mesh, when=bound))
    assert torch.equal(back.triangles, mesh.triangles)
    assert torch.allclose(back.points, mesh.points, rtol=0, atol=1e-12)


def test_where_the_reference_is_not_good_a_mesh_is_improved_as_without():
    mesh = channel()
    goal = at(mesh, 9.5)
    bound = Bound(angle=20.0)
    plain, _ = deform(mesh, goal, options=DeformOptions(when=bound))
    after, report = deform(mesh, goal, options=DeformOptions(when=bound, reference=mesh))
    report.check()
    assert torch.equal(after.triangles, plain.triangles)
    assert torch.equal(after.points, plain.points)


def test_each_mesh_of_a_batch_takes_its_own_reference():
    first, second = channel(), meshes.ring()
    batch = join([first, second])
    goal = torch.cat([at(first, 0.5), second.points * 1.3])
    both, _ = deform(batch, goal, options=DeformOptions(reference=batch))
    for mesh, target, whole in zip((first, second), (at(first, 0.5), second.points * 1.3), both.split(), strict=True):
        alone, _ = deform(mesh, target, options=DeformOptions(reference=mesh))
        assert torch.equal(whole.points, alone.points)
        assert torch.equal(whole.triangles, alone.triangles)


def test_another_mesh_is_no_reference():
    mesh = channel()
    with pytest.raises(InvalidMeshError, match="numbers of vertices"):
        deform(mesh, mesh.points, options=DeformOptions(reference=meshes.ring()))
    turned = mesh.with_triangles(mesh.triangles.flip(0))
    deform(mesh, mesh.points, options=DeformOptions(reference=turned))
