"""One run at a time in a folder, and nothing left that blocks the next."""

import errno
import os
from pathlib import Path

import pytest
from children import started

from torchmesh.batches.folder_lock import locked_folder
from torchmesh.errors import MeshIOError

HOLDER = """
import sys, time
from pathlib import Path
from torchmesh.batches.folder_lock import locked_folder
with locked_folder(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(100)
"""


def enter(out: Path) -> None:
    with locked_folder(out):
        pass


def test_the_folder_is_made_and_nothing_is_left_in_it(tmp_path):
    out = tmp_path / "new" / "out"
    (out / ".torchmesh-run").mkdir(parents=True)
    (out / ".torchmesh-run" / "half.vtu").touch()
    with locked_folder(out):
        assert not (out / ".torchmesh-run").exists(), "what a killed run was writing"
        (out / ".torchmesh-run").mkdir()
        (out / ".torchmesh-run" / "half.vtu").touch()
    assert list(out.iterdir()) == []


def test_a_second_run_is_refused_until_the_first_has_ended(tmp_path):
    with locked_folder(tmp_path):
        for _ in range(2):
            with pytest.raises(MeshIOError, match="another run is writing to this folder; wait for its end"):
                enter(tmp_path)
    enter(tmp_path)


def test_a_process_that_is_killed_blocks_nobody(tmp_path):
    with started("-c", HOLDER, tmp_path) as holder:
        assert holder.stdout.readline() == "locked\n"
        with pytest.raises(MeshIOError, match="another run is writing"):
            enter(tmp_path)
        holder.kill()
        holder.wait(timeout=60)
    assert list(tmp_path.iterdir()) != [], "the lock file stays, and does no harm"
    enter(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name == "nt", reason="POSIX has flock")
@pytest.mark.parametrize("code", [errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_file_system_without_locks_is_used_without_one(tmp_path, monkeypatch, code):
    def refuse(*_) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr("fcntl.flock", refuse)
    enter(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(MeshIOError, match="cannot be written"):
        enter(tmp_path / "file" / "out")


@pytest.mark.parametrize("name", [".torchmesh-run", ".torchmesh-run.lock", "manifest.jsonl"])
def test_links_planted_in_the_folder_are_not_followed(tmp_path, name):
    out, precious = tmp_path / "out", tmp_path / "precious"
    out.mkdir()
    precious.write_text("mine")
    (out / name).symlink_to(precious)
    with pytest.raises(MeshIOError, match=rf"{name}: is a symbolic link"), locked_folder(out, "manifest.jsonl"):
        pytest.fail("the folder was entered")
    assert precious.read_text() == "mine"
