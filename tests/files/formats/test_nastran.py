"""Nastran decks in free, small and large fields: only moved nodes, flipped elements and their loads change."""

import warnings

import pytest
from decks import POINTS, TRIANGLES, changed_lines, flip_and_move, stale

import torchmesh as tm
from torchmesh.files.formats.nastran_cards import real, real_text


def free():
    grids = "".join(f"GRID,{k + 1},,{x!r},{y!r},0.0\n" for k, (x, y) in enumerate(POINTS))
    faces = [f"CTRIA3,{k + 1},{10 if k < 4 else 20},{a + 1},{b + 1},{c + 1}" for k, (a, b, c) in enumerate(TRIANGLES)]
    return grids + "\n".join(faces) + "\n"


def small():
    grids = "".join(f"GRID    {k + 1:<8}{'':8}{x:<8}{y:8}{'0.':8}\n" for k, (x, y) in enumerate(POINTS))
    faces = [
        f"CTRIA3  {k + 1:8}{10 if k < 4 else 20:8}{a + 1:8}{b + 1:8}{c + 1:8}" for k, (a, b, c) in enumerate(TRIANGLES)
    ]
    return grids + "\n".join(faces) + "\n"


def large():
    grids = "".join(f"GRID*   {k + 1:<16}{'':16}{x:16}{y:16}*\n*       {'0.0':16}\n" for k, (x, y) in enumerate(POINTS))
    faces = [
        f"CTRIA3* {k + 1:16}{10 if k < 4 else 20:16}{a + 1:16}{b + 1:16}\n*       {c + 1:16}"
        for k, (a, b, c) in enumerate(TRIANGLES)
    ]
    return grids + "\n".join(faces) + "\n"


HEAD = "SOL 101\nCEND\nTITLE = a plate  $ with a comment\nSUBCASE 1\n  LOAD = 2\nBEGIN BULK\nPSHELL,10,1,0.01\n$ ---\n"
TAIL = "PLOADE1,2,5,1.0,1.0,2,3\nPLOADE1,2,5,2.0,2.0,3,6\nSPC1,1,123456,1,4\nENDDATA\nanything\n"
BOUND = [("PLOADE1,2,5,2.0,2.0,3,6", "PLOADE1,2,6,2.0,2.0,3,6")]


def patched(tmp_path, bulk):
    source, target = tmp_path / "in.bdf", tmp_path / "out.bdf"
    source.write_text(HEAD + bulk + TAIL)
    mesh = tm.read(source)
    assert mesh.constrained_edges.tolist() == [[1, 4]]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tm.write(target, flip_and_move(mesh), like=source)
    back = tm.read(target)
    assert back.triangles[4:].tolist() == [[1, 2, 4], [2, 5, 4]]
    return changed_lines(source, target), back.points[6].tolist()


def test_free_fields(tmp_path):
    lines, at = patched(tmp_path, free())
    assert lines == [
        ("GRID,7,,0.25,0.5,0.0", "GRID,7,,.333333333333333,.55,0.0"),
        ("CTRIA3,5,20,2,3,6", "CTRIA3,5,20,2,3,5"),
        ("CTRIA3,6,20,2,6,5", "CTRIA3,6,20,3,6,5"),
        *BOUND,
    ]
    assert at == pytest.approx([1 / 3, 0.55], rel=1e-14)


def test_small_fields(tmp_path):
    lines, at = patched(tmp_path, small())
    assert lines == [
        ("GRID    7               0.25         0.50.      ", "GRID    7               .3333333.55     0.      "),
        ("CTRIA3         5      20       2       3       6", "CTRIA3         5      20       2       3       5"),
        ("CTRIA3         6      20       2       6       5", "CTRIA3         6      20       3       6       5"),
        *BOUND,
    ]
    assert at == pytest.approx([1 / 3, 0.55], rel=1e-6)


def test_large_fields(tmp_path):
    lines, at = patched(tmp_path, large())
    assert [new for _, new in lines] == [
        f"GRID*   {7:<16}{'':16}.333333333333333{'.55':16}*",
        f"*       {5:16}",
        f"CTRIA3* {6:16}{20:16}{3:16}{6:16}",
        BOUND[0][1],
    ]
    assert at == pytest.approx([1 / 3, 0.55], rel=1e-14)


def test_tabs_count_as_blanks_up_to_the_next_field(tmp_path):
    lines, at = patched(tmp_path, small().replace("GRID    7               0.25    ", "GRID\t7\t\t0.25\t"))
    assert lines[0] == ("GRID\t7\t\t0.25\t     0.50.      ", "GRID    7               .3333333.55     0.      ")
    assert at == pytest.approx([1 / 3, 0.55], rel=1e-6)


