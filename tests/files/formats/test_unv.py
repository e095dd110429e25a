"""Universal files: columns stay columns, groups are walls and regions, other datasets stay to the letter."""

import numpy as np
import pytest
from dialects import divided, improved, named, turned

import torchmesh as tm
from torchmesh.files.documents import load


def ints(*values: int) -> str:
    return "".join(f"{value:10d}" for value in values)


def reals(*values: float) -> str:
    return "".join(f"{value:25.16E}" for value in values).replace("E", "D")


POINTS = ((0, 0), (1, 0), (1, 1), (0, 1), (1.4, 0.5))
SIDES = ((10, 20), (20, 30), (30, 40), (40, 10))
LINES = [
    "    -1", "   164", "         1  SI: Meter (newton)         2", "    -1", "    -1", "  2411",
    *(line for k, (x, y) in enumerate(POINTS, 1) for line in (ints(10 * k, 1, 1, 11), reals(x, y, 0))),
    "    -1", "    -1", "  2412",
    *(line for k, (a, b) in enumerate(SIDES, 1) for line in (ints(k, 11, 2, 1, 7, 2), ints(0, 1, 1), ints(a, b))),
    *(line for k, (a, b) in enumerate(SIDES, 5) for line in (ints(k, 41, 3, 1, 7, 3), ints(a, b, 50))),
    "    -1", "    -1", "  2467", ints(1, 0, 0, 0, 0, 0, 0, 3), "inlet", ints(8, 1, 0, 0, 8, 2, 0, 0), ints(8, 4, 0, 0),
    ints(2, 0, 0, 0, 0, 0, 0, 4), "plate", ints(8, 5, 0, 0, 8, 6, 0, 0), ints(8, 7, 0, 0, 8, 8, 0, 0), "    -1",
]  # fmt: skip
TEXT = "\n".join(LINES) + "\n"


@pytest.fixture
def source(tmp_path):
    (tmp_path / "a.unv").write_text(TEXT)
    return tmp_path / "a.unv"


def test_only_the_moved_node_changes(source, tmp_path):
    assert improved(source, tmp_path / "b.unv") == [(reals(1.4, 0.5, 0), reals(0.5, 0.5, 0))]
    assert named(source)["inlet"] == [[0, 1], [0, 3], [1, 2]]


def test_flips_change_the_lines_of_their_nodes(source, tmp_path):
    first, second = ints(10, 20, 50), ints(20, 30, 50)
    assert turned(source, tmp_path / "b.unv") == [(first, second), (second, first)]


def test_a_mesh_with_more_nodes_is_written_anew_with_its_groups(source, tmp_path):
    mesh, _ = divided(source)
    assert load(source).units == "metre, newton"
    with pytest.warns(tm.MeshWarning, match="dataset 164"):
        tm.write(tmp_path / "b.unv", mesh, like=source)
    assert np.array_equal(tm.read(tmp_path / "b.unv").triangles, mesh.triangles)
    assert np.array_equal(tm.read(tmp_path / "b.unv").points, mesh.points)
    assert named(tmp_path / "b.unv")["inlet"] == named(source)["inlet"]
    assert sum(map(len, load(tmp_path / "b.unv").mesh.cell_sets["plate"])) == 6


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        (ints(5, 41, 3, 1, 7, 3), ints(5, 111, 3, 1, 7, 4), "element type 111 with 4 nodes"),
        (ints(10, 20, 50), ints(10, 20, 60), "refers to node 60"),
        (ints(50, 1, 1, 11), ints(40, 1, 1, 11), "number of another one"),
        (ints(1, 0, 0, 0, 0, 0, 0, 3), ints(1, 0, 0, 0, 0, 0, 0, 3000), "the group 'inlet' has"),
        ("\n    -1\n    -1\n  2467", "\n    -1\n  2467", "has no end"),
    ],
)
def test_mistakes_are_named(source, old, new, what):
    source.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(tm.MeshIOError, match=what):
        tm.read(source)
