"""Formats that meshio reads; test_documents has the round trips of all formats."""

import h5py
import meshes
import numpy as np
import pytest
from file_contents import grid, save

import torchmesh as tm
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


@pytest.mark.parametrize("name", ["a.hmf", "a.h5m", "a.med", "a.h5"])
def test_an_attribute_of_variable_length_is_refused_unread(tmp_path, name):
    """The HDF5 library died of one that a damaged byte had made of a string."""
    path = tmp_path / name
    (tm.save_batch if path.suffix == ".h5" else tm.write)(path, meshes.grid(3, 3))
    with h5py.File(path, "r+") as file:
        sequences = np.empty(1, object)
        sequences[0] = np.arange(3)
        file.attrs.create("version", sequences, (1,), h5py.vlen_dtype(np.int64))
    with pytest.raises(tm.MeshIOError, match="attribute 'version' is a sequence of variable length"):
        (tm.load_batch if path.suffix == ".h5" else tm.read)(path)
