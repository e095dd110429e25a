"""Slivers that lie below the precision of a mesh's coordinates are raised, and exact signs keep all upright."""

import meshes
import pytest
import torch
from exact import inverted

import torchmesh as tm
from torchmesh.mesh.measure import upright
from torchmesh.smoothing.raising import _centred, _flat, raised

HEIGHTS = [1e-9, 1e-16, 1e-18, 1e-30, 1e-160, 1e-300]


def fan(height: float, **more) -> tm.MeshBatch:
    """A square of four triangles, whose common vertex lies so high above the lower edge."""
    points = [[0.0, 0], [1, 0], [1, 1], [0, 1], [0.5, height]]
    return tm.MeshBatch.from_arrays(points, [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], **more)


def with_slivers(n: int = 12, every: int = 4) -> tm.MeshBatch:
    """A grid some of whose free vertices lie next to the middle of an opposite edge."""
    mesh = meshes.grid(n, n)
    points = mesh.points.clone()
    for vertex in range(every * (n + 1) + every, len(points) - n - 1, every * (n + 1)):
        for v in range(vertex, vertex + n - 2 * every + 1, every):
            row = next(t for t in mesh.triangles.tolist() if v in t)
            k = row.index(v)
            a, b = points[row[k - 2]], points[row[k - 1]]
            inward = torch.stack([a[1] - b[1], b[0] - a[0]])
            places = [0.5 * (a + b) + height * inward for height in (0.0, 1e-17, 1e-16, 1e-15, 1e-14)]
            points[v] = next(place for place in places if _fits(mesh, points, v, place))
    return mesh.with_points(points)


def _fits(mesh, points, vertex, place):
    there = points.clone()
    there[vertex] = place
    return bool(upright(mesh.with_points(there)).all())


@pytest.mark.parametrize("height", HEIGHTS)
def test_a_sliver_of_any_height_is_raised_within_its_star(height):
    mesh, all_of_it = fan(height), torch.tensor([True])
    after = raised(mesh, ~mesh.fixed, all_of_it)
    assert torch.equal(after.points[mesh.fixed], mesh.points[mesh.fixed])
    assert inverted(after) == 0
    assert (float(after.points[4, 1]) > 0.01) == (height < 1e-12)
    assert not bool(_flat(_centred(after)[after.triangles]).any()) or height > 1e-12


def test_many_slivers_are_raised_and_other_vertices_and_meshes_stay():
    mesh = with_slivers()
    flat = _flat(_centred(mesh)[mesh.triangles])
    assert int(flat.sum()) >= 4
    both = tm.join([mesh, mesh])
    after = raised(both, ~both.fixed, torch.tensor([False, True]))
    first, second = after.split()
    assert torch.equal(first.points, mesh.points)
    assert inverted(second) == 0
    assert not bool(_flat(_centred(second)[second.triangles]).any())
    assert bool(
        (second.points == mesh.points).all(1)[~torch.isin(torch.arange(len(mesh.points)), mesh.triangles[flat])].all()
    )


@pytest.mark.filterwarnings("ignore:.*belong to no triangle")
def test_a_vertex_of_no_triangle_may_be_anywhere():
    mesh = fan(1e-18)
    far = tm.MeshBatch.from_arrays(torch.cat([mesh.points, torch.full((1, 2), 1e20).double()]), mesh.triangles)
    assert torch.equal(_centred(far)[:5], _centred(mesh))
    after, _ = tm.smooth(far)
    assert torch.equal(after.points[:5], tm.smooth(mesh)[0].points)
    assert tm.quality(after).max[0] < 1.1548


def test_what_is_held_stays_flat():
    mesh = fan(1e-18)
    assert torch.equal(raised(mesh, torch.zeros_like(mesh.fixed), torch.tensor([True])).points, mesh.points)
