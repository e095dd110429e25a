"""SMS' meshes: cards stay to the letter, strings of nodes are walls."""

import numpy as np
import pytest
from dialects import divided, improved, named, turned

import torchmesh as tm
from torchmesh.files.documents import load

CARDS = """MESH2D
MESHNAME "Mesh"
E3T      1    1    2    5    1
E3T      2    2    3    5    1
E3T      3    3    4    5    1
E3T      4    4    1    5    1
ND       1 0.00000000e+000 0.00000000e+000 0.0
ND       2 1.00000000e+000 0.00000000e+000 0.0
ND       3 1.00000000e+000 1.00000000e+000 0.0
ND       4 0.00000000e+000 1.00000000e+000 0.0
ND       5 1.40000000e+000 5.00000000e-001 0.0
NS  1 2 3
NS  -4
NS 4 -1 inflow
BEGPARAMDEF
GM  "Mesh"
ENDPARAMDEF
"""


@pytest.fixture
def source(tmp_path):
    (tmp_path / "square.2dm").write_text(CARDS)
    return tmp_path / "square.2dm"


def test_only_the_moved_node_changes(source, tmp_path):
    old = "ND       5 1.40000000e+000 5.00000000e-001 0.0"
    assert improved(source, tmp_path / "out.2dm") == [(old, old.replace("1.40000000e+000", "0.5"))]
    assert named(source) == {"string-1": [[0, 1], [1, 2], [2, 3]], "inflow": [[0, 3]]}


def test_flips_change_the_rows_of_their_triangles(source, tmp_path):
    first, second = CARDS.splitlines()[2:4]
    new = ["E3T      1    2    3    5    1", "E3T      2    1    2    5    1"]
    assert turned(source, tmp_path / "out.2dm") == list(zip((first, second), new, strict=True))


def test_a_mesh_with_more_nodes_is_written_anew(source, tmp_path):
    mesh, _ = divided(source)
    with pytest.warns(tm.MeshWarning, match="MESHNAME cards, BEGPARAMDEF cards, GM cards"):
        tm.write(tmp_path / "out.2dm", mesh, like=source)
    assert np.array_equal(tm.read(tmp_path / "out.2dm").triangles, mesh.triangles)
    assert (tmp_path / "out.2dm").read_text().endswith("NS 1 2 3 -4 1\nNS 4 -1 2\n")


def test_elements_of_second_order_go_round(tmp_path):
    nodes = "".join(
        f"ND {k} {x} {y} 0\n" for k, (x, y) in enumerate(((0, 0), (1, 0), (2, 0), (1, 1), (0, 2), (0, 1)), 1)
    )
    (tmp_path / "a.2dm").write_text(f"MESH2D\nE6T 1 1 2 3 4 5 6 1\n{nodes}")
    mesh = load(tmp_path / "a.2dm").mesh
    points = mesh.points[mesh.cells[0].data[0]]
    np.testing.assert_array_equal(points[3:], (points[[0, 1, 2]] + points[[1, 2, 0]]) / 2)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("E3T      1    1    2    5", "E3T      1    1    2    50", "refers to node 50"),
        ("E3T      1    1    2    5    1", "E3T 1 1", "a card E3T needs 4 numbers: 'E3T 1 1'"),
        ("ND       5 1.4", "ND       4 1.4", "number of another one"),
        ("NS 4 -1 inflow", "NS 4 1", "has no end"),
        ("NS  1 2 3", "NS  1 x 3", "a string of nodes has 'x'"),
    ],
)
def test_mistakes_are_named(source, old, new, what):
    source.write_text(CARDS.replace(old, new))
    with pytest.raises(tm.MeshIOError, match=what):
        tm.read(source)
