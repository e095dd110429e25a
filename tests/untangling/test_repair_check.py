"""The check of a repair notices every kind of damage."""

import dataclasses

import numpy as np
import torch
from cavities import make, region_mesh, whole

from torchmesh.untangling.repair_check import why_not_certified
from torchmesh.untangling.retriangulation import retriangulate


def test_the_check_notices_every_kind_of_damage():
    points, triangles, _, interface = region_mesh()
    mesh = make(points, triangles, constrained_edges=interface)
    everything = whole(mesh)
    assert why_not_certified(mesh, mesh, everything) == ""
    mirrored = mesh.with_points(mesh.points * torch.tensor([-1.0, 1.0], dtype=torch.float64))
    assert "inverted" in why_not_certified(mirrored, mirrored, everything)
    twice = mesh.with_triangles(torch.cat([mesh.triangles[:1], mesh.triangles[:-1]]))
    assert "same way" in why_not_certified(mesh, twice, everything)
    assert "fixed" in why_not_certified(mesh, mesh.with_points(mesh.points + 1), everything)
    other = make(points, triangles)
    flipped = retriangulate(other, everything, keep=torch.zeros(len(points), dtype=torch.bool)).mesh
    flipped = mesh.with_points(flipped.points).with_triangles(flipped.triangles)
    assert "constrained edge" in why_not_certified(mesh, flipped, everything)
    five = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0.5]])
    before = make(five, [[0, 1, 2], [0, 2, 3], [1, 4, 2]])
    after = before.with_triangles(torch.tensor([[0, 1, 2], [0, 2, 3], [1, 4, 3]]))
    assert "boundary" in why_not_certified(before, after, whole(after))
    two_inside = np.array([[0, 0], [4, 0], [0, 4], [1, 1], [2, 1]], float)
    before = make(two_inside, [[0, 1, 3], [1, 2, 4], [2, 0, 3], [3, 1, 4], [3, 4, 2]])
    after = dataclasses.replace(before, triangles=torch.tensor([[0, 1, 3], [1, 2, 3], [2, 0, 3]]))
    assert "4 vertices are in 3 triangles" in why_not_certified(before, after, whole(after))
