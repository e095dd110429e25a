import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchmesh.mesh import triangle as tri
from torchmesh.mesh.triangle import Corners

UNIT = st.floats(-1, 1, allow_subnormal=False)


def one(*xy):
    return Corners(*(torch.tensor([float(v)], dtype=torch.float64) for v in xy))


def some(rng, count=50):
    return Corners(*torch.from_numpy(rng.uniform(-1, 1, (6, count))))


def test_corners_gathers_the_six_coordinates():
    points = torch.tensor([[0.0, 1.0], [2.0, 3.0], [4.0, 5.0], [6.0, 7.0]])
    t = tri.corners(points, torch.tensor([[2, 0, 1], [3, 1, 2]]))
    assert [v.tolist() for v in t] == [[4, 6], [5, 7], [0, 2], [1, 3], [2, 4], [3, 5]]


def test_signed_area_of_known_triangles():
    assert tri.signed_area(one(0, 0, 4, 0, 0, 3)).item() == 6
    assert tri.signed_area(one(0, 0, 0, 3, 4, 0)).item() == -6
    assert tri.signed_area(one(0, 0, 1, 1, 2, 2)).item() == 0


def test_squared_edge_lengths_of_the_3_4_5_triangle():
    assert [v.item() for v in tri.squared_edge_lengths(one(0, 0, 4, 0, 0, 3))] == [16, 25, 9]


def test_equilateral_has_inverse_mean_ratio_one():
    ratio = tri.inverse_mean_ratio(one(0, 0, 1, 0, 0.5, math.sqrt(3) / 2))
    # sqrt(3) is rounded in the corner and in the formula.
    assert ratio.item() == pytest.approx(1, abs=1e-15)


def test_flat_triangle_has_infinite_inverse_mean_ratio_and_inverted_that_of_its_mirror_image():
    assert tri.inverse_mean_ratio(one(0, 0, 1, 1, 2, 2)).item() == math.inf
    assert tri.inverse_mean_ratio(one(0, 0, 0, 0, 0, 0)).item() == math.inf
    assert torch.equal(tri.inverse_mean_ratio(one(0, 0, 1, 0, 0, 1)), tri.inverse_mean_ratio(one(0, 0, 0, 1, 1, 0)))


def test_inverse_mean_ratio_is_equation_4_of_kim_2017(rng):
    t = some(rng)
    a, b, c = (np.stack([x.numpy(), y.numpy()], 1) for x, y in ((t.ax, t.ay), (t.bx, t.by), (t.cx, t.cy)))
    product = np.stack([b - a, c - a], 2) @ np.linalg.inv([[1, 0.5], [0, math.sqrt(3) / 2]])
    expected = np.linalg.norm(product, axis=(1, 2)) ** 2 / (2 * np.abs(np.linalg.det(product)))
    # A random triangle may be a sliver with a cancelling area, condition about its ratio.
    np.testing.assert_allclose(tri.inverse_mean_ratio(t).numpy(), expected, rtol=1e-12)


@given(st.floats(-1, 2), st.floats(0.1, 2), st.floats(0, 6.28), st.floats(0.1, 10), UNIT, UNIT)
def test_inverse_mean_ratio_knows_neither_place_nor_turn_nor_size(x, y, turn, size, dx, dy):
    cos, sin = size * math.cos(turn), size * math.sin(turn)
    placed = one(dx, dy, dx + cos, dy + sin, dx + cos * x - sin * y, dy + sin * x + cos * y)
    # The placed corners are rounded to 1e-16 of (1 + 3 size); the area, at least 0.05 size^2, feels that eighty-fold.
    expected = tri.inverse_mean_ratio(one(0, 0, 1, 0, x, y)).item()
    assert tri.inverse_mean_ratio(placed).item() == pytest.approx(expected, rel=1e-13 * (1 + 1 / size))


@given(st.tuples(*[UNIT] * 6), st.integers(-300, 300))
def test_inverse_mean_ratio_has_the_same_bits_at_any_power_of_two(xy, exponent):
    xy = [round(v, 6) for v in xy]
    scaled = one(*(math.ldexp(v, exponent) for v in xy))
    assert torch.equal(tri.inverse_mean_ratio(scaled), tri.inverse_mean_ratio(one(*xy)))


def test_angles_of_the_30_60_90_triangle():
    at = tri.angles(one(0, 0, math.sqrt(3), 0, 0, 1))
    # Corners a = 90, b = 30, c = 60 degrees; sqrt(3) is rounded.
    np.testing.assert_allclose([math.degrees(v.item()) for v in at], [90, 30, 60], rtol=1e-15)


def test_angles_sum_to_pi_also_when_inverted(rng):
    t = some(rng)
    total = sum(tri.angles(t))
    # Three roundings of numbers below pi.
    np.testing.assert_allclose(total.numpy(), math.pi, rtol=1e-14)
    assert bool((tri.signed_area(t) < 0).any())


def test_angle_at_is_unsigned_and_reaches_zero_and_pi():
    px, py, qx, qy = (torch.tensor([v]) for v in (0.0, 0.0, 1.0, 0.0))
    for end, angle in [((1, 1), math.pi / 4), ((1, -1), math.pi / 4), ((-2, 0), math.pi), ((3, 0), 0)]:
        rx, ry = (torch.tensor([float(v)]) for v in end)
        assert tri.angle_at(px, py, qx, qy, rx, ry).item() == pytest.approx(angle, abs=5e-7)  # float32
