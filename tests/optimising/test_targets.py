import math

import meshes
import numpy as np
import pytest
import torch
from exact import inverted

import torchmesh as tm
from torchmesh import (
    ImproveOptions,
    InvalidMeshError,
    MeshBatch,
    MetricField,
    SmoothOptions,
    Status,
    improve,
    join,
    metric_from,
    quality,
    smooth,
    target_from,
    target_quality,
)
from torchmesh.flipping.delaunay import flip_to_delaunay
from torchmesh.optimising.energies import InverseMeanRatio
from torchmesh.optimising.jacobian import equilateral
from torchmesh.optimising.objective import MeshObjective, pack
from torchmesh.optimising.targets import aim, narrow

TURN = torch.tensor([[math.cos(0.7), -math.sin(0.7)], [math.sin(0.7), math.cos(0.7)]], dtype=torch.float64)
# Three times as long along a line of slope 1/2 as across it.
STRETCH = torch.tensor([[5.0, -2.0], [-2.0, 8.0]], dtype=torch.float64) / 3
EXACTLY = {"energy_tolerance": 0.0, "gradient_tolerance": 1e-7, "max_iterations": 3000}


def layer(columns: int = 20, rows: int = 12, aspect: float = 100.0, growth: float = 1.5) -> MeshBatch:
    """The strip over the wall y = 0 from x = 0 to 1: cells `aspect` times as long as high at the wall."""
    points, triangles = meshes.grid_arrays(columns, rows)
    height = np.concatenate([[0], np.cumsum(growth ** np.arange(rows))]) / (columns * aspect)
    points[:, 1] = height[np.rint(points[:, 1] * rows).astype(int)]
    return MeshBatch.from_arrays(points, triangles)


def bent(mesh: MeshBatch) -> MeshBatch:
    """The wall pushed up in the middle, the rest after it."""
    moved = mesh.points.clone()
    wall = mesh.points[:, 1] == 0
    moved[wall, 1] += 0.05 * torch.sin(math.pi * mesh.points[wall, 0]) ** 2
    return tm.femwarp(mesh, moved)


def shaken(mesh: MeshBatch, part: float = 0.3, seed: int = 0) -> MeshBatch:
    """Interior vertices moved along x by up to `part` of a twentieth."""
    throw = torch.rand(len(mesh.points), generator=torch.Generator().manual_seed(seed), dtype=torch.float64) - 0.5
    points = mesh.points.clone()
    points[~mesh.fixed, 0] += part / 20 * throw[~mesh.fixed]
    return mesh.with_points(points)


def constant(matrix: torch.Tensor, mesh: MeshBatch) -> MetricField:
    return MetricField(matrix.expand(len(mesh.points), 2, 2))


def root(matrix: torch.Tensor) -> torch.Tensor:
    values, vectors = torch.linalg.eigh(matrix / torch.linalg.det(matrix).sqrt())
    return vectors @ torch.diag(values.sqrt()) @ vectors.T


MESH = lambda: meshes.jittered(8, 7, 0.12, 3)  # noqa: E731


def test_a_mesh_is_ideal_towards_itself():
    mesh = meshes.delaunay(50, 3)
    torch.testing.assert_close(
        target_quality(mesh, target_from(mesh)), torch.ones(len(mesh.triangles), dtype=torch.float64)
    )
    w = target_from(mesh)
    a, b, c = mesh.points[mesh.triangles].unbind(1)
    assert torch.equal(w[:, :, 0], b - a)
    assert torch.equal(w[:, :, 1], c - a)


@pytest.mark.parametrize("factor", [2.0**-200, 0.3, 2.0**200])
def test_size_and_turn_of_target_matrices_do_not_matter(factor):
    mesh = MESH()
    w = target_from(meshes.grid(8, 7))
    expected = target_quality(mesh, w)
    torch.testing.assert_close(target_quality(mesh, factor * (TURN @ w)), expected, rtol=1e-13, atol=0)
    torch.testing.assert_close(target_quality(mesh.with_points(mesh.points @ TURN.T), w), expected, rtol=1e-12, atol=0)


def test_equilateral_targets_are_the_default():
    mesh = MESH()
    w = torch.tensor([[1, 0.5], [0, math.sqrt(3) / 2]], dtype=torch.float64).expand(len(mesh.triangles), 2, 2)
    for targets in (w, constant(torch.eye(2, dtype=torch.float64), mesh)):
        torch.testing.assert_close(target_quality(mesh, targets), quality(mesh).inverse_mean_ratio, rtol=1e-13, atol=0)
        plain, _ = smooth(mesh, SmoothOptions(**EXACTLY))
        aimed, info = smooth(mesh, SmoothOptions(targets=targets, **EXACTLY))
        assert info.status.item() == Status.CONVERGED
        torch.testing.assert_close(aimed.points, plain.points, rtol=0, atol=1e-6)


