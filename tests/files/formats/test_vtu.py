"""VTK's XML files: only what changes is written anew, and damage is named."""

import numpy as np
import pytest
from dialects import VTU as TEXT
from dialects import improved
from file_contents import grid, load, save

import torchmesh as tm
from torchmesh.files.formats import vtk_blocks
from torchmesh.files.mesh_files import read, write


@pytest.fixture
def source(tmp_path):
    (tmp_path / "a.vtu").write_text(TEXT)
    return tmp_path / "a.vtu"


def test_vtu_keeps_field_data(tmp_path):
    source = save(tmp_path / "in.vtu", grid(field_data={"TIME": np.array([1 / 3])}))
    write(tmp_path / "out.vtu", read(source), like=source)
    np.testing.assert_array_equal(load(tmp_path / "out.vtu").field_data["TIME"], [1 / 3])


def test_only_the_points_and_their_range_change(source, tmp_path):
    range_of = 'NumberOfComponents="3" RangeMin="0" RangeMax="1.49"'
    (old, new), (before, after) = improved(source, tmp_path / "out.vtu")
    assert range_of in old
    assert new == old.replace("1.49", repr(2**0.5)).replace('RangeMin="0"', 'RangeMin="0.0"')
    assert before == "0 0 0 1 0 0 1 1 0 0 1 0 1.4 0.5 0"
    assert after == before.replace("1.4", "0.5")


@pytest.mark.parametrize(("number", "size"), [(69, 3), (76, 3), (7, 3)])
def test_lagrange_triangles_of_first_order_and_polygons_of_three_corners_stay_what_they_are(
    source, tmp_path, number, size
):
    text = TEXT.replace("5 5 5 5", " ".join([str(number)] * 4))
    source.write_text(text)
    improved(source, tmp_path / "out.vtu")
    assert f">{number} {number} {number} {number}<" in (tmp_path / "out.vtu").read_text()


def test_fixed_vertices_are_added_where_they_are_needed(source, tmp_path):
    mesh = read(source)
    held = tm.MeshBatch.from_arrays(mesh.points, mesh.triangles, np.ones(5, bool))
    write(tmp_path / "out.vtu", held, like=source)
    assert read(tmp_path / "out.vtu").fixed.all()
    assert "made by hand" in (tmp_path / "out.vtu").read_text()
    write(tmp_path / "again.vtu", read(source), like=source)
    assert (tmp_path / "again.vtu").read_text() == TEXT


def test_pieces_lie_side_by_side(source, tmp_path):
    start, end = TEXT.index("<Piece"), TEXT.index("</Piece>") + len("</Piece>")
    other = TEXT[start:end].replace("0 0 0 1 0 0 1 1 0 0 1 0 1.4", "5 0 0 6 0 0 6 1 0 5 1 0 6.4")
    source.write_text(TEXT[:end] + other + TEXT[end:])
    mesh, report = tm.improve(read(source))
    assert len(mesh.triangles) == 8
    assert report.valid.all()
    write(tmp_path / "out.vtu", mesh, like=source)
    after = (tmp_path / "out.vtu").read_text()
    assert after.count("<Piece") == 2
    assert np.array_equal(read(tmp_path / "out.vtu").points, mesh.points)


def test_blocks_of_lz4_are_unpacked_and_packed():
    part = b"abcabcabcabcabcabcabcabcabcabcabcabcabcabc" + bytes(300) + b"the end"
    # Three literals and a copy from three bytes before; a literal and a copy of it; literals at the end.
    block = (
        b"\x3f" + b"abc" + b"\x03\x00" + bytes([39 - 4 - 15]) + b"\x1f\x00\x01\x00" + bytes([255, 299 - 4 - 15 - 255])
    )
    block += b"\x70the end"
    assert vtk_blocks._from_lz4(block, 1000) == part
    assert vtk_blocks._from_lz4(vtk_blocks._as_lz4(part), len(part)) == part
    assert vtk_blocks._from_lz4(vtk_blocks._as_lz4(b"short"), 5) == b"short"
    for damaged, most in ((block, 100), (block[:10], 1000), (b"\x00\x09\x00", 1000)):
        with pytest.raises(ValueError, match="compressed data is"):
            vtk_blocks._from_lz4(damaged, most)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("3 6 9 12", "3 6 9 13", "lead behind their nodes"),
        ("3 6 9 12", "3 6 2 12", "out of order"),
        ("5 5 5 5", "5 5 5", "3 types of cells and 4 cells"),
        ("5 5 5 5", "6 6 6 6", "strips of triangles"),
        ("5 5 5 5", "99 5 5 5", "cells of the type 99"),
        ("0 1 2 3 4<", "0 1 2 3<", "the array 'rank' has 4 rows instead of 5"),
        ("0 1 2 3 4<", "0 1 x 3 4<", "the array 'rank' has text that is not numbers"),
        ('version="2.2"', 'version="2.2" compressor="vtkOwn"', "the compressor 'vtkOwn' is not known"),
        ('type="UnstructuredGrid"', 'type="PolyData"', r"it holds a PolyData; give it the extension \.vtp"),
        ("</Cells>", "", "it is no XML"),
    ],
)
def test_mistakes_are_named(source, old, new, what):
    source.write_text(TEXT.replace(old, new))
    with pytest.raises(tm.MeshIOError, match=what):
        read(source)
