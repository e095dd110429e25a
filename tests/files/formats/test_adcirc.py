"""Meshes of ADCIRC and SCHISM: depths, strings of nodes and everything else stay to the letter."""

import numpy as np
import pytest
from dialects import divided, improved, named, turned

import torchmesh as tm
from torchmesh.files.documents import load

FORT = """grid with boundaries  ! made by SMS
4 5
1 0.0 0.0 -10.0
20 1.0 0.0 -10.0
3 1.0 1.0 -10.0
4 0.0 1.0 -10.0
5 1.4D+00 0.5 -10.0
1 3 1 20 5
2 3 20 3 5
3 3 3 4 5
4 3 4 1 5
1 = Number of open boundaries
2 = Total number of open boundary nodes
2 = Number of nodes for open boundary 1
1
20
1 = Number of land boundaries
4 = Total number of land boundary nodes
4 0 = Number of nodes for land boundary 1
20
3
4
1
"""


@pytest.fixture(params=["fort.14", "hgrid.gr3", "mesh.grd"])
def source(tmp_path, request):
    (tmp_path / request.param).write_text(FORT)
    return tmp_path / request.param


def test_only_the_moved_node_changes(source, tmp_path):
    assert improved(source, tmp_path / f"out{source.suffix}") == [("5 1.4D+00 0.5 -10.0", "5 0.5 0.5 -10.0")]
    assert named(source) == {"open-1": [[0, 1]], "land-1": [[0, 3], [1, 2], [2, 3]]}


def test_text_behind_numbers_is_passed_over_and_stays(tmp_path):
    """As Fortran reads rows: what stands behind the numbers that it asks for is no part of them."""
    told = FORT.replace("-10.0\n4 0.0", "-10.0  ! NODE NO., X, Y, DEPTH\n4 0.0").replace(
        "\n1\n20\n", "\n1  ! beginning\n20 end\n"
    )
    (tmp_path / "fort.14").write_text(told)
    assert improved(tmp_path / "fort.14", tmp_path / "out.14") == [("5 1.4D+00 0.5 -10.0", "5 0.5 0.5 -10.0")]
    assert named(tmp_path / "fort.14")["open-1"] == [[0, 1]]
    assert load(tmp_path / "fort.14").skipped == ()
    (tmp_path / "fort.14").write_text(FORT.replace("1 3 1 20 5", "1 three 1 20 5"))
    with pytest.raises(tm.MeshIOError, match="a row of the elements needs 5 numbers"):
        load(tmp_path / "fort.14")


def test_flips_change_the_rows_of_their_triangles(source, tmp_path):
    changed = turned(source, tmp_path / f"out{source.suffix}")
    assert changed == [("1 3 1 20 5", "1 3 20 3 5"), ("2 3 20 3 5", "2 3 1 20 5")]


def test_a_mesh_with_more_nodes_gets_its_strings_again(source, tmp_path):
    mesh, _ = divided(source)
    target = tmp_path / f"out{source.suffix}"
    tm.write(target, mesh, like=source)
    text = target.read_text()
    assert text.startswith("grid with boundaries  ! made by SMS\n6 6\n1 0.0 0.0 -10.0\n2 1.0 0.0 -10.0\n")
    assert text.split("= Number of open")[1] == FORT.split("= Number of open")[1].replace("20\n", "2\n")
    assert named(target) == named(source)


def test_files_of_values_have_no_boundaries_and_blank_titles(tmp_path):
    path = tmp_path / "drag.gr3"
    path.write_text("\n" + FORT.split("\n", 1)[1].split("1 = Number of open")[0])
    assert improved(path, tmp_path / "out.gr3") == [("5 1.4D+00 0.5 -10.0", "5 0.5 0.5 -10.0")]
    assert named(path) == {}


def test_islands_are_closed_and_weirs_keep_their_heights(tmp_path):
    text = FORT.replace("4 0 = Number", "4 21 = Number").replace(
        "\n20\n3\n4\n1\n", "\n20 0.5 1.0\n3 0.5 1.0\n4 0.5 1.0\n1 0.5 1.0\n"
    )
    (tmp_path / "fort.14").write_text(text)
    assert named(tmp_path / "fort.14")["island-1"] == [[0, 1], [0, 3], [1, 2], [2, 3]]
    assert len(improved(tmp_path / "fort.14", tmp_path / "out.14")) == 1
    with pytest.warns(tm.MeshWarning, match="heights and coefficients of island-1"):
        tm.write(tmp_path / "b.vtu", tm.read(tmp_path / "fort.14"), like=tmp_path / "fort.14")
    mesh, _ = divided(tmp_path / "fort.14")
    with pytest.warns(tm.MeshWarning, match="heights and coefficients of island-1"):
        tm.write(tmp_path / "c.14", mesh, like=tmp_path / "fort.14")
    assert (tmp_path / "c.14").read_text().endswith("4 21 = Number of nodes for land boundary 1\n2\n3\n4\n1\n")


def test_quads_are_read(tmp_path):
    (tmp_path / "a.gr3").write_text("t\n2 5\n1 0 0 1\n2 1 0 1\n3 1 1 1\n4 0 1 1\n5 2 0 1\n1 4 1 2 3 4\n2 3 2 5 3\n")
    cells = load(tmp_path / "a.gr3").mesh.cells
    assert [(block.type, block.data.tolist()) for block in cells] == [
        ("quad", [[0, 1, 2, 3]]),
        ("triangle", [[1, 4, 2]]),
    ]


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("4 5\n", "4 50000000\n", "the nodes says 50000000"),
        ("4 5\n", "four 5\n", "whole numbers: 'four 5'"),
        ("1 3 1 20 5", "1 5 1 20 5", "an element with 5 nodes"),
        ("1 3 1 20 5", "1 3 1 21 5", "refers to node 21"),
        ("5 1.4D", "4 1.4D", "number of another one"),
        ("4 0 = Number", "40 0 = Number", "the nodes of a land boundary says 40"),
        ("2 = Number of nodes", "x = Number of nodes", "begins with the number of its nodes"),
    ],
)
def test_mistakes_are_named(tmp_path, old, new, what):
    (tmp_path / "fort.14").write_text(FORT.replace(old, new))
    with pytest.raises(tm.MeshIOError, match=what):
        tm.read(tmp_path / "fort.14")


def test_depths_are_the_third_coordinate(source):
    source.write_text(FORT.replace("3 1.0 1.0 -10.0", "3 1.0 1.0 -12.5"))
    np.testing.assert_array_equal(load(source).mesh.points[:, 2], [-10, -10, -12.5, -10, -10])


def test_a_bed_is_improved_in_plan_even_where_it_is_a_tilted_plane(source, tmp_path):
    text = FORT.replace("3 1.0 1.0 -10.0", "3 1.0 1.0 -30.0").replace("4 0.0 1.0 -10.0", "4 0.0 1.0 -30.0")
    source.write_text(text.replace("0.5 -10.0", "0.5 -20.0"))
    ((_, new),) = improved(source, tmp_path / f"out{source.suffix}")
    assert new == "5 0.5 0.5 -20.0"