def test_in_a_constant_metric_all_is_as_in_the_plane_mapped_by_its_root():
    mesh, h = MESH(), root(STRETCH)
    mapped = mesh.with_points(mesh.points @ h.T)
    metric = constant(7.0 * STRETCH, mesh)
    torch.testing.assert_close(target_quality(mesh, metric), quality(mapped).inverse_mean_ratio, rtol=1e-13, atol=0)
    aimed, _ = smooth(mesh, SmoothOptions(targets=metric, **EXACTLY))
    plain, _ = smooth(mapped, SmoothOptions(**EXACTLY))
    torch.testing.assert_close(aimed.points @ h.T, plain.points, rtol=0, atol=1e-6)
    random = meshes.scrambled(meshes.delaunay(60, 5), 1)
    flipped, info = flip_to_delaunay(random, metric=constant(STRETCH, random))
    assert info.flips.item() > 0
    rule = tm.FlipOptions(rule="shape")
    expected, _ = flip_to_delaunay(random.with_points(random.points @ h.T), rule)
    assert {frozenset(t) for t in flipped.triangles.tolist()} == {frozenset(t) for t in expected.triangles.tolist()}


def test_a_constant_target_matrix_is_a_map_of_the_corners():
    # Right triangles as targets: a grid's own. Towards them the undisturbed grid is the one minimum.
    grid = meshes.grid(8, 7)
    recovered, info = smooth(MESH(), SmoothOptions(targets=target_from(grid), **EXACTLY))
    assert info.status.item() == Status.CONVERGED
    torch.testing.assert_close(recovered.points, grid.points, rtol=0, atol=1e-6)
    assert info.energy.item() == pytest.approx(float((~grid.fixed)[grid.triangles].any(1).sum()), rel=1e-9)


def test_the_metric_objective_has_the_gradient_of_its_energy(rng):
    mesh = MESH()
    values = torch.from_numpy(rng.normal(size=(len(mesh.points), 2, 2)))
    metric = MetricField(values @ values.mT + 0.1 * torch.eye(2))
    packing = pack(mesh.points, mesh.triangles, ~mesh.fixed, mesh.point_offsets, mesh.triangle_offsets)
    plain = MeshObjective(
        InverseMeanRatio(2, 3.0), equilateral(), packing.rows, packing.anchored, packing.block_offsets,
        packing.triangle_offsets, packing.spread_vertices(torch.ones(len(mesh.points))),
    )  # fmt: skip
    objective = aim(plain, mesh, packing, metric)
    energy, gradient, _ = objective(packing.unknowns)
    points = mesh.points.clone().requires_grad_()
    moving = (~mesh.fixed)[mesh.triangles].any(1)
    ratio = target_quality(mesh.with_points(points), metric)[moving]
    expected = (ratio**2 + (ratio / 3) ** 8).sum()
    assert energy.item() == pytest.approx(expected.item(), rel=1e-11)
    (slopes,) = torch.autograd.grad(expected, points)
    unit = packing.unit.item()
    torch.testing.assert_close(gradient[packing.x_rows], unit * slopes[packing.vertices, 0], rtol=1e-9, atol=1e-7)
    torch.testing.assert_close(gradient[packing.y_rows], unit * slopes[packing.vertices, 1], rtol=1e-9, atol=1e-7)


def test_the_metric_of_an_affine_image_of_equilateral_triangles_makes_them_ideal():
    mesh = meshes.equilateral()
    image = mesh.with_points(mesh.points @ torch.tensor([[3.0, 0.4], [0.2, 0.5]], dtype=torch.float64))
    torch.testing.assert_close(
        target_quality(image, metric_from(image)),
        torch.ones(len(mesh.triangles), dtype=torch.float64),
        rtol=1e-12,
        atol=0,
    )
    assert quality(image).mean.item() > 3


def test_a_metric_turns_with_its_triangles():
    mesh = meshes.delaunay(50, 3)
    turned = mesh.with_points(3 * mesh.points @ TURN.T)
    given, expected = metric_from(mesh, turned), metric_from(turned)
    torch.testing.assert_close(given.values, expected.values, rtol=1e-10, atol=1e-10)
    with pytest.raises(InvalidMeshError, match="the reference's triangles, in their order"):
        metric_from(mesh, mesh.with_triangles(mesh.triangles.flip(0)))


