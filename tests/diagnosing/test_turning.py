"""A boundary that turns too little is a proof; a mesh that lies over itself is not called impossible."""

import meshes
import numpy as np
import pytest
import torch

import torchmesh as tm
from torchmesh import MeshBatch, Status, improve, join, quality
from torchmesh.diagnosing.turning import turns_too_little


def strip(degrees: float = 430.0, columns: int = 60, rows: int = 4) -> MeshBatch:
    """An annular strip that winds on past its own beginning: a valid mesh that lies over itself."""
    angle = np.radians(np.linspace(0, degrees, columns + 1))
    radius = np.linspace(1.0, 1.6, rows + 1)
    points = np.stack([np.outer(np.cos(angle), radius), np.outer(np.sin(angle), radius)], 2).reshape(-1, 2)
    _, triangles = meshes.grid_arrays(columns, rows)
    return MeshBatch.from_arrays(points, triangles[:, ::-1].copy())


def swapped() -> MeshBatch:
    """A square in whose lower side two neighbours have changed places."""
    mesh = meshes.grid(8, 8)
    points = mesh.points.clone()
    low = (points[:, 1] == 0).nonzero().squeeze(1)
    points[low[3]], points[low[4]] = mesh.points[low[4]], mesh.points[low[3]]
    return mesh.with_points(points)


@pytest.mark.parametrize("name", list(meshes.VALID))
def test_no_valid_mesh_turns_too_little(name):
    assert turns_too_little(meshes.VALID[name]()).tolist() == [False]


def test_strips_of_more_than_one_turn_do_not_turn_too_little():
    for degrees in (200.0, 360.0, 430.0, 900.0):
        mesh = strip(degrees)
        assert int(quality(mesh).inverted) == 0
        assert turns_too_little(mesh).tolist() == [False]


def test_proofs():
    mirrored = meshes.grid().points.clone() * torch.tensor([-1.0, 1.0], dtype=torch.float64)
    ring = meshes.ring()
    outer = ring.points.clone()
    outer[-16:] = outer[-16:].flip(0)
    batch = join([meshes.grid().with_points(mirrored), swapped(), meshes.grid(), ring.with_points(outer), ring])
    assert turns_too_little(batch).tolist() == [True, True, False, True, False]
    scaled = batch.with_points(batch.points * 1e-160)
    assert turns_too_little(scaled).tolist() == [True, True, False, True, False]


def test_an_edge_without_length_proves_nothing():
    mesh = meshes.grid()
    points = mesh.points.clone()
    points[1] = points[0]
    assert turns_too_little(mesh.with_points(points)).tolist() == [False]


@pytest.mark.parametrize("topology", ["flip", "keep"])
def test_a_strip_over_itself_is_untangled(topology):
    mesh = strip()
    tangled = meshes.disturbed(mesh, 0.12, 4)
    assert int(quality(tangled).inverted) > 20
    _, report = improve(tangled, tm.ImproveOptions(topology=topology))
    assert bool(report.valid)
    assert bool(report.certified)
    assert report.quality.mean < 1.25


@pytest.mark.parametrize("topology", ["flip", "keep"])
def test_everything_out_of_reach_of_a_fault_is_mended(topology):
    mesh = swapped()
    free = (~mesh.fixed).nonzero().squeeze(1)
    points = mesh.points.clone()
    high = free[mesh.points[free, 1] > 0.6]
    points[high] += 0.15 * torch.randn(len(high), 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    tangled = mesh.with_points(points)
    after, report = improve(tangled, tm.ImproveOptions(topology=topology))
    assert report.status.tolist() == [Status.PARTLY]
    assert "1 inverted triangle is left" in report.messages[0]
    left = ~quality(after).upright
    assert 0 < int(left.sum()) <= 3
    assert after.points[after.triangles[left]].mean(1)[:, 1].max() < 0.3
    with pytest.raises(tm.ConvergenceError):
        report.check()


def test_a_fault_alone_leaves_the_mesh_as_it_was():
    mesh = swapped()
    after, report = improve(mesh)
    assert report.status.tolist() in ([Status.INFEASIBLE], [Status.PARTLY])
    if report.status.tolist() == [Status.INFEASIBLE]:
        assert torch.equal(after.points, mesh.points)
        assert torch.equal(after.triangles, mesh.triangles)
    assert report.messages[0]
