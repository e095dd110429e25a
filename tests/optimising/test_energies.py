import dataclasses
import itertools
import math

import meshes
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchmesh.mesh.triangle import Corners, corners, inverse_mean_ratio, signed_area
from torchmesh.optimising import energies
from torchmesh.optimising.energies import (
    InverseMeanRatio,
    Regularised,
    Target,
    TotalLiftedContent,
    UntangleBeta,
    pieces_of,
)

ENERGIES = {
    "imr": InverseMeanRatio(),
    "imr^1": InverseMeanRatio(1),
    "imr^3": InverseMeanRatio(3),
    "imr^8": InverseMeanRatio(8),
    "imr, ceiling": InverseMeanRatio(2, ceiling=1.5),
    "untangle-beta": UntangleBeta(0.3),
    "regularised": Regularised(0.5),
    "regularised, small eps": Regularised(1e-3),
    "regularised, no area": Regularised(0.1, theta=0.0),
    "lifted content": TotalLiftedContent(0.01),
}
UPRIGHT_ONLY = {name for name in ENERGIES if name.startswith("imr")}


def jacobians(generator, count=200, upright=False):
    """(count, 2, 2) random J and their invariants."""
    j = torch.randn(count, 2, 2, generator=generator, dtype=torch.float64)
    if upright:
        j[:, 0] = torch.where(torch.linalg.det(j)[:, None] < 0, -j[:, 0], j[:, 0])
    return j, j.square().sum((1, 2)), torch.linalg.det(j)


def independent_energy(name, points, triangles, target_sides):
    """The sum over the triangles in textbook notation, points[triangles] and matrices; differentiable."""
    a, b, c = points[triangles].unbind(1)
    w = torch.tensor([[1, 0.5], [0, math.sqrt(3) / 2]], dtype=points.dtype)
    j = torch.stack([b - a, c - a], 2) @ torch.linalg.inv(w) / target_sides[:, None, None]
    norm2, det = j.square().sum((1, 2)), torch.linalg.det(j)
    energy = ENERGIES[name]
    if name in UPRIGHT_ONLY:
        q = norm2 / (2 * det)
        return (q**energy.power + (0 if energy.ceiling is None else (q / energy.ceiling) ** 8)).sum()
    if name == "untangle-beta":
        area = det / 2
        return (((area - energy.beta).abs() - (area - energy.beta)) / 2).square().sum()
    if name == "lifted content":
        return torch.sqrt(det**2 + energy.alpha * norm2 + energy.alpha**2).sum()
    chi = (det + torch.sqrt(energy.eps**2 + det**2)) / 2
    return ((1 - energy.theta) * norm2 / chi + energy.theta * (1 + det**2) / chi).sum()


