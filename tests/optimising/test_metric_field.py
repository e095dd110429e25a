"""Metric fields: which triangles are equilateral in them, how they may be given, and what is refused."""

import math

import meshes
import numpy as np
import pytest
import torch

import torchmesh as tm
from torchmesh import ImproveOptions, InvalidMeshError, MetricField, SmoothOptions, improve, smooth, target_quality

EQUILATERAL = torch.tensor([[1.0, 0.5], [0.0, 3**0.5 / 2]], dtype=torch.float64)


def rotation(angle: torch.Tensor) -> torch.Tensor:
    cosine, sine = angle.cos(), angle.sin()
    return torch.stack([torch.stack([cosine, -sine], -1), torch.stack([sine, cosine], -1)], -2)


def leaning(positions: torch.Tensor) -> torch.Tensor:
    """Target matrices as a function of position: triangles of growing length that turn with y."""
    stretch = torch.diag_embed(torch.stack([1 + 3 * positions[:, 0], torch.ones(len(positions)).to(positions)], 1))
    return rotation(positions[:, 1]) @ stretch @ EQUILATERAL


def test_a_triangle_with_its_target_matrix_is_equilateral_in_the_metric(rng):
    points = torch.tensor(rng.uniform(size=(3, 2)))
    w = leaning(points[:1])[0]
    corners = torch.stack([points[0], points[0] + 0.01 * w[:, 0], points[0] + 0.01 * w[:, 1]])
    one = tm.MeshBatch.from_arrays(corners, [[0, 1, 2]])
    fields = (
        MetricField.from_targets(w.expand(3, 2, 2)),
        MetricField.from_targets(lambda positions: 7 * w.expand(len(positions), 2, 2)),
        MetricField.from_triangles(one, w[None]),
    )
    for field in fields:
        assert float(target_quality(one, field)) == pytest.approx(1, abs=1e-9)
    # Which corner is the first one, W does not say in a metric.
    turned = tm.MeshBatch.from_arrays(corners, [[1, 2, 0]])
    assert float(target_quality(turned, fields[0])) == pytest.approx(1, abs=1e-9)


def test_stretching_is_the_metric_of_a_stretched_triangle(rng):
    angle, aspect = torch.tensor(rng.uniform(0, 6, 5)), torch.tensor(rng.uniform(0.2, 8, 5))
    direction = 3 * rotation(angle)[:, :, 0]
    w = rotation(angle) @ torch.diag_embed(torch.stack([aspect, torch.ones(5).to(aspect)], 1)) @ EQUILATERAL
    fan = [[0, 0], [2, 0], [2, 1], [1, 2], [0, 2]]
    mesh = tm.MeshBatch.from_arrays(np.array(fan, float), [[0, 1, 2], [0, 2, 3], [0, 3, 4]])
    expected = MetricField.from_targets(w).at_vertices(mesh)
    for field in (
        MetricField.stretched(direction, aspect),
        MetricField.stretched(lambda positions: direction, aspect),
        MetricField.stretched(direction, lambda positions: aspect),
    ):
        torch.testing.assert_close(field.at_vertices(mesh), expected, rtol=1e-11, atol=1e-12)
    plane = MetricField.stretched(torch.zeros(5, 2), 4.0).at_vertices(mesh)
    torch.testing.assert_close(plane, torch.tensor([1.0, 0.0, 1.0]).to(plane).expand(5, 3))


def test_target_matrices_may_be_a_function_of_position():
    mesh = meshes.disturbed(meshes.grid(9, 8), 0.01, 5)
    field = MetricField.from_targets(leaning)
    by_function, _ = smooth(mesh, SmoothOptions(targets=leaning))
    by_field, _ = smooth(mesh, SmoothOptions(targets=field))
    assert torch.equal(by_function.points, by_field.points)
    before, after = (float(target_quality(m, field).mean()) for m in (mesh, by_function))
    assert after < before
    flipped, report = improve(mesh, ImproveOptions(smooth=SmoothOptions(targets=leaning)))
    assert report.certified.tolist() == [True]
    assert float(target_quality(flipped, field).mean()) < after


def test_a_matrix_that_was_rounded_is_symmetric_enough():
    mesh = meshes.grid(3, 3)
    skew = torch.tensor([[2.0, 0.3], [0.3 + 1e-9, 1.0]], dtype=torch.float64)
    askew = skew + torch.tensor([[0, 0.1], [0, 0]])
    MetricField(lambda positions: skew.expand(len(positions), 2, 2)).at_vertices(mesh)
    with pytest.raises(InvalidMeshError, match="a metric is symmetric"):
        MetricField(lambda positions: askew.expand(len(positions), 2, 2)).at_vertices(mesh)


def test_metrics_that_are_none_are_refused():
    mesh = meshes.jittered(8, 7, 0.12, 3)
    with pytest.raises(ValueError, match=r"MetricField.values must be \(V, 3\) or \(V, 2, 2\), not \(5, 4\)"):
        MetricField(torch.zeros(5, 4))
    with pytest.raises(ValueError, match="must be a tensor or a function, not str"):
        MetricField("x")
    values = torch.tensor([1.0, 0, 1]).repeat(len(mesh.points), 1)
    with pytest.raises(InvalidMeshError, match=r"must be \(72, 3\) or \(72, 2, 2\), not \(71, 3\)"):
        smooth(mesh, SmoothOptions(targets=MetricField(values[1:])))
    values[5, 1] = 2
    with pytest.raises(InvalidMeshError, match=r"MetricField.values row 5 is not positive definite"):
        smooth(mesh, SmoothOptions(targets=MetricField(values)))
    values[5] = math.nan
    with pytest.raises(InvalidMeshError, match=r"row 5 is not positive definite"):
        smooth(mesh, SmoothOptions(targets=MetricField(values)))
    skew = torch.eye(2).repeat(len(mesh.points), 1, 1)
    skew[3, 0, 1] = 0.5
    with pytest.raises(InvalidMeshError, match=r"row 3 .* a metric is symmetric"):
        smooth(mesh, SmoothOptions(targets=MetricField(skew)))
    with pytest.raises(InvalidMeshError, match=r"the metric function's result must be \(72, 3\)"):
        smooth(mesh, SmoothOptions(targets=MetricField(lambda x: x)))


def test_wrong_fields_are_refused():
    mesh = meshes.grid(2, 2)
    mirrored = torch.diag(torch.tensor([1.0, -1.0])).expand(9, 2, 2)
    with pytest.raises(InvalidMeshError, match=r"targets row 0 is .* determinant of a target matrix must be positive"):
        MetricField.from_targets(mirrored)
    with pytest.raises(InvalidMeshError, match="the target function's result row 0 is"):
        smooth(mesh, SmoothOptions(targets=lambda positions: mirrored))
    with pytest.raises(InvalidMeshError, match=r"the target function's result must be \(N, 2, 2\), not \(9, 2\)"):
        smooth(mesh, SmoothOptions(targets=lambda positions: positions))
    with pytest.raises(InvalidMeshError, match="targets must be 8 matrices, one a triangle, not 9"):
        MetricField.from_triangles(mesh, mirrored)
    with pytest.raises(ValueError, match=r"MetricField.stretched needs a positive aspect, not 0"):
        MetricField.stretched(mesh.points, 0)
    with pytest.raises(InvalidMeshError, match=r"directions must be \(N, 2\), not \(9,\)"):
        MetricField.stretched(mesh.points[:, 0], 2.0)
