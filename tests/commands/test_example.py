"""`torchmesh example`: the files to try the commands on."""

import meshio
from command_line import inverted, is_one_clear_line, names

from torchmesh import read


def test_it_writes_what_it_lists_and_replaces_nothing_unasked(call, folder):
    done = call("example", "samples")
    assert (done.status, done.err) == (0, "")
    for name in ("undeformed.vtk", "channel.msh", "in/circle.vtu", "in/more/gate.vtu"):
        assert f"samples/{name}" in done.out
    assert "displacement" in meshio.read(folder / "samples" / "undeformed.vtk").point_data
    assert inverted(folder / "samples" / "in" / "circle.vtu") > 0
    before = (folder / "samples" / "channel.msh").read_bytes()
    (folder / "samples" / "channel.msh").write_text("mine")
    assert is_one_clear_line(call("example", "samples"), "is there already; --force replaces it")
    assert (folder / "samples" / "channel.msh").read_text() == "mine"
    assert call("example", "samples", "--force", "--quiet").out == ""
    assert (folder / "samples" / "channel.msh").read_bytes() == before
    assert ".tmp" not in names(folder / "samples")


def test_the_channel_has_a_body_with_layers_by_name(call, folder):
    call("example", "--quiet", "--force")
    assert call("warp", "channel.msh", "moved.msh", "--move", "body:0.2,0.1").status == 0
    assert call("quality", "moved.msh").status == 0
    given, moved = (meshio.read(folder / name) for name in ("channel.msh", "moved.msh"))
    assert (moved.points != given.points).any()
    assert len(read(folder / "channel.msh").triangles) == 288


def test_a_folder_that_cannot_be_written_is_one_line(call, folder, monkeypatch):
    (folder / "file").write_text("")
    assert is_one_clear_line(call("example", "file/inside"), "file/inside: no folder can be made: ")

    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    (folder / "ro").mkdir()
    monkeypatch.setattr("tempfile.TemporaryDirectory", refuse)
    done = call("example", "ro")
    assert is_one_clear_line(done, "error: ro/undeformed.vtk: cannot be written: Permission denied")
