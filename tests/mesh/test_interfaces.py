"""Who holds the vertices on interfaces, and who gives them back."""

from dataclasses import replace

import meshes
import pytest
import torch

import torchmesh as tm
from torchmesh.mesh.interfaces import check_interfaces, holding, interface_vertices, released
from torchmesh.mesh.vertex_map import Names


def test_the_ends_of_constrained_edges_are_held_unless_they_are_free():
    mesh = tm.join([meshes.grid(), meshes.l_shape()])
    ends = interface_vertices(mesh)
    assert sorted(ends.nonzero().squeeze(1).tolist()) == sorted(set(mesh.constrained_edges.reshape(-1).tolist()))
    inner = ends & ~mesh.fixed
    assert int(inner.sum()) == 2
    for choice in (None, "fixed", "slide"):
        assert torch.equal(holding(mesh, choice).fixed, mesh.fixed | ends)
    assert holding(mesh, "free") is mesh
    assert holding(meshes.grid()).fixed.sum() == meshes.grid().fixed.sum()


def test_what_is_given_back_has_the_fixed_vertices_that_were_given():
    mesh = meshes.l_shape()
    held = holding(mesh)
    assert torch.equal(released(held, mesh).fixed, mesh.fixed)
    assert released(mesh, mesh) is mesh
    rows = torch.tensor([5, 3, 12])
    few = replace(held, fixed=held.fixed[rows])
    renamed = Names.of_rows(len(mesh.points), rows.device).select(rows).vertex_map()
    assert torch.equal(released(few, mesh, renamed).fixed, mesh.fixed[rows])


def test_unknown_choices_are_refused_by_name():
    check_interfaces(None, "Options.interfaces")
    for make in (tm.SmoothOptions, tm.UntangleOptions, tm.PolishOptions, tm.ImproveOptions):
        with pytest.raises(ValueError, match=rf"{make.__name__}.interfaces must be 'fixed', 'slide', 'free' or None"):
            make(interfaces="loose")


@pytest.mark.parametrize("step", [tm.smooth, tm.untangle, tm.polish, tm.relax])
def test_every_step_holds_interfaces_and_moves_them_as_interior_vertices_when_free(step):
    mesh = meshes.l_shape(4)
    points = meshes.disturbed(replace(mesh, constrained_edges=mesh.constrained_edges[:0]), 0.02, 1).points
    inner = interface_vertices(mesh) & ~mesh.fixed
    if step is tm.untangle:
        points[inner] += torch.tensor([0.3, 0.2])
    if step is tm.polish:
        points[inner.nonzero()[1]] += 0.16
    mesh = mesh.with_points(points)
    options = {tm.smooth: tm.SmoothOptions, tm.untangle: tm.UntangleOptions, tm.polish: tm.PolishOptions}.get(step)

    def done(mesh, **choice):
        if options is None:
            return step(mesh, **choice)
        return step(mesh, options(**choice))[0]

    held, free = done(mesh), done(mesh, interfaces="free")
    assert torch.equal(held.points[inner], mesh.points[inner])
    assert not torch.equal(free.points[inner], mesh.points[inner])
    assert torch.equal(held.fixed, mesh.fixed)
    assert torch.equal(free.fixed, mesh.fixed)
    if step is not tm.polish:
        # Without flips, free interfaces are none.
        plain = replace(mesh, constrained_edges=mesh.constrained_edges[:0])
        assert torch.equal(free.points, done(plain).points)
