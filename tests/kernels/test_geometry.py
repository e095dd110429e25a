"""Quality, angles, twins, signs and crossings, compiled, against their twins in torch and numpy: the same bits."""

import numpy as np
import pytest
import torch
from both_loops import both
from meshes import delaunay, grid, jittered, ring, scrambled

from torchmesh import join
from torchmesh.kernels import geometry, library
from torchmesh.layering.layers import low_half_edges
from torchmesh.mesh import connectivity, measure
from torchmesh.mesh.detached import without_autograd
from torchmesh.mesh.ragged import spread
from torchmesh.mesh.units import centre_and_unit
from torchmesh.triangulating import arrays, crossings
from torchmesh.warping.boundary_path import first_flat


def batches(generator):
    lattice = grid(9, 8)
    at = torch.randint(0, 4, lattice.points.shape, generator=generator).to(lattice.points)
    odd = jittered(cells=2.0, seed=5)
    points = odd.points.clone()
    points[10], points[11], points[12] = torch.nan, torch.inf, 1e200
    return [join([ring(), delaunay(70, seed=1)]), scrambled(delaunay(60, seed=2), seed=3), lattice.with_points(at),
            jittered(cells=4.0).with_points(1e150 * jittered(cells=4.0).points), odd.with_points(points)]  # fmt: skip


def test_quality_has_the_same_bits_and_angles_nearly(generator):
    for mesh in batches(generator):
        for (expected, ratio), (got, ratio_2) in [both(lambda m=mesh: measure.shapes(m))]:
            torch.testing.assert_close(got, expected, rtol=1e-15, atol=1e-300, equal_nan=True)
            torch.testing.assert_close(ratio_2, ratio, rtol=0, atol=0, equal_nan=True)
        for run in (lambda m=mesh: (measure.upright(m),),
                    lambda m=mesh: vars(measure.quality(m)).values()):  # fmt: skip
            for expected, got in zip(*both(run), strict=True):
                torch.testing.assert_close(got, expected, rtol=0, atol=0, equal_nan=True)


def test_triangles_are_first_flat_at_the_same_time(generator):
    for mesh in batches(generator):
        noise = torch.randn(mesh.points.shape, generator=generator, dtype=torch.float64)
        _, unit = centre_and_unit(mesh.points, mesh.point_offsets)
        goals = [mesh.points + 0.1 * spread(unit, mesh.point_offsets)[:, None] * noise, -mesh.points, 0 * mesh.points]
        for goal in goals:
            expected, got = both(lambda m=mesh, g=goal: first_flat(m, g))
            torch.testing.assert_close(got, expected, rtol=4e-16, atol=0, equal_nan=True)


def test_twins_are_the_same(generator):
    for mesh in batches(generator):
        order = torch.randperm(len(mesh.triangles), generator=generator)
        for triangles in (mesh.triangles, mesh.triangles[order].roll(1, 1), mesh.triangles[:7]):
            expected, got = both(lambda t=triangles: connectivity.twins(t))
            assert torch.equal(expected, got)
    assert len(connectivity.twins(torch.zeros((0, 3), dtype=torch.int64))) == 0


def test_components_are_the_same(generator):
    for mesh in batches(generator):
        order = torch.randperm(len(mesh.triangles), generator=generator)
        for triangles in (mesh.triangles, mesh.triangles[order], mesh.triangles[order[::3]], mesh.triangles[:0]):
            twin = connectivity.twins(triangles)
            walls = torch.rand(len(twin), generator=generator) < 0.6
            for blocked in (None, walls, walls | walls[twin]):
                expected, got = both(lambda t=triangles, w=twin, b=blocked: connectivity.triangle_components(t, w, b))
                assert torch.equal(expected, got)


