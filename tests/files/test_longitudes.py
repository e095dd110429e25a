"""A mesh by longitude and latitude that crosses the date line is told; others are not."""

import warnings

import meshes
import numpy as np
import pytest

import torchmesh as tm
from torchmesh.files.longitudes import crosses_the_date_line


def band(first, last, low=-180.0):
    """A strip of triangles from a longitude to another one, with longitudes from `low` on."""
    x, y = np.meshgrid(np.arange(first, last + 1.0), np.arange(-2.0, 3.0))
    points, faces = np.stack([x.ravel(), y.ravel()], 1), []
    columns = x.shape[1]
    for j in range(x.shape[0] - 1):
        for i in range(columns - 1):
            a = j * columns + i
            faces += [[a, a + 1, a + 1 + columns], [a, a + 1 + columns, a + columns]]
    points[:, 0] = (points[:, 0] - low) % 360 + low
    return points, np.array(faces)


@pytest.mark.parametrize(
    ("low", "first", "what"),
    [(-180.0, 170, "add 360 to longitudes below 0"), (0.0, 350, "take 360 from longitudes above 180")],
)
def test_a_mesh_across_the_date_line_is_told(low, first, what):
    text = crosses_the_date_line(*band(first, first + 20, low))
    assert "8 elements are wider than 180 in x" in text
    assert what in text


def test_what_lies_on_one_side_or_is_no_map_of_degrees_is_not_told(tmp_path):
    assert crosses_the_date_line(*band(100, 170)) == ""
    points, faces = band(-170, 170)
    assert crosses_the_date_line(points, faces) == ""
    points, faces = band(170, 190)
    assert crosses_the_date_line(points * 10, faces) == ""
    assert crosses_the_date_line(points, faces[:0]) == ""
    coarse = np.array([[-100, 0], [150, 0], [0, 80], [150, 80.0]]), np.array([[0, 1, 2], [1, 3, 2]])
    assert crosses_the_date_line(*coarse) == ""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tm.write(tmp_path / "a.vtu", tm.MeshBatch.from_arrays(*meshes.grid_arrays(3, 3)))
        tm.read(tmp_path / "a.vtu")


def test_it_is_a_warning_of_read(tmp_path):
    points, faces = band(170, 190)
    rows = [f"{k + 1} {x} {y} 5.0" for k, (x, y) in enumerate(points)]
    rows += [f"{k + 1} 3 {a + 1} {b + 1} {c + 1}" for k, (a, b, c) in enumerate(faces)]
    (tmp_path / "a.grd").write_text(
        f"grid\n{len(faces)} {len(points)}\n" + "\n".join([*rows, "0", "0", "0", "0"]) + "\n"
    )
    with pytest.warns(tm.MeshWarning) as said:
        tm.read(tmp_path / "a.grd")
    assert any("crosses the date line; add 360" in str(one.message) for one in said)
