"""`improve` and interfaces between regions: fixed, sliding or free."""

import dataclasses

import meshes
import numpy as np
import pytest
import torch
from judges import directed_edges

import torchmesh as tm
from torchmesh.mesh.interfaces import interface_vertices
from torchmesh.remeshing.relocation import relocate
from torchmesh.untangling.retriangulation import retriangulate_cavities


def tangled(cells: int = 4) -> tm.MeshBatch:
    """An L whose interface crosses itself: two of its vertices have passed each other."""
    mesh = meshes.l_shape(cells)
    inner = (interface_vertices(mesh) & ~mesh.fixed).nonzero().squeeze(1)
    points = mesh.points.clone()
    points[inner[:2]] = points[inner[:2].flip(0)]
    return mesh.with_points(points)


def inner_of(mesh: tm.MeshBatch) -> torch.Tensor:
    return interface_vertices(mesh) & ~mesh.fixed


@pytest.mark.parametrize("topology", ["keep", "flip", "full"])
def test_free_mends_a_tangled_interface_that_fixed_reports_with_advice(topology):
    mesh = tangled()
    held, report = tm.improve(mesh, tm.ImproveOptions(topology=topology))
    assert report.valid.tolist() == [False]
    assert "interfaces='free'" in report.messages[0]
    assert torch.equal(held.points[inner_of(mesh)], mesh.points[inner_of(mesh)])
    assert report.regions is None
    better, report = tm.improve(mesh, tm.ImproveOptions(topology=topology, interfaces="free"))
    assert report.valid.tolist() == report.certified.tolist() == [True]
    edges = directed_edges(better.triangles)
    assert all((u, v) in edges and (v, u) in edges for u, v in better.constrained_edges.tolist())
    if topology != "full":
        assert torch.equal(better.fixed, mesh.fixed)
        assert torch.equal(better.constrained_edges, mesh.constrained_edges)
    assert report.regions.before.tolist() == pytest.approx([2.0, 1.0])
    assert float(report.regions.after.sum()) == pytest.approx(3.0)
    assert "the areas of 2 regions changed by" in report.messages[0]
    assert report.to_dict()[0]["regions"][1]["after"] == float(report.regions.after[1])


def test_interfaces_go_as_the_boundary_does_unless_they_are_asked_for():
    mesh = meshes.l_shape(4)
    mesh = mesh.with_points(meshes.disturbed(mesh, 0.12, 3).points)
    line, rim = inner_of(mesh), mesh.fixed
    expected = {
        ("fixed", None): (False, False),
        ("slide", None): (True, True),
        ("slide", "fixed"): (True, False),
        ("fixed", "slide"): (False, True),
        ("fixed", "free"): (False, True),
    }
    for (boundary, interfaces), moves in expected.items():
        better, report = tm.improve(mesh, tm.ImproveOptions(boundary=boundary, interfaces=interfaces))
        assert report.valid.all()
        found = [not torch.equal(better.points[rows], mesh.points[rows]) for rows in (rim, line)]
        assert tuple(found) == moves, (boundary, interfaces)
        straight = bool((better.points[line, 0] == 1).all())
        assert straight is (interfaces != "free")


def test_what_the_user_fixes_or_holds_on_an_interface_stays():
    mesh = meshes.disturbed(meshes.l_shape(4), 0.12, 3)
    row = int(inner_of(mesh).nonzero()[1])
    mark = torch.zeros(len(mesh.points), dtype=torch.bool)
    mark[row] = True
    pinned = tm.MeshBatch.from_arrays(mesh.points, mesh.triangles, mark, mesh.constrained_edges)
    for interfaces in ("slide", "free"):
        options = tm.ImproveOptions(interfaces=interfaces)
        fixed, _ = tm.improve(pinned, options)
        held, report = tm.improve(mesh, options, hold=mark)
        assert report.certified.all()
        for better in (fixed, held):
            assert torch.equal(better.points[row], mesh.points[row])
            assert not torch.equal(better.points[inner_of(mesh)], mesh.points[inner_of(mesh)])
        assert torch.equal(held.fixed, mesh.fixed)


def test_free_in_a_batch_is_free_alone():
    parts = [tangled(), meshes.jittered(), tangled(3)]
    options = tm.ImproveOptions(interfaces="free")
    whole, report = tm.improve(tm.join(parts), options)
    assert report.regions.mesh.tolist() == [0, 0, 1, 2, 2]
    for mesh, joined in zip(parts, whole.split(), strict=True):
        alone, _ = tm.improve(mesh, options)
        assert torch.equal(alone.points, joined.points)
        assert torch.equal(alone.triangles, joined.triangles)


def test_a_motion_carries_interfaces_unless_they_are_held():
    mesh = meshes.l_shape(4)
    line = inner_of(mesh)
    turn = torch.tensor([[0.8, 0.6], [-0.6, 0.8]], dtype=torch.float64)
    goal = mesh.points @ turn
    # FEMWARP reproduces affine motions; so it does for the interface, whose rows of the goal are not read.
    unread = torch.where(mesh.fixed[:, None], goal, torch.nan)
    torch.testing.assert_close(tm.femwarp(mesh, unread).points, goal, rtol=0, atol=1e-12)
    held = tm.femwarp(mesh, torch.where(line[:, None], mesh.points, goal), hold=line)
    assert torch.equal(held.points[line], mesh.points[line])
    assert torch.equal(held.fixed, mesh.fixed)
    arrived, report = tm.deform(mesh, unread)
    assert report.valid.all()
    away = (arrived.points[line] - goal[line]).norm(dim=1)
    assert float(away.max()) < 0.05
    arrived, _ = tm.deform(mesh, torch.where(line[:, None], mesh.points, mesh.points), hold=line)
    assert torch.equal(arrived.points[line], mesh.points[line])
    assert torch.equal(arrived.fixed, mesh.fixed)


