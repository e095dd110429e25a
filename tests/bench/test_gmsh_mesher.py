"""gmsh fills the loops with counter-clockwise triangles of about the number wanted, and meshes are made once."""

import numpy as np
import pytest

from experiments.shared import outlines
from experiments.shared.cache import cached
from torchmesh.bench.exact_check import double_areas, inverted
from torchmesh.bench.methods import gmsh_mesher


@pytest.fixture
def loops():
    pytest.importorskip("gmsh")
    return [outlines.rectangle(0, 0, 4, 2, 1.0), outlines.circle(2, 1, 0.5, 8, 0.5)]


def area(loops):
    polygons = [loop[:, :2].T for loop in loops]
    areas = [0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) for x, y in polygons]
    return areas[0] - sum(areas[1:])


def test_the_triangles_fill_the_domain_and_every_vertex_is_used(loops):
    points, triangles = gmsh_mesher.triangulate(loops)
    assert inverted(points, triangles) == 0
    assert 0.5 * double_areas(points, triangles).sum() == pytest.approx(area(loops), rel=1e-12)
    assert np.array_equal(np.unique(triangles), np.arange(len(points)))


def test_sides_of_an_unsplit_loop_stay_whole(loops):
    fine = [loop * (1, 1, 0.2) for loop in loops]

    def on_hole(points):
        return int((np.hypot(points[:, 0] - 2, points[:, 1] - 1) < 0.5 + 1e-9).sum())

    assert on_hole(gmsh_mesher.triangulate(fine)[0]) > 8
    assert on_hole(gmsh_mesher.triangulate(fine, unsplit=(1,))[0]) == 8


def test_the_number_of_triangles_is_about_the_one_wanted(loops):
    _, triangles = gmsh_mesher.triangulate_about(loops, area(loops), 400)
    assert 360 < len(triangles) < 440


def test_arrays_are_made_once_and_not_left_half_written(tmp_path):
    path, made = tmp_path / "folder" / "mesh.npz", []

    def make():
        made.append(1)
        return {"points": np.arange(6.0)}

    def broken():
        raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        cached(path, broken)
    assert not path.exists()
    for _ in range(2):
        assert np.array_equal(cached(path, make)["points"], np.arange(6.0))
    assert made == [1]
    assert [p.name for p in path.parent.iterdir()] == ["mesh.npz"]
