"""Jobs over workers that die: each job has one result, and the one that kills its worker is found."""

import itertools
import os
import random
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Sequence

import pytest

from torchmesh import ImproveOptions
from torchmesh.batches.batches import Job
from torchmesh.batches.manifest import FileResult
from torchmesh.batches.workers import Crew, LocalWorker, WorkerLost
from torchmesh.errors import MeshError


def jobs_named(count: int, size: int = 1000, kind: str = "good") -> list[Job]:
    return [Job(f"{kind}{n}", f"in/{kind}{n}.vtu", f"out/{kind}{n}.vtu", "out/.staging", size) for n in range(count)]


class Actor:
    """A worker in this process: answers, dies by chance, and always over a job that is poison."""

    def __init__(self, chance: random.Random, risk: float) -> None:
        self.chance, self.risk = chance, risk
        self.batches: list[int] = []

    def run(self, jobs: Sequence[Job]) -> Iterator[FileResult]:
        self.batches.append(len(jobs))
        for job in jobs:
            if job.name.startswith("poison") or self.chance.random() < self.risk:
                raise WorkerLost("killed by signal 9")
            yield FileResult(job.name, job.file, job.output, "settled", True, vertices=job.size // 50)

    def stop(self) -> None:
        pass

    def close(self) -> None:
        pass


@pytest.mark.parametrize("count", [1, 2, 5])
@pytest.mark.parametrize("seed", range(4))
def test_every_job_has_one_result_whatever_dies(seed, count):
    jobs = jobs_named(60) + jobs_named(3, kind="poison")
    random.Random(seed).shuffle(jobs)
    crew = Crew(jobs, lambda: Actor(random.Random(seed), 0.02), count, 200)
    results = list(crew.results())
    assert Counter(r.name for r in results) == Counter(job.name for job in jobs)
    bad = {r.name: r for r in results if r.error}
    assert {f"poison{n}" for n in range(3)} <= set(bad)
    # By chance a good job may see its worker die twice when alone; not many do.
    assert len(bad) <= 5
    assert "poison1.vtu: its worker died 2 times over it alone (killed by signal 9)" in bad["poison1"].error


def test_without_deaths_nothing_is_an_error():
    actors: list[Actor] = []

    def hire() -> Actor:
        actors.append(Actor(random.Random(0), 0.0))
        return actors[-1]

    results = list(Crew(jobs_named(100, size=5000), hire, 2, 1000).results())
    assert len(results) == 100
    assert not any(r.error for r in results)
    # 100 vertices each: ten fill a batch.
    assert all(len(a.batches) == 0 or max(a.batches) <= 10 for a in actors)
    assert sum(sum(a.batches) for a in actors) == 100


def test_what_is_left_is_shared_fairly():
    crew = Crew(jobs_named(8, size=5000), lambda: Actor(random.Random(0), 0.0), 2, 10**6)
    assert [len(crew._take()), len(crew._take())] == [4, 4]


def test_sizes_are_learned_from_the_files_read():
    """The first guess is bytes for a vertex; a binary format may need fewer, so a batch would be half empty."""
    crew = Crew(jobs_named(100, size=1000), lambda: Actor(random.Random(0), 0.0), 1, 200)
    assert len(crew._take()) == 10
    crew._learn(crew._jobs[0], FileResult("x", "x.vtu", vertices=10))
    crew._busy = 0
    assert len(crew._take()) == 20


def test_no_more_workers_than_jobs():
    hired = []
    crew = Crew(jobs_named(1), lambda: hired.append(1) or Actor(random.Random(0), 0.0), 50, 10)
    assert len(list(crew.results())) == 1
    assert len(hired) == 1


def test_an_error_that_is_no_death_is_not_hidden():
    class Broken(Actor):
        def run(self, jobs):
            raise ZeroDivisionError("a bug")

    with pytest.raises(ZeroDivisionError):
        list(Crew(jobs_named(5), lambda: Broken(random.Random(0), 0.0), 2, 10).results())


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
import signal
from torchmesh import ImproveOptions
from torchmesh.batches.batches import Job
from torchmesh.batches.workers import LocalWorker, WorkerLost

signal.signal(signal.SIGPIPE, signal.SIG_DFL)
worker = LocalWorker(ImproveOptions(), 100, "")
process = worker._running()
process.kill()
process.wait()
try:
    list(worker.run([Job("a", "a.vtu", "b.vtu", "staging", 1)] * 10_000))
except WorkerLost as lost:
    print(lost)
assert not signal.sigpending() and not signal.pthread_sigmask(signal.SIG_BLOCK, [])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "killed by signal 9, perhaps for want of memory\n"), done.stderr
