"""SU2 files: markers keep their names, foreign lines stay, mistakes are named."""

import meshio
import numpy as np
import pytest
import torch
from file_contents import SU2, grid_arrays, load, rebuilt, save

from torchmesh.errors import MeshError, MeshIOError, MeshWarning
from torchmesh.files.documents import load as load_document
from torchmesh.files.formats.registry import FORMATS
from torchmesh.files.mesh_files import read, write


def test_su2_names_of_several_words_become_one_word_and_none_is_an_error(tmp_path):
    (tmp_path / "in.su2").write_text(SU2.replace("MARKER_TAG= wall", "MARKER_TAG=  inlet pipe % left"))
    form, document = FORMATS["su2"], load_document(tmp_path / "in.su2")
    form.write(tmp_path / "out.su2", document.mesh, document, same_rows=False)
    assert "MARKER_TAG= inlet_pipe\nMARKER_ELEMS= 2\n" in (tmp_path / "out.su2").read_text()
    assert form.left_behind(document, form, same_rows=True) == []
    assert form.left_behind(document, form, same_rows=False) == ["comments at the ends of lines"]
    (tmp_path / "in.su2").write_text(SU2.replace("MARKER_TAG= wall", "MARKER_TAG= "))
    with pytest.raises(MeshIOError, match="MARKER_TAG has no name"):
        read(tmp_path / "in.su2")


def test_su2_markers_keep_their_names(tmp_path):
    (tmp_path / "in.su2").write_text(SU2)
    mesh = read(tmp_path / "in.su2")
    assert len(mesh.triangles) == 4
    write(tmp_path / "out.su2", mesh.with_points(mesh.points + 1), like=tmp_path / "in.su2")
    text = (tmp_path / "out.su2").read_text()
    # Only the lines of the points change, and keep what stands behind the coordinates.
    changed = [(old, new) for old, new in zip(SU2.splitlines(), text.splitlines(), strict=True) if old != new]
    assert len(changed) == 5
    assert changed[4] == ("0.5 0.25 4", "1.5 1.25 4")
    with pytest.warns(MeshWarning, match="FFD_NBOX"):
        write(tmp_path / "out.vtu", mesh, like=tmp_path / "in.su2")
    tags = load(tmp_path / "out.vtu")
    np.testing.assert_array_equal(np.concatenate(tags.cell_data["su2:tag"]), [0, 0, 0, 0, 1, 1, 2, 2])


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("NDIME= 2", "NDIME= 3", "NDIME is not 2"),
        ("NELEM= 4", "NELEM= 40", "NELEM says 40, the file ends after"),
        ("NMARK= 2", "NMARK= 3", "NMARK says 3 markers, the file has 2"),
        ("5 0 1 4 0", "10 0 1 4 2 0", "element type 10 is not planar"),
        ("5 0 1 4 0", "5 0 1", "needs 3 points"),
        ("5 0 1 4 0", "5 0 1 9 0", "rows of points run from 0 to 4"),
        ("NPOIN", "NPOINTS", "no NPOIN"),
    ],
)
def test_su2_mistakes_are_named(tmp_path, old, new, what):
    (tmp_path / "in.su2").write_text(SU2.replace(old, new))
    with pytest.raises(MeshError, match=rf"in\.su2: .*{what}"):
        read(tmp_path / "in.su2")


def test_su2_is_flat_and_lays_a_tilted_mesh_down(tmp_path):
    points, faces = grid_arrays()
    upright = points[:, [0, 2, 1]] * [1, 1, -1]
    save(tmp_path / "in.vtu", meshio.Mesh(upright, [("triangle", faces)]))
    mesh = read(tmp_path / "in.vtu")
    with pytest.warns(MeshWarning, match="two-dimensional"):
        write(tmp_path / "out.su2", mesh, like=tmp_path / "in.vtu")
    assert torch.equal(read(tmp_path / "out.su2").points, mesh.points)


