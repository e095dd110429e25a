"""Shapes and sizes that layers aim at: what they do to a mesh, and their gradients against differences."""

import pickle

import pytest
import torch
from meshes import disc, disturbed, grid, hopeless, jittered, moved_hole, ring

import torchmesh as tm
from torchmesh import nn
from torchmesh.mesh.means import vertex_size

MESH = tm.join([disturbed(grid(), 0.02, 1), disc(), ring()])
T, V = len(MESH.triangles), len(MESH.points)


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


AIMS = {
    "targets": (torch.eye(2, dtype=torch.float64) + 0.2 * random(T, 2, 2)),
    "sizes of triangles": 0.2 * (0.3 * random(T)).exp(),
    "sizes at vertices": 0.2 * (0.3 * random(V)).exp(),
}


@pytest.mark.parametrize("name", AIMS)
def test_gradients_are_those_of_differences(name):
    keyword = name.split()[0]
    layer, weight, base, h = nn.Smooth(MESH), random(V, 2, seed=1), AIMS[name], 1e-5
    aim, points = base.clone().requires_grad_(), MESH.points.clone().requires_grad_()
    out = layer(points, **{keyword: aim})
    assert bool(layer.info.converged.all())
    by_aim, by_points = torch.autograd.grad((out * weight).sum(), (aim, points))

    def value(p: torch.Tensor, a: torch.Tensor) -> float:
        return float((layer(p, **{keyword: a}) * weight).sum())

    way = random(*base.shape, seed=2) * base.abs()
    expected = (value(MESH.points, base + h * way) - value(MESH.points, base - h * way)) / (2 * h)
    assert float((by_aim * way).sum()) == pytest.approx(expected, rel=1e-5, abs=1e-6)
    along = random(V, 2, seed=3) * MESH.fixed[:, None]
    expected = (value(MESH.points + h * along, base) - value(MESH.points - h * along, base)) / (2 * h)
    assert float((by_points * along).sum()) == pytest.approx(expected, rel=1e-5, abs=1e-6)


def test_equilateral_targets_are_none_and_their_size_does_not_matter():
    layer = nn.Smooth(MESH)
    ideal = torch.tensor([[1.0, 0.5], [0.0, 0.75**0.5]], dtype=torch.float64)
    size = torch.linspace(0.1, 3, T, dtype=torch.float64)[:, None, None]
    torch.testing.assert_close(layer(MESH.points, targets=size * ideal), layer(MESH.points), rtol=0, atol=1e-8)


def test_targets_are_those_of_smooth():
    mesh, targets = grid(), torch.eye(2, dtype=torch.float64) + 0.2 * random(len(grid().triangles), 2, 2)
    options = tm.SmoothOptions(targets=targets, energy_tolerance=0, gradient_tolerance=1e-11, max_iterations=3000)
    smoothed, _ = tm.smooth(mesh, options)
    torch.testing.assert_close(nn.Smooth(mesh)(mesh.points, targets=targets), smoothed.points, rtol=0, atol=1e-6)


def test_vertices_go_where_sizes_are_small():
    mesh = grid(8, 8)
    x = mesh.points[:, 0]
    fine = torch.where(x < x.mean(), 0.05, 0.2)
    layer = nn.Smooth(mesh)
    out = mesh.with_points(layer(mesh.points, sizes=fine))
    assert bool(layer.info.converged.all())
    assert int(tm.quality(out).inverted.sum()) == 0
    free = ~mesh.fixed
    left, right = free & (x < x.mean() - 0.1), free & (x > x.mean() + 0.1)
    assert float(vertex_size(out)[left].mean()) < 0.95 * float(vertex_size(out)[right].mean())


def test_a_unit_of_length_is_none():
    sizes = AIMS["sizes of triangles"]
    big = MESH.with_points(64 * MESH.points)
    one, other = nn.Smooth(MESH)(MESH.points, sizes=sizes), nn.Smooth(big)(big.points, sizes=64 * sizes)
    assert torch.equal(64 * one, other)


@pytest.mark.parametrize(
    ("aims", "message"),
    [
        ({"targets": torch.ones(3, 2, 2)}, "targets must be"),
        ({"targets": torch.zeros(T, 2, 2)}, "mesh 0: targets row 0"),
        ({"targets": 3}, "targets must be .* not int"),
        ({"sizes": torch.ones(5)}, "sizes must be"),
        ({"sizes": -torch.ones(T)}, "sizes row 0"),
    ],
)
def test_aims_that_are_none_are_refused(aims, message):
    with pytest.raises(tm.InvalidMeshError, match=message):
        nn.Smooth(MESH)(MESH.points, **aims)


def test_aims_of_triangles_do_not_go_with_flips():
    layer = nn.Untangle(MESH, topology="flip")
    for aims, word in (({"targets": AIMS["targets"]}, "targets"), ({"sizes": AIMS["sizes of triangles"]}, "sizes")):
        with pytest.raises(tm.InvalidMeshError, match=word):
            layer(MESH.points, **aims)


# --- the ways in: from nothing, from a start, with flips ---


