"""Remeshing in a metric does in the plane what it would do in the plane mapped by the metric's root."""

import math

import meshes
import pytest
import torch
from exact import boundary, inverted, total_area

import torchmesh as tm
from torchmesh import MetricField, RemeshOptions, SmoothOptions, target_quality
from torchmesh.mesh import connectivity
from torchmesh.remeshing.metric_sizing import (
    metric_conformity,
    metric_lengths,
    metric_quality,
    metric_size_field,
    unit_metric,
)
from torchmesh.remeshing.mutable import fan_quality, length

ASPECT = 4.0


def along_x(positions: torch.Tensor) -> torch.Tensor:
    """The metric in which triangles four times as long along x are equilateral."""
    return torch.tensor([1 / ASPECT, 0, ASPECT], dtype=torch.float64).expand(len(positions), 3)


def wide(cells: int = 10) -> tm.MeshBatch:
    """A rectangle of 4 by 1."""
    mesh = meshes.grid(cells, cells)
    return mesh.with_points(mesh.points * torch.tensor([4.0, 1.0]))


def square_of(mesh: tm.MeshBatch) -> tm.MeshBatch:
    """`mesh` mapped by the root of that metric: lengths are there what the metric says they are."""
    return mesh.with_points(mesh.points * torch.tensor([ASPECT**-0.5, ASPECT**0.5], dtype=torch.float64))


def test_lengths_sizes_and_shapes_are_those_of_the_mapped_plane():
    mesh = meshes.disturbed(wide(), 0.02, 0)
    mapped, metric = square_of(mesh), along_x(mesh.points)
    edges = connectivity.edges(mesh.triangles, connectivity.twins(mesh.triangles))
    plain = (mapped.points[edges[:, 0]] - mapped.points[edges[:, 1]]).norm(dim=1)
    torch.testing.assert_close(metric_lengths(mesh, edges, metric), plain, rtol=1e-13, atol=0)
    wanted = torch.tensor([len(mesh.triangles)])
    for sizes in ("keep", "uniform"):
        torch.testing.assert_close(
            metric_size_field(mesh, sizes, metric, wanted), tm.size_field(mapped, sizes), rtol=1e-12, atol=0
        )
    torch.testing.assert_close(
        metric_quality(mesh, metric).inverse_mean_ratio, tm.quality(mapped).inverse_mean_ratio, rtol=1e-12, atol=0
    )
    size = tm.size_field(mapped, "uniform")
    ours, theirs = metric_conformity(mesh, size, metric), tm.size_conformity(mapped, size)
    for name in ("mean", "low", "high"):
        torch.testing.assert_close(getattr(ours, name), getattr(theirs, name), rtol=1e-12, atol=0)


def test_sizes_of_the_boundary_reach_inwards_and_never_beyond_its_own():
    mesh = meshes.disturbed(wide(), 0.02, 1)
    metric = along_x(mesh.points)
    size = metric_size_field(mesh, "boundary", metric, torch.tensor([len(mesh.triangles)]))
    boundary = connectivity.boundary_edges(mesh.triangles, connectivity.twins(mesh.triangles))
    known = metric_lengths(mesh, boundary, metric)
    assert float(size.min()) >= float(known.min()) * (1 - 1e-12)
    assert float(size.max()) <= float(known.max()) * (1 + 1e-12)
    edges = connectivity.edges(mesh.triangles, connectivity.twins(mesh.triangles))
    total, number = torch.zeros_like(size), torch.zeros_like(size)
    for u, w in edges.tolist():
        for a, b in ((u, w), (w, u)):
            total[a] += size[b]
            number[a] += 1
    free = ~mesh.fixed
    torch.testing.assert_close((total / number)[free], size[free], rtol=1e-10, atol=0)


def test_fans_and_steps_without_a_metric_are_those_of_the_plane(rng):
    p, a, b = torch.tensor(rng.normal(size=(3, 2, 50)))
    plane = torch.tensor([1.0, 0.0, 1.0], dtype=torch.float64).expand(50, 3)
    torch.testing.assert_close(
        fan_quality(*p, *a, *b, 3 * plane), fan_quality(*p, *a, *b), rtol=1e-13, atol=0, equal_nan=True
    )
    torch.testing.assert_close(length(*p, plane), length(*p), rtol=1e-14, atol=0)
    root = torch.tensor([[1.5, 0.4], [0.4, 0.9]], dtype=torch.float64)
    square = root @ root
    metric = torch.stack([square[0, 0], square[0, 1], square[1, 1]]).expand(50, 3)
    torch.testing.assert_close(
        fan_quality(*p, *a, *b, metric), fan_quality(*(root @ p), *(root @ a), *(root @ b)), rtol=1e-11, atol=0
    )
    torch.testing.assert_close(length(*p, metric), (root @ p).norm(dim=0), rtol=1e-13, atol=0)
    torch.testing.assert_close(unit_metric(5 * metric), metric / torch.linalg.det(root), rtol=1e-13, atol=0)


