"""The sign of the Jacobian of six-node triangles, against dense sampling and an independent rational minimum."""

from fractions import Fraction

import numpy as np
import pytest
import torch

from torchmesh.curving.validity import coefficients, exact_minimum, jacobian_range, scaled_jacobian, upright

ROW = torch.arange(6)[None]


def shape_gradients(x, y):
    """The derivatives of the six shape functions of a quadratic triangle, as textbooks have them."""
    z = 1 - x - y
    return (
        np.array([1 - 4 * z, 4 * x - 1, 0 * x, 4 * (z - x), 4 * y, -4 * y]),
        np.array([1 - 4 * z, 0 * x, 4 * y - 1, -4 * x, 4 * x, 4 * (z - y)]),
    )


def sampled(nodes, steps=60):
    """The Jacobian on a fine lattice of the triangle, corners and sides included."""
    i, j = np.meshgrid(np.arange(steps + 1), np.arange(steps + 1))
    keep = i + j <= steps
    along, across = shape_gradients(i[keep] / steps, j[keep] / steps)
    (a, b), (c, d) = np.transpose(along.T @ nodes), np.transpose(across.T @ nodes)
    return a * d - b * c


def rational_minimum(nodes):
    """The least Jacobian by the Lagrange values at the six nodes, in fractions, without Bernstein coefficients."""
    p = [(Fraction(float(x)), Fraction(float(y))) for x, y in nodes]
    half = Fraction(1, 2)

    def jacobian(x, y):
        z = 1 - x - y
        gx = [1 - 4 * z, 4 * x - 1, 0, 4 * (z - x), 4 * y, -4 * y]
        gy = [1 - 4 * z, 0, 4 * y - 1, -4 * x, 4 * x, 4 * (z - y)]
        a, b = (sum(g * q[k] for g, q in zip(gx, p, strict=True)) for k in (0, 1))
        c, d = (sum(g * q[k] for g, q in zip(gy, p, strict=True)) for k in (0, 1))
        return a * d - b * c

    # c + bx x + by y + xx x^2 + xy x y + yy y^2, by values at six places.
    c = jacobian(Fraction(0), Fraction(0))
    x1, xh, y1, yh, m = (
        jacobian(Fraction(u), Fraction(v)) for u, v in ((1, 0), (half, 0), (0, 1), (0, half), (half, half))
    )
    xx, yy = 2 * (x1 + c - 2 * xh), 2 * (y1 + c - 2 * yh)
    bx, by = x1 - c - xx, y1 - c - yy
    xy = 4 * (m - c - (bx + by) / 2 - (xx + yy) / 4)
    places = [(Fraction(0), Fraction(0)), (Fraction(1), Fraction(0)), (Fraction(0), Fraction(1))]
    if xx:
        places.append((-bx / (2 * xx), Fraction(0)))
    if yy:
        places.append((Fraction(0), -by / (2 * yy)))
    bend = xx + yy - xy
    if bend:
        t = (bx - by + 2 * xx - xy) / (2 * bend)  # along x = 1 - t, y = t
        places.append((1 - t, t))
    if 4 * xx * yy != xy * xy:
        det = 4 * xx * yy - xy * xy
        places.append(((xy * by - 2 * yy * bx) / det, (xy * bx - 2 * xx * by) / det))
    return min(jacobian(x, y) for x, y in places if x >= 0 and y >= 0 and x + y <= 1)


def random_triangles(rng, count, spread):
    corners = np.array([[0, 0], [1, 0], [0.3, 0.8]])
    middles = (corners + np.roll(corners, -1, 0)) / 2
    nodes = np.concatenate([corners, middles])[None] + rng.normal(scale=spread, size=(count, 6, 2))
    return nodes


