"""Fitting a mesh to a format: what has to go is named."""

import warnings

import meshio
import numpy as np
import pytest
from file_contents import grid, save

from torchmesh.errors import MeshWarning
from torchmesh.files.documents import load
from torchmesh.files.drafts import Draft
from torchmesh.files.mesh_files import read, write


def test_what_a_format_cannot_hold_is_named(tmp_path):
    source = save(tmp_path / "in.vtu", grid())
    with pytest.warns(MeshWarning, match=r"out\.off: off files do not hold .*'p'.*'region'.*line cells.*'u'.*'v'"):
        write(tmp_path / "out.off", read(source), like=source)


@pytest.mark.parametrize("name", ["a.unv", "a.stl", "a.vtp", "a.bdf"])
def test_mid_side_nodes_that_a_format_does_not_hold_leave_no_points_behind(tmp_path, name):
    nine = [[0, 0], [2, 0], [2, 2], [0, 2], [1, 0], [2, 1], [1, 2], [0, 1], [1, 1]]
    points = np.pad(np.array([*nine, [3, 0], [4, 1], [3.5, 0.5], [3, 1], [2.5, 0.5]], float), ((0, 0), (0, 1)))
    cells = [("quad9", np.arange(9)[None]), ("triangle6", np.array([[1, 10, 2, 11, 12, 5]])), ("line", [[1, 9]])]
    mesh = meshio.Mesh(points, [(kind, np.array(rows)) for kind, rows in cells], point_data={"k": np.arange(14.0)})
    mesh.point_sets = {"some": np.array([4, 10])}
    with pytest.raises(MeshWarning, match="mid-side nodes"):
        Draft.of(tmp_path / name, mesh).tell()
    if name == "a.bdf":  # it holds six nodes
        mesh.cells = mesh.cells[:1]
    Draft.of(tmp_path / name, mesh).save()
    found = load(tmp_path / name).mesh
    if name == "a.vtp":
        assert found.point_data["k"].tolist() == [0, 1, 2, 3, 9, 10, 13]  # 9 is of a line, and 13 was of no cell at all
        assert np.flatnonzero(found.point_data["some"]).tolist() == [5]
    used = np.unique(np.concatenate([block.data.reshape(-1) for block in found.cells]))
    loose = {"a.vtp": 1, "a.unv": 1, "a.bdf": 5, "a.stl": 0}[name]
    assert len(found.points) - len(used) == loose


def test_stl_of_several_blocks_says_nothing_of_its_own(tmp_path):
    mesh = grid(point_data={}, cell_data={})
    faces = next(block.data for block in mesh.cells if block.type == "triangle")
    two = meshio.Mesh(mesh.points, [("triangle", faces[:5]), ("triangle", faces[5:])])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Draft.of(tmp_path / "a.stl", two).save()