@pytest.mark.parametrize("name", list(ENERGIES))
def test_slopes_by_hand_are_those_of_autograd(name, generator):
    _, stretch, det = jacobians(generator, upright=name in UPRIGHT_ONLY)
    stretch.requires_grad_()
    det.requires_grad_()
    value = ENERGIES[name].value(stretch, det)
    by_stretch, by_det = torch.autograd.grad(value.sum(), (stretch, det), allow_unused=True)
    by_stretch = torch.zeros_like(det) if by_stretch is None else by_stretch
    phi, slope_stretch, slope_det = ENERGIES[name].value_and_slopes(stretch.detach(), det.detach())
    # Two formulae of a dozen roundings each; for inverted triangles and small eps terms of size 1/eps^2 cancel.
    for got, expected in ((phi, value.detach()), (slope_stretch, by_stretch), (slope_det, by_det)):
        torch.testing.assert_close(got, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", list(ENERGIES))
def test_slopes_are_differences_of_the_value(name, generator):
    _, stretch, det = jacobians(generator, 50, upright=True)
    det = det + 0.2
    energy, h = ENERGIES[name], 1e-6
    _, by_stretch, by_det = energy.value_and_slopes(stretch, det)
    # Central differences: h^2 times a third derivative, and 1e-16 / h times the value.
    up, down = energy.value(stretch + h, det), energy.value(stretch - h, det)
    torch.testing.assert_close(by_stretch, (up - down) / (2 * h), rtol=1e-5, atol=1e-8)
    up, down = energy.value(stretch, det + h), energy.value(stretch, det - h)
    torch.testing.assert_close(by_det, (up - down) / (2 * h), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", list(ENERGIES))
@pytest.mark.parametrize("sized", [False, True])
def test_energy_and_forces_are_those_of_autograd_through_the_corners(name, sized, generator):
    mesh = meshes.equilateral() if name in UPRIGHT_ONLY else meshes.jittered(cells=0.6)
    points = mesh.points + 0.1 * torch.randn(mesh.points.shape, generator=generator, dtype=torch.float64)
    triangles = mesh.triangles
    sides = torch.rand(len(triangles), generator=generator, dtype=torch.float64) + 0.5
    if not sized:
        sides = torch.ones_like(sides)
    assert name not in UPRIGHT_ONLY or bool((signed_area(corners(points, triangles)) > 0).all())
    rows = torch.stack([2 * triangles.T, 2 * triangles.T + 1], 1).reshape(6, -1)
    phi, gradient, det = energies.energy_and_forces(
        points.reshape(-1), pieces_of(rows, ENERGIES[name], energies.equilateral(sides if sized else 1.0))
    )
    points.requires_grad_()
    expected = independent_energy(name, points, triangles, sides)
    expected.backward()
    scale = float(points.grad.abs().max())
    torch.testing.assert_close(phi.sum(), expected.detach(), rtol=1e-10, atol=0)
    # Slivers cancel: an entry is as exact as the largest forces that meet in it.
    torch.testing.assert_close(gradient.reshape(-1, 2), points.grad, rtol=1e-9, atol=1e-12 * scale)
    area = signed_area(corners(points.detach(), triangles))
    torch.testing.assert_close(det, area / (math.sqrt(3) / 4 * sides**2), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("name", list(ENERGIES))
def test_forces_on_a_triangle_sum_to_nothing(name, generator):
    coordinates = torch.randn(600, generator=generator, dtype=torch.float64)
    rows = torch.arange(600).reshape(100, 6).T
    if name in UPRIGHT_ONLY:
        clockwise = signed_area(Corners(*coordinates[rows])) < 0
        rows = torch.where(clockwise, rows[[0, 1, 4, 5, 2, 3]], rows)
    _, force, _ = energies.energy_and_forces(coordinates, pieces_of(rows, ENERGIES[name], energies.equilateral()))
    force = force.reshape(100, 3, 2)
    # No energy depends on where the triangle is; each sum is exact to the last bits of its terms.
    assert bool((force.sum(1).abs() <= 1e-14 * force.abs().amax((1, 2))[:, None]).all())


def test_rows_may_be_int32_and_in_any_order(generator):
    coordinates = torch.randn(60, generator=generator, dtype=torch.float64)
    rows = torch.arange(60).reshape(10, 6).T
    order = torch.randperm(60, generator=generator)
    place = order.argsort()
    straight = energies.energy_and_forces(coordinates, pieces_of(rows, Regularised(1.0), energies.equilateral()))
    shuffled = energies.energy_and_forces(
        coordinates[order], pieces_of(place[rows].to(torch.int32), Regularised(1.0), energies.equilateral())
    )
    assert torch.equal(straight[0], shuffled[0])
    assert torch.equal(straight[1], shuffled[1][place])


# --- the energies themselves ---


def one_triangle(*xy):
    return Corners(*(torch.tensor([float(v)], dtype=torch.float64) for v in xy))


def test_invariants_of_the_target_itself():
    t = one_triangle(1, 1, 3, 1, 2, 1 + math.sqrt(3))
    for target in (energies.equilateral(2.0), energies.target_of(t)):
        stretch, det = energies.invariants(t, target)
        # J is the identity: ||J||^2 = 2 and det J = 1.
        assert stretch.item() == pytest.approx(2, rel=1e-14)
        assert det.item() == pytest.approx(1, rel=1e-14)


def test_invariants_of_a_target_are_those_of_the_matrix(rng):
    shape, target = rng.normal(size=(2, 50, 2, 2))
    target[:, 0] *= np.where(np.linalg.det(target) < 0, -1, 1)[:, None]
    j = shape @ np.linalg.inv(target)

    def as_corners(e):
        zero = np.zeros(len(e))
        return Corners(*(torch.from_numpy(v) for v in (zero, zero, e[:, 0, 0], e[:, 1, 0], e[:, 0, 1], e[:, 1, 1])))

    stretch, det = energies.invariants(as_corners(shape), energies.target_of(as_corners(target)))
    condition = np.linalg.cond(target)
    assert np.all(np.abs(stretch.numpy() / (j**2).sum((1, 2)) - 1) < 1e-14 * condition**2)
    assert np.all(np.abs(det.numpy() / np.linalg.det(j) - 1) < 1e-12 * condition**2)


def test_inverse_mean_ratio_is_that_of_the_triangle(generator):
    t = Corners(*torch.randn(6, 100, generator=generator, dtype=torch.float64))
    stretch, det = energies.invariants(t, energies.equilateral())
    value = InverseMeanRatio(1).value(stretch, det)
    upright = det > 0
    torch.testing.assert_close(value[upright], inverse_mean_ratio(t)[upright], rtol=1e-13, atol=0)
    assert bool(upright.any())
    assert bool((value[~upright] == torch.inf).all())


def test_inverse_mean_ratio_of_an_equilateral_triangle_is_one():
    for power in (1, 2, 8):
        t = one_triangle(0, 0, 2, 0, 1, math.sqrt(3))
        value = InverseMeanRatio(power).value(*energies.invariants(t, energies.equilateral(5.0)))
        assert value.item() == pytest.approx(1, rel=1e-15 * 4 * power)


@given(st.floats(0.1, 2), st.floats(-1, 2), st.floats(0, 6.28), st.floats(0.1, 10), st.floats(-1, 1), st.floats(-1, 1))
def test_inverse_mean_ratio_knows_neither_place_nor_turn_nor_size(y, x, turn, size, dx, dy):
    cos, sin = size * math.cos(turn), size * math.sin(turn)
    plain = one_triangle(0, 0, 1, 0, x, y)
    placed = one_triangle(dx, dy, dx + cos, dy + sin, dx + cos * x - sin * y, dy + sin * x + cos * y)
    values = [
        InverseMeanRatio(1).value(*energies.invariants(t, energies.equilateral())).item() for t in (plain, placed)
    ]
    # Rounded coordinates of size (1 + 3 size) against heights of at least 0.03 size.
    assert values[1] == pytest.approx(values[0], rel=1e-13 * (1 + 1 / size))


@pytest.mark.parametrize("det", [0.0, -1e-300, -1.0])
def test_no_step_to_a_triangle_that_is_not_upright_can_lower_the_inverse_mean_ratio(det):
    stretch, det = torch.tensor([2.0], dtype=torch.float64), torch.tensor([det], dtype=torch.float64)
    for power in (1, 2, 8):
        energy = InverseMeanRatio(power)
        assert energy.value(stretch, det).item() == math.inf
        phi = energy.value_and_slopes(stretch, det)[0].item()
        assert phi > 1e150


def test_untangle_beta_is_zero_from_beta_up_and_the_square_of_the_lack_below():
    beta = 0.25
    area = torch.tensor([-1.0, 0.0, 0.1, 0.25, 0.3, 7.0], dtype=torch.float64)
    for value in (UntangleBeta(beta).value(area, 2 * area), UntangleBeta(beta).value_and_slopes(area, 2 * area)[0]):
        expected = [(beta - a) ** 2 if a < beta else 0.0 for a in area.tolist()]
        torch.testing.assert_close(value, torch.tensor(expected, dtype=torch.float64), rtol=1e-15, atol=0)
        assert value[3:].tolist() == [0, 0, 0]
    _, by_stretch, by_det = UntangleBeta(beta).value_and_slopes(area, 2 * area)
    assert by_stretch.tolist() == [0] * 6
    assert by_det[3:].tolist() == [0, 0, 0]
    assert bool((by_det[:3] < 0).all())


def test_regularised_tends_to_twice_the_inverse_mean_ratio_on_upright_triangles(generator):
    _, stretch, det = jacobians(generator, upright=True)
    stretch, det = stretch[det > 0.1], det[det > 0.1]
    limit = 2 * InverseMeanRatio(1).value(stretch, det)
    gap = [
        (Regularised(eps, theta=0.0).value(stretch, det) / limit - 1).abs().max().item() for eps in (1e-1, 1e-3, 1e-5)
    ]
    # chi differs from det by at most eps^2 / (4 det): a hundredth of eps is about a ten-thousandth of the gap.
    assert gap[1] < 1e-3 * gap[0]
    assert gap[2] < 1e-3 * gap[1]
    weight = 1 / 128
    with_area = (1 - weight) * limit + weight * (1 + det * det) / det
    torch.testing.assert_close(Regularised(1e-9, weight).value(stretch, det), with_area, rtol=1e-10, atol=0)


@given(st.floats(-10, 10), st.floats(-6, 1))
def test_regularised_determinant_is_positive_and_satisfies_its_equation(det, log_eps):
    eps = 10**log_eps
    chi = Regularised(eps).chi(torch.tensor([det], dtype=torch.float64)).item()
    assert chi > 0
    # chi = (det + sqrt(eps^2 + det^2)) / 2 solves chi (chi - det) = eps^2 / 4: checked without its cancellation.
    assert chi * (chi - det) == pytest.approx(eps * eps / 4, rel=1e-12 * max(1, det * det / eps**2 * 1e-3))


def test_regularised_is_finite_for_inverted_triangles_and_grows_as_eps_falls():
    stretch, det = torch.tensor([3.0, 3.0]), torch.tensor([0.0, -1.0])
    values = [Regularised(eps).value(stretch.double(), det.double()) for eps in (1.0, 0.1, 0.01, 1e-8)]
    assert all(bool(v.isfinite().all()) for v in values)
    assert all(bool((after > before).all()) for before, after in itertools.pairwise(values))


def test_lifted_content_tends_to_the_absolute_area(generator):
    _, stretch, det = jacobians(generator)
    torch.testing.assert_close(TotalLiftedContent(1e-12).value(stretch, det), det.abs(), rtol=0, atol=1e-5)
    assert bool((TotalLiftedContent(0.1).value(stretch, det) > det.abs()).all())


def test_slopes_have_the_same_bits_wherever_a_triangle_stands(generator):
    # Vectorised functions may round otherwise in the last, odd rows of a tensor.
    _, stretch, det = jacobians(generator, 203, upright=True)
    for name, energy in ENERGIES.items():
        whole = torch.stack(energy.value_and_slopes(stretch, det))
        for start in (0, 1, 101, 202):
            part = torch.stack(energy.value_and_slopes(stretch[start:].clone(), det[start:].clone()))
            assert torch.equal(part, whole[:, start:]), name
            single = torch.stack(energy.value_and_slopes(stretch[start : start + 1], det[start : start + 1]))
            assert torch.equal(single, whole[:, start : start + 1]), name


def test_select_rows_takes_tensors_and_leaves_floats():
    keep = torch.tensor([True, False, True])
    values = torch.tensor([1.0, 2.0, 3.0])
    assert energies.select_rows(UntangleBeta(values), keep).beta.tolist() == [1, 3]
    assert energies.select_rows(Regularised(values), keep).eps.tolist() == [1, 3]
    assert energies.select_rows(Regularised(values, 0.5), keep).theta == 0.5
    assert energies.select_rows(InverseMeanRatio(8), keep) == InverseMeanRatio(8)
    target = energies.select_rows(Target(1.0, 0.0, 1.0, values), keep)
    assert (target.g11, target.m.tolist()) == (1.0, [1, 3])


@pytest.mark.parametrize("name", list(ENERGIES))
def test_energies_are_frozen(name):
    field = dataclasses.fields(ENERGIES[name])[0].name
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(ENERGIES[name], field, 1.0)
