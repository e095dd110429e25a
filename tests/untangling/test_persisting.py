"""The second-order ways solve what L-BFGS leaves tangled, alone as in a batch, and leave what is solved as it is."""

import math
from dataclasses import replace

import meshes
import numpy as np
import pytest
import torch
from exact import inverted

import torchmesh as tm
from torchmesh import NewtonWays, Status, UntangleOptions, join, untangle
from torchmesh.learning.outlines import regular_polygon
from torchmesh.triangulating.mesher import Outline, mesh_outline
from torchmesh.untangling import persisting


def turned_inside(mesh: tm.MeshBatch, inner: float) -> tm.MeshBatch:
    """A ring whose inner circle has turned by 180 degrees, with every free vertex at the mean of its neighbours."""
    inside = mesh.points.norm(dim=1) < inner + 1e-6
    return tm.relax(mesh.with_points(torch.where(inside[:, None], -mesh.points, mesh.points)))


def half_turn(sectors: int = 24, layers: int = 6) -> tm.MeshBatch:
    """The same of a ring of regular layers."""
    return turned_inside(meshes.ring(sectors, layers, 0.4, 1.3), 0.4)


def hard_half_turn() -> tm.MeshBatch:
    """The same of an irregular ring, in which L-BFGS stalls."""
    circle = regular_polygon(120)
    outline = Outline((circle, 0.5 * circle[::-1]), (1.0, 1.0), 0.2)
    return turned_inside(tm.MeshBatch.from_arrays(*mesh_outline(outline, 600, np.random.default_rng([0, 7]))[:2]), 0.5)


def turned_by_150() -> tm.MeshBatch:
    """A ring of three layers whose inner circle, of 0.6 of its radius, has turned by 150 degrees."""
    circle = regular_polygon(120)
    outline = Outline((circle, 0.6 * circle[::-1]), (1.0, 1.0), 0.2)
    mesh = tm.MeshBatch.from_arrays(*mesh_outline(outline, 300, np.random.default_rng(300))[:2])
    sine, cosine = math.sin(math.radians(150)), math.cos(math.radians(150))
    turned = mesh.points @ torch.tensor([[cosine, sine], [-sine, cosine]], dtype=torch.float64)
    inside = mesh.points.norm(dim=1) < 0.6 + 1e-6
    return tm.relax(mesh.with_points(torch.where(inside[:, None], turned, mesh.points)))


def test_growing_weights_solve_what_no_other_way_does():
    mesh = turned_by_150()
    without, _ = untangle(mesh, UntangleOptions("newton", newton=NewtonWays(weightings=())))
    assert inverted(without) > 0
    moved, info = untangle(mesh, UntangleOptions("newton"))
    assert inverted(moved) == 0
    assert info.status.tolist() == [Status.VALID]
    assert torch.equal(moved.points[mesh.fixed], mesh.points[mesh.fixed])


def test_a_half_turn_is_untangled_where_first_order_stalls():
    mesh = hard_half_turn()
    first, info = untangle(mesh, UntangleOptions(newton=None))
    assert inverted(first) > 0
    assert info.status.tolist() == [Status.STALLED]
    moved, info = untangle(mesh)
    assert inverted(moved) == 0
    assert info.status.tolist() == [Status.VALID]
    assert torch.equal(moved.points[mesh.fixed], mesh.points[mesh.fixed])
    better, report = tm.improve(mesh, tm.ImproveOptions(topology="keep"))
    assert inverted(better) == 0
    assert report.certified.tolist() == [True]
    assert torch.equal(better.triangles, mesh.triangles)
    assert "newton" in [step.stage for step in report.steps[0]]


@pytest.mark.parametrize("way", ["_pushed", "_lifted", "_regularised", "_weighted"])
def test_each_way_solves_it_by_itself(way, monkeypatch):
    for other in {"_pushed", "_lifted", "_regularised", "_weighted"} - {way}:
        monkeypatch.setattr(persisting, other, lambda *_: False)
    moved, _ = untangle(half_turn(), UntangleOptions("newton"))
    assert inverted(moved) == 0


def test_joined_equals_alone():
    batch = [half_turn(), meshes.jittered(8, 7, 0.5, 0), half_turn(30, 8)]
    moved, info = untangle(join(batch), UntangleOptions("newton"))
    for b, mesh in enumerate(batch):
        alone, by_itself = untangle(mesh, UntangleOptions("newton"))
        assert torch.equal(moved[b].points, alone.points)
        assert info.iterations[b] == by_itself.iterations[0]
    assert info.status.tolist() == [Status.VALID] * 3


