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
    "losses.regularised": (TANGLED, lambda mesh: tm.losses.regularised(mesh.points, mesh), 8),
    "flip_to_delaunay": (TANGLED, lambda mesh: tm.flip_to_delaunay(mesh)[0].triangles, 160),
    "smooth": (VALID, lambda mesh: tm.smooth(mesh)[0].points, 130),
    "untangle": (jittered(6, 5, 0.5), lambda mesh: tm.untangle(mesh)[0].points, 900),
    "nn.Smooth": (VALID, lambda mesh: tm.nn.Smooth(mesh)(mesh.points), 260),
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
