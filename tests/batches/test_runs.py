"""Folders of files: kept apart, resumed after every kind of end, and never half-written.

Traps are laid by a `sitecustomize` module on PYTHONPATH (`file_runs.TRAPS`).
"""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import meshes
import meshio
import numpy as np
import pytest
import torch
from children import started
from file_runs import NAMES, POSIX, TRAPS, contents, result_names

from torchmesh import ImproveOptions, improve, improve_files, read, write
from torchmesh.batches import manifest
from torchmesh.batches import runs as files
from torchmesh.batches.runs import Run, settings
from torchmesh.commands.main import main
from torchmesh.errors import MeshIOError, MeshWarning, MissingDependencyError


@pytest.fixture
def traps(tmp_path, monkeypatch) -> Path:
    folder = tmp_path / "traps"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(TRAPS.format(folder=str(folder)))
    monkeypatch.setenv("PYTHONPATH", str(folder))
    return folder


def lines(out: Path) -> list[dict]:
    return [json.loads(line) for line in (out / "manifest.jsonl").read_text().splitlines()]


# --- the whole of it ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def done(originals, tmp_path_factory) -> tuple[Path, list]:
    out = tmp_path_factory.mktemp("done") / "new" / "out"
    return out, list(improve_files(originals, out, workers=2, budget=120))


def test_every_file_has_its_result_and_its_place(done, originals):
    out, results = done
    assert sorted(r.name for r in results) == NAMES
    assert set(contents(out)) == set(NAMES)
    for result in results:
        assert (result.error, result.valid, result.resumed) == (None, True, False)
        assert result.file == str(originals / result.name)
        after, report = improve(read(result.file))
        assert torch.equal(read(result.output).points, after.points)
        assert result.imr_average_after == float(report.quality.mean[0])


def test_the_manifest_has_a_line_and_a_row_for_each(done):
    out, results = done
    assert lines(out) == [r.record() for r in sorted(results, key=lambda r: r.name)]
    parquet = pytest.importorskip("pyarrow.parquet")
    assert parquet.read_table(out / "manifest.parquet").to_pylist() == lines(out)
    assert not [p for p in out.iterdir() if p.name.startswith(".")]


def test_a_second_run_does_nothing_again(done, originals, monkeypatch):
    out, results = done
    before = contents(out)
    monkeypatch.setattr(files, "Crew", lambda *_: pytest.fail("work began"))
    again = list(improve_files(originals, out))
    assert all(r.resumed for r in again)
    assert [r.record() for r in again] == [r.record() for r in sorted(results, key=lambda r: r.name)]
    assert contents(out) == before


def test_results_depend_on_neither_batches_nor_workers(done, originals, tmp_path, inline):
    results = list(improve_files(originals, tmp_path / "out", workers=1, budget=10**6))
    assert len({r.worker for r in results}) == 1
    assert {n: c for n, (c, _) in contents(tmp_path / "out").items()} == {
        n: c for n, (c, _) in contents(done[0]).items()
    }


# --- refusals ----------------------------------------------------------------------------------------


def test_options_that_cannot_travel_are_refused(inputs, tmp_path):
    options = ImproveOptions()
    object.__setattr__(options, "smooth", lambda: None)
    with pytest.raises(ValueError, match="the options cannot be sent to another process"):
        improve_files(inputs, tmp_path / "out", options)


def test_ray_that_is_missing_is_named(inputs, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingDependencyError, match=r"torchmesh-untangle\[ray\]"):
        list(improve_files(inputs, tmp_path / "out", engine="ray"))


# --- going on ----------------------------------------------------------------------------------------


@pytest.fixture
def resumed(done, inputs, tmp_path) -> tuple[Path, Path]:
    """A finished run whose inputs and results may be changed."""
    out = tmp_path / "out"
    shutil.copytree(done[0], out)
    return inputs, out


def test_what_has_changed_is_done_again(resumed):
    inputs, out = resumed
    assert result_names(inputs, out) == []
    write(inputs / "a" / "x.vtu", meshes.jittered(seed=9))
    (inputs / "b" / "x.vtu").touch()  # no change
    (out / "b" / "y.msh").unlink()
    (out / "b" / "c" / "x.vtu").write_text("half")
    run = Run.plan(inputs, out)
    assert sorted(job.name for job in run.jobs) == ["a/x.vtu", "b/c/x.vtu", "b/y.msh"]
    assert run.changed == {"the input has changed": 1, "the result is gone or has changed": 2}
    assert sorted(r.name for r in run.kept) == ["a/y.msh", "b/c/y.msh", "b/x.vtu"]
    assert result_names(inputs, out, redo=True) == NAMES


