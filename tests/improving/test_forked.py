"""One batch over several processes: cuts, order, failures, and the same bits as in one process."""

import io
import itertools
import os
import signal
import sys
import threading

import meshes
import pytest
import torch

from torchmesh import ImproveOptions, MeshWarning, improve, join
from torchmesh.improving.forked import can_fork, one_thread, over_processes, shard_borders
from torchmesh.mesh.ragged import offsets_from_counts

forks = pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux only")


def offsets(*counts):
    return offsets_from_counts(torch.tensor(counts))


def test_a_small_batch_is_one_shard():
    assert shard_borders(offsets(2000, 2000, 2000), 2) == [0, 3]
    assert shard_borders(offsets(10**6), 2) == [0, 1]


def test_shards_have_like_numbers_of_triangles():
    counts = [2000] * 60
    assert shard_borders(offsets(*counts), 2) == [0, 30, 60]
    assert shard_borders(offsets(*counts), 1) == [0, 60]
    borders = shard_borders(offsets(*[1000, 3000] * 200), 4)
    assert len(borders) == 9
    totals = [sum(([1000, 3000] * 200)[a:b]) for a, b in itertools.pairwise(borders)]
    assert max(totals) - min(totals) <= 6000


def test_every_mesh_is_in_one_shard():
    generator = torch.Generator().manual_seed(0)
    for workers in (2, 3, 7):
        counts = torch.randint(1, 30_000, (40,), generator=generator)
        borders = shard_borders(offsets_from_counts(counts), workers)
        assert borders == sorted(set(borders))
        assert borders[0] == 0
        assert borders[-1] == 40


@forks
def test_results_come_in_order():
    assert list(over_processes(lambda i: (i, os.getpid()), 7, 2))[3][0] == 3
    assert {pid for _, pid in over_processes(lambda i: (i, os.getpid()), 7, 2)} != {os.getpid()}


@forks
def test_an_exception_in_a_worker_is_raised_here():
    def task(i):
        if i == 1:
            raise ValueError("mesh 7")
        return i

    with pytest.raises(ValueError, match="mesh 7"):
        list(over_processes(task, 3, 2))


@forks
def test_what_a_killed_worker_leaves_is_done_here():
    parent = os.getpid()

    def task(i):
        if i == 1 and os.getpid() != parent:
            os.kill(os.getpid(), signal.SIGKILL)
        return i

    with pytest.warns(MeshWarning, match="worker process died"):
        assert list(over_processes(task, 4, 2)) == [0, 1, 2, 3]


@forks
def test_a_progress_bar_of_the_caller_is_no_reason_not_to_fork():
    tqdm = pytest.importorskip("tqdm")
    cpu = torch.device("cpu")
    with tqdm.tqdm(total=1, file=io.StringIO()):
        assert can_fork(cpu)
    end = threading.Event()
    thread = threading.Thread(target=end.wait)
    thread.start()
    safe = can_fork(cpu)
    end.set()
    thread.join()
    assert not safe


@forks
def test_the_same_bits_over_processes_and_in_one(monkeypatch):
    monkeypatch.setattr("torchmesh.improving.forked._LEAST", 50)
    batch = join([meshes.jittered(6, 6, 0.6, seed) for seed in range(8)])
    calls = []
    alone, report = improve(batch, ImproveOptions(workers=1))
    shared, other = improve(batch, ImproveOptions(workers=3), progress=calls.append)
    assert torch.equal(alone.points, shared.points)
    assert torch.equal(alone.triangles, shared.triangles)
    assert torch.equal(alone.point_offsets, shared.point_offsets)
    assert torch.equal(report.status, other.status)
    assert torch.equal(report.quality.inverse_mean_ratio, other.quality.inverse_mean_ratio)
    assert [[s.stage for s in steps] for steps in report.steps] == [[s.stage for s in steps] for steps in other.steps]
    assert other.messages == report.messages
    assert calls[-1].stage.startswith("shard")
    assert calls[-1].meshes == 0


def test_one_thread_inside_and_as_before_after():
    before = torch.get_num_threads()
    with one_thread():
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == before


def test_other_devices_do_not_fork():
    assert not can_fork(torch.device("meta"))


def test_workers_must_be_positive():
    with pytest.raises(ValueError, match="workers"):
        ImproveOptions(workers=0)
