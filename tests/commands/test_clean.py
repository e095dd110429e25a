"""`torchmesh clean`: what it prints, what it writes, and what it refuses."""

import meshio
import numpy as np
from command_line import is_one_clear_line, names

from torchmesh import read


def write_dirty(path):
    square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    points = np.array([*square, [0.5, 0.5, 0], [0.3, 0.7, 0], [0, 0, 0], [9, 9, 9]])
    triangles = np.array([[6, 1, 2], [0, 4, 5], [4, 2, 5], [2, 3, 5], [3, 0, 5], [3, 0, 5]])
    data = {"tag": [np.arange(6)]}
    meshio.Mesh(points, [("triangle", triangles)], point_data={"u": points[:, 0]}, cell_data=data).write(path)


def test_it_says_what_it_did_and_the_result_can_be_improved(call, folder):
    write_dirty(folder / "dirty.vtu")
    refused = call("improve", "dirty.vtu", "x.vtu")
    assert is_one_clear_line(refused, "torchmesh clean IN OUT")
    done = call("clean", "dirty.vtu", "clean.vtu")
    assert (done.status, done.err) == (0, "")
    assert done.out.splitlines() == [
        "1 vertex was merged with another in its position",
        "1 triangle that was there twice was removed",
        "1 hanging vertex was joined (triangles or quads divided: 1)",
        "1 vertex of no triangle was dropped",
        "1 component of 6 triangles",
    ]
    written = meshio.read(folder / "clean.vtu")
    assert written.point_data["u"].tolist() == written.points[:, 0].tolist()
    assert written.cell_data["tag"][0].tolist() == [0, 0, 1, 2, 3, 4]
    assert call("improve", "clean.vtu", "better.vtu").status == 0
    again = call("clean", "clean.vtu", "again.vtu")
    assert again.out.splitlines() == ["nothing to mend", "1 component of 6 triangles"]
    assert (folder / "again.vtu").read_bytes() == (folder / "clean.vtu").read_bytes()
    assert call("clean", "dirty.vtu", "dirty.vtu", "--in-place", "--quiet").out == ""
    assert len(read(folder / "dirty.vtu").triangles) == 6


def test_slits_are_sewn_on_request(call, folder):
    assert "sew closes slits" in call("clean", "cracked.vtk", "same.vtk").out
    assert len(read(folder / "same.vtk").points) == 10
    assert call("clean", "cracked.vtk", "whole.vtk", "--sew").status == 0
    assert len(read(folder / "whole.vtk").points) == 8


def test_bad_usage_is_one_line_and_writes_nothing(call, folder):
    before = names(folder)
    assert is_one_clear_line(call("clean", "missing.vtk", "x.vtk"), "no such file")
    assert is_one_clear_line(call("clean", "tangled.vtk", "x.foo"), "extension")
    assert call("clean", "tangled.vtk", "x.vtk", "--tolerance", "-1").status == 2
    assert is_one_clear_line(call("clean", "tangled.vtk", "x.vtk", "--tolerance", "nan"), "--tolerance")
    assert names(folder) == before