# --- a boundary layer ---


def test_a_shaken_layer_of_aspect_100_comes_back_to_its_shape():
    mesh = layer()
    assert quality(mesh).max.item() > 50
    start = shaken(mesh)
    targets = target_from(mesh)
    assert inverted(start) == 0
    assert target_quality(start, targets).max().item() > 10
    back, _ = smooth(start, SmoothOptions(targets=targets))
    assert target_quality(back, targets).max().item() < 1.001
    assert inverted(back) == 0
    plain, _ = smooth(start)
    assert target_quality(plain, targets).max().item() > 2


@pytest.mark.parametrize("how", ["matrices", "metric", "function"])
def test_a_layer_stays_a_layer_while_its_wall_bends(how):
    mesh = layer()
    start = bent(mesh)
    targets = target_from(mesh)
    if how == "matrices":
        options = ImproveOptions(topology="keep", smooth=SmoothOptions(targets=targets))
    elif how == "metric":
        options = ImproveOptions(smooth=SmoothOptions(targets=metric_from(mesh, start)))
    else:
        tall = mesh.points[mesh.points[:, 0] == 0, 1]

        def metric(points):
            """Along the wall and across it, the heights of the layer's rows."""
            x, y = points.to(torch.float64).unbind(1)
            slope = 0.05 * math.pi * torch.sin(2 * math.pi * x)
            distance = (y - 0.05 * torch.sin(math.pi * x) ** 2).clamp_min(0)
            row = torch.bucketize(distance, tall[1:-1], right=True)
            long, high = torch.full_like(x, 1 / 20), tall.diff()[row]
            m, n = long**-2, high**-2
            size = 1 + slope**2
            return torch.stack([(m + n * slope**2) / size, (m - n) * slope / size, (m * slope**2 + n) / size], 1)

        options = ImproveOptions(smooth=SmoothOptions(targets=MetricField(metric)))
    kept, report = improve(start, options)
    lost, _ = improve(start, ImproveOptions(shapes="equilateral", relocate=True))
    assert report.certified.tolist() == [True]
    aimed = options.smooth.targets
    before, after = (target_quality(m, aimed).mean().item() for m in (start, kept))
    assert after < before
    assert after < 1.25
    # The first vertices over the wall stay about as high over it, where improving shapes alone lifts them. Between
    # the wall's vertices its chords leave the curve by up to 0.0003, which is more than half a first cell.
    row = (mesh.points[:, 1] > 0) & (mesh.points[:, 1] < 1.5 / 2000) & ((mesh.points[:, 0] - 0.5).abs() < 0.3)
    heights = [m.points[row, 1] - 0.05 * torch.sin(math.pi * m.points[row, 0]) ** 2 for m in (kept, lost)]
    assert heights[0].min().item() > 0.5 / 2000
    assert heights[0].max().item() < 4.5 / 2000
    assert heights[1].max().item() > 10 / 2000


# --- options, batches, errors ---


def test_targets_and_sliding_boundaries_go_together():
    mesh = layer()
    start = shaken(mesh)
    wall = (mesh.points[:, 1] == 0) & (mesh.points[:, 0] > 0) & (mesh.points[:, 0] < 1)
    start.points[wall, 0] += 0.015 * torch.sin(200 * start.points[wall, 0])
    options = SmoothOptions(boundary="slide", targets=target_from(mesh), max_iterations=1000)
    back, _ = smooth(start, options)
    held, _ = smooth(start, SmoothOptions(targets=target_from(mesh), max_iterations=1000))
    assert bool((back.points[wall, 1] == 0).all())
    assert target_quality(back, options.targets).max() < 1.01 < 1.1 < target_quality(held, options.targets).max()


def test_joined_equals_alone():
    parts = [MESH(), layer(10, 6), meshes.delaunay(50, 3)]
    batch = join(parts)
    matrices = target_from(batch)
    field = metric_from(batch)
    for topology, targets in (
        ("keep", matrices),
        ("flip", field),
        ("flip", MetricField(lambda x: STRETCH.expand(len(x), 2, 2))),
    ):
        options = ImproveOptions(topology=topology, smooth=SmoothOptions(targets=targets))
        start = join([parts[0], shaken(parts[1]), meshes.disturbed(parts[2], 0.01, 4)])
        together, _ = improve(start, options)
        for b, (mesh, result) in enumerate(zip(start.split(), together.split(), strict=True)):
            at = torch.arange(3) == b
            own = ImproveOptions(topology=topology, smooth=SmoothOptions(targets=narrow(targets, batch, at)))
            alone, _ = improve(mesh, own)
            assert torch.equal(alone.points, result.points)
            assert torch.equal(alone.triangles, result.triangles)