def test_an_input_of_the_same_size_and_other_content_is_seen(resumed):
    inputs, out = resumed
    path = inputs / "a" / "x.vtu"
    data = bytearray(path.read_bytes())
    data[-2] ^= 1
    path.write_bytes(data)
    assert result_names(inputs, out) == ["a/x.vtu"]


def test_other_options_are_said_and_everything_is_done_again(resumed):
    inputs, out = resumed
    run = Run.plan(inputs, out, ImproveOptions(topology="keep"))
    assert len(run.jobs) == 6
    (reason,) = run.changed
    assert (
        reason == f"other options: then {settings(ImproveOptions())}; now {settings(ImproveOptions())}, topology='keep'"
    )


def test_settings_tell_options_apart():
    from importlib.metadata import version

    plain = f"torchmesh {version('torchmesh-untangle')}"
    assert settings(ImproveOptions()) == plain
    assert "method='paper'" in settings(ImproveOptions.paper())
    assert settings(ImproveOptions.paper(beta=0.01)) != settings(ImproveOptions.paper(beta=0.02))
    assert settings(ImproveOptions(smooth_rounds=3)) == f"{plain}, smooth_rounds=3"
    assert settings(ImproveOptions.fast(quads="split")) == f"{plain}, method='fast', quads='split'"


def test_an_error_is_tried_again_and_a_mended_file_done(inputs, tmp_path, inline):
    good = (inputs / "a" / "x.vtu").read_bytes()
    (inputs / "a" / "x.vtu").write_bytes(good[:300])
    out = tmp_path / "out"
    first = {r.name: r for r in improve_files(inputs / "a", out, workers=1)}
    assert "cannot be read as vtu" in first["x.vtu"].error
    assert first["y.msh"].valid
    run = Run.plan(inputs / "a", out)
    assert run.changed == {"an error then": 1}
    (inputs / "a" / "x.vtu").write_bytes(good)
    second = {r.name: r for r in improve_files(inputs / "a", out, workers=1)}
    assert second["x.vtu"].valid
    assert second["y.msh"].resumed
    assert [line["name"] for line in lines(out)] == ["x.vtu", "y.msh"]


def test_a_torn_line_is_done_again(resumed):
    inputs, out = resumed
    path = out / "manifest.jsonl"
    path.write_bytes(path.read_bytes()[:-100])
    assert result_names(inputs, out) == ["b/y.msh"]


def test_a_run_that_is_left_goes_on_later(inputs, tmp_path, inline):
    out = tmp_path / "out"
    results = improve_files(inputs, out, workers=1, budget=1)
    first = next(results)
    results.close()
    assert lines(out)[0]["name"] == first.name
    assert set(contents(out)) <= set(NAMES)
    again = list(improve_files(inputs, out, workers=1))
    assert [r.name for r in again if r.resumed] == [first.name]
    assert sorted(r.name for r in again) == NAMES


def test_two_runs_at_once_are_refused(inputs, tmp_path, inline):
    out = tmp_path / "out"
    results = improve_files(inputs, out, workers=1, budget=1)
    next(results)
    with pytest.raises(MeshIOError, match="another run is writing to this folder"):
        next(improve_files(inputs, out))
    results.close()
    assert Run.plan(inputs, out).kept


def test_without_pyarrow_a_warning_names_the_extra(done, originals, tmp_path, monkeypatch):
    shutil.copytree(done[0], tmp_path / "out")
    (tmp_path / "out" / "manifest.parquet").unlink(missing_ok=True)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.warns(MeshWarning, match=r"torchmesh-untangle\[parquet\]"):
        assert len(list(improve_files(originals, tmp_path / "out"))) == 6
    assert not (tmp_path / "out" / "manifest.parquet").exists()


