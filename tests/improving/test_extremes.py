"""Areas near the end of floating point, far origins, long thin domains: right, or a clear refusal."""

import meshes
import numpy as np
import pytest
import torch
from exact import inverted

from torchmesh import (
    ImproveOptions,
    InvalidMeshError,
    MeshBatch,
    Status,
    deform,
    improve,
    largest_step,
    quality,
    untangle,
)

TANGLES = {
    "jittered": lambda: meshes.jittered(8, 7, 0.6, 0),
    "moved hole": lambda: meshes.moved_hole(5.0),
    "interface": meshes.dragged_interface,
}


@pytest.mark.parametrize("topology", ["flip", "keep"])
@pytest.mark.parametrize("name", list(TANGLES))
@pytest.mark.parametrize("scale", [1e-147, 1e148])
def test_tiny_and_huge(name, scale, topology):
    # At 1e-147 the triangles' areas are about 1e-296.
    mesh = TANGLES[name]()
    plain, _ = improve(mesh, ImproveOptions(topology=topology))
    scaled, report = improve(mesh.with_points(mesh.points * scale), ImproveOptions(topology=topology))
    assert inverted(scaled) == 0
    assert report.certified.tolist() == [True]
    # Rounding decides between the equal diagonals of a square, and so where flips and smoothing end.
    assert quality(scaled).mean.item() == pytest.approx(quality(plain).mean.item(), abs=0.06)


@pytest.mark.parametrize("name", list(TANGLES))
@pytest.mark.parametrize("offset", [1e6, 1e8, -1e8])
def test_far_from_the_origin(name, offset):
    mesh = TANGLES[name]()
    after, report = improve(mesh.with_points(mesh.points + offset))
    assert inverted(after) == 0
    assert report.certified.tolist() == [True]
    assert report.quality.mean.item() == pytest.approx(improve(mesh)[1].quality.mean.item(), abs=0.06)


@pytest.mark.parametrize("topology", ["flip", "keep"])
def test_how_far_away_a_vertex_of_no_triangle_is_does_not_matter(topology):
    mesh, options = TANGLES["jittered"](), ImproveOptions(topology=topology)
    plain, _ = improve(mesh, options)
    for far in ([1e16, 0.0], [-1e100, 1e100]):
        there = torch.tensor([far], dtype=torch.float64)
        points, fixed = torch.cat([mesh.points, there]), torch.cat([mesh.fixed, torch.tensor([True])])
        ends = torch.tensor([0, len(points)])
        more = MeshBatch(
            points, mesh.triangles, fixed, mesh.constrained_edges, ends, mesh.triangle_offsets, mesh.frames
        )
        after, report = improve(more, options)
        assert report.certified.tolist() == [True]
        assert torch.equal(after.triangles, plain.triangles)
        assert torch.equal(after.points, torch.cat([plain.points, there]))


def test_so_far_that_the_boundary_falls_together_is_refused_or_right():
    # At 1e16 the coordinates are multiples of 2, and all vertices of the square coincide.
    mesh = TANGLES["jittered"]()
    after, report = improve(mesh.with_points(mesh.points + 1e16))
    assert report.status.tolist() == [Status.INFEASIBLE]
    assert "both at" in report.messages[0]
    assert bool(after.points.isfinite().all())


@pytest.mark.parametrize("aspect", [1e3, 1e6])
@pytest.mark.parametrize("name", list(TANGLES))
def test_long_thin_domains(name, aspect):
    mesh = TANGLES[name]()
    stretched = mesh.with_points(mesh.points * torch.tensor([aspect, 1.0], dtype=torch.float64))
    after, report = improve(stretched)
    assert inverted(after) == 0
    assert report.certified.tolist() == [True]


def test_long_thin_triangles_kept():
    points, triangles = meshes.grid_arrays(6, 6)
    mesh = MeshBatch.from_arrays(points * [1e6, 1.0], triangles)
    noise = torch.from_numpy(np.random.default_rng(0).normal(size=points.shape) * [2e5, 0.2])
    tangled = mesh.with_points(torch.where(mesh.fixed[:, None], mesh.points, mesh.points + noise))
    assert inverted(tangled) > 0
    after, _ = improve(tangled, ImproveOptions(topology="keep"))
    assert inverted(after) == 0


@pytest.mark.parametrize("scale", [1e-147, 1e148])
def test_steps_and_deformations_of_any_size(scale):
    mesh = MeshBatch.from_arrays(*meshes.holed_arrays())
    hole = torch.hypot(mesh.points[:, 0] - 4, mesh.points[:, 1] - 5) < 1.1
    goal = mesh.points + hole[:, None] * torch.tensor([3.0, 0.0], dtype=torch.float64)
    scaled = mesh.with_points(mesh.points * scale)
    step = largest_step(mesh, goal).item()
    assert largest_step(scaled, goal * scale).item() == pytest.approx(step, rel=1e-9)
    after, report = deform(scaled, goal * scale)
    assert report.status.tolist() == [Status.VALID]
    assert inverted(after) == 0


@pytest.mark.parametrize(("scale", "match"), [(1e-152, "underflow; rescale"), (1e151, "overflow; rescale")])
def test_what_floating_point_cannot_hold_is_refused(scale, match):
    points, triangles = meshes.grid_arrays(3, 3)
    with pytest.raises(InvalidMeshError, match=match):
        MeshBatch.from_arrays(points * scale, triangles)


@pytest.mark.parametrize("offset", [0.0, 1e8])
def test_untangling_with_triangles_kept_far_away(offset):
    mesh = meshes.jittered(8, 7, 0.4, 0)
    moved, info = untangle(mesh.with_points(mesh.points + offset))
    assert info.status.tolist() == [Status.VALID]
    assert inverted(moved) == 0
