"""The names of a boundary's loops."""

import meshes
import numpy as np
import pytest

from torchmesh import MeshBatch
from torchmesh.mesh.boundary_parts import boundary_parts as loops_of


def test_holes_are_numbered_from_left_to_right():
    points, triangles = meshes.grid_arrays(9, 3)
    cell = np.floor(points[triangles].mean(1) * [9, 3]).astype(int)
    holes = (cell == [1, 1]).all(1) | (cell == [4, 1]).all(1) | (cell == [7, 1]).all(1)
    for order in (slice(None), slice(None, None, -1)):
        loops = loops_of(MeshBatch.from_arrays(points, triangles[~holes][order]))
        assert list(loops) == ["outer:1", "hole:1", "hole:2", "hole:3"]
        middle = [float(points[loop.numpy(), 0].mean()) for loop in loops.values()]
        assert middle == pytest.approx([0.5, 1.5 / 9, 4.5 / 9, 7.5 / 9])
