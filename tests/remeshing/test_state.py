"""The state of a batch that is being remeshed: some meshes are taken out of it and put back."""

from dataclasses import replace

import meshes
import torch
from editing import state_of

import torchmesh as tm
from torchmesh.mesh.connectivity import twins
from torchmesh.remeshing.splits import split_rounds
from torchmesh.remeshing.state import RemeshState, editable, rebuilt


def three() -> RemeshState:
    batch = tm.join([meshes.grid(3, 3), meshes.l_shape(2), meshes.ring()])
    state = state_of(batch, torch.arange(1, len(batch.points) + 1))
    return replace(state, metric=state.size[:, None] * torch.tensor([1.0, 0.5, 2.0]))


def refined(state: RemeshState) -> RemeshState:
    """Each mesh with a third of its edges split, counted."""
    e = editable(state)
    splits = split_rounds(e, lambda h: (h % 3 == 0, h), max_rounds=1)
    return replace(rebuilt(state, e), splits=state.splits + splits, flips=state.flips + 5)


def assert_same(one: RemeshState, other: RemeshState) -> None:
    for name in ("size", "wanted", "splits", "collapses", "flips", "rounds", "metric"):
        assert torch.equal(getattr(one, name), getattr(other, name)), name
    assert torch.equal(one.names.of, other.names.of)
    assert one.names.fresh == other.names.fresh
    for name in ("points", "triangles", "fixed", "constrained_edges", "point_offsets", "triangle_offsets", "frames"):
        assert torch.equal(getattr(one.batch, name), getattr(other.batch, name)), name


def test_what_is_taken_out_and_put_back_is_as_it_was():
    state = three()
    for keep in ([True, False, True], [False, True, False], [True, True, True], [False, False, False]):
        at = torch.tensor(keep)
        assert_same(state.put(at, state.select(at)), state)


def test_changed_meshes_take_their_place_with_all_that_is_theirs():
    state, at = three(), torch.tensor([False, True, True])
    part = refined(state.select(at))
    assert int(part.splits.min()) > 0
    after = state.put(at, part)
    assert_same(after.select(at), part)
    assert_same(after.select(~at), replace(state.select(~at), names=part.names.renamed(state.select(~at).names.of)))
    assert after.splits.tolist() == [0, *part.splits.tolist()]
    assert torch.equal(after.batch.twin, twins(after.batch.triangles))
    assert (after.names.vertex_map().new_to_old < 0).sum() == part.splits.sum()


def test_taking_back_restores_all_but_the_history():
    state = three()
    at = torch.tensor([True, False, True])
    done = refined(state)
    back = done.taken_back(at, state)
    names = done.names.renamed(state.select(at).names.of)
    assert_same(back.select(at), replace(state.select(at), names=names, flips=state.flips[at] + 5))
    assert_same(back.select(~at), done.select(~at))
    everything = done.taken_back(torch.ones(3, dtype=torch.bool), state)
    assert torch.equal(everything.batch.points, state.batch.points)
    assert everything.names.fresh == done.names.fresh
    assert everything.flips.tolist() == [5, 5, 5]
