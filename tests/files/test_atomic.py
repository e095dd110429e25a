"""Files are replaced whole or not at all."""

import pytest

from torchmesh.errors import MeshIOError
from torchmesh.files.atomic import check_target, replacing


def test_paths_that_cannot_be_written_to(tmp_path, monkeypatch):
    with pytest.raises(MeshIOError, match="does not exist"):
        check_target(tmp_path / "nowhere" / "picture.png")
    with pytest.raises(MeshIOError, match="is a directory"):
        check_target(tmp_path)

    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.mkdtemp", refuse)
    with pytest.raises(MeshIOError, match="cannot be written: Permission denied"):
        check_target(tmp_path / "picture.png")


def test_replacing_leaves_the_old_file_when_the_new_one_fails(tmp_path):
    target = tmp_path / "file.txt"
    target.write_text("old")

    def half(error: Exception) -> None:
        with replacing(target) as path:
            path.write_text("half")
            raise error

    with pytest.raises(ZeroDivisionError):
        half(ZeroDivisionError())
    with pytest.raises(MeshIOError, match=r"file\.txt: cannot be written: No space left on device"):
        half(OSError(28, "No space left on device"))
    with pytest.raises(KeyboardInterrupt):
        half(KeyboardInterrupt())
    assert target.read_text() == "old"
    with replacing(target) as path:
        path.write_text("new")
    assert target.read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["file.txt"]