@pytest.mark.parametrize("spread", [0.02, 0.12, 0.3])
def test_signs_and_ranges_are_those_of_dense_samples_and_of_a_rational_twin(rng, spread):
    all_nodes = random_triangles(rng, 100, spread)
    rows = torch.arange(600).reshape(100, 6)
    points = torch.from_numpy(all_nodes.reshape(-1, 2))
    signs, (low, high) = upright(points, rows), jacobian_range(points, rows)
    undecided = (coefficients(points, rows)[0][:, 3:] <= 0).any(1) & (coefficients(points, rows)[0][:, :3] > 0).all(1)
    assert spread != 0.12 or bool(undecided.any())
    for k, nodes in enumerate(all_nodes):
        exact = rational_minimum(nodes)
        assert exact_minimum(nodes.tolist()) == exact
        assert bool(signs[k]) == (exact > 0)
        values = sampled(nodes)
        if values.min() <= 0:
            assert not signs[k]
        # Between lattice points a quadratic falls below them by no more than its bend times the square of the step.
        assert float(low[k]) == pytest.approx(float(exact), abs=1e-13)
        assert values.min() - 0.02 <= float(low[k]) <= values.min() + 1e-12
        assert values.max() - 1e-12 <= float(high[k]) <= values.max() + 0.02


def test_a_minimum_of_zero_is_inverted_and_one_bit_above_is_not():
    # The node of the lower side rises until the Jacobian at the corner is zero: at a quarter of the opposite height.
    nodes = torch.tensor([[0.0, 0], [1, 0], [0, 1], [0.5, 0.25], [0.5, 0.5], [0, 0.5]], dtype=torch.float64)
    assert exact_minimum(nodes.tolist()) == 0
    assert not bool(upright(nodes, ROW))
    nodes[3, 1] = np.nextafter(0.25, 0)
    assert exact_minimum(nodes.tolist()) > 0
    assert bool(upright(nodes, ROW))


def test_quarter_points_have_no_jacobian_at_the_tip():
    nodes = torch.tensor([[0.0, 0], [1, 0], [0, 1], [0.25, 0], [0.5, 0.5], [0, 0.25]], dtype=torch.float64)
    assert not bool(upright(nodes, ROW))


def test_straight_triangles_have_a_scaled_jacobian_of_one_and_minus_one_when_inverted():
    nodes = torch.tensor([[0.0, 0], [2, 0], [0, 1], [1, 0], [1, 0.5], [0, 0.5]], dtype=torch.float64)
    assert scaled_jacobian(nodes, ROW).tolist() == [1.0]
    assert coefficients(nodes, ROW)[0].tolist() == [[2.0] * 6]
    mirrored = nodes * nodes.new_tensor([1, -1])
    assert scaled_jacobian(mirrored, ROW).tolist() == [-1.0]
    assert not bool(upright(mirrored, ROW))


def test_straight_triangles_with_rounded_nodes_have_a_scaled_jacobian_of_one_to_rounding(rng):
    corners = 1 + 0.01 * rng.random((200, 3, 2))
    middles = (corners + np.roll(corners, -1, 1)) / 2
    points = torch.from_numpy(np.concatenate([corners, middles], 1).reshape(-1, 2))
    scaled = scaled_jacobian(points, torch.arange(1200).reshape(200, 6)).abs()
    # Nodes near 1 are rounded to 1e-16, in triangles of 0.01 whose heights may be a hundredth of that.
    assert float(scaled.min()) > 1 - 1e-9


def test_the_sign_does_not_depend_on_the_corner_or_on_powers_of_two(rng):
    for nodes in random_triangles(rng, 20, 0.15):
        points = torch.from_numpy(nodes)
        turned = torch.tensor([[1, 2, 0, 4, 5, 3]])
        assert (
            upright(points, ROW).tolist()
            == upright(points, turned).tolist()
            == upright(points * 2.0**-90, ROW).tolist()
        )


def test_nodes_that_are_not_finite_are_inverted():
    nodes = torch.zeros((6, 2), dtype=torch.float64)
    nodes[4, 0] = torch.nan
    assert not bool(upright(nodes, ROW))
