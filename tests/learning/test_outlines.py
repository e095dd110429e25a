"""Outlines of domains: they have the shapes that they are named for, and the right direction."""

import numpy as np
import pytest

from torchmesh.learning import outlines
from torchmesh.triangulating.polygon import why_not_simple


def test_naca_0012_has_its_thickness_and_a_sharp_end():
    wing = outlines.naca(0.0, 0.4, 0.12, points=200)
    assert np.allclose(wing[:, 1].max(), 0.06, atol=2e-4)
    assert np.allclose(wing[0], [0.5, 0.0], atol=1e-3)
    # Counter-clockwise, symmetric.
    z = wing[:, 0] + 1j * wing[:, 1]
    assert 0.5 * np.sum(np.conj(z) * np.roll(z, -1)).imag > 0
    assert np.allclose(wing[1:200, 1], -wing[:-200:-1, 1], atol=1e-12)


@pytest.mark.parametrize("name", sorted(outlines.LETTERS))
def test_letters_have_their_area_and_holes(name):
    loops = outlines.letter_loops(name)
    cells = "".join(outlines.LETTERS[name]).count("#")
    cell = (2 / len(outlines.LETTERS[name])) ** 2
    areas = [0.5 * np.sum(np.conj(z) * np.roll(z, -1)).imag for z in (p[:, 0] + 1j * p[:, 1] for p in loops)]
    assert areas[0] > 0
    assert all(area < 0 for area in areas[1:])
    assert sum(areas) == pytest.approx(cells * cell)
    assert len(loops) == 1 + {"A": 1, "O": 1, "P": 1}.get(name, 0)


@pytest.mark.parametrize(("turns", "fill"), [(0.6, 0.7), (2.0, 0.35)])
def test_a_spiral_is_simple_and_ends_at_radius_one(turns, fill):
    loop = outlines.spiral_loop(turns, fill)
    assert why_not_simple(loop, [np.arange(len(loop))]) is None
    outer, inner = loop[len(loop) // 2 - 1], loop[len(loop) // 2]
    assert np.hypot(*((outer + inner) / 2)) == pytest.approx(1)


def test_laid_along_a_square_every_corner_is_met():
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    laid = outlines.laid_along(square, 10)
    assert laid.shape == (10, 2)
    assert {tuple(p) for p in square} <= {tuple(p) for p in laid}
