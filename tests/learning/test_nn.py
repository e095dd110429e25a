"""The layers: valid out, at the minimum, and the gradient against differences of whole forward passes."""

import pytest
import torch
from meshes import delaunay, disc, disturbed, grid, jittered, l_shape, ring

import torchmesh as tm
from torchmesh import losses, nn
from torchmesh.mesh.interfaces import holding
from torchmesh.mesh.triangle import corners, inverse_mean_ratio
from torchmesh.optimising.energies import InverseMeanRatio

SMOOTHABLE = tm.join([disturbed(grid(), 0.02, 1), disc(), ring(), delaunay(60, 3), l_shape()])
TANGLED = tm.join([jittered(6, 5, 0.5), disturbed(disc(), 0.2, 2), disturbed(ring(), 0.15, 3)])
OPTIONS = {
    "squared": nn.LayerOptions(),
    "with a ceiling": nn.LayerOptions(tm.SmoothOptions(ceiling=1.3)),
    "cubed": nn.LayerOptions(tm.SmoothOptions(power=3)),
}
CASES = {"smooth": (nn.Smooth, SMOOTHABLE), "untangle": (nn.Untangle, TANGLED)}


def random(shape, seed: int) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("options", OPTIONS)
def test_what_comes_out_is_valid_and_at_the_minimum(case, options):
    layer_type, mesh = CASES[case]
    options = OPTIONS[options]
    layer = layer_type(mesh, options)
    points = layer(mesh.points)
    assert torch.equal(points[mesh.fixed], mesh.points[mesh.fixed])
    assert bool(layer.info.valid.all())
    assert bool(layer.info.converged.all())
    assert int(tm.quality(mesh.with_points(points)).inverted.sum()) == 0
    moving = points.clone().requires_grad_()
    ratio = inverse_mean_ratio(corners(moving, mesh.triangles))
    energy = InverseMeanRatio(options.smooth.power, options.smooth.ceiling).value(2 * ratio, torch.ones_like(ratio))
    (gradient,) = torch.autograd.grad(energy.sum(), moving)
    # Of numbers that are 1 to 100 on the way there.
    assert float(gradient[~mesh.fixed].abs().max()) < 1e-7


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("options", OPTIONS)
def test_gradient_is_that_of_differences(case, options):
    layer_type, mesh = CASES[case]
    layer = layer_type(mesh, OPTIONS[options])
    weight, way = random(mesh.points.shape, 1), random(mesh.points.shape, 2)
    points = mesh.points.clone().requires_grad_()
    (gradient,) = torch.autograd.grad((layer(points) * weight).sum(), points)
    # What moves is found from what is held, boundary and interfaces, alone.
    assert bool((gradient[~holding(mesh).fixed] == 0).all())
    along = way * mesh.fixed[:, None]

    def per_mesh(values: torch.Tensor) -> torch.Tensor:
        return torch.stack([v.sum() for v in values.split(mesh.point_offsets.diff().tolist())])

    # The error of central differences falls with h squared: two of them, and what is left is of fourth order.
    near, far = (
        per_mesh((layer(mesh.points + h * along) - layer(mesh.points - h * along)) * weight) / (2 * h)
        for h in (1e-4, 2e-4)
    )
    torch.testing.assert_close(per_mesh(gradient * along), (4 * near - far) / 3, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("case", CASES)
def test_single_precision_in_single_precision_out(case):
    layer_type, mesh = CASES[case]
    weight = random(mesh.points.shape, 1)
    results = {}
    for dtype in (torch.float64, torch.float32):
        points = mesh.points.to(torch.float32).to(dtype).requires_grad_()
        out = layer_type(mesh.to(dtype))(points)
        (gradient,) = torch.autograd.grad((out * weight.to(dtype)).sum(), points)
        assert out.dtype == gradient.dtype == dtype
        results[dtype] = out.detach().double(), gradient.double()
    # Both solve in double precision; only what goes in and out is rounded.
    for single, double in zip(results[torch.float32], results[torch.float64], strict=True):
        torch.testing.assert_close(single, double, rtol=1e-5, atol=1e-5)


def test_differences_in_single_precision():
    mesh = SMOOTHABLE.to(torch.float32)
    layer, weight, way = nn.Smooth(mesh), random(mesh.points.shape, 1), random(mesh.points.shape, 2)
    along = way * mesh.fixed[:, None]
    points = mesh.points.clone().requires_grad_()
    (gradient,) = torch.autograd.grad((layer(points).double() * weight).sum(), points)
    h = 2e-3
    ends = [(layer((mesh.points + sign * h * along).float()).double() * weight).sum() for sign in (1, -1)]
    # Coordinates of order one are rounded to 1e-7 and differences of them divided by h.
    assert float((gradient.double() * along).sum()) == pytest.approx(float(ends[0] - ends[1]) / (2 * h), rel=2e-3)


def test_the_start_of_the_interior_does_not_matter():
    one, other = SMOOTHABLE, disturbed(SMOOTHABLE, 0.001, 7)
    assert int(tm.quality(other).inverted.sum()) == 0
    torch.testing.assert_close(nn.Smooth(one)(one.points), nn.Smooth(one)(other.points), rtol=0, atol=1e-9)


def test_untangle_ends_where_smooth_does():
    points = nn.Untangle(TANGLED)(TANGLED.points)
    again = nn.Smooth(TANGLED)(points)
    torch.testing.assert_close(points, again, rtol=0, atol=1e-9)


def test_translations_and_turns_pass_through():
    """Moving the whole boundary rigidly moves everything: the gradient's sum is the weights' sum."""
    weight = random(SMOOTHABLE.points.shape, 3)
    points = SMOOTHABLE.points.clone().requires_grad_()
    (gradient,) = torch.autograd.grad((nn.Smooth(SMOOTHABLE)(points) * weight).sum(), points)
    torch.testing.assert_close(gradient.sum(0), weight.sum(0), rtol=1e-8, atol=1e-8)
    out = nn.Smooth(SMOOTHABLE)(SMOOTHABLE.points)
    spin = torch.stack([-SMOOTHABLE.points[:, 1], SMOOTHABLE.points[:, 0]], 1)
    spun = torch.stack([-out[:, 1], out[:, 0]], 1)
    torch.testing.assert_close((gradient * spin).sum(), (weight * spun).sum(), rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("case", CASES)
def test_a_mesh_in_a_batch_has_the_bits_it_has_alone(case):
    layer_type, mesh = CASES[case]
    weight = random(mesh.points.shape, 4)
    options = OPTIONS["with a ceiling"]
    points = mesh.points.clone().requires_grad_()
    out = layer_type(mesh, options)(points)
    (gradient,) = torch.autograd.grad((out * weight).sum(), points)
    for b, part in enumerate(mesh.split()):
        rows = slice(int(mesh.point_offsets[b]), int(mesh.point_offsets[b + 1]))
        alone = part.points.clone().requires_grad_()
        result = layer_type(part, options)(alone)
        assert torch.equal(result, out[rows])
        assert torch.equal(torch.autograd.grad((result * weight[rows]).sum(), alone)[0], gradient[rows])


def test_smooth_refuses_or_passes_tangled_meshes():
    mesh = tm.join([grid(), jittered(), disc()])
    with pytest.raises(tm.InvalidMeshError, match=r"meshes \[1\] have inverted triangles"):
        nn.Smooth(mesh)(mesh.points)
    layer = nn.Smooth(mesh, on_failure="keep")
    points = mesh.points.clone().requires_grad_()
    out = layer(points)
    assert layer.info.valid.tolist() == layer.info.converged.tolist() == [True, False, True]
    rows = slice(int(mesh.point_offsets[1]), int(mesh.point_offsets[2]))
    assert torch.equal(out[rows], mesh.points[rows])
    (gradient,) = torch.autograd.grad(out.sum(), points)
    # The tangled mesh's boundary has its own gradient only.
    assert torch.equal(gradient[rows], mesh.fixed[rows][:, None].double().expand(-1, 2))


def crossed() -> tm.MeshBatch:
    """A grid with one corner taken across the mesh: its boundary crosses itself."""
    mesh = grid()
    points = mesh.points.clone()
    points[0] = torch.tensor([2.0, 3.0])
    return mesh.with_points(points)


def test_untangle_refuses_or_passes_what_cannot_be_untangled():
    mesh = tm.join([crossed(), grid()])
    with pytest.raises(tm.InvalidMeshError, match=r"mesh 0 cannot be untangled: .*meet at"):
        nn.Untangle(mesh)(mesh.points)
    layer = nn.Untangle(mesh, on_failure="keep")
    points = mesh.points.clone().requires_grad_()
    out = layer(points)
    assert layer.info.valid.tolist() == [False, True]
    (gradient,) = torch.autograd.grad((out * random(out.shape, 5)).sum(), points)
    assert bool(gradient.isfinite().all())
    assert bool((gradient[~mesh.fixed] == 0).all())


def test_a_mesh_without_free_vertices_passes():
    one = tm.MeshBatch.from_arrays([[0.0, 0], [1, 0], [0, 1]], [[0, 1, 2]])
    mesh = tm.join([one, grid()])
    points = mesh.points.clone().requires_grad_()
    layer = nn.Smooth(mesh)
    weight = random(mesh.points.shape, 6)
    out = layer(points)
    assert bool(layer.info.converged.all())
    (gradient,) = torch.autograd.grad((out * weight).sum(), points)
    assert torch.equal(gradient[:3], weight[:3])


def test_the_layer_trains_a_boundary():
    """A boundary point found through the shapes of the mesh that it leads to."""
    mesh, layer = grid(), nn.Smooth(grid())
    side = int((mesh.points - torch.tensor([1.0, 0.4])).norm(dim=1).argmin())
    target = mesh.points.clone()
    target[side] += torch.tensor([0.06, 0.03])
    wanted = layer(target)
    shift = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.Adam([shift], lr=0.01)
    for _ in range(30):
        points = mesh.points.index_add(0, torch.tensor([side]), shift[None])
        # The point itself is not looked at: all that is known of it comes through the interior.
        loss = (layer(points) - wanted)[~mesh.fixed].square().sum()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    torch.testing.assert_close(shift.detach(), torch.tensor([0.06, 0.03], dtype=torch.float64), rtol=0, atol=0.01)


def test_the_layer_follows_a_loss():
    points = TANGLED.points.clone().requires_grad_()
    loss = losses.inverse_mean_ratio(nn.Untangle(TANGLED)(points), TANGLED).sum()
    (gradient,) = torch.autograd.grad(loss, points)
    assert bool(gradient.isfinite().all())
    assert float(gradient[TANGLED.fixed].abs().max()) > 0


def test_one_step_is_not_said_to_have_converged():
    layer = nn.Smooth(SMOOTHABLE, nn.LayerOptions(tm.SmoothOptions(max_iterations=1), newton_steps=1))
    points = layer(SMOOTHABLE.points)
    assert not bool(layer.info.converged.all())
    assert int(tm.quality(SMOOTHABLE.with_points(points)).inverted.sum()) == 0


def test_layers_have_no_parameters_and_take_the_mesh_with_the_call():
    layer = nn.Smooth()
    assert not list(layer.parameters())
    one, two = grid(), disc()
    assert layer(one.points, one).shape == one.points.shape
    assert layer(two.points, two).shape == two.points.shape
    with pytest.raises(tm.InvalidMeshError, match="no mesh"):
        layer(one.points)


@pytest.mark.parametrize(
    ("points", "message"),
    [(torch.zeros(3, 2), "points must be"), (torch.full((42, 2), float("nan")), "row 0")],
)
def test_wrong_points_are_refused(points, message):
    with pytest.raises(tm.InvalidMeshError, match=message):
        nn.Smooth(grid())(points)


@pytest.mark.parametrize(
    "name", ["newton_steps", "tolerance", "cg_tolerance", "cg_iterations", "near", "first_cg_tolerance", "halvings"]
)
def test_wrong_options_are_refused_by_name(name):
    with pytest.raises(ValueError, match=name):
        nn.LayerOptions(**{name: 0})


@pytest.mark.parametrize("smooth", [{"boundary": "slide"}, {"targets": torch.eye(2).double()[None]}])
def test_energies_without_a_derivative_are_refused(smooth):
    with pytest.raises(ValueError, match=r"LayerOptions\.smooth"):
        nn.LayerOptions(tm.SmoothOptions(**smooth))


def test_on_failure_is_one_of_two():
    with pytest.raises(ValueError, match="on_failure"):
        nn.Smooth(on_failure="ignore")