def test_tangled_meshes_are_untangled_first():
    mesh = meshes.moved_hole()
    metric = MetricField(lambda x: STRETCH.expand(len(x), 2, 2))
    better, report = improve(mesh, ImproveOptions(smooth=SmoothOptions(targets=metric)))
    assert report.certified.tolist() == [True]
    plain, _ = improve(mesh)
    assert target_quality(better, metric).mean() < target_quality(plain, metric).mean()
    assert quality(better).mean > quality(plain).mean


def test_flat_triangles_are_infinitely_far_from_any_target():
    mesh = MeshBatch.from_arrays([[0, 0], [1, 0], [2, 0], [1, 1]], [[0, 1, 3], [1, 2, 3], [0, 2, 1]])
    w = torch.eye(2, dtype=torch.float64).expand(3, 2, 2)
    for targets in (w, constant(STRETCH, mesh)):
        assert target_quality(mesh, targets).isinf().tolist() == [False, False, True]


def test_what_cannot_work_is_refused():
    mesh = MESH()
    w = target_from(mesh)
    with pytest.raises(ValueError, match="do not last when edges flip: set topology='keep'"):
        ImproveOptions(smooth=SmoothOptions(targets=w))
    with pytest.raises(ValueError, match=r"must be a \(T, 2, 2\) tensor .* not MeshBatch; for a mesh as target"):
        SmoothOptions(targets=mesh)
    with pytest.raises(ValueError, match=r"not \(3, 3\)"):
        SmoothOptions(targets=torch.zeros(3, 3))
    with pytest.raises(
        InvalidMeshError, match=r"targets must be \(112, 2, 2\), one matrix a triangle, not \(111, 2, 2\)"
    ):
        smooth(mesh, SmoothOptions(targets=w[1:]))
    bad = w.clone()
    bad[7] = bad[7].flip(1)
    with pytest.raises(
        InvalidMeshError, match=r"mesh 0: targets row 7 is .* determinant of a target matrix must be posit"
    ):
        smooth(mesh, SmoothOptions(targets=bad))
    with pytest.raises(InvalidMeshError, match=r"mesh 0: triangles row .* is inverted, so it is no target"):
        target_from(meshes.jittered())


def test_the_shapes_of_a_surface_in_space_are_targets():
    mesh = meshes.delaunay(50, 3)
    flat = target_from(mesh)
    # The plane mesh, turned and laid somewhere in space, has the same shapes.
    turn, _ = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1)))
    points = torch.nn.functional.pad(mesh.points, (0, 1)) @ turn.T + 3
    lifted = target_from(points, mesh.triangles)
    torch.testing.assert_close(lifted.mT @ lifted, flat.mT @ flat, rtol=1e-12, atol=1e-14)
    assert bool((torch.linalg.det(lifted) > 0).all())
    torch.testing.assert_close(target_quality(mesh, lifted), torch.ones(len(flat), dtype=torch.float64))
    # numpy is taken, too; lengths on a bent surface are those in space.
    height = mesh.points[:, 0].square()[:, None]
    bent = target_from(torch.cat([mesh.points, height], 1).numpy(), mesh.triangles.numpy())
    a, b, c = torch.cat([mesh.points, height], 1)[mesh.triangles].unbind(1)
    torch.testing.assert_close(bent[:, :, 0].norm(dim=1), (b - a).norm(dim=1))
    torch.testing.assert_close((bent[:, :, 0] - bent[:, :, 1]).norm(dim=1), (b - c).norm(dim=1))


@pytest.mark.parametrize(
    ("points", "triangles", "message"),
    [
        (torch.zeros(3, 2), [[0, 1, 2]], r"must be \(V, 3\), not \(3, 2\)"),
        (torch.eye(3), None, "needs the triangles"),
        (torch.eye(3), [[0, 1, 3]], r"row 0 is \[0, 1, 3\]: there are 3 positions"),
        (torch.eye(3), [[0, 1, 2], [0, 0, 1]], "row 1 of the surface is flat"),
        (torch.eye(3) * torch.nan, [[0, 1, 2]], "flat or not finite"),
        (torch.eye(3), [[0.0, 1.0, 2.0]], "whole numbers"),
        (meshes.grid(2, 2), [[0, 1, 2]], "a batch has its own"),
    ],
)
def test_what_is_no_surface_is_refused_by_name(points, triangles, message):
    with pytest.raises(InvalidMeshError, match=message):
        target_from(points, triangles)
