import meshes
import pytest
import torch

import torchmesh as tm
from torchmesh.mesh.means import Means, sums_at_vertices, vertex_size


def test_vertex_size_is_the_root_mean_square_edge():
    assert vertex_size(meshes.equilateral(side=3.0)).tolist() == pytest.approx([3.0] * 30, rel=1e-14)


@pytest.mark.parametrize("shape", [(), (3,)])
def test_sums_are_those_of_a_loop_over_the_elements(shape, rng):
    mesh = meshes.l_shape(2)
    values = torch.from_numpy(rng.normal(size=(len(mesh.triangles), *shape)))
    expected = torch.zeros((len(mesh.points), *shape), dtype=torch.float64)
    for triangle, value in zip(mesh.triangles.tolist(), values, strict=True):
        for v in triangle:
            expected[v] += value
    # Seven numbers of size one at most, in another order.
    torch.testing.assert_close(sums_at_vertices(mesh.triangles, values, len(mesh.points)), expected, rtol=0, atol=1e-14)


def test_sums_and_means_do_not_depend_on_the_rest_of_the_batch(rng):
    parts = [meshes.l_shape(2), meshes.jittered(), meshes.ring()]
    batch = tm.join(parts)
    values = torch.from_numpy(rng.normal(size=len(batch.triangles)))
    pieces = values.split([len(m.triangles) for m in parts])
    alone = [sums_at_vertices(m.triangles, v, len(m.points)) for m, v in zip(parts, pieces, strict=True)]
    assert torch.equal(sums_at_vertices(batch.triangles, values, len(batch.points)), torch.cat(alone))
    alone = [Means(m).round_vertices(v) for m, v in zip(parts, pieces, strict=True)]
    assert torch.equal(Means(batch).round_vertices(values), torch.cat(alone))


def test_means_are_zero_only_where_there_is_no_triangle():
    mesh = meshes.grid(3, 3)
    means = Means(mesh)
    ones = torch.ones(len(mesh.triangles), dtype=torch.float64)
    assert torch.equal(means.round_vertices(ones), torch.ones(len(mesh.points), dtype=torch.float64))
    x = mesh.points[:, 0].contiguous()
    torch.testing.assert_close(means.of_corners(x), x[mesh.triangles].mean(1), rtol=1e-15, atol=0)
    with pytest.warns(tm.MeshWarning, match="belong to no triangle"):
        lonely = tm.MeshBatch.from_arrays([[0, 0], [1, 0], [0, 1], [5, 5]], [[0, 1, 2]])
    assert Means(lonely).round_vertices(torch.ones(1, dtype=torch.float64)).tolist() == [1, 1, 1, 0]
    assert vertex_size(lonely)[3] == 0
