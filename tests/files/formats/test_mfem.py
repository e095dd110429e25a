"""MFEM's meshes: told from Medit's by their content, changed in place, written anew where rows change."""

import numpy as np
import pytest
from dialects import divided, improved, named, turned

import torchmesh as tm
from torchmesh.files.documents import load

SQUARE = """MFEM mesh v1.0

#
# MFEM Geometry Types (see fem/geom.hpp):
#
# SEGMENT     = 1
# TRIANGLE    = 2
#

dimension
2

elements
4
1 2 0 1 4
1 2 1 2 4
1 2 2 3 4
1 2 3 0 4

boundary
4
1 1 0 1
2 1 1 2
3 1 2 3
4 1 3 0

vertices
5
2
0 0
1 0
1 1
0 1
1.4 0.5
"""


@pytest.fixture
def source(tmp_path):
    (tmp_path / "square.mesh").write_text(SQUARE)
    return tmp_path / "square.mesh"


def test_only_the_moved_vertex_changes(source, tmp_path):
    assert improved(source, tmp_path / "out.mesh") == [("1.4 0.5", "0.5 0.5")]
    names = {f"attribute-{k}": [edge] for k, edge in enumerate(([0, 1], [1, 2], [2, 3], [0, 3]), 1)}
    assert named(source) == names


def test_flips_change_the_rows_of_their_triangles(source, tmp_path):
    assert turned(source, tmp_path / "out.mesh") == [("1 2 0 1 4", "1 2 1 2 4"), ("1 2 1 2 4", "1 2 0 1 4")]


def test_names_of_attributes_are_those_of_walls(source, tmp_path):
    sets = 'bdr_attribute_sets\n2\n"outer wall" 2 1 2\n"lid" 1 3\n\nvertices\n'
    source.write_text(SQUARE.replace("v1.0", "v1.3").replace("vertices\n", sets) + "\nmfem_mesh_end\n")
    assert named(source)["outer wall"] == [[0, 1], [1, 2]]
    assert improved(source, tmp_path / "out.mesh") == [("1.4 0.5", "0.5 0.5")]
    with pytest.warns(tm.MeshWarning, match="not carried over .*: the bdr_attribute_sets"):
        tm.write(tmp_path / "b.vtu", tm.read(source), like=source)


def test_quads_and_coordinates_in_space_are_read(source):
    quad = SQUARE.replace("elements\n4\n", "elements\n5\n1 3 1 5 6 2\n").replace("5\n2\n0 0\n1 0\n", "7\n2\n0 0\n1 0\n")
    source.write_text(quad + "2 0\n2 1\n")
    cells = load(source).mesh.cells
    assert [(block.type, len(block.data)) for block in cells] == [("quad", 1), ("triangle", 4), ("line", 4)]
    points = SQUARE.split("5\n2\n")[1].replace("\n", " 0\n")
    source.write_text(SQUARE.split("5\n2\n")[0] + "5\n3\n" + points)
    assert tm.read(source).points.shape == (5, 2)


def test_a_mesh_with_more_vertices_is_written_anew_in_the_same_format(source, tmp_path):
    mesh, _ = divided(source)
    with pytest.warns(tm.MeshWarning, match="comments"):
        tm.write(tmp_path / "out.mesh", mesh, like=source)
    assert (tmp_path / "out.mesh").read_text().startswith("MFEM mesh v1.0\n")
    assert np.array_equal(tm.read(tmp_path / "out.mesh").triangles, mesh.triangles)
    assert named(tmp_path / "out.mesh") == named(source)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("v1.0", "v2.0", "not of the versions"),
        ("MFEM mesh v1.0", "MFEM INLINE mesh v1.0", "not of the versions"),
        ("dimension\n2", "dimension\n3", "dimension is not 2"),
        ("1 2 0 1 4", "1 4 0 1 4 2", "geometry 4 is not planar"),
        ("5\n2\n0 0\n", "5\n\nnodes\nFiniteElementSpace\n", "curved"),
        ("elements\n4", "elements\n4000", "elements says 4000"),
        ("\nboundary", "\nborder", "its section 'border' is not known"),
    ],
)
def test_mistakes_are_named(source, old, new, what):
    source.write_text(SQUARE.replace(old, new))
    with pytest.raises(tm.MeshIOError, match=what):
        tm.read(source)
