"""Files are replaced whole or not at all."""

import errno
import os

import pytest

from torchmesh.errors import MeshIOError
from torchmesh.files.atomic import check_target, full_disk_named, replacing


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


def test_files_made_beside_the_target_are_moved_with_it(tmp_path):
    with replacing(tmp_path / "a.txt") as path:
        path.write_text("one")
        path.with_name("b.txt").write_text("two")
        assert not (tmp_path / "b.txt").exists()
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {"a.txt": "one", "b.txt": "two"}


def test_a_block_that_writes_nothing_is_an_error(tmp_path):
    with pytest.raises(MeshIOError, match=r"a\.txt: cannot be written"), replacing(tmp_path / "a.txt"):
        pass
    assert not list(tmp_path.iterdir())


def test_a_replaced_file_hands_on_its_permissions(tmp_path):
    target = tmp_path / "a.txt"
    target.write_text("old")
    target.chmod(0o640)
    with replacing(target) as path:
        path.write_text("new")
    assert target.stat().st_mode & 0o777 == 0o640


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_only_regular_files_are_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(MeshIOError, match="is not a regular file"):
        check_target(tmp_path / "pipe")
    with pytest.raises(MeshIOError, match="is not a regular file"), replacing(tmp_path / "pipe"):
        pytest.fail("the block was entered")


@pytest.mark.parametrize("error", [PermissionError(13, "Permission denied"), RuntimeError("NetCDF: HDF error")])
def test_a_full_disk_is_named_whatever_a_library_says(tmp_path, monkeypatch, error):
    class Full:
        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def write(self, _):
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(type(error)), full_disk_named(tmp_path):  # there is space: the error is what it says
        raise error
    monkeypatch.setattr("tempfile.TemporaryFile", lambda dir: Full())
    with pytest.raises(OSError, match="No space left on device"), full_disk_named(tmp_path):
        raise error
