"""Vertices in triangles: against every triangle tried in turn, in exact rationals."""

import exact
import meshes
import numpy as np
import pytest
import torch

from torchmesh import MeshBatch, improve, transfer, transfer_matrix


def barycentric(p, corners) -> list[float]:
    """Weights of the corners at p, exact until the end."""
    whole = exact.double_area(*corners)
    a, b, c = corners
    return [float(exact.double_area(*t) / whole) for t in ((p, b, c), (a, p, c), (a, b, p))]


def by_brute_force(before: MeshBatch, values: np.ndarray, p: list[float]) -> float | None:
    """The value at p of the first upright triangle that holds it, closed."""
    points = before.points.tolist()
    for row in before.triangles.tolist():
        weights = barycentric(p, [points[v] for v in row])
        if min(weights) >= 0:
            return sum(w * values[v] for w, v in zip(weights, row, strict=True))
    return None


@pytest.mark.parametrize(("before", "after"), [(meshes.jittered(6, 6, 0.1), meshes.jittered(6, 6, 0.15, seed=5)),
                                               (meshes.grid(4, 4), meshes.grid(6, 5)),
                                               (meshes.delaunay(30, 1), meshes.delaunay(30, 1))])  # fmt: skip
def test_values_are_those_of_the_triangle_round_each_vertex(before, after):
    if len(before.points) == 30:
        after = before.with_points(0.6 * before.points)
    values = np.random.default_rng(1).normal(size=len(before.points))
    found = transfer(before, after, torch.from_numpy(values)).tolist()
    expected = [by_brute_force(before, values, p) for p in after.points.tolist()]
    assert None not in expected
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


def test_weights_of_thin_triangles_give_the_point():
    """A triangle 1e-7 high, turned by an angle: without a second look weights are off by 1e-9 of its length."""
    flat = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.5, 1e-7], [0.5, -0.5]], dtype=torch.float64)
    before = MeshBatch.from_arrays(meshes.turned(flat, 33.0), [[0, 1, 2], [0, 3, 1]])
    inside = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.37, 0.3e-7], [0.5, -0.5]], dtype=torch.float64)
    after = MeshBatch.from_arrays(meshes.turned(inside, 33.0), [[0, 1, 2], [0, 3, 1]])
    made, info = transfer(before, after, before.points, report=True)
    assert (made - after.points).abs().max() < 1e-15
    assert int(info.outside) == 0


def test_a_vertex_outside_takes_the_nearest_boundary_value():
    before = meshes.grid(4, 4)
    points = before.points.clone()
    moved = ((points[:, 0] == 1) & (points[:, 1] == 0.5)).nonzero().squeeze(1)
    points[moved] = torch.tensor([1.2, 0.6], dtype=torch.float64)
    made, info = transfer(before, before.with_points(points), before.points, report=True)
    np.testing.assert_allclose(made[moved].numpy(), [[1.0, 0.6]], atol=1e-15)
    assert (int(info.outside), int(info.tangled), int(info.moved)) == (1, 0, 1)


def test_rounding_is_not_outside():
    """Vertices on a slanted straight boundary are off it by a rounding error."""
    before = meshes.grid(7, 3).with_points(meshes.turned(meshes.grid(7, 3).points, 17.0))
    after = meshes.grid(11, 5).with_points(meshes.turned(meshes.grid(11, 5).points, 17.0))
    made, info = transfer(before, after, before.points, report=True)
    assert int(info.outside) == 0
    assert (made - after.points).abs().max() < 1e-15


@pytest.mark.parametrize("topology", ["flip", "keep", "full"])
@pytest.mark.parametrize(
    "tangled",
    [meshes.jittered(9, 8, 0.5), meshes.disturbed(meshes.ring(), 0.12, 1),
     meshes.disturbed(MeshBatch.from_arrays(*meshes.holed_arrays()), 0.5, 1), meshes.moved_hole()],
    ids=["square", "ring", "hole", "moved hole"],
)  # fmt: skip
def test_linear_fields_of_tangled_meshes_are_exact(tangled, topology):
    from torchmesh import ImproveOptions

    assert exact.inverted(tangled) > 0
    after, _ = improve(tangled, ImproveOptions(topology=topology))
    made, info = transfer(tangled, after, tangled.points, report=True)
    size = tangled.points.abs().max()
    assert (made - after.points).abs().max() <= 1e-12 * size
    assert int(info.outside) == 0


def test_a_hole_is_not_bridged():
    """Values round a hole that a vertex was thrown into do not come from its other side."""
    mesh = meshes.disturbed(MeshBatch.from_arrays(*meshes.holed_arrays()), 0.5, 1)
    after, _ = improve(mesh)
    angle = torch.atan2(mesh.points[:, 1] - 5, mesh.points[:, 0] - 4)
    side = (angle > 0).double()
    matrix = transfer_matrix(mesh, after).to_dense()
    far = (after.points[:, 1] > 5.9) & (after.points[:, 1] < 6.5) & ((after.points[:, 0] - 4).abs() < 0.5)
    assert bool(far.any())
    assert torch.equal((matrix @ side)[far], torch.ones(int(far.sum()), dtype=torch.float64))
