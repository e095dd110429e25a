"""Losses: the energies' values, finite with finite gradients on any points, twice differentiable."""

from functools import partial

import pytest
import torch
from meshes import VALID, disc, disturbed, equilateral, grid, jittered, ring

import torchmesh as tm
from torchmesh import losses
from torchmesh.learning import scales
from torchmesh.mesh.triangle import corners, inverse_mean_ratio

LOSSES = {
    "inverse mean ratio": losses.inverse_mean_ratio,
    "its cube": partial(losses.inverse_mean_ratio, power=3, limit=3.0),
    "untangle-beta": partial(losses.untangle_beta, beta=0.3),
    "regularised": losses.regularised,
    "regularised to the reference": partial(losses.regularised, reference=True, eps=0.01),
    "minimum Jacobian": losses.minimum_jacobian,
    "minimum Jacobian over the mean": partial(losses.minimum_jacobian, reference=False, threshold=0.5),
}
MESH = tm.join([grid(), disc(), ring()])


def points_of_every_kind() -> dict[str, torch.Tensor]:
    p = MESH.points
    rows = torch.arange(len(p))[:, None]
    noise = torch.randn(p.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return {
        "as they are": p,
        "tangled": p + 0.3 * noise,
        "all in one place": torch.zeros_like(p),
        "all in one place far off": torch.full_like(p, 1e3),
        "on a line": p * torch.tensor([1.0, 0.0], dtype=torch.float64),
        "every third in one place": torch.where(rows % 3 == 0, p, p[7]),
        "neighbours in pairs": p[rows.squeeze(1) // 2 * 2],
        "mirrored": p * torch.tensor([-1.0, 1.0], dtype=torch.float64),
        "nearly flat": p * torch.tensor([1.0, 1e-12], dtype=torch.float64),
        "large": 1e4 * p,
        "small": 1e-6 * p,
    }


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize("kind", points_of_every_kind())
@pytest.mark.parametrize("name", LOSSES)
def test_losses_and_gradients_are_finite_everywhere(name, kind, dtype):
    points = points_of_every_kind()[kind].to(dtype).requires_grad_()
    for per, count in (("mesh", len(MESH)), ("triangle", len(MESH.triangles))):
        value = LOSSES[name](points, MESH, per=per)
        assert value.shape == (count,)
        assert value.dtype == dtype
        (gradient,) = torch.autograd.grad(value.sum(), points)
        assert bool(value.isfinite().all())
        assert bool(gradient.isfinite().all())
        assert bool((value >= 0).all())


@pytest.mark.parametrize("name", LOSSES)
def test_gradients_are_those_of_the_values(name):
    mesh = disturbed(grid(2, 2), 0.05, 1)
    points = disturbed(mesh, 0.6, 2).points.requires_grad_()
    assert bool((tm.quality(mesh.with_points(points.detach())).inverted > 0).all())
    loss = partial(LOSSES[name], mesh=mesh)
    assert torch.autograd.gradcheck(lambda p: loss(p, per="triangle"), points)
    assert torch.autograd.gradcheck(lambda p: loss(p, per="mesh"), points)
    assert torch.autograd.gradgradcheck(lambda p: loss(p, per="triangle"), points)


@pytest.mark.parametrize("name", [n for n in LOSSES if n not in ("minimum Jacobian", "minimum Jacobian over the mean")])
def test_per_mesh_is_the_mean_over_its_triangles(name):
    points = points_of_every_kind()["tangled"]
    each = LOSSES[name](points, MESH, per="triangle")
    means = [each[a:b].mean() for a, b in zip(MESH.triangle_offsets[:-1], MESH.triangle_offsets[1:], strict=True)]
    torch.testing.assert_close(LOSSES[name](points, MESH), torch.stack(means))


def test_minimum_jacobian_per_mesh_is_its_worst_triangles():
    points = points_of_every_kind()["tangled"]
    each = losses.minimum_jacobian(points, MESH, per="triangle")
    worst = [each[a:b].max() for a, b in zip(MESH.triangle_offsets[:-1], MESH.triangle_offsets[1:], strict=True)]
    torch.testing.assert_close(losses.minimum_jacobian(points, MESH), torch.stack(worst))


@pytest.mark.parametrize("name", LOSSES)
def test_a_mesh_has_the_same_loss_alone(name):
    points = points_of_every_kind()["tangled"]
    together = LOSSES[name](points, MESH)
    for b, mesh in enumerate(MESH.split()):
        part = points[MESH.point_offsets[b] : MESH.point_offsets[b + 1]]
        assert torch.equal(LOSSES[name](part, mesh), together[b : b + 1])


@pytest.mark.parametrize("name", LOSSES)
def test_losses_know_no_unit_origin_or_direction(name):
    points = points_of_every_kind()["tangled"]
    turned = torch.tensor([[0.6, 0.8], [-0.8, 0.6]], dtype=torch.float64)
    loss = LOSSES[name](points, MESH)
    other = LOSSES[name](1e3 * points @ turned + 5, MESH.with_points(1e3 * MESH.points @ turned + 5))
    torch.testing.assert_close(other, loss, rtol=1e-9, atol=1e-12)


def test_inverse_mean_ratio_is_the_metric_below_the_limit():
    mesh = tm.join([VALID[name]() for name in ("grid", "disc", "l_shape", "equilateral")])
    expected = inverse_mean_ratio(corners(mesh.points, mesh.triangles))
    torch.testing.assert_close(losses.inverse_mean_ratio(mesh.points, mesh, per="triangle"), expected)
    torch.testing.assert_close(losses.inverse_mean_ratio(mesh.points, mesh, power=2, per="triangle"), expected**2)


@pytest.mark.parametrize(("height", "expected"), [(1.0, 1.0), (0.0, 8.0), (-1.0, 24.0)])
def test_inverse_mean_ratio_beyond_the_limit_is_as_documented(height, expected):
    one = tm.MeshBatch.from_arrays([[0.0, 0], [1, 0], [0.5, 0.75**0.5]], [[0, 1, 2]])
    points = one.points * torch.tensor([1.0, height])
    # 1 at rest, 2 limit when flat, 2 limit + limit^2 for the mirror image.
    assert float(losses.inverse_mean_ratio(points, one, limit=4.0)) == pytest.approx(expected)


def test_inverse_mean_ratio_is_continuous_with_its_slope_at_the_limit():
    one = tm.MeshBatch.from_arrays([[0.0, 0], [1, 0], [0.5, 0.75**0.5]], [[0, 1, 2]])

    def at(height: float) -> tuple[float, float]:
        points = torch.tensor([[0.0, 0], [1, 0], [0.5, height]], dtype=torch.float64, requires_grad=True)
        value = losses.inverse_mean_ratio(points, one, limit=4.0)
        return float(value.detach()), float(torch.autograd.grad(value, points)[0][2, 1])

    low, high = 0.05, 0.8
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if at(middle)[0] > 4.0 else (low, middle)
    below, above = at(low - 1e-9), at(high + 1e-9)
    assert below[0] == pytest.approx(above[0], rel=1e-7)
    assert below[1] == pytest.approx(above[1], rel=1e-6)


def test_untangle_beta_is_kims_formula():
    mesh, beta = jittered(), 0.2
    area = tm.quality(mesh).area
    mean = tm.quality(grid(8, 7)).area.mean()
    expected = (((area / mean - beta).abs() - (area / mean - beta)) / 2) ** 2
    result = losses.untangle_beta(mesh.points, grid(8, 7), beta=beta, per="triangle")
    torch.testing.assert_close(result, expected)
    assert float(losses.untangle_beta(grid(8, 7).points, grid(8, 7), beta=0.5)) == 0


def test_the_reference_is_the_minimum_of_its_regularised_loss():
    mesh = disturbed(grid(), 0.02, 1)
    points = mesh.points.clone().requires_grad_()
    # Each triangle is its own target: no stretch, no shear, up to the regularisation of the determinant.
    value = losses.regularised(points, mesh, reference=True, eps=1e-6, per="triangle")
    torch.testing.assert_close(value.detach(), torch.full_like(value.detach(), 2.0), rtol=1e-9, atol=0)
    (gradient,) = torch.autograd.grad(value.sum(), points)
    assert float(gradient.abs().max()) < 1e-8


def test_minimum_jacobian_is_the_ratio_of_areas():
    mesh = equilateral()
    value = losses.minimum_jacobian(mesh.points * torch.tensor([0.5, 0.1]), mesh, threshold=1.0)
    assert float(value) == pytest.approx(0.95)
    assert float(losses.minimum_jacobian(mesh.points, mesh, threshold=0.9)) == 0


@pytest.mark.parametrize(
    ("loss", "options", "message"),
    [
        (losses.inverse_mean_ratio, {"power": 0}, "power"),
        (losses.inverse_mean_ratio, {"power": 1.5}, "power must be a whole number"),
        (losses.inverse_mean_ratio, {"limit": 1.0}, "limit"),
        (losses.untangle_beta, {"beta": -1.0}, "beta"),
        (losses.regularised, {"eps": 0.0}, "eps"),
        (losses.regularised, {"theta": 1.0}, "theta"),
        (losses.untangle_beta, {"per": "vertex"}, "per"),
    ],
)
def test_wrong_arguments_are_refused_by_name(loss, options, message):
    with pytest.raises(ValueError, match=message):
        loss(MESH.points, MESH, **options)


@pytest.mark.parametrize("loss", [losses.regularised, losses.minimum_jacobian])
def test_a_tangled_mesh_is_no_reference(loss):
    mesh = tm.join([grid(), jittered()])
    with pytest.raises(tm.InvalidMeshError, match=r"mesh 1: triangles row \d+ is inverted"):
        loss(mesh.points, mesh, reference=True)


def test_points_of_another_shape_are_refused():
    with pytest.raises(tm.InvalidMeshError, match="points must be"):
        losses.inverse_mean_ratio(MESH.points[1:], MESH)


def test_minimising_a_loss_untangles():
    mesh = jittered(6, 5, 0.5)
    points = mesh.points.clone().requires_grad_()
    free = (~mesh.fixed)[:, None]
    optimiser = torch.optim.LBFGS([points], max_iter=200, line_search_fn="strong_wolfe")

    def closure() -> torch.Tensor:
        optimiser.zero_grad()
        loss = losses.regularised(points, grid(6, 5), eps=0.1).sum()
        loss.backward()
        points.grad *= free
        return loss

    assert int(tm.quality(mesh).inverted) > 0
    optimiser.step(closure)
    assert int(tm.quality(mesh.with_points(points.detach())).inverted) == 0


def test_scales_are_computed_once_for_a_mesh_and_anew_when_it_changes(monkeypatch):
    mesh = jittered(5, 4, 0.2, seed=3)
    mesh = mesh.with_points(mesh.points.clone())
    calls = []
    original = scales.local_size
    monkeypatch.setattr(scales, "local_size", lambda batch: calls.append(1) or original(batch))
    first = tm.losses.regularised(mesh.points + 0.01, mesh)
    assert torch.equal(tm.losses.regularised(mesh.points + 0.01, mesh), first)
    assert torch.equal(tm.losses.regularised(mesh.points + 0.01, mesh.with_points(mesh.points)), first)
    assert len(calls) == 1
    mesh.points.mul_(2)
    second = tm.losses.regularised(mesh.points + 0.02, mesh)
    torch.testing.assert_close(second, first)
    assert len(calls) == 2
    with torch.inference_mode():
        mine = mesh.with_points(mesh.points * 1)
        torch.testing.assert_close(tm.losses.regularised(mine.points + 0.02, mine), second)


@pytest.mark.parametrize("size", [1.0, 0.0])
def test_a_mesh_that_encloses_no_area_gives_a_scale(size):
    """Its upright and inverted triangles cancel, or all its vertices coincide."""
    mesh = tm.MeshBatch.from_arrays([[0, 0], [1, 0], [0, 1], [1, 1.0]], [[0, 1, 2], [1, 3, 2]])
    points = mesh.points.clone()
    points[3] = points[0]
    mesh = mesh.with_points(size * points)
    moved = MESH.points[:4].detach().clone().requires_grad_()
    loss = losses.regularised(moved, mesh)
    loss.sum().backward()
    assert bool(loss.isfinite().all())
    assert bool(moved.grad.isfinite().all())
