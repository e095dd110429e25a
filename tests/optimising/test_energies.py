"""Slopes by hand against autograd and differences; each energy against what is known of it."""

import dataclasses
import itertools
import math

import pytest
import torch
from energy_cases import ENERGIES, UPRIGHT_ONLY
from hypothesis import given
from hypothesis import strategies as st

from torchmesh.mesh.triangle import Corners, inverse_mean_ratio
from torchmesh.optimising.energies import (
    InverseMeanRatio,
    Regularised,
    TotalLiftedContent,
    UntangleBeta,
    derivatives_by_autograd,
    slopes_and_curvatures,
)
from torchmesh.optimising.jacobian import equilateral, invariants


def jacobians(generator, count=200, upright=False):
    """(count, 2, 2) random J and their invariants."""
    j = torch.randn(count, 2, 2, generator=generator, dtype=torch.float64)
    if upright:
        j[:, 0] = torch.where(torch.linalg.det(j)[:, None] < 0, -j[:, 0], j[:, 0])
    return j, j.square().sum((1, 2)), torch.linalg.det(j)


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
def test_slopes_and_curvatures_are_differences_of_the_slopes_by_hand(name, generator):
    _, stretch, det = jacobians(generator, 50, upright=True)
    stretch, det = stretch + 1, det + 0.5
    energy, h = ENERGIES[name], 1e-6
    slopes, (ss, sd, dd) = slopes_and_curvatures(energy, stretch, det)
    torch.testing.assert_close(slopes, torch.stack(energy.value_and_slopes(stretch, det)[1:]), rtol=1e-9, atol=1e-12)
    up, down = (energy.value_and_slopes(stretch + step, det) for step in (h, -h))
    by_stretch = [(one - other) / (2 * h) for one, other in zip(up[1:], down[1:], strict=True)]
    up, down = (energy.value_and_slopes(stretch, det + step) for step in (h, -h))
    by_det = [(one - other) / (2 * h) for one, other in zip(up[1:], down[1:], strict=True)]
    for got, expected in ((ss, by_stretch[0]), (sd, by_stretch[1]), (sd, by_det[0]), (dd, by_det[1])):
        # Central differences: h^2 times a third derivative, and 1e-16 / h times the slope.
        torch.testing.assert_close(got, expected, rtol=1e-5, atol=1e-6 * float(slopes.abs().max()))


@pytest.mark.parametrize("energy", [Regularised(0.3), Regularised(1e-3), TotalLiftedContent(1e-2)])
def test_curvatures_by_hand_are_those_of_autograd(energy, generator):
    """Upright triangles and inverted ones."""
    _, stretch, det = jacobians(generator, 200)
    for got, expected in zip(
        slopes_and_curvatures(energy, stretch, det), derivatives_by_autograd(energy, stretch, det), strict=True
    ):
        # For inverted triangles and small eps terms of size 1 / eps^2 and more cancel.
        scale = expected.abs().clamp_min(1.0)
        torch.testing.assert_close(got / scale, expected / scale, rtol=0, atol=1e-7)


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


# --- the energies themselves ---


def one_triangle(*xy):
    return Corners(*(torch.tensor([float(v)], dtype=torch.float64) for v in xy))


def test_inverse_mean_ratio_is_that_of_the_triangle(generator):
    t = Corners(*torch.randn(6, 100, generator=generator, dtype=torch.float64))
    stretch, det = invariants(t, equilateral())
    value = InverseMeanRatio(1).value(stretch, det)
    upright = det > 0
    torch.testing.assert_close(value[upright], inverse_mean_ratio(t)[upright], rtol=1e-13, atol=0)
    assert bool(upright.any())
    assert bool((value[~upright] == torch.inf).all())


def test_inverse_mean_ratio_of_an_equilateral_triangle_is_one():
    for power in (1, 2, 8):
        t = one_triangle(0, 0, 2, 0, 1, math.sqrt(3))
        value = InverseMeanRatio(power).value(*invariants(t, equilateral(5.0)))
        assert value.item() == pytest.approx(1, rel=1e-15 * 4 * power)


@given(st.floats(0.1, 2), st.floats(-1, 2), st.floats(0, 6.28), st.floats(0.1, 10), st.floats(-1, 1), st.floats(-1, 1))
def test_inverse_mean_ratio_depends_on_neither_position_nor_turn_nor_size(y, x, turn, size, dx, dy):
    cos, sin = size * math.cos(turn), size * math.sin(turn)
    plain = one_triangle(0, 0, 1, 0, x, y)
    moved = one_triangle(dx, dy, dx + cos, dy + sin, dx + cos * x - sin * y, dy + sin * x + cos * y)
    values = [InverseMeanRatio(1).value(*invariants(t, equilateral())).item() for t in (plain, moved)]
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


@pytest.mark.parametrize("name", list(ENERGIES))
def test_energies_are_frozen(name):
    field = dataclasses.fields(ENERGIES[name])[0].name
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(ENERGIES[name], field, 1.0)


def test_lifted_content_tends_to_the_absolute_area_from_above(generator):
    _, stretch, det = jacobians(generator)
    torch.testing.assert_close(TotalLiftedContent(1e-12).value(stretch, det), det.abs(), rtol=0, atol=1e-5)
    assert bool((TotalLiftedContent(0.1).value(stretch, det) > det.abs()).all())
