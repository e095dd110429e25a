"""SU2 files with several zones are changed in place: moved points and flipped elements, and nothing else."""

import pytest
import torch

import torchmesh as tm
from torchmesh.files.formats.su2_zones import zones_of
from torchmesh.files.source import Source

SQUARE = "NDIME= 2\nNELEM= 4\n5 0 1 4 0\n5 1 2 4 1\n5 2 3 4 2\n5 3 0 4 3\nNPOIN= 5\n"
WALL = "NMARK= 1\nMARKER_TAG= wall\nMARKER_ELEMS= 2\n3 0 1\n3 1 2\n"
TEXT = (
    "% two zones\nNZONE= 2\n\nIZONE= 1\n" + SQUARE + "0.0 0.0 0\n1.0 0.0 1\n1.0 1.0 2\n0.0 1.0 3\n\n"
    "  1.4   0.5  4 % the odd one\n" + WALL + "IZONE= 2\n" + SQUARE + "2. 0. 0\n3. 0. 1\n3. 1. 2\n2. 1. 3\n"
    "2.5 .5 4\n" + WALL + "FFD_NBOX= 1\n"
)


def test_only_what_has_moved_changes(tmp_path):
    (tmp_path / "in.su2").write_bytes(TEXT.replace("\n", "\r\n").encode())
    mesh = tm.read(tmp_path / "in.su2")
    assert (len(mesh.points), len(mesh.triangles)) == (10, 8)
    after, report = tm.improve(mesh)
    assert report.valid.all()
    tm.write(tmp_path / "out.su2", after, like=tmp_path / "in.su2")
    before, now = TEXT.split("\n"), (tmp_path / "out.su2").read_bytes().decode().split("\r\n")
    changed = [(a, b) for a, b in zip(before, now, strict=True) if a != b]
    assert [a for a, _ in changed] == ["  1.4   0.5  4 % the odd one"]
    x, y = after.points[4].tolist()
    assert changed[0][1] == f"  {x!r}   {y!r}  4 % the odd one"
    assert torch.equal(tm.read(tmp_path / "out.su2").points, after.points)


def test_flipped_elements_keep_their_lines_and_zones(tmp_path):
    (tmp_path / "in.su2").write_text(TEXT)
    mesh = tm.read(tmp_path / "in.su2")
    faces = mesh.triangles.clone()
    faces[4:6] = torch.tensor([[5, 6, 7], [5, 7, 9]])  # as if an edge of the second zone had flipped
    faces[6:8] = torch.tensor([[7, 8, 9], [8, 5, 9]])
    tm.write(tmp_path / "out.su2", mesh.with_triangles(faces), like=tmp_path / "in.su2")
    text = (tmp_path / "out.su2").read_text()
    assert text.split("IZONE= 2")[0] == TEXT.split("IZONE= 2")[0]
    assert "NELEM= 4\n5 0 1 2 0\n5 0 2 4 1\n5 2 3 4 2\n5 3 0 4 3\n" in text
    assert torch.equal(tm.read(tmp_path / "out.su2").triangles, faces)


@pytest.mark.filterwarnings("ignore::torchmesh.MeshWarning")
def test_zones_are_refused_with_other_vertices_and_named_in_other_formats(tmp_path):
    (tmp_path / "in.su2").write_text(TEXT)
    mesh = tm.read(tmp_path / "in.su2")
    finer, _ = tm.remesh(tm.improve(mesh)[0], tm.RemeshOptions(sizes=lambda p: 0.2 + 0 * p[:, 0]))
    assert len(finer.points) > 10
    with pytest.raises(tm.MeshIOError, match="changed in place"):
        tm.write(tmp_path / "out.su2", finer, like=tmp_path / "in.su2")
    tm.write(tmp_path / "out.vtu", mesh, like=tmp_path / "in.su2")
    assert tm.read(tmp_path / "out.vtu").triangles.shape == (8, 3)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("NZONE= 2", "NZONE= 3", "NZONE says 3 zones, the file has 2"),
        ("5 3 0 4 3\nNPOIN= 5\n2.", "5 3 0 7 3\nNPOIN= 5\n2.", "zone 2 has a triangle .* from 0 to 4"),
        ("2.5 .5 4\n", "2.5\n", "two coordinates"),
        ("FFD_NBOX", "NPOIN", "the file ends after"),
    ],
)
def test_mistakes_are_named(tmp_path, old, new, what):
    assert old in TEXT
    (tmp_path / "in.su2").write_text(TEXT.replace(old, new))
    with pytest.raises(tm.MeshIOError, match=what):
        tm.read(tmp_path / "in.su2")


def test_the_number_of_zones():
    assert zones_of(["% NZONE= 3\n", " NZONE = 2 % two\n"]) == 2
    assert zones_of(["NDIME= 2\n", "NELEM= 0\n", "NZONE= 2\n"]) == 1


def test_messages_name_points_and_elements_as_their_zones_count_them(tmp_path):
    wrong = TEXT.replace("2. 1. 3\n", "nan 1. 3\n")
    (tmp_path / "in.su2").write_text(wrong)
    with pytest.raises(tm.InvalidMeshError, match=r"points row 8 .*in the file: node 3 of zone 2\)"):
        tm.read(tmp_path / "in.su2")
    source = Source.open(_saved(tmp_path / "b.su2", TEXT))
    assert source.explained("triangles 1 and 6 are inverted, at vertex 5").endswith(
        "(in the file: node 0 of zone 2; elements 1 of zone 1, 2 of zone 2)"
    )


def _saved(path, text):
    path.write_text(text)
    return path
