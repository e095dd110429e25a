"""Kratos' model parts: only moved nodes and flipped elements change; properties and sub model parts bound regions."""

import warnings

import pytest
from decks import POINTS, TRIANGLES, changed_lines, flip_and_move, stale

import torchmesh as tm
from torchmesh.files.source import Source

NODES = "".join(f"\t{k + 1}   {x!r}  {y!r}  0.0\n" for k, (x, y) in enumerate(POINTS))
FACES = "".join(
    f"{k + 1} {1 if k < 4 else 2}  {' '.join(str(v + 1) for v in row)} // {k}\n" for k, row in enumerate(TRIANGLES)
)
PART = f"""Begin ModelPartData
// VARIABLE_NAME value
End ModelPartData

Begin Properties 1
  DENSITY 1000
End Properties
Begin Nodes // all
{NODES}End Nodes
Begin Elements Element2D3N
{FACES}End Elements
Begin Conditions LineCondition2D2N
1 0 2 3
2 0 3 6
End Conditions
Begin NodalData TEMPERATURE
1 0 20.5
End NodalData
Begin SubModelPart Inlet
  Begin SubModelPartNodes
  2
  3
  End SubModelPartNodes
  Begin SubModelPartConditions
  1
  End SubModelPartConditions
  Begin SubModelPart Half
    Begin SubModelPartElements
    5
    6
    End SubModelPartElements
  End SubModelPart
End SubModelPart
"""


def test_only_moved_nodes_and_flipped_elements_change(tmp_path):
    source, target = tmp_path / "in.mdpa", tmp_path / "out.mdpa"
    source.write_text(PART)
    mesh = tm.read(source)
    assert mesh.constrained_edges.tolist() == [[1, 4]]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tm.write(target, flip_and_move(mesh), like=source)
    assert changed_lines(source, target) == [
        ("\t7   0.25  0.5  0.0", "\t7   0.3333333333333333  0.55  0.0"),
        ("5 2  2 3 6 // 4", "5 2  2 3 5 // 4"),
        ("6 2  2 6 5 // 5", "6 2  3 6 5 // 5"),
    ]


def test_sub_model_parts_bound_regions_by_themselves(tmp_path):
    (tmp_path / "in.mdpa").write_text(PART.replace(" 2  ", " 1  "))
    source = Source.open(tmp_path / "in.mdpa")
    assert source.mesh.constrained_edges.tolist() == [[1, 4]]
    assert sorted(source.content.mesh.cell_sets) == ["Inlet", "Inlet.Half"]
    assert source.content.mesh.point_sets["Inlet"].tolist() == [1, 2]


def test_words_may_stand_on_any_line(tmp_path):
    text = PART.replace("1 1  1 2 7 // 0\n", "1 1\n 1 2 // broken\n7\n")
    (tmp_path / "in.mdpa").write_text(text)
    tm.write(tmp_path / "out.mdpa", flip_and_move(tm.read(tmp_path / "in.mdpa")), like=tmp_path / "in.mdpa")
    assert len(changed_lines(text, tmp_path / "out.mdpa")) == 3


def test_conditions_on_triangles_follow_their_elements(tmp_path):
    surface = "Begin Conditions SurfaceCondition3D3N\n8 0 2 3 6\n9 0 2 6 5\nEnd Conditions\n"
    (tmp_path / "in.mdpa").write_text(PART.replace("Begin NodalData", surface + "Begin NodalData"))
    mesh = tm.read(tmp_path / "in.mdpa")
    assert len(mesh.triangles) == 6
    tm.write(tmp_path / "out.mdpa", flip_and_move(mesh), like=tmp_path / "in.mdpa")
    assert "8 0 2 3 5\n9 0 3 6 5\n" in (tmp_path / "out.mdpa").read_text()


def test_values_of_elements_are_regions_or_are_named(tmp_path):
    shared = "Begin ElementalData ACTIVE\n1 0\n2 0\n3 0\n4 0\nEnd ElementalData\n"
    (tmp_path / "in.mdpa").write_text(PART.replace(" 2  ", " 1  ").replace("    5\n    6\n", "") + shared)
    assert tm.read(tmp_path / "in.mdpa").constrained_edges.tolist() == [[1, 4]]
    own = "Begin ElementalData STRESS\n5 1.5\n6 2.5\nEnd ElementalData\n"
    (tmp_path / "in.mdpa").write_text(PART + own)
    with pytest.warns(tm.MeshWarning, match="ElementalData STRESS"):
        tm.write(tmp_path / "out.mdpa", flip_and_move(tm.read(tmp_path / "in.mdpa")), like=tmp_path / "in.mdpa")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("End Elements", ""), "Elements Element2D3N has no end"),
        (("End Elements", "End Element"), "'End Element' ends no block"),
        (("1 0 2 3\n", "1 0 2 33\n"), "Conditions 1 has node 33, which is not there"),
        (("End SubModelPart\n", "", -1), "has no end"),
        (("0.25  0.5  0.0", "0.25  0.5"), "without three coordinates"),
    ],
)
def test_mistakes_are_named(tmp_path, change, message):
    text = PART[: PART.rindex("End SubModelPart")] if len(change) == 3 else PART.replace(*change)
    (tmp_path / "in.mdpa").write_text(text)
    with pytest.raises(tm.MeshIOError, match=message):
        tm.read(tmp_path / "in.mdpa")


def test_another_format_names_what_is_lost(tmp_path):
    (tmp_path / "in.mdpa").write_text(PART)
    with pytest.warns(tm.MeshWarning, match="Properties 1, NodalData TEMPERATURE"):
        tm.write(tmp_path / "out.vtu", tm.read(tmp_path / "in.mdpa"), like=tmp_path / "in.mdpa")


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("TEMPERATURE", "1 0 20.5\n7 0 30\n", ["NodalData TEMPERATURE at 1 node"]),
        ("VELOCITY", "7 1 [3] (0, 0, 1.5)\n", ["NodalData VELOCITY at 1 node"]),
        # A value at a node that stays, supports of zero, a field that is the same everywhere, and a flag.
        ("TEMPERATURE", "1 0 20.5\n", []),
        ("DISPLACEMENT_X", "7 1 0.0\n", []),
        ("VELOCITY", "7 1 [3] (0, 0, 0)\n", []),
        ("TEMPERATURE", "".join(f"{k} 0 20\n" for k in range(1, 8)), []),
        ("BOUNDARY", "7\n", []),
    ],
)
def test_values_at_nodes_that_moved_are_named(tmp_path, name, values, said):
    block = f"Begin NodalData {name}\n{values}End NodalData"
    (tmp_path / "in.mdpa").write_text(PART.replace("Begin NodalData TEMPERATURE\n1 0 20.5\nEnd NodalData", block))
    assert stale(tmp_path / "in.mdpa") == said
    assert block in (tmp_path / "moved.mdpa").read_text()
