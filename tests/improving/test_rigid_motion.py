"""Vertices that follow their body exactly, and layers that are named."""

import math

import meshes
import pytest
import torch
from exact import inverted

from torchmesh import DeformOptions, ImproveOptions, InvalidMeshError, MeshBatch, deform, join

CENTRE = torch.tensor([4.0, 5.0], dtype=torch.float64)


def channel() -> MeshBatch:
    return MeshBatch.from_arrays(*meshes.holed_arrays())


def around(mesh: MeshBatch, radius: float) -> torch.Tensor:
    return (mesh.points - CENTRE).norm(dim=1) < radius


def placed(points: torch.Tensor, degrees: float, shift: tuple[float, float]) -> torch.Tensor:
    return CENTRE + meshes.turned(points - CENTRE, degrees) + torch.tensor(shift, dtype=torch.float64)


@pytest.mark.parametrize("own_wall", [True, False])
@pytest.mark.parametrize(("degrees", "shift"), [(0.0, (3.0, 1.0)), (100.0, (0.0, 0.0)), (-40.0, (4.0, -1.0))])
def test_rigid_vertices_shift_and_turn_with_their_wall(degrees, shift, own_wall):
    mesh = channel()
    wall, near = around(mesh, 1.1), around(mesh, 2.8)
    assert int((near & ~wall).sum()) > 10
    goal = torch.where(wall[:, None], placed(mesh.points, degrees, shift), mesh.points)
    rigid = near if own_wall else near & ~wall
    after, report = deform(mesh, goal, rigid=rigid)
    report.check()
    assert inverted(after) == 0
    assert torch.allclose(after.points[near], placed(mesh.points, degrees, shift)[near], rtol=0, atol=1e-13)
    # The triangles of the body are those that they were, and all is as free as before.
    body = near[mesh.triangles].all(1)
    assert torch.equal(after.triangles[body], mesh.triangles[body])
    assert torch.equal(after.fixed, mesh.fixed)
    assert torch.equal(after.constrained_edges, mesh.constrained_edges)
    assert bool(report.report.certified[0])
    without, _ = deform(mesh, goal)
    assert not torch.allclose(without.points[near], after.points[near], atol=1e-3)


def test_a_body_in_a_batch_is_the_same_alone():
    mesh = channel()
    wall, near = around(mesh, 1.1), around(mesh, 2.8)
    goal = torch.where(wall[:, None], placed(mesh.points, 30.0, (2.0, 0.5)), mesh.points)
    other = meshes.ring()
    alone, _ = deform(mesh, goal, rigid=near)
    both, _ = deform(
        join([other, mesh]),
        torch.cat([other.points * 1.2, goal]),
        rigid=torch.cat([torch.zeros_like(other.fixed), near]),
    )
    assert torch.equal(both.split()[1].points, alone.points)


def test_a_wall_that_bends_and_a_body_without_one_are_refused_by_name():
    mesh = channel()
    wall, near = around(mesh, 1.1), around(mesh, 2.8)
    stretched = CENTRE + (mesh.points - CENTRE) * torch.tensor([1.3, 1.0])
    with pytest.raises(InvalidMeshError, match=r"rigid row .*bends"):
        deform(mesh, torch.where(wall[:, None], stretched, mesh.points), rigid=near)
    inner = (~mesh.fixed & ~around(mesh, 3.5)).nonzero().squeeze(1)
    touches = mesh.triangles[mesh.fixed[mesh.triangles].any(1)].unique()
    alone = torch.zeros_like(mesh.fixed)
    alone[inner[~torch.isin(inner, touches)][0]] = True
    with pytest.raises(InvalidMeshError, match="no edge joins"):
        deform(mesh, mesh.points, rigid=alone)
    with pytest.raises(InvalidMeshError, match="rigid must be"):
        deform(mesh, mesh.points, rigid=torch.ones(3))
    with pytest.raises(ValueError, match="rigid"):
        deform(mesh, mesh.points, rigid=near, options=DeformOptions(improve=ImproveOptions(topology="full")))


def layered() -> MeshBatch:
    """A ring whose inner wall has a layer of six rows."""
    points, triangles = meshes.ring_arrays(40, 14, 0.4, 1.3)
    plain = MeshBatch.from_arrays(points, triangles)
    radius = plain.points.norm(dim=1, keepdim=True)
    row = ((radius - 0.4) / (0.9 / 14)).round()
    low = 0.4 + 1e-3 * (1.4**row - 1) / 0.4
    far = 0.4 + 1e-3 * (1.4**6 - 1) / 0.4
    height = torch.where(row <= 6, low, far + (1.3 - far) * (row - 6) / 8)
    return plain.with_points(plain.points / radius * height)


@pytest.mark.parametrize("shapes", ["auto", "equilateral"])
def test_a_named_layer_follows_its_wall_and_is_held_on_arrival(shapes):
    mesh = layered()
    radius = mesh.points.norm(dim=1)
    low = radius < 0.4 + 1e-3 * (1.4**4 - 1) / 0.4
    inner = mesh.fixed & (radius < 0.5)
    turn = math.radians(25.0)
    matrix = torch.tensor([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]], dtype=torch.float64)
    there = mesh.points @ matrix + torch.tensor([0.1, 0.0])
    goal = torch.where(inner[:, None], there, mesh.points)
    options = DeformOptions(improve=ImproveOptions(shapes=shapes))
    after, report = deform(mesh, goal, options=options, layer="hole:1")
    report.check()
    assert torch.allclose(after.points[low], there[low], rtol=0, atol=1e-12)
    assert torch.equal(after.fixed, mesh.fixed)
    assert len(after.constrained_edges) == 0


def test_a_wall_without_a_layer_is_refused_by_name():
    mesh = channel()
    with pytest.raises(InvalidMeshError, match="no layer along hole:1"):
        deform(mesh, mesh.points, layer="hole:1")
    with pytest.raises(InvalidMeshError, match="no part 'hole:7'"):
        deform(mesh, mesh.points, layer="hole:7")
    with pytest.raises(InvalidMeshError, match=r"names no part.* warp FILE --list tells the box"):
        deform(mesh, mesh.points, layer="wing")
    for wrong in (3, ["hole:1", 3], torch.zeros(3)):
        with pytest.raises(TypeError, match="layer must be the name of a wall"):
            deform(mesh, mesh.points, layer=wrong)


def test_a_wall_of_quads_says_that_they_need_no_layer():
    mesh = meshes.quad_layers()
    for batch in (mesh, join([mesh, channel()])):
        with pytest.raises(InvalidMeshError, match=r"mesh 0: along hole:1 stand quads.* need no layer="):
            deform(batch, batch.points, layer="hole:1")
    with pytest.raises(InvalidMeshError, match="mesh 0: there is no layer along outer:1"):
        deform(mesh, mesh.points, layer="outer:1")
