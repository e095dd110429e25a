"""The compiled continuation in epsilon against its twin, to the bit: the same minimiser, other loops round it."""

import pytest
import torch
from meshes import delaunay, grid, hopeless, jittered

from torchmesh import Status, UntangleOptions, join, untangle
from torchmesh.kernels import continuation, library

OPTIONS = {
    "as it is": UntangleOptions(newton=None),
    "few values": UntangleOptions(max_continuations=1, max_iterations=2, size_sweeps=(20,), newton=None),
    "little work": UntangleOptions(work=20 * 2000, least_steps=20, size_sweeps=(20,), newton=None),
    "short steps": UntangleOptions(max_iterations=2, stall_patience=2, stall_ratio=1.0, stall_depth=0.0, newton=None),
}


BATCH = join(
    [jittered(8, 7, 0.9, 1), hopeless(), jittered(6, 5, 3.0, 2), grid(4, 3), delaunay(50, 4), jittered(8, 7, 0.5, 0)]
)


def outcome(batch, options, **more):
    moved, info = untangle(batch, options, **more)
    return moved.points, info.energy, info.gradient, info.iterations, info.evaluations, info.status


@pytest.mark.parametrize("name", OPTIONS)
def test_all_ends_are_those_of_the_twin_to_the_bit(name):
    """Whoever watches a minimisation gets the twin, with the compiled minimiser."""
    ours = outcome(BATCH, OPTIONS[name])
    twins = outcome(BATCH, OPTIONS[name], monitor=lambda *_: None)
    assert all(torch.equal(a, b) for a, b in zip(ours, twins, strict=True))


def test_the_cases_end_in_every_way():
    ends = {status for options in OPTIONS.values() for status in outcome(BATCH, options)[-1].tolist()}
    assert ends >= {Status.VALID, Status.STALLED, Status.ITERATION_LIMIT}


def test_torch_alone_comes_to_valid_meshes_too():
    with library.using("torch"):
        status = outcome(BATCH, OPTIONS["as it is"])[-1]
    assert torch.equal(status, outcome(BATCH, OPTIONS["as it is"])[-1])


def test_threads_pauses_and_company_change_no_bit(monkeypatch):
    whole = outcome(BATCH, OPTIONS["as it is"])
    monkeypatch.setattr(continuation, "threads", lambda: 3)
    monkeypatch.setattr(continuation, "_TRIANGLES", 1)
    paused = outcome(BATCH, OPTIONS["as it is"])
    assert all(torch.equal(a, b) for a, b in zip(whole, paused, strict=True))
    for b, part in enumerate(BATCH.split()):
        alone = outcome(part, OPTIONS["as it is"])
        assert torch.equal(alone[0], whole[0][BATCH.point_offsets[b] : BATCH.point_offsets[b + 1]])
        assert all(torch.equal(a, w[b : b + 1]) for a, w in zip(alone[1:], whole[1:], strict=True))
