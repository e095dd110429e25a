"""Formats that meshio reads; test_documents has the round trips of all formats."""

import pytest
from file_contents import grid, save

from torchmesh.errors import MeshIOError
from torchmesh.files.mesh_files import read


def test_stl_merges_vertices_where_they_coincide(tmp_path):
    facet = "facet normal 0 0 1\nouter loop\nvertex {}\nvertex {}\nvertex {}\nendloop\nendfacet\n"
    text = "solid a\n" + facet.format("0 0 0", "1 0 0", "0 1 0") + facet.format("1 -0.0 0", "1 1 0", "-0.0 1 0")
    (tmp_path / "a.stl").write_text(text + "endsolid a\n")
    assert read(tmp_path / "a.stl").triangles.tolist() == [[0, 1, 2], [1, 3, 2]]


def test_a_tecplot_file_of_several_zones_is_refused(tmp_path):
    path = save(tmp_path / "a.dat", grid(point_data={}, cell_data={}))
    text = path.read_text()
    path.write_text(text + text[text.upper().index("ZONE") :])
    with pytest.raises(MeshIOError, match=r"2 zones.*each zone its own file"):
        read(path)
