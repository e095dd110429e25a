"""Jobs over workers that die: each job has one result, and the job that kills its worker is found."""

import random
import threading
from collections import Counter
from collections.abc import Iterator, Sequence

import pytest
from file_runs import jobs_named

from torchmesh.batches.batches import Job
from torchmesh.batches.crew import Crew, JobPool
from torchmesh.batches.manifest import FileResult
from torchmesh.batches.workers import WorkerLost


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
    pool = JobPool(jobs_named(8, size=5000), 2, 10**6)
    assert [len(pool.take()), len(pool.take())] == [4, 4]


def test_sizes_are_learned_from_the_files_read():
    """The first guess is bytes for a vertex; a binary format may need fewer, so a batch would be half empty."""
    jobs = jobs_named(100, size=1000)
    pool = JobPool(jobs, 1, 200)
    assert len(pool.take()) == 10
    pool.learn(jobs[0], FileResult("x", "x.vtu", vertices=10))
    pool.finish()
    assert len(pool.take()) == 20


def test_a_job_that_comes_back_is_waited_for():
    """One worker has the only job, and another waits; it gets the job when the first one dies."""
    pool = JobPool(jobs_named(1), 2, 100)
    first, taken = pool.take(), []
    waiting = threading.Thread(target=lambda: taken.append(pool.take()))
    waiting.start()
    assert pool.give_back(first, "killed") == []
    pool.finish()
    waiting.join(timeout=60)
    assert taken == [first]
    (result,) = pool.give_back(first, "killed again")
    assert "its worker died 2 times over it alone (killed again)" in result.error
    pool.finish()
    assert pool.take() == []


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
