"""COMSOL's meshes: comments and selections stay to the letter, boundaries have the numbers that COMSOL shows."""

import numpy as np
import pytest
from dialects import divided, improved, named, turned

import torchmesh as tm
from torchmesh.files.documents import load

SQUARE = """# Created by COMSOL Multiphysics.

# Major & minor version
0 1~
2 # number of tags
# Tags
5 mesh1~
10 mesh1_sel1
2 # number of types
# Types
3 obj~
3 obj

# --------- Object 0 ----------

0 0 1~
4 Mesh # class
4 # version
2 # sdim
5 # number of mesh vertices
0 # lowest mesh vertex index

# Mesh vertex coordinates
0 0~
1 0~
1 1~
0 1~
1.3999999999999999 0.5~

3 # number of element types

# Type #0

3 vtx # type name


1 # number of vertices per element
2 # number of elements
# Elements
0~
1~

2 # number of geometric entity indices
# Geometric entity indices
0~
1~

# Type #1

3 edg # type name


2 # number of vertices per element
4 # number of elements
# Elements
0 1~
1 2~
2 3~
3 0~

4 # number of geometric entity indices
# Geometric entity indices
0~
1~
2~
3~

# Type #2

3 tri # type name


3 # number of vertices per element
4 # number of elements
# Elements
0 1 4~
1 2 4~
2 3 4~
3 0 4~

4 # number of geometric entity indices
# Geometric entity indices
1~
1~
1~
1~

# --------- Object 1 ----------

0 0 1~
9 Selection # class
0 # Version
8 in # let # Label
5 mesh1 # Geometry/mesh tag
1 # Dimension
1 # Number of entities
# Entities
3~
""".replace("~", " ")  # COMSOL writes a blank at the end of lines


@pytest.fixture
def source(tmp_path):
    (tmp_path / "square.mphtxt").write_text(SQUARE)
    return tmp_path / "square.mphtxt"


def test_only_the_moved_vertex_changes(source, tmp_path):
    assert improved(source, tmp_path / "out.mphtxt") == [("1.3999999999999999 0.5 ", "0.5 0.5 ")]
    sides = {f"boundary-{k}": [edge] for k, edge in enumerate(([0, 1], [1, 2], [2, 3], [0, 3]), 1)}
    assert named(source) == {**sides, "in # let": [[0, 3]]}


def test_flips_change_the_rows_of_their_triangles(source, tmp_path):
    assert turned(source, tmp_path / "out.mphtxt") == [("0 1 4 ", "1 2 4 "), ("1 2 4 ", "0 1 4 ")]


def test_older_versions_have_parameters_and_pairs_of_domains(source, tmp_path):
    text, end = SQUARE.replace("4 # version", "2 # version"), "# number of geometric entity indices"
    for count in (2, 4, 4):
        head, rest = text.split(f"\n{count} {end}", 1)
        rows, tail = rest.split("\n\n", 1)
        pairs = (
            "1 # number of up/down pairs\n# Up/down\n1 0" if count == 4 else "0 # number of up/down pairs\n# Up/down"
        )
        parameters = "2 # number of parameter values per element\n1 # number of parameters\n# Parameters\n0 0.5\n"
        text = f"{head}\n{parameters}\n{count}  {end}{rows}\n\n{pairs}\n\n{tail}"
    source.write_text(text)
    assert improved(source, tmp_path / "out.mphtxt") == [("1.3999999999999999 0.5 ", "0.5 0.5 ")]


def test_a_mesh_with_more_vertices_is_written_anew(source, tmp_path):
    mesh, _ = divided(source)
    with pytest.warns(tm.MeshWarning, match="the selection 'in # let'"):
        tm.write(tmp_path / "out.mphtxt", mesh, like=source)
    assert np.array_equal(tm.read(tmp_path / "out.mphtxt").triangles, mesh.triangles)
    first, second = (load(path).mesh for path in (source, tmp_path / "out.mphtxt"))
    for i in (0, 1):
        assert np.array_equal(first.cell_data["comsol:entity"][i], second.cell_data["comsol:entity"][i])


def test_quads_are_in_rows(source):
    text = SQUARE.replace("3 tri", "4 quad").replace("\n3 # number of vertices per element\n4", "\n4 # number\n1")
    text = text.replace("0 1 4 \n1 2 4 \n2 3 4 \n3 0 4 ", "0 1 3 2").replace(
        "\n4 # number of geometric entity indices\n# Geometric entity indices\n1 \n1 \n1 \n1 ", "\n1 # n\n1"
    )
    source.write_text(text)
    assert load(source).mesh.cells[2].data.tolist() == [[0, 1, 2, 3]]


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("4 Mesh # class", "5 Geom2 # class", "its first object is a Geom2"),
        ("3 tri # type", "4 tri3 # type", "element type 'tri3' is not known"),
        ("2 # sdim", "1 # sdim", "its dimension is 1"),
        ("5 # number of mesh", "500000 # number of mesh", "the vertices says 500000"),
        ("0 1 4 ", "0 1 5 ", "rows of points run from 0 to 4"),
    ],
)
def test_mistakes_are_named(source, old, new, what):
    source.write_text(SQUARE.replace(old, new))
    with pytest.raises(tm.MeshError, match=what):
        tm.read(source)
