import numpy as np
import pytest

from torchmesh.triangulating.arrays import signs
from torchmesh.triangulating.placing import place_vertices
from torchmesh.triangulating.triangulation import Triangulation


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_spread_stays_inside_and_stops_where_floating_point_ends(dtype):
    rim = np.array([[1.0, 1.0], [1.0 + 8 * np.finfo(dtype).eps, 1.0], [1.0, 1.0 + 8 * np.finfo(dtype).eps]])
    points = np.concatenate([rim, np.zeros((100, 2))])
    work = Triangulation(points, np.array([[0, 1, 2]]), np.ones(len(points)))
    left = place_vertices(work, np.arange(3, 103), np.dtype(dtype))
    assert 0 < len(left) < 100
    assert (signs(points, *work.corners.T) > 0).all()
    np.testing.assert_array_equal(points[3:103].astype(dtype), points[3:103])
