"""The compiled matrices and systems of projections against those of scipy and numpy, to rounding."""

import numpy as np
import pytest
import torch
from both_loops import both
from pairs_of_meshes import pairs_of_meshes
from scipy.sparse import coo_matrix

from torchmesh import transfer
from torchmesh.kernels import projection
from torchmesh.transferring.overlaps import overlaps
from torchmesh.transferring.pairs import both_sides
from torchmesh.transferring.projection import mixed_mass

VALID_AFTER = [name for name in pairs_of_meshes() if name != "nothing in common"]


def test_entries_at_one_position_add_up(rng):
    rows, columns = rng.integers(0, 5, 4000), rng.integers(0, 70, 4000)
    rows[rows == 3] = 4  # a row without entries
    weights = rng.normal(size=4000)
    got = projection.summed((rows, columns, weights), 6)
    dense = coo_matrix((weights, (rows, columns)), shape=(6, 70)).toarray()
    assert len(got[0]) == np.count_nonzero(dense)
    assert (np.diff(got[0] * 70 + got[1]) > 0).all(), "rows or columns out of order"
    np.testing.assert_allclose(got[2], dense[got[0], got[1]], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", VALID_AFTER)
def test_the_mixed_mass_is_that_of_numpy(name):
    before, after = both_sides(*pairs_of_meshes()[name])
    shared = overlaps(before, after, moments=True)
    sign = np.where(shared.before % 3 == 0, -1.0, 1.0)
    expected, got = (m.matrix().to_dense() for m in both(lambda: mixed_mass(before, after, shared, sign)))
    torch.testing.assert_close(got, expected, rtol=1e-13, atol=1e-14 * float(expected.abs().max()))


@pytest.mark.parametrize("name", VALID_AFTER)
def test_projected_values_are_the_same(name, generator):
    before, after = pairs_of_meshes()[name]
    values = torch.randn((len(before.points), 2), generator=generator, dtype=torch.float64)
    expected, got = both(lambda: transfer(before, after, values, method="conservative"))
    torch.testing.assert_close(got, expected, rtol=0, atol=1e-10 if name == "graded" else 1e-13)
