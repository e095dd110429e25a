"""An interrupt ends the program in one line with status 130, whatever it is doing, and its processes with it."""

import os
import signal
import sys
import time

import meshes
import pytest
from children import interrupted_at, started

from torchmesh import write

pytestmark = pytest.mark.skipif(os.name == "nt", reason="POSIX signals")


def run_into_the_trap(tmp_path, name: str, times: int, *arguments: str) -> tuple[int, str]:
    """Status and standard error of the command line that is interrupted when it imports a module."""
    environment = os.environ | {"PYTHONPATH": interrupted_at(name, tmp_path, times)}
    with started("-m", "torchmesh", *arguments, cwd=tmp_path, env=environment) as child:
        _, err = child.communicate(timeout=120)
    return child.returncode, err


# The last two are imported when torch is there, which takes seconds.
IMPORTS = [(name, times) for name in ("typer", "torch", "numpy", "torch._C") for times in (1, 2)]
IMPORTS += [("meshio", 1), ("torchmesh.files", 2)]


@pytest.mark.parametrize(("name", "times"), IMPORTS)
def test_an_interrupt_during_an_import_is_one_line(tmp_path, name, times):
    """Twice in a row is how `timeout -s INT` sends it."""
    write(tmp_path / "a.vtu", meshes.jittered())
    assert run_into_the_trap(tmp_path, name, times, "improve", "a.vtu", "b.vtu") == (130, "interrupted\n")
    assert not list(tmp_path.glob("*b.vtu*"))


def test_an_interrupt_during_an_import_in_the_midst_of_the_work_leaves_nothing(tmp_path):
    """matplotlib is imported when the mesh is improved and its files are about to be written."""
    write(tmp_path / "a.vtu", meshes.jittered())
    arguments = ("improve", "a.vtu", "b.vtu", "--plot", "p.png", "--report", "r.json", "-q")
    assert run_into_the_trap(tmp_path, "matplotlib.figure", 1, *arguments) == (130, "interrupted\n")
    assert {p.name for p in tmp_path.iterdir()} - {"__pycache__"} == {"a.vtu", "sitecustomize.py"}


# The command in this program's place is interrupted while Python runs the source of a string.
IN_A_STRING = """
import sys
from torchmesh import __main__
from torchmesh.commands import main as commands

def run():
    exec("import os, signal; os.kill(os.getpid(), signal.SIGINT); [None for _ in range(1000)]")

commands.main = run
sys.exit(__main__.main())
"""


def test_an_interrupt_while_a_string_is_run_ends_with_the_status_of_all_others(tmp_path):
    (tmp_path / "in_a_string.py").write_text(IN_A_STRING)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    with started("-m", "in_a_string", cwd=tmp_path, env=environment) as child:
        assert child.communicate(timeout=120) == ("", "interrupted\n")
    assert child.returncode == 130


FORKS = """
import os, sys, time
from torchmesh.improving.forked import over_processes

def task(number):
    os.write(1, b"%d\\n" % os.getpid())  # one write: lines of two processes do not mix
    time.sleep(100)

for _ in range(2):
    try:
        list(over_processes(task, 2, 2))
    except KeyboardInterrupt:
        print("ended", flush=True)
"""


def test_forked_workers_end_with_their_parent():
    """The interrupt comes to the parent only, and then to all of them, as a terminal sends it."""
    path = {"PYTHONPATH": os.pathsep.join(sys.path)}
    with started("-c", FORKS, start_new_session=True, env=os.environ | path) as child:
        for kill in (os.kill, os.killpg):
            workers = [int(child.stdout.readline()) for _ in range(2)]
            kill(child.pid, signal.SIGINT)
            assert child.stdout.readline() == "ended\n"
            for worker in workers:
                wait_for_the_end(worker)
        assert child.communicate(timeout=60) == ("", "")


def wait_for_the_end(process: int) -> None:
    for _ in range(100):
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    pytest.fail("a worker outlived its parent")