@pytest.mark.parametrize("topology", ["keep", "flip", "full"])
@pytest.mark.parametrize("pinned", [True, False])
def test_free_lets_an_interface_go_out_of_the_way_of_a_body(topology, pinned):
    """A hole goes to the far side of where the interface was; the interface stayed, or was carried along."""
    mesh, goal = body_beside_an_interface(0.4)
    moved = mesh.with_points(goal) if pinned else tm.femwarp(mesh, goal)
    assert int(tm.quality(moved).inverted) > 15
    better, report = tm.improve(moved, tm.ImproveOptions(topology=topology, interfaces="free"))
    assert report.certified.tolist() == [True]
    assert float(report.regions.after.sum()) == pytest.approx(float(report.regions.before.sum()))
    # The hole, of area 0.04, now lies where the interface was.
    assert float(report.regions.after[0]) > 0.6
    edges = directed_edges(better.triangles)
    assert all((u, v) in edges and (v, u) in edges for u, v in better.constrained_edges.tolist())


def body_beside_an_interface(distance: float) -> tuple[tm.MeshBatch, torch.Tensor]:
    """A square with a hole left of the interface x = 1/2, and the positions after the hole has gone right."""
    points, triangles = meshes.grid_arrays(24, 24)
    middles = points[triangles].mean(1)
    inside = (abs(middles - [0.35, 0.5]) < 0.1).all(1)
    used, triangles = np.unique(triangles[~inside], return_inverse=True)
    points, triangles = points[used], triangles.reshape(-1, 3)
    west = points[triangles].mean(1)[:, 0] < 0.5
    left, right = (directed_edges(torch.from_numpy(triangles[side])) for side in (west, ~west))
    mesh = tm.MeshBatch.from_arrays(points, triangles, None, sorted(e for e in left if e[::-1] in right))
    hole = mesh.fixed & ((mesh.points - torch.tensor([0.35, 0.5])).abs().amax(1) < 0.2)
    return mesh, mesh.points + hole[:, None] * torch.tensor([distance, 0.05])


@pytest.mark.parametrize("split", [False, True])
@pytest.mark.parametrize("size", [0.15, 0.5])
def test_remeshing_moves_free_interfaces_and_takes_none_of_their_vertices_out(split, size):
    mesh = meshes.l_shape(4)
    line, sizes = inner_of(mesh), torch.full((len(mesh.points),), size, dtype=torch.float64)
    remesh = tm.RemeshOptions(sizes=sizes, split_boundary=split)
    for interfaces in ("fixed", "free"):
        after, report = tm.improve(mesh, tm.ImproveOptions(topology="full", interfaces=interfaces, remesh=remesh))
        assert report.certified.tolist() == [True]
        row = report.vertex_map.old_to_new[line]
        assert bool((row >= 0).all())
        moved = (after.points[row] != mesh.points[line]).any(1)
        assert bool(moved.any()) is (interfaces == "free")
        # What halves an interface is no more fixed than the rest of it.
        assert not after.fixed[inner_of(after)].any()
        assert int((after.fixed & interface_vertices(after)).sum()) == 2
        if interfaces == "free":
            area = report.regions.after
            assert float(area.sum()) == pytest.approx(3.0)
            assert float((area - report.regions.before).abs().max()) > 0
        assert len(after.constrained_edges) == 4 or (split and size == 0.15 and len(after.constrained_edges) > 4)
        after, _ = tm.remesh(mesh, dataclasses.replace(remesh, interfaces=interfaces))
        straight = bool((after.points[inner_of(after), 0] == 1).all())
        assert straight is (interfaces == "fixed")


def test_vertices_that_travel_take_free_interfaces_along():
    mesh = meshes.l_shape(6)
    line = inner_of(mesh)
    remesh = tm.RemeshOptions(sizes=lambda xy: 0.05 + 0.2 * xy[:, 0])
    for interfaces in ("fixed", "free"):
        options = dataclasses.replace(remesh, interfaces=interfaces)
        after, done = relocate(mesh, options)
        assert int(done.splits) > 0
        assert torch.equal(after.fixed, mesh.fixed)
        assert torch.equal(after.constrained_edges, mesh.constrained_edges)
        assert int(tm.quality(after).inverted) == 0
        assert torch.equal(after.points[line], mesh.points[line]) is (interfaces == "fixed")


def test_cavities_move_free_walls_that_cross():
    for mesh in (tangled(), tangled(6)):
        held, info = retriangulate_cavities(mesh)
        assert int(tm.quality(held).inverted) > 0
        assert "meet" in info.reasons[0]
        free, info = retriangulate_cavities(mesh, "free")
        assert info.reasons == [""]
        assert int(tm.quality(free).inverted) == 0
        edges = directed_edges(free.triangles)
        assert all((u, v) in edges and (v, u) in edges for u, v in mesh.constrained_edges.tolist())
        still = mesh.fixed
        assert torch.equal(free.points[still], mesh.points[still])
