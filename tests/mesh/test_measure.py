import dataclasses
import math

import meshes
import numpy as np
import pytest
import torch
from exact import double_areas, inverted

import torchmesh as tm
from torchmesh import MeshBatch, join, minimum_angle, quality
from torchmesh.mesh.measure import upright
from torchmesh.mesh.predicates import orientation
from torchmesh.mesh.triangle import corners, inverse_mean_ratio, signed_area

ALL = meshes.VALID | meshes.TANGLED


def plain(mesh):
    """Area, inverse mean ratio and smallest angle per triangle, by numpy's matrices."""
    a, b, c = mesh.points.numpy()[mesh.triangles.numpy()].transpose(1, 0, 2)
    edges = np.stack([b - a, c - a], 2)
    area = np.linalg.det(edges) / 2
    j = edges @ np.linalg.inv([[1, 0.5], [0, math.sqrt(3) / 2]])
    ratio = np.linalg.norm(j, axis=(1, 2)) ** 2 / (2 * np.abs(np.linalg.det(j)))

    def angle(p, q, r):
        u, v = q - p, r - p
        return np.degrees(np.arccos((u * v).sum(1) / np.linalg.norm(u, axis=1) / np.linalg.norm(v, axis=1)))

    return area, ratio, np.min([angle(a, b, c), angle(b, c, a), angle(c, a, b)], axis=0)


@pytest.mark.parametrize("scale", [1.0, 1e-160, 1e150])
def test_quality_is_that_of_the_single_formulas_to_the_bit(scale):
    mesh = join([make() for make in ALL.values()])
    points = mesh.points * scale
    points[mesh.triangles[:20, 1]] = points[mesh.triangles[:20, 0]]
    q, t = quality(mesh.with_points(points)), corners(points, mesh.triangles)
    assert torch.equal(q.area, signed_area(t))
    assert torch.equal(q.inverse_mean_ratio, inverse_mean_ratio(t))
    assert torch.equal(q.upright, orientation(*t) > 0)
    assert bool(q.inverse_mean_ratio.isinf().any())


