"""SU2 files: markers keep their names, foreign lines stay, mistakes are named."""

import meshio
import numpy as np
import pytest
import torch
from file_contents import SU2, grid_arrays, load, save

from torchmesh.errors import MeshError, MeshIOError, MeshWarning
from torchmesh.files.mesh_files import read, write


def test_su2_names_of_several_words_become_one_word_and_none_is_an_error(tmp_path):
    (tmp_path / "in.su2").write_text(SU2.replace("MARKER_TAG= wall", "MARKER_TAG=  inlet pipe % left"))
    mesh = read(tmp_path / "in.su2")
    write(tmp_path / "out.su2", mesh, like=tmp_path / "in.su2")
    assert "MARKER_TAG= inlet_pipe\nMARKER_ELEMS= 2\n" in (tmp_path / "out.su2").read_text()
    (tmp_path / "in.su2").write_text(SU2.replace("MARKER_TAG= wall", "MARKER_TAG= "))
    with pytest.raises(MeshIOError, match="MARKER_TAG has no name"):
        read(tmp_path / "in.su2")


def test_su2_markers_keep_their_names(tmp_path):
    (tmp_path / "in.su2").write_text(SU2)
    mesh = read(tmp_path / "in.su2")
    assert len(mesh.triangles) == 4
    write(tmp_path / "out.su2", mesh.with_points(mesh.points + 1), like=tmp_path / "in.su2")
    text = (tmp_path / "out.su2").read_text()
    assert "MARKER_TAG= wall\nMARKER_ELEMS= 2\n3 0 1\n3 1 2\n" in text
    assert "MARKER_TAG= far_field\nMARKER_ELEMS= 2\n3 2 3\n3 3 0\n" in text
    assert "FFD_NBOX= 1" in text
    assert "% a comment" in text
    assert "1.5 1.25\n" in text
    with pytest.warns(MeshWarning, match="FFD_NBOX"):
        write(tmp_path / "out.vtu", mesh, like=tmp_path / "in.su2")
    tags = load(tmp_path / "out.vtu")
    np.testing.assert_array_equal(np.concatenate(tags.cell_data["su2:tag"]), [0, 0, 0, 0, 1, 1, 2, 2])


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("NDIME= 2", "NDIME= 3", "NDIME is not 2"),
        ("NELEM= 4", "NELEM= 40", "NELEM says 40, the file ends after"),
        ("NMARK= 2", "NMARK= 3", "NMARK says 3 markers, the file has 2"),
        ("5 0 1 4 0", "10 0 1 4 2 0", "element type 10 is not planar"),
        ("5 0 1 4 0", "5 0 1", "needs 3 points"),
        ("5 0 1 4 0", "5 0 1 9 0", "rows of points run from 0 to 4"),
        ("NPOIN", "NPOINTS", "no NPOIN"),
    ],
)
def test_su2_mistakes_are_named(tmp_path, old, new, what):
    (tmp_path / "in.su2").write_text(SU2.replace(old, new))
    with pytest.raises(MeshError, match=rf"in\.su2: .*{what}"):
        read(tmp_path / "in.su2")


def test_su2_is_flat_and_lays_a_tilted_mesh_down(tmp_path):
    points, faces = grid_arrays()
    upright = points[:, [0, 2, 1]] * [1, 1, -1]
    save(tmp_path / "in.vtu", meshio.Mesh(upright, [("triangle", faces)]))
    mesh = read(tmp_path / "in.vtu")
    with pytest.warns(MeshWarning, match="two-dimensional"):
        write(tmp_path / "out.su2", mesh, like=tmp_path / "in.vtu")
    assert torch.equal(read(tmp_path / "out.su2").points, mesh.points)
