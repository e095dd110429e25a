"""The local median shape: what it is for one shape throughout, and that a few bad triangles do not move it."""

import meshes
import pytest
import torch

import torchmesh as tm
from torchmesh.mesh.measure import quality
from torchmesh.mesh.triangle import corners, inverse_mean_ratio
from torchmesh.optimising.median_metric import MedianOptions, median_metric, ratio_in, triangle_metrics
from torchmesh.optimising.metric_tensors import determinant
from torchmesh.optimising.targets import target_quality

STRETCH = torch.tensor([[4.0, 0.0], [0.0, 1.0]], dtype=torch.float64)


def every(mesh):
    return torch.ones(len(mesh.triangles), dtype=torch.bool)


def test_in_its_own_metric_a_triangle_is_equilateral_and_in_the_plane_it_has_its_ratio():
    mesh = meshes.delaunay(60, 2)
    metric = triangle_metrics(mesh)
    torch.testing.assert_close(determinant(metric), torch.ones(len(metric), dtype=torch.float64))
    own = ratio_in(metric, metric)
    torch.testing.assert_close(own, torch.ones_like(own), rtol=0, atol=1e-9 * float(metric.square().max()))
    plane = torch.tensor([[1.0, 0.0, 1.0]], dtype=torch.float64).expand_as(metric)
    t = corners(mesh.points, mesh.triangles)
    torch.testing.assert_close(ratio_in(metric, plane), inverse_mean_ratio(t), rtol=1e-12, atol=0)
    # The slow twin: a constant metric field.
    seen = torch.tensor([[2.0, 0.3, 0.8]], dtype=torch.float64)
    seen = (seen / determinant(seen).sqrt()).expand(len(mesh.points), 3)
    expected = target_quality(mesh, tm.MetricField(seen))
    torch.testing.assert_close(ratio_in(metric, seen[:1].expand_as(metric)), expected, rtol=1e-10, atol=0)


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_a_mesh_of_one_shape_has_that_shape_as_its_median(turn):
    angle = torch.tensor(turn, dtype=torch.float64)
    turned = torch.stack([torch.stack([angle.cos(), angle.sin()]), torch.stack([-angle.sin(), angle.cos()])])
    plain = meshes.equilateral(8, 7)
    mesh = plain.with_points(plain.points @ STRETCH @ turned)
    metric = median_metric(mesh, every(mesh))
    torch.testing.assert_close(metric, triangle_metrics(mesh)[:1].expand_as(metric))
    assert float(target_quality(mesh, tm.MetricField(metric)).max()) == pytest.approx(1.0)


def test_a_few_bad_triangles_do_not_move_the_median():
    plain = meshes.disturbed(meshes.equilateral(12, 11), 0.05, 0)
    mesh = plain.with_points(plain.points @ STRETCH)
    points = mesh.points.clone()
    row = 6 * 12 + 5
    points[row] += torch.tensor([3.3, 0.8])
    bad = mesh.with_points(points)
    upright = quality(bad).upright
    ratio = target_quality(bad, tm.MetricField(median_metric(bad, upright)))
    round_it = (bad.triangles == row).any(1)
    assert float(ratio[~round_it].max()) < 1.5
    assert bool((~upright | (ratio > 3))[round_it].any())
    # The mean would follow the worst of them.
    assert float(quality(bad).inverse_mean_ratio[~round_it].min()) > 1.5


def test_the_median_stretches_with_the_mesh():
    mesh = meshes.delaunay(80, 4)
    stretched = mesh.with_points(mesh.points @ STRETCH)
    before = target_quality(mesh, tm.MetricField(median_metric(mesh, every(mesh), MedianOptions(rounds=60))))
    after = target_quality(
        stretched, tm.MetricField(median_metric(stretched, every(stretched), MedianOptions(rounds=60)))
    )
    torch.testing.assert_close(before, after, rtol=2e-2, atol=0)


def test_the_median_in_a_batch_is_that_alone():
    parts = [meshes.delaunay(50, 1), meshes.jittered(), meshes.ring()]
    whole = tm.join(parts)
    found = median_metric(whole, quality(whole).upright).split([len(m.points) for m in parts])
    for mesh, metric in zip(parts, found, strict=True):
        assert torch.equal(median_metric(mesh, quality(mesh).upright), metric)


def test_where_no_triangle_counts_the_metric_is_that_of_the_plane():
    mesh = meshes.grid()
    metric = median_metric(mesh, ~every(mesh))
    assert torch.equal(metric, torch.tensor([[1.0, 0.0, 1.0]], dtype=torch.float64).expand(len(mesh.points), 3))
    with pytest.raises(ValueError, match=r"MedianOptions.sweeps must be at least 1"):
        MedianOptions(sweeps=0)