def options(targets, sizes="boundary", **more) -> RemeshOptions:
    smooth = SmoothOptions(ceiling=1.5, energy_tolerance=1e-4, targets=targets)
    return RemeshOptions(sizes=sizes, smooth=smooth, **more)


@pytest.mark.parametrize("kind", ["function", "tensor"])
def test_triangles_become_as_long_as_the_metric_says(kind):
    mesh = wide()
    field = MetricField(along_x if kind == "function" else along_x(mesh.points))
    sizes = torch.full((len(mesh.points),), 0.15, dtype=torch.float64)
    after, info = tm.remesh(mesh, options(field, sizes))
    assert inverted(after) == 0
    assert total_area(after) == total_area(mesh)
    new_row = info.vertex_map.old_to_new
    moved = {tuple(new_row[torch.tensor(edge)].tolist()) for edge in boundary(mesh.triangles)}
    assert {tuple(edge) for edge in boundary(after.triangles)} == moved
    assert int(info.splits) > 50
    q = target_quality(after, MetricField(along_x))
    assert float(q.mean()) < 1.05
    assert float(info.conformity.mean) == pytest.approx(1, abs=0.1)
    # As many as fill the mapped square, which has the same area, with room for the boundary's own edges.
    expected = 4 / (math.sqrt(3) / 4 * 0.15**2)
    assert len(after.triangles) == pytest.approx(expected, rel=0.25)
    inner = ~after.fixed[after.triangles].any(1)
    corner = after.points[after.triangles[inner]]
    reach = corner.amax(1) - corner.amin(1)
    assert float((reach[:, 0] / reach[:, 1]).log().mean().exp()) == pytest.approx(ASPECT, rel=0.15)


def test_a_metric_that_is_the_planes_remeshes_as_well_as_none():
    # Of one small mesh the two ways come to different meshes; of several they are as good.
    mesh = tm.join([meshes.disturbed(meshes.l_shape(4), 0.02, seed) for seed in range(4)])
    plane = MetricField(lambda positions: torch.eye(2, dtype=torch.float64).expand(len(positions), 2, 2))
    sizes = torch.full((len(mesh.points),), 0.15, dtype=torch.float64)
    plain, ours = (tm.remesh(mesh, options(targets, sizes))[0] for targets in (None, plane))
    assert float(tm.quality(ours).mean.mean()) == pytest.approx(float(tm.quality(plain).mean.mean()), abs=0.01)
    assert len(ours.points) == pytest.approx(len(plain.points), rel=0.1)


def test_joined_equals_alone():
    parts = [wide(6), meshes.disturbed(meshes.l_shape(3), 0.03, 3), wide(4)]
    together, info = tm.remesh(tm.join(parts), options(MetricField(along_x)))
    assert int((info.splits + info.collapses).min()) > 0
    for part, joined in zip(parts, together.split(), strict=True):
        alone, _ = tm.remesh(part, options(MetricField(along_x)))
        assert torch.equal(alone.points, joined.points)
        assert torch.equal(alone.triangles, joined.triangles)


def layer(positions: torch.Tensor) -> torch.Tensor:
    """Along the inner boundary of a ring: tangents, where triangles are long near it."""
    return torch.stack([-positions[:, 1], positions[:, 0]], 1)


def thickness(positions: torch.Tensor) -> torch.Tensor:
    return 1 + 5 * torch.exp(-(((positions.norm(dim=1) - 0.4) / 0.15) ** 2))


@pytest.mark.parametrize("boundary_is", ["fixed", "slide"])
def test_improve_remeshes_a_layer_in_its_metric(boundary_is):
    mesh = meshes.disturbed(meshes.ring(32, 7), 0.03, 4)
    field = MetricField.stretched(layer, thickness)
    smooth = SmoothOptions(ceiling=1.5, energy_tolerance=1e-3, targets=field)
    means = {}
    for topology in ("flip", "full"):
        after, report = tm.improve(mesh, tm.ImproveOptions(topology=topology, smooth=smooth, boundary=boundary_is))
        assert report.certified.tolist() == [True]
        means[topology] = float(target_quality(after, field).mean())
    assert len(after.points) != len(mesh.points)
    assert means["full"] < means["flip"]
    assert means["full"] < 1.08


def test_matrices_of_triangles_are_refused_with_the_way_out():
    matrices = torch.eye(2, dtype=torch.float64).expand(4, 2, 2)
    with pytest.raises(ValueError, match=r"which come and go here: give a MetricField \(metric_from, MetricField.from"):
        RemeshOptions(smooth=SmoothOptions(targets=matrices))
    with pytest.raises(ValueError, match="do not last when edges flip"):
        tm.ImproveOptions(topology="full", smooth=SmoothOptions(targets=matrices))
