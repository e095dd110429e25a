"""The sign of the Jacobian of quads of eight and nine nodes, against dense sampling of textbook shape functions."""

import numpy as np
import pytest
import torch

from torchmesh.curving.elements import Elements
from torchmesh.curving.quads import is_positive, quad_coefficients, quad_scaled_jacobian, quads_upright
from torchmesh.curving.unfolding import _of_quads

EIGHT, NINE = np.array([[0, 1, 2, 3, 4, 5, 6, 7, -1]]), np.arange(9)[None]
SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0], [1, 0.5], [0.5, 1], [0, 0.5], [0.5, 0.5]])


def lagrange(u, v):
    """The nine functions of Lagrange at (u, v), as products of those of one direction."""
    one, other = ([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)] for t in (u, v))
    places = [(0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1), (1, 1)]
    return np.array([one[i] * other[j] for i, j in places])


def serendipity(u, v):
    """The eight functions of serendipity, as textbooks have them for the square from -1 to 1."""
    x, y = 2 * u - 1, 2 * v - 1
    at = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    corners = [(1 + a * x) * (1 + b * y) * (a * x + b * y - 1) / 4 for a, b in at]
    middles = [(1 - x**2) * (1 - y) / 2, (1 + x) * (1 - y**2) / 2, (1 - x**2) * (1 + y) / 2, (1 - x) * (1 - y**2) / 2]
    return np.array(corners + middles)


def sampled(nodes, steps=40):
    """The Jacobian on a fine lattice, by central differences of the map, which are exact for parabolas."""
    u, v = np.meshgrid(np.linspace(0, 1, steps + 1), np.linspace(0, 1, steps + 1))
    shapes = lagrange if len(nodes) == 9 else serendipity
    h = 0.25

    def moved(du, dv):
        return np.tensordot(shapes(u + du, v + dv), nodes, (0, 0))

    (a, b), (c, d) = (np.moveaxis(moved(*p) - moved(*q), 2, 0) / (2 * h) for p, q in (
        ((h, 0), (-h, 0)), ((0, h), (0, -h))))  # fmt: skip
    return a * d - b * c


def thrown(seed, count, sigma):
    rng = np.random.default_rng(seed)
    return SQUARE[None] + sigma * rng.standard_normal((count, 9, 2))


@pytest.mark.parametrize("width", [8, 9])
def test_signs_are_those_of_dense_samples(width):
    seen = [0, 0]
    for nodes in thrown(1, 36, 0.11)[:, :width]:
        least = sampled(nodes).min()
        rows = torch.from_numpy(EIGHT if width == 8 else NINE)
        now = bool(quads_upright(torch.from_numpy(nodes), rows))
        assert now == is_positive(nodes.tolist())
        if abs(least) > 1e-3:
            assert now == (least > 0)
            seen[now] += 1
        scaled = float(quad_scaled_jacobian(torch.from_numpy(nodes), rows))
        assert (scaled > 0) == now
    assert min(seen) > 3


def test_coefficients_bound_the_jacobian_and_are_it_at_the_corners():
    for nodes in thrown(2, 10, 0.2):
        values, errors = quad_coefficients(torch.from_numpy(nodes), torch.from_numpy(NINE))
        at = sampled(nodes)
        assert float(values.min()) <= at.min() + 1e-12
        corners = [at[0, 0], at[0, -1], at[-1, 0], at[-1, -1]]
        assert np.allclose([values[0, i, j] for j in (0, 3) for i in (0, 3)], corners, atol=1e-12)
        assert 0 < float(errors.max()) < 1e-10


def test_a_valid_quad_with_a_negative_coefficient_is_decided_in_fractions():
    found = 0
    for nodes in thrown(3, 130, 0.1):
        values, _ = quad_coefficients(torch.from_numpy(nodes), torch.from_numpy(NINE))
        if float(values.min()) < 0 and sampled(nodes).min() > 1e-3:
            found += 1
            assert bool(quads_upright(torch.from_numpy(nodes), torch.from_numpy(NINE)))
    assert found


def test_a_jacobian_that_is_zero_at_a_corner_or_all_along_is_not_positive():
    flat = SQUARE.copy()
    flat[:, 1] = 0
    triangle = SQUARE.copy()
    triangle[2] = [0.5, 0.5]  # the corner lies on the line between its neighbours
    triangle[[5, 6]] = triangle[[1, 2]].mean(0), triangle[[2, 3]].mean(0)
    for nodes in (flat, triangle):
        assert not bool(quads_upright(torch.from_numpy(nodes), torch.from_numpy(NINE)))
        assert not bool(quads_upright(torch.from_numpy(nodes), torch.from_numpy(EIGHT)))


def test_positions_that_are_not_finite_are_not_upright():
    nodes = SQUARE.copy()
    nodes[5, 0] = np.nan
    assert not bool(quads_upright(torch.from_numpy(nodes), torch.from_numpy(NINE)))


def test_the_gradients_of_the_energy_are_those_of_serendipity():
    order, h = 4, 1e-6
    gradients, straight, _ = _of_quads(order)
    u, v = (g.reshape(-1) / order for g in np.meshgrid(np.arange(order + 1), np.arange(order + 1)))
    along = (serendipity(u + h, v) - serendipity(u - h, v)) / (2 * h)
    across = (serendipity(u, v + h) - serendipity(u, v - h)) / (2 * h)
    assert np.allclose(gradients.numpy(), np.stack([along.T, across.T]), atol=1e-8)
    assert np.allclose(straight.numpy().sum(2), 0)


def test_centres_stay_where_nothing_moves_and_follow_their_sides_elsewhere():
    off = SQUARE + 0.0
    off[8] += 0.01
    elements = Elements(np.zeros((0, 6), np.int64), NINE, off[None])
    assert (elements.settled(off) == off).all()
    moved = off + 0.0
    moved[5] += [0.2, 0.1]
    settled = elements.settled(moved)
    assert (settled[:8] == moved[:8]).all()
    assert np.allclose(settled[8], [0.6, 0.55])


def test_skeletons_with_a_corner_turned_back_are_found():
    dart = SQUARE.copy()
    dart[2] = [0.2, 0.2]
    both = np.concatenate([SQUARE, dart])
    elements = Elements(np.zeros((0, 6), np.int64), np.concatenate([NINE, NINE + 9]))
    assert elements.straight_inverted(both).tolist() == [False, True]
    assert elements.scaled_straight(both).tolist()[0] == 1
