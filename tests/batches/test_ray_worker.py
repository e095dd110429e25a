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

# Ray's own processes and its imports leave files and sockets to the garbage collector.
pytestmark = [POSIX, pytest.mark.filterwarnings("ignore")]


@pytest.fixture(scope="module")
def traps(tmp_path_factory) -> Iterator[Path]:
    """A Ray of two processors whose workers fall into the traps."""
    ray = pytest.importorskip("ray")
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
    """One file over which a worker dies, once: it is done again, and so is what was with it.  One that always kills
    its worker, the smallest and so the last: it is an error, and no other is."""
    folder = tmp_path / "in"
    for part in ("a", "b"):
        (folder / part).mkdir(parents=True)
        write(folder / part / "mesh.vtu", meshes.jittered(seed=1))
    shutil.copy(folder / "a" / "mesh.vtu", folder / "b" / "once.vtu")
    (folder / "b" / "broken.vtu").write_text("no mesh")
    (folder / "b" / "poison.vtu").write_text("no")
    results = {r.name: r for r in improve_files(folder, tmp_path / "out", engine="ray", budget=150)}
    assert (traps / "sprung-once.vtu").exists()
    assert len(results) == 5
    assert {name for name, r in results.items() if r.error} == {"b/broken.vtu", "b/poison.vtu"}
    assert "its worker died 2 times over it alone" in results["b/poison.vtu"].error
    assert set(contents(tmp_path / "out")) == {"a/mesh.vtu", "b/mesh.vtu", "b/once.vtu"}
    assert all(int(r.worker.split(":")[1]) != os.getpid() for r in results.values() if r.worker)
    after, _ = improve(read(folder / "a" / "mesh.vtu"))
    for name in ("b/once.vtu", "b/mesh.vtu"):
        assert torch.equal(read(tmp_path / "out" / name).points, after.points)
    import ray

    assert ray.is_initialized()  # what the caller has opened stays open
