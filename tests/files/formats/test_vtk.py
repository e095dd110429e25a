"""Legacy VTK files: what no array of the mesh is stays to the letter."""

import meshio
import numpy as np
import pytest
import torch
from file_contents import grid, save

import torchmesh as tm
from torchmesh.files.formats.vtk import VTK
from torchmesh.files.mesh_files import read, write

INT64 = """# vtk DataFile Version 5.1
vtk output
ASCII
DATASET UNSTRUCTURED_GRID
POINTS 5 double
0 0 0 1 0 0 1 1 0~
0 1 0 1.4 0.5 0~
METADATA
INFORMATION 1
NAME L2_NORM_RANGE LOCATION vtkDataArray
DATA 2 0 1.48661~

CELLS 5 12
OFFSETS vtktypeint64
0 3 6 9 12~
CONNECTIVITY vtktypeint64
0 1 4 1 2 4 2 3 4~
3 0 4~
CELL_TYPES 4
5
5
5
5

CELL_DATA 4
SCALARS material long~
LOOKUP_TABLE default
1 1 1 1~
""".replace("~", " ")  # VTK writes a blank at the end of lines
POLYGONS = INT64[: INT64.index("CELL_TYPES")].replace("UNSTRUCTURED_GRID", "POLYDATA").replace("CELLS", "POLYGONS")


def test_legacy_vtk_keeps_title_and_field_data(tmp_path):
    source = save(tmp_path / "in.vtk", grid(), binary=False, file_format="vtk42")
    text = source.read_text().splitlines()
    text[1] = "a title of mine"
    text.insert(4, "FIELD FieldData 1\nTIME 1 1 double\n0.125")
    source.write_text("\n".join(text) + "\n")
    write(tmp_path / "out.vtk", read(source), like=source)
    after = (tmp_path / "out.vtk").read_text()
    assert "\na title of mine\n" in after
    assert "TIME 1 1 double\n0.125" in after
    assert torch.equal(read(tmp_path / "out.vtk").points, read(source).points)


@pytest.mark.parametrize("text", [INT64, POLYGONS], ids=["grid", "polygons"])
def test_only_the_points_and_their_range_change(tmp_path, text):
    (tmp_path / "a.vtk").write_text(text)
    mesh, _ = tm.improve(read(tmp_path / "a.vtk"))
    write(tmp_path / "b.vtk", mesh, like=tmp_path / "a.vtk")
    assert torch.equal(read(tmp_path / "b.vtk").points, mesh.points)
    after = (tmp_path / "b.vtk").read_text()
    head, tail = text.split("0 0 0 1 0")[0], text[text.index("METADATA") :]
    assert after.startswith(head)
    assert after.endswith(tail.replace("DATA 2 0 1.48661 ", f"DATA 2 0.0 {2**0.5!r}"))
    assert after[len(head) : after.index("METADATA")] == "0 0 0 1 0 0 1 1 0 \n0 1 0 0.5 0.5 0 \n"


def test_more_fixed_vertices_and_no_fields_change_nothing_else(tmp_path):
    source = tmp_path / "a.vtk"
    source.write_text(INT64 + "FIELD FieldData 2\nc 1 4 double\n1 2 3 4 \nd 1 4 double\n1 2 3 4 \n")
    mesh = read(source)
    held = tm.MeshBatch.from_arrays(mesh.points, mesh.triangles[[1, 0, 2, 3]], np.ones(5, bool))
    with pytest.warns(tm.MeshWarning, match="cell data 'c', cell data 'd'"):
        write(tmp_path / "b.vtk", held, like=source)
    after = (tmp_path / "b.vtk").read_text()
    assert "FIELD FieldData 0\nPOINT_DATA 5\nFIELD FieldData 1\nfixed 1 5 int\n" in after
    assert read(tmp_path / "b.vtk").fixed.all()
    assert after.startswith(INT64[: INT64.index("0 1 4 1 2 4")])


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("5 double", "5 quadruple", "type 'quadruple' are not known"),
        ("POINTS 5", "POINTS 50000000000", "for which it is too small"),
        ("POINTS 5", "POINTS 6", "15 numbers instead of 18"),
        ("CELLS 5 12", "CELLS 5 x", "should have a whole number"),
        ("0 3 6 9 12", "0 3 9 6 12", "out of order"),
        ("SCALARS material long", "SCALES material long", "'SCALES material long' is not understood"),
        ("# vtk", "# ktv", "does not begin with"),
        ("UNSTRUCTURED_GRID", "UNKNOWN_GRID", "cannot be read as vtk"),
    ],
)
def test_mistakes_are_named(tmp_path, old, new, what):
    (tmp_path / "a.vtk").write_text(INT64.replace(old, new))
    with pytest.raises(tm.MeshIOError, match=what):
        read(tmp_path / "a.vtk")


def test_a_file_without_changes_and_with_crowded_lines(tmp_path):
    (tmp_path / "a.vtk").write_text(
        "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 float\n"
        "0 0 0 1 0 0\n1 1 0 0 1 0 1.4 .5 0\n"
        "CELLS 4 16\n3 0 1 4 3 1 2 4\n3 2 3 4 3 3 0 4\nCELL_TYPES 4\n5 5 5 5\n"
    )
    write(tmp_path / "b.vtk", read(tmp_path / "a.vtk"), like=tmp_path / "a.vtk")
    assert (tmp_path / "b.vtk").read_bytes() == (tmp_path / "a.vtk").read_bytes()


@pytest.mark.parametrize(
    ("extension", "modes"),
    [
        ("vtk", {"binary": True}), ("vtk", {"binary": False}), ("vtu", {"binary": True}), ("vtu", {"binary": False}),
        ("xdmf", {"data_format": "HDF"}), ("xdmf", {"data_format": "XML"}),
    ],
)  # fmt: skip
def test_a_file_from_which_arrays_went_is_read_by_others(tmp_path, extension, modes):
    """meshio does not bear an empty line where an array was, and what is in an array that goes is not changed, too."""
    points = np.array([(0.0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 0)])
    faces = [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
    data = {"a": [np.arange(4.0)], "b": [np.arange(4)], "c": [np.ones(4)], "d": [np.arange(4)]}
    source, target = tmp_path / f"a.{extension}", tmp_path / f"b.{extension}"
    mesh = meshio.Mesh(points, [("triangle", faces)], cell_data=data, point_data={"u": points[:, 0], "n": np.arange(5)})
    meshio.write(source, mesh, **modes)
    moved = tm.read(source)
    moved = moved.with_points(moved.points + 0.1 * ~moved.fixed[:, None])
    tm.write(target, moved, like=source, fields="drop")
    found = meshio.read(target)
    assert sorted(found.cell_data) == ["b", "d"]
    assert "n" in found.point_data
    assert "u" not in found.point_data
    assert found.points[4] == pytest.approx((0.6, 0.6, 0.0), abs=1e-6)


def test_freefem_writes_the_number_of_components_without_a_blank(tmp_path):
    head = (
        "# vtk DataFile Version 2.0\nsol.vtk, Created by Freefem++\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 3 float\n"
    )
    cells = "0 0 0\n1 0 0\n0 1 0\nCELLS 1 4\n3 0 1 2\nCELL_TYPES 1\n5\n"
    data = (
        "CELL_DATA 1\nScalars  Label int1\nLOOKUP_TABLE FreeFempp_table\n7\nLOOKUP_TABLE FreeFempp_table 1\n1 0 0 1\n"
    )
    (tmp_path / "a.vtk").write_text(head + cells + data)
    assert VTK.read(tmp_path / "a.vtk").mesh.cell_data["Label"][0].tolist() == [7]
