"""Vertices of meshes that came valid stay near, and the report says how far vertices went."""

import meshes
import numpy as np
import pytest
import torch
from exact import edge_counts, inverted
from scipy.spatial import Delaunay
from scipy.spatial.distance import cdist

import torchmesh as tm
from torchmesh import ImproveOptions, RemeshOptions, improve, join
from torchmesh.mesh.means import local_widths


def slow_widths(mesh: tm.MeshBatch) -> np.ndarray:
    """The mean length of the edges at each vertex, edge by edge."""
    points, ends = mesh.points.numpy(), set(edge_counts(mesh.triangles))
    lengths: list[list[float]] = [[] for _ in points]
    for edge in ends:
        a, b = edge
        for v in edge:
            lengths[v].append(float(np.linalg.norm(points[a] - points[b])))
    return np.array([np.mean(values) if values else 0.0 for values in lengths])


@pytest.mark.parametrize("name", list(meshes.VALID))
def test_the_local_width_is_the_mean_length_of_the_edges_there(name):
    mesh = meshes.VALID[name]()
    assert local_widths(mesh).numpy() == pytest.approx(slow_widths(mesh), rel=1e-12)


def travelled(before, after) -> torch.Tensor:
    way = (after.points - before.points).norm(dim=1)
    return torch.where(way > 0, way / local_widths(before), 0.0)


OPTIONS = {
    "default": ImproveOptions(),
    "fast": ImproveOptions.fast(),
    "slide": ImproveOptions(boundary="slide"),
    "keep": ImproveOptions(topology="keep"),
}


@pytest.mark.parametrize("options", list(OPTIONS))
@pytest.mark.parametrize("mesh", [meshes.delaunay(150, 3), meshes.grid(20, 20), meshes.scrambled(meshes.grid(9, 9), 1)])
def test_no_vertex_of_a_valid_mesh_goes_further_than_the_mesh_is_wide_there(mesh, options):
    after, report = improve(mesh, OPTIONS[options])
    assert bool(report.valid)
    assert travelled(mesh, after).max() <= 1
    assert float(report.travel.max) == pytest.approx(float(travelled(mesh, after).max()))
    assert float(report.quality.mean) <= float(tm.quality(mesh).mean)


def disc(seed: int) -> tm.MeshBatch:
    """A Delaunay mesh of a disc, with 22 vertices at random places of the circle first."""
    random = np.random.default_rng(seed)
    angle = np.sort(random.random(22) * 2 * np.pi)
    circle = np.stack([np.cos(angle), np.sin(angle)], 1)
    points = np.concatenate([circle, random.uniform(-0.5, 0.5, (12, 2))])
    return tm.MeshBatch.from_arrays(points, Delaunay(points).simplices)


@pytest.mark.parametrize("topology", ["flip", "keep"])
@pytest.mark.parametrize("seed", [1, 4])
def test_vertices_held_by_the_tether_stay_on_their_curves_and_the_area_is_kept(seed, topology):
    """They were put on the straight way back, inside the curve, and the area of the mesh fell by up to 4 per cent."""
    mesh = disc(seed)
    after, report = improve(mesh, ImproveOptions(boundary="slide", topology=topology))
    assert bool(report.valid)
    assert float(report.travel.max) > 0.99
    assert travelled(mesh, after).max() <= 1
    areas = [float(tm.quality(batch).area.sum()) for batch in (mesh, after)]
    assert areas[1] == pytest.approx(areas[0], rel=1e-12)
    assert after.points[:22].norm(dim=1).min() > 0.95


def test_a_random_mesh_would_go_further_without_the_tether():
    mesh = meshes.delaunay(150, 3)
    after, _ = improve(mesh, ImproveOptions(relocate=True))
    assert travelled(mesh, after).max() > 1


def test_in_a_batch_each_mesh_is_held_by_itself():
    parts = [meshes.delaunay(150, 3), meshes.jittered(), meshes.delaunay(90, 5)]
    batch, report = improve(join(parts))
    for b, mesh in enumerate(parts):
        alone, its = improve(mesh)
        assert torch.equal(alone.points, batch.split()[b].points)
        assert float(its.travel.max) == float(report.travel.max[b])
    assert report.travel.max[0] <= 1
    assert report.travel.max[2] <= 1


def test_tangled_meshes_and_sizes_asked_for_may_take_vertices_far():
    tangled = meshes.moved_hole()
    _, report = improve(tangled)
    assert bool(report.valid)
    crowded = meshes.grid(12, 12)
    points = crowded.points.clone()
    points[:, 0] = points[:, 0] ** 3
    mesh = crowded.with_points(points)
    after, report = improve(mesh, ImproveOptions(remesh=RemeshOptions(sizes="uniform")))
    assert "relocate" in [step.stage for step in report.steps[0]]
    assert inverted(after) == 0


def test_the_figures_of_the_report_are_those_of_numpy():
    mesh = meshes.disturbed(meshes.grid(10, 10), 0.06, 2)
    after, report = improve(mesh)
    free = (~mesh.fixed).numpy()
    far = cdist(after.points.numpy(), mesh.points.numpy()).diagonal()[free] / slow_widths(mesh)[free]
    figures = [float(getattr(report.travel, name)) for name in ("median", "p95", "max")]
    assert figures == pytest.approx(list(np.percentile(far, [50, 95, 100])), rel=1e-9)
    assert report.to_dict()[0]["travel"] == dict(zip(("median", "p95", "max"), figures, strict=True))


def test_relocate_is_checked_by_name():
    with pytest.raises(ValueError, match=r"ImproveOptions\.relocate"):
        ImproveOptions(relocate="sometimes")
