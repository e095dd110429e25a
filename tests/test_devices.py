"""The library runs on a device that is not the processor, and copies nothing to and fro in its hot paths.

The device is a pretended one (pretended_device.py): its tensors refuse to meet those of the processor.
"""

import dataclasses

import pytest
import torch
from meshes import disc, disturbed, grid, jittered, moved_hole
from pretended_device import DEVICE, Pretended, elsewhere, here

import torchmesh as tm

VALID = tm.join([disturbed(grid(), 0.02, 1), disc()])
TANGLED = tm.join([jittered(6, 5, 0.5), moved_hole()])

# Name: a mesh, what is done with it to a tensor, and how often Python waits for the device at most.  docs/measured.md
# has these numbers; what needs fewer may lower them.
WORK = {
    "quality": (TANGLED, lambda mesh: tm.quality(mesh).mean, 2),
    "losses.untangle_beta": (TANGLED, lambda mesh: tm.losses.untangle_beta(mesh.points, mesh), 0),
    "losses.regularised": (TANGLED, lambda mesh: tm.losses.regularised(mesh.points, mesh), 0),
    "flip_to_delaunay": (TANGLED, lambda mesh: tm.flip_to_delaunay(mesh)[0].triangles, 150),
    "smooth": (VALID, lambda mesh: tm.smooth(mesh)[0].points, 75),
    "untangle": (jittered(6, 5, 0.5), lambda mesh: tm.untangle(mesh)[0].points, 60),
    "nn.Smooth": (VALID, lambda mesh: tm.nn.Smooth(mesh)(mesh.points), 150),
}


def moved(mesh: tm.MeshBatch) -> tm.MeshBatch:
    """The mesh on the pretended device."""
    tensors = {f.name: getattr(mesh, f.name) for f in dataclasses.fields(mesh)}
    there = {name: elsewhere(v) for name, v in tensors.items() if isinstance(v, torch.Tensor)}
    return dataclasses.replace(mesh, **there, _twin=None)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", WORK)
def test_hot_paths_stay_on_the_device(name):
    mesh, work, waits = WORK[name]
    with Pretended() as device:
        result = work(moved(mesh))
    assert result.device == DEVICE
    assert device.copies == {}
    assert sum(device.waits.values()) <= waits, device.waits.most_common(5)
    torch.testing.assert_close(here(result).detach(), work(mesh).detach(), rtol=0, atol=1e-6)


# Name: a mesh, options, and how often Python waits for the device at most.
SMALL = tm.join([jittered(6, 5, 0.5), jittered(5, 4, 0.9, 1)])
IMPROVED = {
    "improve": (SMALL, tm.ImproveOptions(polish=None, relocate=False), 680),
    "improve, triangles kept": (SMALL, tm.ImproveOptions(topology="keep", polish=None), 230),
}

# What looks at boundaries on the processor, wherever the mesh lies (docs/measured.md, *Other devices*).
ON_THE_PROCESSOR = "diagnosing/walls.py"


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", IMPROVED)
def test_the_whole_job_stays_on_the_device_but_for_the_diagnosis(name):
    mesh, options, waits = IMPROVED[name]
    with Pretended() as device:
        better, report = tm.improve(moved(mesh), options)
    assert better.points.device == better.triangles.device == report.status.device == DEVICE
    assert [place for place in device.copies if not place.startswith(ON_THE_PROCESSOR)] == []
    assert sum(device.waits.values()) <= waits, device.waits.most_common(5)
    ours, expected = tm.improve(mesh, options)
    assert here(report.valid).tolist() == expected.valid.tolist() == [True, True]
    torch.testing.assert_close(here(report.quality.mean), tm.quality(ours).mean, rtol=0.01, atol=0)


def test_a_hidden_copy_is_seen():
    there = elsewhere(torch.arange(3.0))
    with Pretended(), pytest.raises(RuntimeError, match="meets the device"):
        there + torch.ones(3)
    with Pretended() as device:
        assert there.to("cpu").device.type == "cpu"
        assert bool((there > 1).any())
    assert sum(device.copies.values()) == 1
    assert sum(device.waits.values()) == 1
    with pytest.raises(TypeError, match="numpy"):
        there.numpy()