@pytest.mark.parametrize("name", list(ALL))
def test_quality_is_that_of_the_textbook(name):
    mesh = ALL[name]()
    q = quality(mesh)
    area, ratio, angle = plain(mesh)
    # The areas of slivers cancel; numpy's determinants of coordinates up to 18 are good to 1e-14.
    np.testing.assert_allclose(q.area.numpy(), area, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(q.inverse_mean_ratio.numpy(), ratio, rtol=1e-9)
    assert q.mean.item() == pytest.approx(ratio.mean(), rel=1e-9)
    assert q.max.item() == pytest.approx(ratio.max(), rel=1e-9)
    assert q.inverted.tolist() == [inverted(mesh)]
    assert q.upright.tolist() == [a > 0 for a in double_areas(mesh)]
    assert torch.equal(upright(mesh), q.upright)
    # arccos near 1 knows an angle to 1e-8 only.
    assert minimum_angle(mesh).item() == pytest.approx(angle.min(), abs=1e-5)


def test_equilateral_triangles_are_perfect():
    q = quality(meshes.equilateral(side=7.0))
    assert q.max.item() == pytest.approx(1, abs=1e-14)
    assert minimum_angle(meshes.equilateral()).item() == pytest.approx(60, abs=1e-12)


def test_a_flat_triangle_counts_as_inverted_and_its_ratio_is_infinite():
    mesh = MeshBatch.from_arrays([[0, 0], [1, 0], [2, 0], [1, 1]], [[0, 1, 3], [1, 2, 3], [0, 2, 1]])
    q = quality(mesh)
    assert q.inverted.tolist() == [1]
    assert q.upright.tolist() == [True, True, False]
    assert q.inverse_mean_ratio[2] == q.max[0] == q.mean[0] == math.inf
    assert minimum_angle(mesh).item() == 0


def test_signs_are_exact_where_areas_round_to_nothing():
    # A point that moves by last bits about the line through two others (Kettner et al., Classroom examples of
    # robustness problems in geometric computations, 2008); plain arithmetic gets half of the signs wrong.
    start = MeshBatch.from_arrays([[0, 0], [12, 12], [0, 24]], [[0, 1, 2]])
    bit, plain = 2.0**-53, 0
    for i in range(8):
        for j in range(8):
            points = [[0.5 + i * bit, 0.5 + j * bit], [12, 12], [24, 24]]
            mesh = start.with_points(torch.tensor(points, dtype=torch.float64))
            exact = [a > 0 for a in double_areas(mesh)]
            assert quality(mesh).upright.tolist() == upright(mesh).tolist() == exact
            plain += (quality(mesh).area > 0).tolist() != exact
    assert plain > 10


def test_float32_is_measured_in_float64():
    mesh = meshes.jittered().to(torch.float32)
    q = quality(mesh)
    assert q.inverse_mean_ratio.dtype == torch.float64
    assert torch.equal(q.inverse_mean_ratio, quality(mesh.to(torch.float64)).inverse_mean_ratio)


def test_joined_equals_alone():
    parts = [make() for make in ALL.values()]
    together = quality(join(parts))
    angles = minimum_angle(join(parts))
    first = 0
    for b, mesh in enumerate(parts):
        alone = quality(mesh)
        rows = slice(first, first := first + len(mesh.triangles))
        for name in ("area", "inverse_mean_ratio", "upright"):
            assert torch.equal(getattr(together, name)[rows], getattr(alone, name))
        for name in ("mean", "max", "inverted"):
            assert torch.equal(getattr(together, name)[b : b + 1], getattr(alone, name))
        assert torch.equal(angles[b : b + 1], minimum_angle(mesh))


def test_the_smallest_angle_has_the_same_bits_wherever_its_triangle_stands():
    # Vectorised functions may round otherwise in the last, odd rows of a tensor.
    parts = [meshes.delaunay(count, count) for count in range(5, 60)]
    together = minimum_angle(join(parts))
    assert torch.equal(together, torch.cat([minimum_angle(mesh) for mesh in parts]))


@pytest.mark.parametrize("exponent", [-400, -1, 7, 400])
def test_shapes_do_not_depend_on_the_unit_of_length(exponent):
    mesh = meshes.jittered()
    scaled = mesh.with_points(mesh.points * 2.0**exponent)
    for name in ("inverse_mean_ratio", "upright", "mean", "max", "inverted"):
        assert torch.equal(getattr(quality(scaled), name), getattr(quality(mesh), name))
    assert torch.equal(minimum_angle(scaled), minimum_angle(mesh))


@pytest.mark.parametrize("moved", [0, 1, 3, 200])
@pytest.mark.parametrize("turned", [0, 2])
def test_what_changed_is_measured_and_the_rest_is_known(moved, turned, rng):
    before = join([make() for make in ALL.values()])
    points, triangles = before.points.clone(), before.triangles.clone()
    points[torch.from_numpy(rng.permutation(len(points))[:moved])] += 0.05
    triangles[:turned] = triangles[:turned, [0, 2, 1]]
    after = before.with_points(points).with_triangles(triangles)
    known, plain = quality(after, known=(before, quality(before))), quality(after)
    for field in dataclasses.fields(known):
        assert torch.equal(getattr(known, field.name), getattr(plain, field.name))


def test_a_quality_known_of_other_triangles_is_no_use():
    before, after = (make() for make in list(meshes.VALID.values())[:2])
    known = quality(after, known=(before, quality(before)))
    assert torch.equal(known.inverse_mean_ratio, quality(after).inverse_mean_ratio)


@pytest.mark.parametrize("mesh", [meshes.moved_hole(), meshes.mixed()], ids=["triangles", "quads"])
def test_measures_carry_no_gradient_whatever_the_points_require(mesh):
    moving = mesh.with_points(mesh.points.clone().requires_grad_())
    found, plain = tm.quality(moving), tm.quality(mesh)
    for name, value in vars(found).items():
        assert not value.requires_grad, name
        assert torch.equal(value, getattr(plain, name)), name
    assert not tm.minimum_angle(moving).requires_grad
    assert any(s.mean.requires_grad for s in tm.metrics.evaluate(moving).values())


def test_what_carries_no_gradient_says_so():
    for verb in (tm.improve, tm.untangle, tm.smooth, tm.polish, tm.flip_to_delaunay, tm.remesh, tm.relax, tm.quality,
                 tm.minimum_angle):  # fmt: skip
        assert "result carries no gradient" in (verb.__doc__ or "")
