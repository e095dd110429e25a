"""Layers are modules like any other: they move, are saved, copied and shown; what they cannot do they say."""

import copy
import pickle

import pytest
import torch
from meshes import disc, disturbed, grid, jittered, ring

import torchmesh as tm
from torchmesh import losses, nn

MESH = tm.join([disturbed(grid(), 0.02, 1), disc(), ring()])


def test_the_mesh_is_in_the_state_and_comes_back_from_it():
    layer = nn.Smooth(MESH)
    state = layer.state_dict()
    assert torch.equal(state["mesh_points"], MESH.points)
    assert torch.equal(state["mesh_triangles"], MESH.triangles)
    for other in (nn.Smooth(), nn.Smooth(grid()), nn.Smooth(MESH)):
        other.load_state_dict(state)
        assert torch.equal(other(MESH.points), layer(MESH.points))
    assert nn.Smooth().state_dict() == {}


def test_loading_writes_into_no_mesh_of_the_callers():
    mesh = grid()
    layer = nn.Smooth(mesh)
    before = mesh.points.clone()
    layer.load_state_dict({k: v + 1 if k == "mesh_points" else v for k, v in layer.state_dict().items()})
    assert torch.equal(mesh.points, before)
    assert torch.equal(layer.mesh.points, before + 1)


@pytest.mark.parametrize("again", [copy.deepcopy, lambda layer: pickle.loads(pickle.dumps(layer))])
def test_copies_do_the_same(again):
    layer = torch.nn.Sequential(nn.Untangle(MESH, on_failure="keep"))
    layer(MESH.points)
    other = again(layer)
    assert torch.equal(other(MESH.points), layer(MESH.points))
    assert repr(other) == repr(layer)


def test_the_mesh_moves_with_the_module():
    layer = torch.nn.Sequential(nn.Untangle(MESH))
    assert layer.to(torch.float32)[0].mesh.points.dtype == torch.float32
    assert layer[0].mesh.frames.dtype == torch.float64
    assert layer[0].mesh.triangles.dtype == torch.int64
    assert layer(MESH.points.float()).dtype == torch.float32
    meta = copy.deepcopy(layer).to("meta")[0].mesh
    assert {t.device.type for t in (meta.points, meta.triangles, meta.fixed, meta.frames)} == {"meta"}


def test_repr_names_the_mesh():
    assert "3 meshes" in repr(nn.Untangle(MESH))
    assert "topology='flip'" in repr(nn.Untangle(topology="flip"))


def test_twins_are_computed_once_and_a_mesh_can_be_replaced():
    layer = nn.Smooth(MESH)
    assert layer.mesh.twin is layer.mesh.twin
    layer.mesh = grid()
    assert len(layer.mesh) == 1
    assert layer(grid().points).shape == grid().points.shape
    with pytest.raises(tm.InvalidMeshError, match="MeshBatch or None"):
        layer.mesh = 3


@pytest.mark.parametrize(
    "transform",
    [
        lambda layer, p: torch.vmap(layer)(p[None]),
        lambda layer, p: torch.func.grad(lambda q: layer(q).sum())(p),
        lambda layer, p: torch.func.jvp(layer, (p,), (p,)),
    ],
)
@pytest.mark.filterwarnings("ignore:.*jit:DeprecationWarning")  # of torch's own
def test_transforms_are_refused_in_a_sentence(transform):
    with pytest.raises(NotImplementedError, match=r"nn\.Smooth does not work inside torch\.vmap.*tm\.join"):
        transform(nn.Smooth(MESH), MESH.points)


def test_a_second_derivative_is_refused_in_a_sentence_and_never_wrong():
    points = MESH.points.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(nn.Smooth(MESH)(points).square().sum(), points, create_graph=True)
    (plain,) = torch.autograd.grad(nn.Smooth(MESH)(points).square().sum(), points)
    assert torch.equal(gradient.detach(), plain)
    with pytest.raises(NotImplementedError, match="first derivatives only"):
        gradient.sum().backward()


@pytest.mark.filterwarnings("ignore:.*jit:DeprecationWarning")  # of torch's own
def test_forward_derivative_is_that_of_differences():
    layer, h = nn.Smooth(MESH), 1e-5
    way = torch.randn(MESH.points.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    with torch.autograd.forward_ad.dual_level():
        out = layer(torch.autograd.forward_ad.make_dual(MESH.points, way))
        tangent = torch.autograd.forward_ad.unpack_dual(out).tangent
    differences = (layer(MESH.points + h * way) - layer(MESH.points - h * way)) / (2 * h)
    torch.testing.assert_close(tangent, differences, rtol=1e-5, atol=1e-6)


LOSSES = {
    "inverse mean ratio": lambda p, m: losses.inverse_mean_ratio(p, m),
    "untangle-beta": lambda p, m: losses.untangle_beta(p, m),
    "regularised": lambda p, m: losses.regularised(p, m),
    "regularised, reference": lambda p, m: losses.regularised(p, m, reference=True),
    "minimum of det": lambda p, m: losses.minimum_jacobian(p, m),
    "per triangle": lambda p, m: losses.minimum_jacobian(p, m, reference=False, per="triangle"),
}


@pytest.mark.parametrize("name", LOSSES)
@pytest.mark.filterwarnings("ignore")
def test_a_loss_is_one_graph(name):
    torch.compiler.reset()
    compiled = torch.compile(LOSSES[name], fullgraph=True, backend="aot_eager")
    results = []
    for loss in (compiled, LOSSES[name]):
        points = MESH.points.clone().requires_grad_()
        values = loss(points, MESH)
        results.append((values.detach(), *torch.autograd.grad(values.sum(), points)))
    for one, other in zip(*results, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-12, atol=1e-12)


@pytest.mark.filterwarnings("ignore")
def test_a_layer_works_inside_what_is_compiled():
    torch.compiler.reset()
    mesh = jittered(6, 5, 0.5)
    layer = nn.Untangle(mesh)
    compiled = torch.compile(lambda p: (2 * layer(1.0 * p)).square().sum(), backend="aot_eager")
    points, plain = (mesh.points.clone().requires_grad_() for _ in range(2))
    value, expected = compiled(points), (2 * layer(plain)).square().sum()
    assert value.detach() == expected.detach()
    value.backward()
    expected.backward()
    assert torch.equal(points.grad, plain.grad)
    assert torch.equal(torch.compile(layer, backend="aot_eager")(mesh.points), layer(mesh.points))
