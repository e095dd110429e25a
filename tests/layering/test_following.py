"""Layers follow their walls rigidly, and where nothing moves they keep their bits."""

import numpy as np
import torch
from layered import flat_layer, round_body, turned_body

from torchmesh.layering.following import follow_walls
from torchmesh.layering.layers import find_layers


def test_a_rigid_motion_of_the_wall_is_that_of_its_layer():
    mesh = round_body()
    moved = turned_body(mesh, 24, 37.0, (0.4, -1.3))
    layers = find_layers(mesh)
    new = follow_walls(layers, mesh.points, moved.points)
    angle = np.radians(37.0)
    turn = torch.tensor([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    want = mesh.points @ turn + torch.tensor([0.4, -1.3], dtype=torch.float64)
    rows = layers.vertices(len(mesh.points))
    assert int(rows.sum()) >= 24 * 6
    assert torch.allclose(new[rows], want[rows], rtol=0, atol=1e-14)
    assert torch.equal(new[~rows], moved.points[~rows])


def test_heights_stay_where_a_wall_bends():
    mesh = flat_layer(columns=20, rows=12)
    points = mesh.points.clone()
    points[:21, 1] += 0.2 * torch.sin(3 * points[:21, 0])
    layers = find_layers(mesh)
    new = follow_walls(layers, mesh.points, points)
    rows = layers.vertices(len(points)).nonzero().squeeze(1)
    foot = rows % 21
    before = (mesh.points[rows] - mesh.points[foot]).norm(dim=1)
    assert torch.allclose((new[rows] - points[foot]).norm(dim=1), before, rtol=1e-9)


def test_what_does_not_move_keeps_its_bits():
    mesh = round_body(sides=30)
    points = mesh.points.clone()
    points[:15, 0] += 0.25
    layers = find_layers(mesh)
    new = follow_walls(layers, mesh.points, points)
    # The columns whose two wall edges both rest: those over the vertices 16 to 28.
    rest = torch.isin(torch.arange(len(points)) % 30, torch.arange(16, 29)) & layers.vertices(len(points))
    assert int(rest.sum()) > 60
    assert torch.equal(new[rest], mesh.points[rest])


def test_a_mesh_without_layers_is_as_it_was_moved():
    mesh = flat_layer()
    none = find_layers(mesh).select(torch.zeros(len(find_layers(mesh)), dtype=torch.bool))
    assert torch.equal(follow_walls(none, mesh.points, mesh.points + 1), mesh.points + 1)
