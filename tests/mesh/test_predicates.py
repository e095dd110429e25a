"""Every sign against exact rational arithmetic."""

import numpy as np
import pytest
import torch
from exact import double_area, incircle, sign
from hypothesis import given
from hypothesis import strategies as st

from torchmesh.mesh import predicates

FINITE = st.floats(-1e150, 1e150)


def orientations(rows):
    """(N, 3, 2) to the library's signs."""
    return predicates.orientation(*torch.from_numpy(np.ascontiguousarray(rows.reshape(len(rows), 6).T))).tolist()


def incircles(rows):
    return predicates.incircle(*torch.from_numpy(np.ascontiguousarray(rows.reshape(len(rows), 8).T))).tolist()


def true_orientations(rows):
    return [sign(double_area(*row)) for row in rows]


def true_incircles(rows):
    return [sign(incircle(*row)) for row in rows]


def collinear(rng, count, corners):
    """Points of one line, rounded: some exactly flat, the others flat but for the last bit."""
    base, along = rng.uniform(-1, 1, (2, count, 1, 2))
    return base + rng.integers(-8, 9, (count, corners, 1)) / 8 * along


def cocircular(rng, count):
    """Four points on one circle of whole-number coordinates, thrice in four of them off by one last bit."""
    on = np.array([(5, 0), (4, 3), (3, 4), (0, 5), (-3, 4), (-4, 3), (-5, 0), (-4, -3), (0, -5), (3, -4)], float)
    rows = np.stack([on[rng.permutation(len(on))[:4]] for _ in range(count)])
    rows += rng.integers(-9, 10, (count, 1, 2))
    nudged = np.nextafter(rows, rng.choice([-100.0, 100.0], rows.shape))
    return np.where((rng.uniform(size=(count, 4, 1)) < 0.25) & (np.arange(count) % 4 > 0)[:, None, None], nudged, rows)


def positions(rng, corners):
    """Named families of (N, corners, 2) coordinates."""
    usual = rng.uniform(-1, 1, (200, corners, 2))
    flat = collinear(rng, 200, corners)
    round_ = cocircular(rng, 200)[:, :corners]
    return {
        "random": usual,
        "collinear": flat,
        "cocircular": round_,
        "huge": usual * 1e150,
        "huge and flat": flat * 1e150,
        "areas near 1e-300": usual * 1e-150,
        "flat, near 1e-300": flat * 1e-150,
        "products that underflow": usual * 1e-161,
        "flat, products that underflow": flat * 1e-161,
        "in-circle terms that underflow": usual * 1e-81,
        "round, in-circle terms that underflow": round_ * 1e-81,
        "subnormal": np.round(usual * 1000) * 5e-324,
        "far from the origin": usual + 1e8,
        "flat, far from the origin": flat + 1e8,
        "round, far from the origin": round_ + 1e8,
        "small, far from the origin": np.round(usual * 8) * 2.0**-26 + 1e8,
        "of all sizes": np.ldexp(usual, rng.integers(-300, 300, (200, corners, 1))),
        "in one point": np.zeros((3, corners, 2)),
    }


FAMILIES = list(positions(np.random.default_rng(0), 3))


@pytest.mark.parametrize("family", FAMILIES)
def test_orientation_is_exact(family, rng):
    rows = positions(rng, 3)[family]
    assert orientations(rows) == true_orientations(rows)


@pytest.mark.parametrize("family", FAMILIES)
def test_incircle_is_exact(family, rng):
    rows = positions(rng, 4)[family]
    assert incircles(rows) == true_incircles(rows)


def test_the_families_hold_what_they_are_for(rng):
    assert {"collinear", "cocircular", "flat, far from the origin"} <= set(FAMILIES)
    flat = true_orientations(positions(rng, 3)["collinear"])
    assert {-1, 0, 1} == set(flat)
    assert {-1, 0, 1} == set(true_incircles(positions(rng, 4)["cocircular"]))
    # Plain floating point gets some of them wrong: the exact path is taken.
    rows = positions(rng, 3)["collinear"]
    (ax, ay), (bx, by), (cx, cy) = rows.transpose(1, 2, 0)
    assert np.sign((bx - ax) * (cy - ay) - (by - ay) * (cx - ax)).tolist() != flat


@given(st.tuples(*[FINITE] * 6))
def test_orientation_of_any_finite_numbers(xy):
    rows = np.array(xy).reshape(1, 3, 2)
    assert orientations(rows) == true_orientations(rows)


@given(st.tuples(*[FINITE] * 8))
def test_incircle_of_any_finite_numbers(xy):
    rows = np.array(xy).reshape(1, 4, 2)
    assert incircles(rows) == true_incircles(rows)


@given(st.lists(st.tuples(st.integers(-3, 3), st.integers(-3, 3)), min_size=4, max_size=4))
def test_small_whole_numbers_where_ties_abound(points):
    rows = np.array(points, float)[None]
    assert orientations(rows[:, :3]) == true_orientations(rows[:, :3])
    assert incircles(rows) == true_incircles(rows)


def test_symmetries(rng):
    rows = np.concatenate([collinear(rng, 100, 4), cocircular(rng, 100)])
    turned, swapped = rows[:, [1, 2, 0, 3]], rows[:, [1, 0, 2, 3]]
    assert orientations(turned[:, :3]) == orientations(rows[:, :3])
    assert orientations(swapped[:, :3]) == [-s for s in orientations(rows[:, :3])]
    assert incircles(turned) == incircles(rows)
    assert incircles(swapped) == [-s for s in incircles(rows)]


def test_float32_is_judged_at_its_own_value():
    rows = torch.tensor([[0.1, 0.1], [0.2, 0.2], [0.3, 0.3]], dtype=torch.float32)
    sign_of = predicates.orientation(*rows.reshape(6, 1))
    assert sign_of.tolist() == [sign(double_area(*rows.tolist()))]


def test_no_rows():
    none = torch.zeros(0, dtype=torch.float64)
    assert predicates.orientation(*[none] * 6).tolist() == []
    assert predicates.incircle(*[none] * 8).tolist() == []
