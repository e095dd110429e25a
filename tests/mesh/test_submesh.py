import meshes
import torch

import torchmesh as tm
from torchmesh.mesh.batch import vertex_mesh
from torchmesh.mesh.connectivity import touching
from torchmesh.mesh.neighbourhoods import surroundings
from torchmesh.mesh.submesh import picked, repeated, submesh


def test_a_submesh_has_the_triangles_asked_for_where_they_were():
    batch = tm.join([meshes.l_shape(2), meshes.jittered(), meshes.grid(3, 2)])
    asked = torch.zeros(len(batch.triangles), dtype=torch.bool)
    asked[[0, 1, 5]] = asked[batch.triangle_offsets[1] + 7] = True
    cut = submesh(batch, asked)
    assert len(cut.mesh) == 3
    assert torch.equal(cut.triangles, asked.nonzero().squeeze(1))
    assert torch.equal(cut.mesh.points[cut.mesh.triangles], batch.points[batch.triangles[asked]])
    assert torch.equal(cut.mesh.fixed, batch.fixed[cut.vertices])
    assert sorted(set(cut.mesh.triangles.flatten().tolist())) == list(range(len(cut.vertices)))
    assert torch.diff(cut.mesh.triangle_offsets).tolist() == [3, 1, 0]
    assert torch.diff(cut.mesh.point_offsets)[2] == 0


def test_constrained_edges_stay_where_both_of_their_ends_do():
    batch = meshes.l_shape(3)
    assert len(batch.constrained_edges) > 1
    edge = batch.constrained_edges[0]
    asked = (batch.triangles[:, :, None] == edge).any(1).sum(1) == 2
    cut = submesh(batch, asked)
    present = set(cut.vertices.tolist())
    expected = [e for e in batch.constrained_edges.tolist() if set(e) <= present]
    assert cut.vertices[cut.mesh.constrained_edges].tolist() == expected
    assert edge.tolist() in expected
    assert len(expected) < len(batch.constrained_edges)


def test_vertices_without_triangles_come_along_when_they_are_named():
    batch = meshes.grid(3, 3)
    asked = torch.arange(len(batch.triangles)) == 0
    cut = submesh(batch, asked, torch.ones(len(batch.points), dtype=torch.bool))
    assert torch.equal(cut.mesh.points, batch.points)
    assert torch.equal(cut.mesh.triangles, batch.triangles[:1])


def test_what_is_put_back_is_where_it_was_and_the_rest_is_as_it_was():
    batch = tm.join([meshes.jittered(), meshes.l_shape(2)])
    damage = torch.arange(len(batch.triangles)) == 40
    near = surroundings(batch, damage, 2)
    cut = submesh(batch, touching(batch.triangles, near))
    assert 0 < len(cut.triangles) < len(batch.triangles) // 2
    same = cut.put_back(batch, cut.mesh)
    assert torch.equal(same.points, batch.points)
    assert torch.equal(same.triangles, batch.triangles)
    moved = cut.put_back(batch, cut.mesh.with_points(cut.mesh.points + 1).with_triangles(cut.mesh.triangles.roll(1, 1)))
    changed = torch.zeros(len(batch.points), dtype=torch.bool)
    changed[cut.vertices] = True
    assert torch.equal(moved.points, torch.where(changed[:, None], batch.points + 1, batch.points))
    assert torch.equal(moved.triangles[cut.triangles], batch.triangles[cut.triangles].roll(1, 1))
    others = torch.ones(len(batch.triangles), dtype=torch.bool)
    others[cut.triangles] = False
    assert torch.equal(moved.triangles[others], batch.triangles[others])


def test_copies_are_copies():
    batch = tm.join([meshes.l_shape(2), meshes.grid(2, 2), meshes.l_shape(1)])
    owner = torch.tensor([0, 0, 1, 2, 2, 2])
    parts = batch.split()
    for copy, b in zip(repeated(batch, owner).split(), owner.tolist(), strict=True):
        for name in ("points", "triangles", "fixed", "constrained_edges"):
            assert torch.equal(getattr(copy, name), getattr(parts[b], name)), name


def test_one_copy_of_each_mesh_is_picked():
    batch = tm.join([meshes.l_shape(2), meshes.grid(2, 2)])
    copies = repeated(batch, torch.tensor([0, 0, 1, 1, 1]))
    numbered = copies.with_points(copies.points + vertex_mesh(copies)[:, None])
    chosen = picked(numbered, torch.tensor([1, 4]), batch)
    assert torch.equal(chosen.points, batch.points + torch.tensor([1, 4])[vertex_mesh(batch)][:, None])
    assert torch.equal(chosen.triangles, batch.triangles)
