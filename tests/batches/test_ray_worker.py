"""`improve_files` over a local Ray of two workers, one of which is killed in the midst of its work."""

import os
import shutil
import warnings
from collections.abc import Iterator
from pathlib import Path

import meshes
import pytest
import torch
from file_runs import POSIX, TRAPS, contents

from torchmesh import improve, improve_files, read, write

ray = pytest.importorskip("ray")
# Ray's own processes and its imports leave files and sockets to the garbage collector.
pytestmark = [POSIX, pytest.mark.filterwarnings("ignore")]


@pytest.fixture(scope="module")
def traps(tmp_path_factory) -> Iterator[Path]:
    """A Ray of two processors whose workers fall into the traps."""
    folder = tmp_path_factory.mktemp("traps")
    (folder / "sitecustomize.py").write_text(TRAPS.format(folder=str(folder)))
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        patch.setenv("PYTHONPATH", str(folder))
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        ray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="error")
        yield folder
        ray.shutdown()


def test_a_killed_worker_loses_nothing(tmp_path, traps):
    """Four files, and one over which a worker dies, once: it is done again, and so is what was with it."""
    folder = tmp_path / "in"
    for part in ("a", "b"):
        (folder / part).mkdir(parents=True)
        for n in range(2):
            write(folder / part / f"m{n}.vtu", meshes.jittered(seed=n))
    shutil.copy(folder / "a" / "m0.vtu", folder / "b" / "once.vtu")
    (folder / "b" / "broken.vtu").write_text("no mesh")
    results = {r.name: r for r in improve_files(folder, tmp_path / "out", engine="ray", budget=150)}
    assert (traps / "sprung-once.vtu").exists()
    assert len(results) == 6
    assert {name for name, r in results.items() if r.error} == {"b/broken.vtu"}
    assert set(contents(tmp_path / "out")) == set(results) - {"b/broken.vtu"}
    assert all(int(r.worker.split(":")[1]) != os.getpid() for r in results.values())
    for name in ("b/once.vtu", "b/m1.vtu"):
        after, _ = improve(read(folder / name))
        assert torch.equal(read(tmp_path / "out" / name).points, after.points)
    assert ray.is_initialized()  # what the caller has opened stays open


def test_a_file_that_always_kills_its_worker_is_an_error(tmp_path, traps):
    write(tmp_path / "poison.vtu", meshes.jittered())
    write(tmp_path / "good.vtu", meshes.jittered())
    paths = [tmp_path / "poison.vtu", tmp_path / "good.vtu"]
    results = {r.name: r for r in improve_files(paths, tmp_path / "out", engine="ray", workers=1)}
    assert results["good.vtu"].valid
    assert "its worker died 2 times over it alone" in results["poison.vtu"].error
    assert set(contents(tmp_path / "out")) == {"good.vtu"}
