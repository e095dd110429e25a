import numpy as np
import pytest

from torchmesh.triangulating.arrays import among, distinct


@pytest.mark.parametrize("size", [0, 1, 7, 300])
def test_distinct_and_among_are_what_numpy_has(size):
    rng = np.random.default_rng(size)
    values, others = rng.integers(-20, 20, size), rng.integers(-20, 20, (5, 2))
    assert np.array_equal(distinct(values), np.unique(values))
    assert np.array_equal(among(values, others), np.isin(values, others))
    assert np.array_equal(among(others, values), np.isin(others, values))