def test_no_constant_depends_on_the_unit_of_length():
    mesh = half_turn()
    moved, _ = untangle(mesh, UntangleOptions("newton"))
    scaled, _ = untangle(mesh.with_points(mesh.points * 2.0**-40), UntangleOptions("newton"))
    assert torch.equal(scaled.points, moved.points * 2.0**-40)


def test_the_shapes_of_a_reference_are_the_first_target():
    rest = meshes.ring(24, 6, 0.4, 1.3)
    mesh = half_turn()
    moved, info = untangle(mesh, UntangleOptions("newton"), reference=rest)
    assert info.status.tolist() == [Status.VALID]
    assert inverted(moved) == 0
    with pytest.raises(tm.InvalidMeshError):
        untangle(mesh, UntangleOptions("newton"), reference=mesh)


@pytest.mark.parametrize("method", ["newton", "regularised"])
def test_rest_shapes_of_a_surface_in_space_are_targets(method):
    mesh = meshes.jittered(8, 7, 0.6, 2)
    rest = meshes.grid(8, 7).points
    points = torch.stack([rest[:, 0], 0.5 * rest[:, 1], rest[:, 0].square()], 1)
    targets = tm.target_from(points, mesh.triangles)
    assert inverted(mesh) > 0
    moved, info = untangle(mesh, UntangleOptions(method), targets=targets)
    assert info.status.tolist() == [Status.VALID]
    alone, _ = untangle(mesh, UntangleOptions(method), targets=1000 * targets)
    torch.testing.assert_close(moved.points, alone.points, rtol=0, atol=1e-6)
    joined, _ = untangle(join([half_turn(), mesh]), UntangleOptions(method),
                         targets=torch.cat([tm.target_from(meshes.ring(24, 6, 0.4, 1.3)), targets]))  # fmt: skip
    assert torch.equal(joined[1].points, moved.points)
    for bad, message in ((targets[:-1], "targets must be"), (0 * targets, "row 0 is")):
        with pytest.raises(tm.InvalidMeshError, match=message):
            untangle(mesh, targets=bad)
    with pytest.raises(tm.InvalidMeshError, match="not with a reference"):
        untangle(mesh, targets=targets, reference=meshes.grid(8, 7))


def test_a_valid_mesh_stays_and_what_cannot_move_is_not_tried(monkeypatch):
    monkeypatch.setattr(persisting, "_solve", lambda *_: pytest.fail("tried"))
    mesh = meshes.grid(6, 6)
    moved, _ = untangle(mesh, UntangleOptions("newton"))
    assert torch.equal(moved.points, mesh.points)
    points = mesh.points.clone()
    points[[14, 15]] = points[[15, 14]]
    held = replace(mesh, points=points, fixed=torch.ones_like(mesh.fixed))
    moved, info = untangle(held, UntangleOptions("newton"))
    assert info.status.tolist() == [Status.STALLED]


def test_quads_and_scrambled_starts():
    mesh = meshes.mixed(6, 5, 3)
    throw = torch.rand(mesh.points.shape, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    tangled = mesh.with_points(torch.where(mesh.fixed[:, None], mesh.points, throw * mesh.points.amax(0)))
    moved, info = untangle(tangled, UntangleOptions("newton"))
    assert info.status.tolist() == [Status.VALID]
    assert int(tm.quality(moved).inverted) == 0


def test_options_refuse_by_name():
    with pytest.raises(ValueError, match=r"NewtonWays\.pushes must be at least 1"):
        NewtonWays(pushes=0)
    with pytest.raises(ValueError, match=r"NewtonWays\.alphas must all be positive"):
        NewtonWays(alphas=(0.0,))
    with pytest.raises(ValueError, match=r"NewtonWays\.weightings must be triples"):
        NewtonWays(weightings=((100, 0.1, 1.0),))
    with pytest.raises(ValueError, match=r"NewtonWays\.weight_decay must be from 0 to 1"):
        NewtonWays(weight_decay=1.5)
    with pytest.raises(ValueError, match=r"UntangleOptions\.newton must not be None"):
        UntangleOptions("newton", newton=None)
