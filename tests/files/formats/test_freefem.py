"""FreeFem's meshes: told from Gmsh's by their content, changed in place, written anew where rows change."""

import numpy as np
import pytest
from dialects import divided, improved, named, turned

import torchmesh as tm
from torchmesh.files.documents import load

SQUARE = (
    "5 4 4\n0 0 1\n1 0 1\n1 1 3\n0 1 3\n1.4 0.5 0\n1 2 5 7\n2 3 5 7\n3 4 5 7\n4 1 5 7\n1 2 1\n2 3 2\n3 4 3\n4 1 4\n"
)


@pytest.fixture
def source(tmp_path):
    (tmp_path / "square.msh").write_text(SQUARE)
    return tmp_path / "square.msh"


def test_only_the_moved_vertex_changes(source, tmp_path):
    assert improved(source, tmp_path / "out.msh") == [("1.4 0.5 0", "0.5 0.5 0")]
    assert named(source) == {"label-1": [[0, 1]], "label-2": [[1, 2]], "label-3": [[2, 3]], "label-4": [[0, 3]]}


def test_flips_change_the_rows_of_their_triangles(source, tmp_path):
    assert turned(source, tmp_path / "out.msh") == [("1 2 5 7", "2 3 5 7"), ("2 3 5 7", "1 2 5 7")]


def test_a_mesh_with_more_vertices_is_written_anew_in_the_same_format(source, tmp_path):
    mesh, centre = divided(source)
    with pytest.warns(tm.MeshWarning, match="point data 'freefem:label'"):
        tm.write(tmp_path / "out.msh", mesh, like=source)
    lines = (tmp_path / "out.msh").read_text().splitlines()
    assert lines[0] == "6 6 4"
    assert lines[6] == f"{centre[0]!r} {centre[1]!r} 0".replace("np.float64(", "").replace(")", "")
    assert lines[-4:] == ["1 2 1", "2 3 2", "3 4 3", "4 1 4"]
    assert np.array_equal(tm.read(tmp_path / "out.msh").triangles, mesh.triangles)


def test_the_extension_of_ours_makes_a_new_file_of_freefem(source, tmp_path):
    tm.write(tmp_path / "out.freefem", tm.read(source), like=source)
    assert (tmp_path / "out.freefem").read_text() == SQUARE
    tm.write(tmp_path / "new.msh", tm.read(source))
    assert (tmp_path / "new.msh").read_bytes().startswith(b"$MeshFormat")  # Gmsh's, where no file is followed
    assert load(tmp_path / "new.msh").format == "gmsh"


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("5 4 4\n", "5 4 400000\n", "the edges says 400000, the file ends after 4"),
        ("5 4 4\n", "5 99999999999999999 4\n", "the triangles says 99999999999999999"),
        ("1 2 5 7", "1 2 5", "a row of the triangles needs 4 numbers: '1 2 5'"),
        ("1 2 5 7", "1 2 1e300 7", "no whole number"),
        ("1 2 5 7", "1 2 6 7", "rows of points run from 0 to 4"),
        ("1 2 1\n", "1 two 1\n", "a row that is not numbers"),
    ],
)
def test_mistakes_are_named(source, old, new, what):
    source.write_text(SQUARE.replace(old, new))
    with pytest.raises(tm.MeshError, match=what) as error:
        tm.read(source)
    assert len(str(error.value)) <= 300