def test_digits_that_would_turn_a_triangle_over_are_refused(tmp_path):
    bulk = small().replace("0.25         0.5", "0.25      5.E-10")
    (tmp_path / "in.bdf").write_text(HEAD + bulk + TAIL)
    mesh = tm.read(tmp_path / "in.bdf")
    points = mesh.points.clone()
    points[6, 0], points[6, 1] = 1 - 1e-10, 0.5
    with pytest.raises(tm.MeshIOError, match="too few digits"):
        tm.write(tmp_path / "out.bdf", mesh.with_points(points), like=tmp_path / "in.bdf")
    assert not (tmp_path / "out.bdf").exists()


@pytest.mark.parametrize("width", [8, 16])
def test_real_numbers_are_as_exact_as_their_field(width):
    for value in (1 / 3, -1 / 3, 1234567.891, -1.23456789e-7, 6.02214076e23, 0.0, -0.5, 99999999.6, 1e-99, -123456.7):
        text = real_text(value, width)
        assert len(text) <= width
        assert "." in text
        assert real(text) == pytest.approx(value, rel=10.0 ** (5 - width), abs=1e-300)
    assert real_text(0.5, 8) == ".5"
    assert real("1.5+3") == real("1.5D3") == real("1.5E+3") == 1500
    assert real("-1.5-3") == -0.0015


@pytest.mark.parametrize(
    ("bulk", "message"),
    [
        ("INCLUDE 'mesh.bdf'\n", "INCLUDE; put the text of the included file"),
        ("GRID,99,3,0.,0.,0.\n", "several coordinate systems"),
        ("GRID,1,,0.,0.,0.\n", "GRID 1 is there twice"),
    ],
)
def test_what_cannot_be_changed_in_place_is_refused_by_name(tmp_path, bulk, message):
    (tmp_path / "in.bdf").write_text(HEAD + free() + bulk + TAIL)
    with pytest.raises(tm.MeshError, match=message):
        tm.read(tmp_path / "in.bdf")


def test_a_deck_that_is_cut_short_is_refused_and_bulk_data_alone_is_read(tmp_path):
    (tmp_path / "in.bdf").write_text(HEAD + free())
    with pytest.raises(tm.MeshIOError, match="no ENDDATA"):
        tm.read(tmp_path / "in.bdf")
    (tmp_path / "in.bdf").write_text(free())
    assert len(tm.read(tmp_path / "in.bdf").triangles) == 6


def test_elements_with_one_pressure_are_a_region(tmp_path):
    load = "PLOAD4,3,1,5.0\nPLOAD4,3,2,5.0\nPLOAD4,3,3,5.0\nPLOAD4,3,4,5.0\n"
    (tmp_path / "in.bdf").write_text(HEAD + free().replace(",20,", ",10,") + load + TAIL)
    assert tm.read(tmp_path / "in.bdf").constrained_edges.tolist() == [[1, 4]]


def test_pressures_and_angles_of_single_elements_are_named(tmp_path):
    load = "PLOAD4,3,5,5.0\nPLOAD4,3,6,6.0\n"
    bulk = free().replace("CTRIA3,5,20,2,3,6", "CTRIA3,5,20,2,3,6,30.")
    (tmp_path / "in.bdf").write_text(HEAD + bulk + load + TAIL)
    with pytest.warns(tm.MeshWarning, match="THETA.*PLOAD4 by element"):
        tm.write(tmp_path / "out.bdf", flip_and_move(tm.read(tmp_path / "in.bdf")), like=tmp_path / "in.bdf")


@pytest.mark.parametrize(
    ("cards", "said"),
    [
        ("TEMP,4,1,20.,7,30.\n", ["TEMP at 1 node"]),
        ("TEMP           4       7     3.+1\n", ["TEMP at 1 node"]),
        ("FORCE,4,7,,5.,1.,0.,0.\nSPCD,4,1,1,.5,7,2,.5\n", ["FORCE at 1 node, SPCD at 1 node"]),
        ("SPC,4,7,12,.25\nMOMENT,4,7,,0.,1.,0.,0.\n", ["SPC at 1 node"]),
        # Supports and loads of zero, values at nodes that stay, and a field that is the same everywhere.
        ("SPC,4,7,12,0.0\nSPC1,4,12,7\nSPCD,4,7,1,\nFORCE,4,7,,0.,1.,0.,0.\nFORCE,4,2,,1.,1.,0.,0.\n", []),
        ("TEMP,4,1,20.,2,20.,3,20.\nTEMP,4,4,20.,5,20.,6,2+1\nTEMP,4,7,20.\n", []),
        ("TEMP,4,99,20.\n", []),
    ],
)
def test_values_at_nodes_that_moved_are_named(tmp_path, cards, said):
    (tmp_path / "in.bdf").write_text(HEAD + free() + cards + TAIL)
    assert stale(tmp_path / "in.bdf") == said
    assert cards in (tmp_path / "moved.bdf").read_text()
