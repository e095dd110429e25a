"""How meshes end that are tangled still: never worse than they came."""

import meshes
import torch

from torchmesh import ImproveOptions, Status, join
from torchmesh.improving.faults import end_the_tangled
from torchmesh.improving.runner import Log, Runner
from torchmesh.improving.state import State


def test_a_stalled_mesh_with_more_inverted_triangles_than_it_had_comes_back_as_given():
    few, many = meshes.jittered(6, 5, 0.5, seed=1), meshes.jittered(6, 5, 2.0, seed=1)
    options = ImproveOptions(topology="keep")
    state = State.of(join([few, many]), options)
    had = state.quality.inverted.tolist()
    assert 0 < had[0] < had[1]
    swapped = torch.cat([many.points, few.points])
    log = Log(2)
    log.mark("initial", state, torch.ones(2, dtype=torch.bool))
    after = end_the_tangled(state.at(state.mesh.with_points(swapped)), Runner(log), options)
    assert after.status.tolist() == [Status.STALLED] * 2
    first, second = after.mesh.split()
    assert torch.equal(first.points, few.points), "it has more inverted triangles than were given"
    assert torch.equal(second.points, few.points), "it has fewer, which were taken back"
    assert [step.stage for step in log.steps[0]] == ["initial", "as given"]
