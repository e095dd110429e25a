"""Scrambled interiors are restored; others come back as they were, after two sweeps."""

import meshes
import pytest
import torch

import torchmesh as tm
from torchmesh import join, relax
from torchmesh.untangling.averaging import AverageOptions, _Averaging, average


def inverted(mesh: tm.MeshBatch) -> int:
    return int(tm.quality(mesh).inverted.sum())


def thrown(mesh: tm.MeshBatch, how: str) -> tm.MeshBatch:
    """`mesh` with its free vertices at other positions."""
    points, middle = mesh.points.clone(), mesh.points[mesh.fixed].mean(0)
    free = (~mesh.fixed).nonzero().squeeze(1)
    if how == "in one point":
        points[free] = middle
    elif how == "outside":
        points[free] += 20 * mesh.points.abs().max()
    elif how == "shuffled":
        points[free] = points[free[torch.randperm(len(free), generator=torch.Generator().manual_seed(7))]]
    elif how == "mirrored":
        points[free, 0] = 2 * middle[0] - points[free, 0]
    return mesh.with_points(points) if how != "jittered" else meshes.disturbed(mesh, 0.6, 3)


HOW = ["in one point", "outside", "shuffled", "mirrored", "jittered"]


@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize("name", ["grid", "disc", "equilateral", "delaunay", "wide"])
def test_a_scrambled_interior_comes_back_to_the_mean_of_its_neighbours(name, how):
    mesh = thrown(meshes.grid(70, 60) if name == "wide" else meshes.VALID[name](), how)
    assert inverted(mesh) > 0
    found = average(mesh)
    assert inverted(found) == 0
    assert torch.equal(found.points[mesh.fixed], mesh.points[mesh.fixed])
    assert torch.equal(found.triangles, mesh.triangles)
    # The residual is a thousandth; the positions are off by that times the condition of the system.
    extent = float((mesh.points[mesh.fixed].amax(0) - mesh.points[mesh.fixed].amin(0)).max())
    assert float((found.points - relax(mesh).points).abs().max()) < 0.1 * extent


def test_enough_sweeps_solve_the_equations():
    mesh = thrown(meshes.grid(9, 8), "outside")
    work = _Averaging(mesh)
    for _ in range(100):
        work.sweep()
    torch.testing.assert_close(work.moved().points, relax(mesh).points, rtol=0, atol=1e-12)


def test_an_interior_that_followed_its_boundary_is_left_as_it_is_at_the_first_glance(monkeypatch):
    points, triangles = meshes.holed_arrays(40, 24, 24)
    mesh = tm.MeshBatch.from_arrays(points, triangles)
    hole = mesh.fixed & (mesh.points > mesh.points.amin(0)).all(1) & (mesh.points < mesh.points.amax(0)).all(1)
    moved = tm.femwarp(mesh, mesh.points + 5 * hole[:, None] * torch.tensor([1.0, 0.0]))
    assert inverted(moved) > 20
    sweeps = []
    monkeypatch.setattr(_Averaging, "sweep", lambda self, sweep=_Averaging.sweep: sweeps.append(sweep(self)))
    assert torch.equal(average(moved).points, moved.points)
    assert len(sweeps) == AverageOptions().glance


def test_where_no_mean_is_valid_the_better_of_both_comes_back():
    # A hole moved too far and an interior thrown about: averaging undoes the second, not the first.
    mesh = meshes.disturbed(meshes.moved_hole(), 2.0, 5)
    found = average(mesh)
    assert 0 < inverted(found) < 0.5 * inverted(mesh)


def test_joined_equals_alone():
    parts = [thrown(meshes.VALID[name](), how) for name in meshes.VALID for how in HOW]
    parts += [meshes.moved_hole(), meshes.jittered(40, 30), thrown(meshes.grid(50, 50), "outside"), meshes.grid(1, 1)]
    parts += [meshes.disturbed(meshes.moved_hole(), 2.0, 5), meshes.jittered()]
    for mesh, together in zip(parts, average(join(parts)).split(), strict=True):
        assert torch.equal(average(mesh).points, together.points)


@pytest.mark.parametrize(("scale", "offset"), [(1e150, 0.0), (1e-140, 0.0), (1.0, 1e8), (3.0, 0.0)])
def test_unit_and_origin_do_not_matter(scale, offset):
    mesh = thrown(meshes.grid(), "shuffled")
    found = average(mesh.with_points(mesh.points * scale + offset))
    assert inverted(found) == 0
    back = (found.points - offset) / scale
    # At 1e8 a double has eight digits left behind the point.
    torch.testing.assert_close(back, average(mesh).points, rtol=0, atol=1e-6 if offset else 1e-9)


def test_single_precision_stays_so():
    mesh = thrown(meshes.grid().to(torch.float32), "in one point")
    found = average(mesh)
    assert found.points.dtype == torch.float32
    assert inverted(found) == 0


def test_what_has_no_free_vertex_comes_back():
    mesh = meshes.grid(1, 1)
    assert bool(mesh.fixed.all())
    for batch in (mesh, join([mesh, mesh])):
        assert torch.equal(average(batch).points, batch.points)


def test_improve_tries_it_first():
    _, report = tm.improve(thrown(meshes.grid(12, 12), "shuffled"))
    assert report.worked == ["average"]
    assert report.steps[0][1].kept
    assert float(report.quality.max) < 1.6


@pytest.mark.parametrize("wrong", [{"sweeps": 0}, {"glance": 0}, {"across": 0}, {"gain": 1}, {"residual": 0}])
def test_options_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match=f"AverageOptions.{next(iter(wrong))}"):
        AverageOptions(**wrong)