def test_a_mesh_that_stays_tangled_is_not_done_again(inputs, tmp_path, inline):
    points, triangles = meshes.grid_arrays(6, 6)
    points[0] = 1.4
    meshio.Mesh(points, [("triangle", triangles)]).write(inputs / "a" / "crossed.vtu")
    results = {r.name: r for r in improve_files(inputs / "a", tmp_path / "out", workers=1)}
    assert (results["crossed.vtu"].status, results["crossed.vtu"].valid) == ("stalled", False)
    assert np.isfinite(results["crossed.vtu"].imr_average_after)
    assert result_names(inputs / "a", tmp_path / "out") == []


# --- killed -------------------------------------------------------------------------------------------


@POSIX
def test_a_worker_that_is_killed_loses_nothing(inputs, tmp_path, traps):
    """Once by chance: everything is valid.  Always by the same file: that file is the only error.

    The file that kills is the smallest and so the last: one worker the fewer is started.
    """
    shutil.copy(inputs / "a" / "x.vtu", inputs / "a" / "once.vtu")
    (inputs / "a" / "poison.vtu").write_text("never read")
    results = {r.name: r for r in improve_files(inputs / "a", tmp_path / "out", workers=1, budget=1)}
    assert sorted(results) == ["once.vtu", "poison.vtu", "x.vtu", "y.msh"]
    assert (traps / "sprung-once.vtu").exists()
    assert [name for name, r in results.items() if r.error] == ["poison.vtu"]
    assert "its worker died 2 times over it alone (killed by signal 9" in results["poison.vtu"].error
    assert set(contents(tmp_path / "out")) == {"once.vtu", "x.vtu", "y.msh"}
    assert not [p for p in (tmp_path / "out").iterdir() if p.name.startswith(".")]


def batch(inputs: Path, out: Path, *more: str) -> contextlib.AbstractContextManager[subprocess.Popen]:
    """A run of `torchmesh batch`, as a process that can be interrupted."""
    return started("-m", "torchmesh", "batch", inputs, "--out", out, "--budget", "1", *more)


def wait_for(condition, process: subprocess.Popen) -> None:
    deadline = time.monotonic() + 120
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)


def children(pid: int) -> set[int]:
    listed = subprocess.run(["ps", "-A", "-o", "pid=,ppid="], capture_output=True, text=True, check=True).stdout
    return {int(line.split()[0]) for line in listed.splitlines() if int(line.split()[1]) == pid}


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{pid}/stat")  # where nobody waits for orphans they stay as zombies
    return not (status.exists() and status.read_text().rsplit(")", 1)[1].split()[0] == "Z")


@POSIX
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_run_that_is_killed_goes_on_where_it_stopped(inputs, tmp_path, traps, how, inline):
    shutil.copy(inputs / "a" / "x.vtu", inputs / "b" / "slow.vtu")
    out = tmp_path / "out"
    count, enough = (2, 3) if how == signal.SIGKILL else (1, 0)
    with batch(inputs, out, "--workers", str(count)) as process:
        wait_for(lambda: (traps / "sprung-slow.vtu").exists() and len(lines(out)) >= enough, process)
        crew = children(process.pid)
        assert len(crew) == count
        process.send_signal(how)
        _, err = process.communicate(timeout=60)
    assert process.returncode == (-signal.SIGKILL if how == signal.SIGKILL else 130)
    if how == signal.SIGINT:
        assert "interrupted" in err
        assert "of 7 meshes are done; the same command goes on from there" in err
        assert "Traceback" not in err
        assert not [p for p in out.iterdir() if p.name.startswith(".")]
    deadline = time.monotonic() + 60
    while any(map(alive, crew)):  # the one in the slow file too
        assert time.monotonic() < deadline
        time.sleep(0.02)

    if how == signal.SIGINT:
        return
    before, told = contents(out), {line["name"] for line in lines(out)}
    (traps / "fast").touch()
    assert main(["batch", str(inputs), "--out", str(out), "--workers", "1", "--budget", "30000"]) == 0
    after = contents(out)
    assert set(after) == {*NAMES, "b/slow.vtu"} == {line["name"] for line in lines(out)}
    assert {name: after[name] for name in told} == {name: before[name] for name in told}
    assert all(line["valid"] for line in lines(out))


@POSIX
def test_the_folder_of_results_may_refuse(inputs, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(MeshIOError, match="cannot be written"):
        list(improve_files(inputs, tmp_path / "file" / "out"))


def test_the_manifest_of_a_folder_is_found(done):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert set(manifest.load(done[0])) == set(NAMES)