def test_flips_change_the_lines_of_their_elements_alone(tmp_path):
    text = "% my case\n" + SU2.replace("5 0 1 4 0", "5 0 1 4 0 % first").replace("NPOIN= 5 5", "NPOIN= 5 % all")
    text = text.replace("3 1 2\n", "3 1 2\nSEND_RECV= 0\n")
    (tmp_path / "in.su2").write_text(text)
    mesh = read(tmp_path / "in.su2")
    turned = rebuilt(mesh, mesh.points.numpy(), mesh.triangles.numpy()[[1, 0, 2, 3]])
    write(tmp_path / "out.su2", turned, like=tmp_path / "in.su2")
    changed = [
        pair
        for pair in zip(text.splitlines(), (tmp_path / "out.su2").read_text().splitlines(), strict=True)
        if pair[0] != pair[1]
    ]
    assert changed == [("5 0 1 4 0 % first", "5 1 2 4 0 % first"), ("5 1 2 4 1", "5 0 1 4 1")]


def test_a_file_of_three_dimensions_with_one_height_is_planar(tmp_path):
    """Points are x, y, z and their number."""
    head, rest = SU2.split("NPOIN= 5 5\n")
    rows, tail = rest.split("NMARK")
    rows = "".join(" ".join([*row.split()[:2], "0.25", row.split()[2]]) + "\n" for row in rows.splitlines())
    text = f"{head}NPOIN= 5 5\n{rows}NMARK{tail}".replace("NDIME= 2", "NDIME= 3")
    (tmp_path / "in.su2").write_text(text)
    mesh = read(tmp_path / "in.su2")
    write(tmp_path / "out.su2", mesh, like=tmp_path / "in.su2")
    assert (tmp_path / "out.su2").read_text() == text
    points = mesh.points.clone()
    points[4, 1] = 0.5
    write(tmp_path / "out.su2", mesh.with_points(points), like=tmp_path / "in.su2")
    assert (tmp_path / "out.su2").read_text() == text.replace("0.5 0.25 0.25 4", "0.5 0.5 0.25 4")
    form, document = FORMATS["su2"], load_document(tmp_path / "in.su2")
    form.write(tmp_path / "out.su2", document.mesh, document, same_rows=False)
    assert "NDIME= 3\n" in (tmp_path / "out.su2").read_text()
    assert "\n0.5 0.25 0.25\n" in (tmp_path / "out.su2").read_text()
    (tmp_path / "in.su2").write_text(text.replace("0.5 0.25 0.25 4", "0.5 0.25 0.5 4"))
    with pytest.raises(MeshIOError, match="NDIME is not 2, and z is not the same"):
        read(tmp_path / "in.su2")


def test_su2_periodic_pairs_stay_in_place_and_go_where_points_do(tmp_path):
    """SU2 before version 7 lists them as markers with a line of their own."""
    pairs = "".join(
        f"MARKER_TAG= SEND_RECEIVE\nMARKER_ELEMS= 1\nSEND_TO= {sign}1\n1 {node} {k}\n"
        for k, (sign, node) in enumerate((("", 0), ("-", 1)), 1)
    )
    (tmp_path / "in.su2").write_text(SU2.replace("NMARK= 2", "NMARK= 4") + pairs)
    mesh = read(tmp_path / "in.su2")
    assert bool(mesh.fixed[:2].all())
    write(tmp_path / "out.su2", mesh, like=tmp_path / "in.su2")
    assert (tmp_path / "out.su2").read_text() == (tmp_path / "in.su2").read_text()
    form, document = FORMATS["su2"], load_document(tmp_path / "in.su2")
    form.write(tmp_path / "new.su2", document.mesh, document, same_rows=False)
    assert "SEND" not in (tmp_path / "new.su2").read_text()
    assert form.left_behind(document, form, same_rows=False)[0] == "the pairs of periodic points (SEND_RECEIVE)"