def test_boundary_loops_are_the_same(generator, monkeypatch):
    """Also where loops meet in vertices, where they are taken apart at them, and where a walk does not close."""
    monkeypatch.setattr(connectivity, "_FEW_EDGES", 0)
    walks = [torch.randint(9, (30,), generator=generator) for _ in range(20)]
    edges = [torch.stack([walk, walk.roll(-1)], 1) for walk in walks]
    edges += [connectivity.boundary_edges(mesh.triangles, mesh.twin) for mesh in batches(generator)]
    edges += [torch.tensor([[0, 1], [1, 2], [2, 3], [7, 8], [8, 7]]), torch.zeros((0, 2), dtype=torch.int64)]
    for pairs in edges:
        for order in (torch.arange(len(pairs)), torch.randperm(len(pairs), generator=generator)):
            expected = connectivity.boundary_loops(pairs[order])
            got = without_autograd(connectivity.boundary_loops)(pairs[order])
            assert [loop.tolist() for loop in got] == [loop.tolist() for loop in expected]
    assert len(geometry.boundary_loops(edges[0])) > 1
    assert geometry.boundary_loops(edges[-2]) is None


def test_half_edges_on_edges_are_the_same(generator):
    for mesh in batches(generator):
        inside = connectivity.edges(mesh.triangles, mesh.twin)
        some = inside[torch.rand(len(inside), generator=generator) < 0.3]
        other = torch.randint(0, len(mesh.points), (20, 2), generator=generator)  # few of them are edges
        for edges in (some, some.flip(1), torch.cat([some, some.flip(1), other]), other, inside[:0]):
            expected, got = (f(mesh.triangles, edges, len(mesh.points)) for f in
                             (connectivity.half_edges_on, without_autograd(connectivity.half_edges_on)))  # fmt: skip
            assert torch.equal(expected, got)
            assert int(got.sum()) >= (len(edges) if edges is some else 0)


def test_low_triangles_are_the_same(generator):
    for mesh in batches(generator):
        among = torch.rand(3 * len(mesh.triangles), generator=generator) < 0.6
        for walls in (mesh.twin < 0, among, torch.zeros_like(among)):
            for share in (0.3, 0.5, 1.0):
                expected = low_half_edges(mesh, walls, share)
                got = without_autograd(low_half_edges)(mesh, walls, share)
                assert torch.equal(expected, got)
                assert not len(got) or bool(walls[got].all())


def test_signs_of_rows_are_the_same(rng):
    points = np.concatenate(
        [rng.uniform(-1, 1, (60, 2)), rng.integers(0, 3, (60, 2)) / 2, rng.uniform(0, 1e-160, (9, 2))]
    )
    rows = rng.integers(0, len(points), (3, 5000))
    expected, got = both(lambda: arrays.signs(points, *rows))
    assert np.array_equal(expected, got)
    assert len(np.unique(got)) == 3


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_segments_that_meet_are_the_same(rng, share):
    for lattice in (False, True):
        points = rng.integers(0, 9, (150, 2)).astype(float) if lattice else rng.uniform(0, 1, (150, 2))
        start = rng.integers(0, len(points), 200)
        near = np.argsort(np.linalg.norm(points[start][:, None] - points, axis=2), axis=1)
        ends = near[np.arange(len(start)), rng.integers(1, max(2, int(share * 150)), len(start))]
        segments = np.stack([start, ends], 1)
        for group in (None, rng.integers(0, 3, len(segments))):
            expected, got = both(lambda s=segments, p=points, g=group: crossings.crossing_pairs(p, s, g))
            assert np.array_equal(expected, got)
            assert len(got) > 10


def test_a_sweep_over_too_many_pairs_is_left_to_the_tree(rng, monkeypatch):
    points = rng.uniform(0, 1, (40, 2))
    segments = rng.permutation(40).reshape(-1, 2)
    with library.using("torch"):
        expected = crossings.crossing_pairs(points, segments)
    monkeypatch.setattr(crossings, "_SWEPT", 3)
    with library.using("compiled"):
        assert np.array_equal(crossings.crossing_pairs(points, segments), expected)
