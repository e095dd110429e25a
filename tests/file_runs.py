"""What tests of runs over many files share: traps for worker processes, a worker in this process, a folder's contents.

TRAPS is a `sitecustomize` module, which every Python process runs at its start: the name of a file says what befalls
the process that opens it.
"""

import os
from pathlib import Path

import pytest

from torchmesh.batches.batches import Job, improve_jobs
from torchmesh.batches.runs import Run

TRAPS = """
import builtins, os, time
from pathlib import Path
opened = builtins.open
def trapped(file, *arguments, **options):
    name = os.path.basename(str(file)) if isinstance(file, (str, os.PathLike)) else ""
    flag = Path({folder!r}) / ("sprung-" + name)
    if name.startswith("poison"):
        os.kill(os.getpid(), 9)
    if name.startswith("once") and not flag.exists():
        flag.touch()
        os.kill(os.getpid(), 9)
    if name.startswith("slow") and not Path({folder!r}, "fast").exists():
        flag.touch()
        time.sleep(100)
    return opened(file, *arguments, **options)
builtins.open = trapped
"""
# The files of the fixtures `originals` and `inputs`.
NAMES = ["a/x.vtu", "a/y.msh", "b/c/x.vtu", "b/c/y.msh", "b/x.vtu", "b/y.msh"]
POSIX = pytest.mark.skipif(os.name == "nt", reason="SIGKILL and the like")


class Inline:
    """A worker in this process: saves the start of another where only the outcome matters."""

    def __init__(self, *settings) -> None:
        self.settings = settings

    def run(self, jobs):
        return improve_jobs(jobs, *self.settings)

    def stop(self) -> None:
        pass

    close = stop


def job(folder: Path, name: str) -> Job:
    """Improve a file of the folder, into its folder "out"."""
    return Job(name, str(folder / name), str(folder / "out" / name), str(folder / "out" / ".staging"))


def jobs_named(count: int, size: int = 1000, kind: str = "good") -> list[Job]:
    """Jobs whose files do not exist."""
    return [Job(f"{kind}{n}", f"in/{kind}{n}.vtu", f"out/{kind}{n}.vtu", "out/.staging", size) for n in range(count)]


def contents(out: Path) -> dict[str, tuple[bytes, int]]:
    """Every mesh file written, with its time of change."""
    return {
        p.relative_to(out).as_posix(): (p.read_bytes(), p.stat().st_mtime_ns)
        for p in out.rglob("*")
        if p.is_file() and not p.name.startswith("manifest.")
    }


def result_names(*arguments, **options) -> list[str]:
    """What a run would do, in order."""
    return sorted(job.name for job in Run.plan(*arguments, **options).jobs)
