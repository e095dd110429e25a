"""Wavefront files: materials, textures and lines stay, groups are regions."""

import pytest
import torch

from torchmesh.errors import MeshWarning
from torchmesh.files.mesh_files import read, write

OBJ = """mtllib a.mtl
o plate
v 0 0 0 0.5 0.5 0.5
v 1 0 0
v 1.0 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vt 0.5 0.5
vn 0 0 1
usemtl red
f 1/1/1 2/2/1 3/3/1
f -4/1/1 -2/3/1 -1/4/1
"""


def test_obj_keeps_materials_texture_and_lines(tmp_path):
    (tmp_path / "in.obj").write_text(OBJ)
    mesh = read(tmp_path / "in.obj")  # five texture points on four vertices
    write(tmp_path / "same.obj", mesh, like=tmp_path / "in.obj")
    assert (tmp_path / "same.obj").read_text() == OBJ
    other = mesh.with_triangles(torch.tensor([[0, 1, 3], [1, 2, 3]]))
    write(tmp_path / "out.obj", other.with_points(mesh.points * 2), like=tmp_path / "in.obj")
    lines = (tmp_path / "out.obj").read_text().splitlines()
    assert lines[-2:] == ["f 1/1/1 2/2/1 4/4/1", "f 2/2/1 3/3/1 4/4/1"]
    assert lines[:3] == ["mtllib a.mtl", "o plate", "v 0 0 0 0.5 0.5 0.5"]
    assert lines[4] == "v 2.0 2.0 0.0"
    assert lines[-3] == "usemtl red"
    with pytest.warns(MeshWarning, match="texture coordinates, normals"):
        write(tmp_path / "out.off", mesh, like=tmp_path / "in.obj")


def test_obj_groups_are_regions(tmp_path):
    (tmp_path / "in.obj").write_text(OBJ.replace("f -4", "usemtl blue\nf -4"))
    assert read(tmp_path / "in.obj").constrained_edges.tolist() == [[0, 2]]


def test_comments_at_the_ends_of_lines_stay(tmp_path):
    text = "# head\nv 0 0 0 # origin\nv 1 0 0\nv 1 1 0\nv 0 1 0 #top\nf 1 2 3 # first\nf 1 3 4\n"
    (tmp_path / "in.obj").write_text(text)
    mesh = read(tmp_path / "in.obj")
    other = mesh.with_triangles(torch.tensor([[0, 1, 3], [1, 2, 3]])).with_points(mesh.points * 2)
    write(tmp_path / "out.obj", other, like=tmp_path / "in.obj")
    lines = (tmp_path / "out.obj").read_text().splitlines()
    assert lines[:2] == ["# head", "v 0 0 0 # origin"]
    assert lines[4:] == ["v 0.0 2.0 0.0 #top", "f 1 2 4 # first", "f 2 3 4"]
