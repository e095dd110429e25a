"""The start by way of a circle: it lies in the domain, is what it is said to be, and is for discs alone."""

from dataclasses import replace

import meshes
import numpy as np
import torch
from exact import inverted

import torchmesh as tm
from torchmesh.bench import boundary
from torchmesh.learning.outlines import bent_band, laid_along, spiral_loop
from torchmesh.untangling.options import NewtonWays, UntangleOptions
from torchmesh.untangling.overlay import overlaid, through_cells
from torchmesh.untangling.overlay_of_rings import overlaid_rings


def laid(outline: np.ndarray, sectors: int = 40, layers: int = 5) -> tm.MeshBatch:
    """A disc whose boundary is laid onto an outline."""
    mesh = meshes.disc(sectors, layers)
    loop = boundary.loops(mesh.triangles)[0]
    points = mesh.points.clone()
    points[loop] = torch.from_numpy(laid_along(outline, len(loop)))
    return tm.relax(mesh.with_points(points))


def test_vertices_lie_in_the_domain_where_means_of_neighbours_do_not():
    import shapely

    mesh = laid(bent_band(4))
    free = ~mesh.fixed
    over = overlaid(mesh, free)
    assert over is not None
    assert torch.equal(over[mesh.fixed], mesh.points[mesh.fixed])
    domain = shapely.Polygon(mesh.points[boundary.loops(mesh.triangles)[0]].numpy())
    inside = [shapely.contains_xy(domain.buffer(1e-9), *points[free].numpy().T) for points in (over, mesh.points)]
    assert inside[0].all()
    assert not inside[1].all()


def test_on_a_regular_polygon_it_is_the_tutte_embedding():
    """Whatever triangulates the polygon: the map from the circle is affine there."""
    mesh = laid(np.stack([3 * np.cos(a := 2 * np.pi * np.arange(40) / 40) + 7, 3 * np.sin(a) - 2], 1))
    over = overlaid(mesh, ~mesh.fixed)
    assert over is not None
    torch.testing.assert_close(over, mesh.points, atol=1e-12, rtol=0)
    assert inverted(mesh.with_points(over)) == 0


def test_a_cell_goes_affinely_and_what_is_just_outside_goes_with_the_nearest():
    circle = torch.tensor([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]], dtype=torch.float64)
    domain = torch.tensor([[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [1.0, 1.0]], dtype=torch.float64)
    cells = torch.tensor([[0, 1, 2], [0, 2, 3]])
    at = torch.cat([circle, circle[cells].mean(1), torch.tensor([[0.5, 0.5 + 1e-15]], dtype=torch.float64)])
    there = torch.cat([domain, domain[cells].mean(1), domain[:2].mean(0, keepdim=True)])
    torch.testing.assert_close(through_cells(at, circle[cells], domain[cells]), there, atol=1e-12, rtol=0)


def test_it_is_for_discs_with_a_simple_boundary_and_nothing_fixed_inside():
    ring = meshes.ring()
    assert overlaid(ring, ~ring.fixed) is None
    disc = meshes.disc(12, 3)
    held = disc.fixed.clone()
    held[int((~disc.fixed).nonzero()[0])] = True
    assert overlaid(replace(disc, fixed=held), ~held) is None
    assert overlaid(disc, torch.ones_like(disc.fixed)) is None
    loop = boundary.loops(disc.triangles)[0]
    crossed = disc.points.clone()
    crossed[loop[:2]] = crossed[loop[:2].flip(0)] if isinstance(loop, torch.Tensor) else crossed[loop[1::-1].copy()]
    assert overlaid(disc.with_points(crossed), ~disc.fixed) is None
    two = tm.MeshBatch.from_arrays(
        torch.cat([disc.points, disc.points + 5]), torch.cat([disc.triangles, disc.triangles + len(disc.points)])
    )
    assert overlaid(two, ~two.fixed) is None


def test_a_long_spiral_is_untangled_from_it_by_pushing_areas_alone(monkeypatch):
    """From means of neighbours the same leaves a part inverted."""
    mesh = laid(spiral_loop(2.4, 0.5), 60, 8)
    assert inverted(mesh) > 50
    ways = NewtonWays(weightings=(), max_continuations=1, steps_per_epsilon=1, alphas=(1e-1,), steps_per_alpha=1)
    moved, info = tm.untangle(mesh, UntangleOptions(method="newton", newton=ways))
    assert inverted(moved) == 0
    assert info.status.tolist() == [tm.Status.VALID]
    assert torch.equal(moved.points[mesh.fixed], mesh.points[mesh.fixed])
    monkeypatch.setattr("torchmesh.untangling.persisting.overlaid", lambda mesh, free: None)
    moved, info = tm.untangle(mesh, UntangleOptions(method="newton", newton=ways))
    assert inverted(moved) > 50
    assert info.status.tolist() == [tm.Status.STALLED]


def ring_turned(radians: float, sectors: int, layers: int, inner: float) -> tm.MeshBatch:
    """A ring whose inner circle has turned."""
    mesh = meshes.ring(sectors, layers, inner, 1.0)
    turn = torch.tensor(radians, dtype=torch.float64)
    turned = mesh.points @ torch.stack([turn.cos(), turn.sin(), -turn.sin(), turn.cos()]).view(2, 2)
    return tm.relax(
        mesh.with_points(torch.where((torch.arange(len(mesh.points)) < sectors)[:, None], turned, mesh.points))
    )


def test_a_ring_that_has_not_turned_is_valid_by_way_of_a_cylinder_and_other_ways_round_are_not():
    mesh = ring_turned(0.0, 24, 4, 0.5)
    over = overlaid_rings(mesh, ~mesh.fixed)
    assert [inverted(mesh.with_points(points)) == 0 for points in over] == [True, False]
    for points in over:
        assert torch.equal(points[mesh.fixed], mesh.points[mesh.fixed])
        radius = points.norm(dim=1)
        assert float(radius.min()) > 0.5 * np.cos(np.pi / 24) - 1e-9
        assert float(radius.max()) < 1 + 1e-9


def test_a_ring_that_turned_half_way_round_goes_both_ways():
    """One way is the mirror image of the other: the mesh has no sense of rotation but for its diagonals."""
    mesh = ring_turned(np.pi, 24, 4, 0.5)
    over = overlaid_rings(mesh, ~mesh.fixed)
    assert len(over) == 2
    # Halfway between the circles the ways differ by a turn of about 180 degrees.
    middle = torch.arange(48, 72)
    (ax, ay), (bx, by) = (points[middle].unbind(1) for points in over)
    apart = torch.atan2(ax * by - ay * bx, ax * bx + ay * by).abs()
    assert float(apart.min()) > 2.5


def test_no_cylinder_for_what_is_no_ring_or_too_bent_for_its_cells():
    disc = meshes.disc(12, 3)
    assert overlaid_rings(disc, ~disc.fixed) == []
    ring = meshes.ring()
    held = ring.fixed.clone()
    held[int((~ring.fixed).nonzero()[0])] = True
    assert overlaid_rings(replace(ring, fixed=held), ~held) == []
    # A hole far from the middle of a long domain: cells at its ends touch the outer boundary alone.
    points = ring.points.clone()
    outer = points.norm(dim=1) > 1.29
    points[outer] *= torch.tensor([6.0, 1.0], dtype=points.dtype)
    assert overlaid_rings(ring.with_points(points), ~ring.fixed) == []