def test_as_many_are_valid_as_improve_keeps():
    mesh = tm.domains.generate(12, ("gate", "jitter"), triangles=150, seed=4).deformed
    throw = 0.3 * random(*mesh.points.shape) * vertex_size(mesh)[:, None]
    tangled = mesh.with_points(mesh.points + throw * ~mesh.fixed[:, None])
    _, report = tm.improve(tangled, tm.ImproveOptions(topology="keep"))
    layer = nn.Untangle(tangled, on_failure="keep")
    layer(tangled.points)
    assert int(layer.info.valid.sum()) >= int(report.valid.sum()) > 6


@pytest.mark.parametrize("topology", ["keep", "flip"])
def test_a_start_leads_to_the_same_minimum(topology, monkeypatch):
    mesh = moved_hole()
    layer = nn.Untangle(mesh, topology=topology)
    first = layer(mesh.points)
    start = layer.info.mesh if topology == "flip" else first
    moved = mesh.points + 1e-3 * torch.tensor([1.0, -2.0])
    from torchmesh.learning import nn as module

    monkeypatch.setattr(module, "improve", None)  # which a start makes needless
    again = layer(moved, start=start)
    assert bool(layer.info.converged.all())
    torch.testing.assert_close(again, first + 1e-3 * torch.tensor([1.0, -2.0]), rtol=0, atol=1e-8)


def test_what_is_remembered_of_a_pass_changes_no_bit():
    """The backward pass leaves factors to the pass that starts from its result, which otherwise makes its own."""
    meshes = [MESH, moved_hole(), ring()]
    batch, motion = tm.join(meshes), 1e-3 * random(sum(len(mesh.points) for mesh in meshes), 2)
    results = []
    for backward in (True, False):
        layer = nn.Untangle(batch)
        points = batch.points.clone().requires_grad_()
        first = layer(points)
        if backward:
            first.square().sum().backward()
        layer = layer if backward else pickle.loads(pickle.dumps(layer))
        results.append(layer(batch.points + motion, start=first.detach()))
        assert bool(layer.info.converged.all())
    assert torch.equal(*results)
    alone = nn.Untangle(meshes[1])
    rows = slice(len(MESH.points), len(MESH.points) + len(meshes[1].points))
    assert torch.equal(alone(meshes[1].points + motion[rows], start=alone(meshes[1].points)), results[0][rows])


def test_a_start_that_does_not_help_does_no_harm():
    mesh = tm.join([moved_hole(), grid()])
    layer = nn.Untangle(mesh)
    expected = layer(mesh.points)
    torch.testing.assert_close(layer(mesh.points, start=torch.zeros_like(mesh.points)), expected, rtol=0, atol=1e-8)
    with pytest.raises(tm.InvalidMeshError, match="start must have"):
        layer(mesh.points, start=mesh.points[:5])


def test_flips_untangle_and_the_gradient_is_that_of_the_flipped_mesh():
    mesh = tm.domains.generate(4, ("holes",), triangles=150, seed=2).deformed
    layer, weight = nn.Untangle(mesh, topology="flip"), random(*mesh.points.shape, seed=5)
    points = mesh.points.clone().requires_grad_()
    out = layer(points)
    flipped = layer.info.mesh
    assert bool(layer.info.converged.all())
    assert not torch.equal(flipped.triangles, mesh.triangles)
    assert torch.equal(flipped.points, out.detach())
    assert int(tm.quality(flipped).inverted.sum()) == 0
    (gradient,) = torch.autograd.grad((out * weight).sum(), points)
    again = flipped.points.clone().requires_grad_()
    (expected,) = torch.autograd.grad((nn.Smooth(flipped)(again) * weight).sum(), again)
    torch.testing.assert_close(gradient, expected, rtol=1e-5, atol=1e-6)


def test_topology_is_one_of_two():
    with pytest.raises(ValueError, match="topology"):
        nn.Untangle(topology="full")


def test_a_mesh_that_could_not_be_untangled_is_worked_on_from_there(monkeypatch):
    """Its second call looks for no other way, which cost as much as the first."""
    mesh = tm.join([hopeless(), jittered(6, 5, 0.5)])
    layer = nn.Untangle(mesh, on_failure="keep")
    first = layer(mesh.points)
    assert layer.info.valid.tolist() == [False, True]
    monkeypatch.setattr("torchmesh.learning.nn.improve", lambda *_: pytest.fail("began anew"))
    again = layer(mesh.points + 1e-5 * ~mesh.fixed[:, None], start=first)
    assert layer.info.valid.tolist() == [False, True]
    rows = slice(int(mesh.point_offsets[1]), None)
    torch.testing.assert_close(again[rows], first[rows], rtol=0, atol=1e-8)
    assert torch.equal(again[mesh.fixed], mesh.points[mesh.fixed])
    with pytest.raises(pytest.fail.Exception, match="began anew"):
        layer(mesh.points, start=torch.zeros_like(first))


def test_input_that_is_valid_is_taken_where_the_start_is_tangled():
    mesh = jittered(6, 5, 0.5)
    valid = nn.Untangle(mesh)(mesh.points)
    layer = nn.Untangle(mesh)
    torch.testing.assert_close(layer(valid, start=mesh.points), valid, rtol=0, atol=1e-8)
    assert bool(layer.info.valid.all())
