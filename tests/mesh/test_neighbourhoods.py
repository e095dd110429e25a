import meshes
import torch

import torchmesh as tm
from torchmesh.mesh.neighbourhoods import rewired, surroundings


def test_surroundings_are_rings_of_vertices_by_breadth_first_search():
    mesh = tm.join([meshes.grid(8, 8), meshes.disc()])
    start = torch.arange(len(mesh.triangles)) == 60
    neighbours: dict[int, set[int]] = {}
    for t in mesh.triangles.tolist():
        for v in t:
            neighbours.setdefault(v, set()).update(t)
    expected = set(mesh.triangles[60].tolist())
    for rings in range(1, 5):
        assert set(surroundings(mesh, start, rings).nonzero().flatten().tolist()) == expected
        expected = set().union(*(neighbours[v] for v in expected))
    # The search has not reached the other mesh, nor all of its own.
    assert len(expected) < len(mesh.split()[0].points)


def test_the_corners_of_other_triangles_are_rewired():
    mesh = meshes.grid(4, 4)
    triangles = mesh.triangles.clone()
    triangles[3] = triangles[3].roll(1)
    assert not bool(rewired(mesh, mesh).any())
    found = rewired(mesh, mesh.with_triangles(triangles)).nonzero().flatten().tolist()
    assert found == sorted(mesh.triangles[3].tolist())
