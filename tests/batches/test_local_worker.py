"""Worker processes: how they start, how they end, and that none is left."""

import itertools
import os
import subprocess
import sys

import pytest
from file_runs import jobs_named

from torchmesh import ImproveOptions
from torchmesh.batches.crew import Crew
from torchmesh.batches.local_worker import LocalWorker
from torchmesh.errors import MeshError


def test_a_worker_that_does_not_start_ends_the_run(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false" if os.name != "nt" else "whoami.exe")
    with pytest.raises(MeshError, match="a worker process does not start: exit status 1"):
        list(Crew(jobs_named(2), lambda: LocalWorker(ImproveOptions(), 100, ""), 1, 100).results())


def test_a_worker_ends_when_its_parent_is_gone():
    """However the parent ends: the worker sees the end of its input, in the midst of work too."""
    worker = LocalWorker(ImproveOptions(), 100, "")
    process = worker._running()
    assert process.poll() is None
    process.stdin.close()
    assert process.wait(timeout=20) == 0
    worker.close()


def test_a_closed_run_leaves_no_process(tmp_path):
    """The jobs' files are missing, which is an answer too."""
    made: list[LocalWorker] = []

    def hire() -> LocalWorker:
        made.append(LocalWorker(ImproveOptions(), 100, ""))
        return made[-1]

    results = Crew(jobs_named(400, size=10**6), hire, 1, 100).results()
    (first,) = itertools.islice(results, 1)
    assert "there is no such file" in first.error
    process = made[0]._process
    results.close()
    assert process.poll() is not None
    assert made[0]._process is None


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGPIPE: there a write to a lost process always raises")
def test_a_lost_worker_kills_nobody_when_a_library_made_broken_pipes_deadly():
    """gmsh does so in `initialize`: then a write to a process that is gone would end the caller."""
    code = """
import signal, subprocess, sys
from torchmesh import ImproveOptions
from torchmesh.batches.batches import Job
from torchmesh.batches.local_worker import LocalWorker
from torchmesh.batches.workers import WorkerLost

signal.signal(signal.SIGPIPE, signal.SIG_DFL)
worker = LocalWorker(ImproveOptions(), 100, "")
pipe = subprocess.PIPE
worker._process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=pipe, stdout=pipe)
worker._process.kill()
worker._process.wait()
try:
    list(worker.run([Job("a", "a.vtu", "b.vtu", "staging", 1)] * 10_000))
except WorkerLost as lost:
    print(lost)
assert not signal.sigpending() and not signal.pthread_sigmask(signal.SIG_BLOCK, [])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "killed by signal 9, perhaps for want of memory\n"), done.stderr
