"""An interrupt ends the program in one line with status 130, whatever it is doing, and its processes with it."""

import os
import signal
import sys
import time

import meshes
import pytest
from children import started

from torchmesh import write

pytestmark = pytest.mark.skipif(os.name == "nt", reason="POSIX signals")

# A module that every Python process runs at its start: it interrupts the process when a module is about to be imported.
TRAP = """
import os, signal, sys
class Trap:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            sys.meta_path.remove(self)
            for _ in range({times}):
                os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Trap())
"""


def interrupted_at(tmp_path, name: str, times: int, *arguments: str, **options) -> tuple[int, str]:
    """Status and standard error of the command line that is interrupted when it imports a module."""
    (tmp_path / "sitecustomize.py").write_text(TRAP.format(name=name, times=times))
    path = os.pathsep.join([str(tmp_path), *sys.path])
    run = started("-m", "torchmesh", *arguments, cwd=tmp_path, env=os.environ | {"PYTHONPATH": path}, **options)
    with run as child:
        _, err = child.communicate(timeout=120)
    return child.returncode, err


# The last two are imported when torch is there, which takes seconds.
IMPORTS = [(name, times) for name in ("typer", "torch", "numpy", "torch._C") for times in (1, 2)]
IMPORTS += [("meshio", 1), ("torchmesh.files", 2)]


@pytest.mark.parametrize(("name", "times"), IMPORTS)
def test_an_interrupt_during_an_import_is_one_line(tmp_path, name, times):
    """Twice in a row is how `timeout -s INT` sends it."""
    write(tmp_path / "a.vtu", meshes.jittered())
    assert interrupted_at(tmp_path, name, times, "improve", "a.vtu", "b.vtu") == (130, "interrupted\n")
    assert not list(tmp_path.glob("*b.vtu*"))


def test_an_interrupt_during_an_import_in_the_midst_of_the_work_leaves_nothing(tmp_path):
    """matplotlib is imported when the mesh is improved and its files are about to be written."""
    write(tmp_path / "a.vtu", meshes.jittered())
    arguments = ("improve", "a.vtu", "b.vtu", "--plot", "p.png", "--report", "r.json", "-q")
    assert interrupted_at(tmp_path, "matplotlib.figure", 1, *arguments) == (130, "interrupted\n")
    assert {p.name for p in tmp_path.iterdir()} - {"__pycache__"} == {"a.vtu", "sitecustomize.py"}


def test_an_ignored_interrupt_stays_ignored(tmp_path):
    write(tmp_path / "a.vtu", meshes.jittered())
    arguments = ("improve", "a.vtu", "b.vtu", "-q")
    assert interrupted_at(tmp_path, "torch", 1, *arguments, sigint_ignored=True) == (0, "")
    assert (tmp_path / "b.vtu").exists()


FORKS = """
import os, sys, time
from torchmesh.improving.forked import over_processes

def task(number):
    os.write(1, b"%d\\n" % os.getpid())  # one write: lines of two processes do not mix
    time.sleep(100)

try:
    list(over_processes(task, 2, 2))
except KeyboardInterrupt:
    print("ended", flush=True)
"""


@pytest.mark.parametrize("group", [False, True], ids=["the parent only", "as the terminal does"])
def test_forked_workers_end_with_their_parent(group):
    with started(
        "-c", FORKS, start_new_session=True, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    ) as child:
        workers = [int(child.stdout.readline()) for _ in range(2)]
        (os.killpg if group else os.kill)(child.pid, signal.SIGINT)
        out, err = child.communicate(timeout=60)
    assert (out, err) == ("ended\n", "")
    for worker in workers:
        for _ in range(100):
            try:
                os.kill(worker, 0)
            except ProcessLookupError:
                break
            time.sleep(0.1)
        else:
            pytest.fail("a worker outlived its parent")
