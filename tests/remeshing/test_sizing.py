"""Size fields: what theory says they are, and what nonsense is refused."""

import math

import meshes
import numpy as np
import pytest
import torch
from both_loops import both, need_compiled_loops

import torchmesh as tm
from torchmesh import MeshBatch
from torchmesh.mesh import connectivity
from torchmesh.mesh.ragged import spread
from torchmesh.remeshing.sizing import (
    InwardOptions,
    carried,
    continue_inwards,
    edge_lengths,
    size_conformity,
    size_field,
)


@pytest.mark.parametrize("sizes", ["boundary", "keep", "uniform"])
def test_an_equilateral_mesh_has_its_side_everywhere(sizes):
    mesh = meshes.equilateral(8, 7, side=0.3)
    field = size_field(mesh, sizes)
    assert field.dtype == torch.float64
    assert torch.allclose(field, torch.full_like(field, 0.3), rtol=1e-6)
    conformity = size_conformity(mesh, sizes)
    for value in (conformity.mean, conformity.low, conformity.high):
        assert float(value) == pytest.approx(1.0, rel=1e-6)


def test_between_two_circles_sizes_grow_with_the_radius():
    # log h is harmonic: between h = c r on two circles round one centre it is log(c r).
    mesh = MeshBatch.from_arrays(*meshes.ring_arrays(64, 24, 0.5, 4.0))
    chord = 2 * math.sin(math.pi / 64)
    # The coarsest that is allowed is far off this mesh's number of triangles: ask for the flat metric's own.
    radius = torch.hypot(*mesh.points.unbind(1))
    flat = 2 * math.pi * math.log(8) / chord**2 / (math.sqrt(3) / 4)
    field = size_field(mesh, "boundary", triangles=torch.tensor([flat]))
    assert torch.allclose(field, chord * radius, rtol=0.02)


def test_the_number_of_triangles_is_kept_as_far_as_it_may_be():
    mesh = MeshBatch.from_arrays(*meshes.ring_arrays(64, 24, 0.5, 4.0))
    counts = torch.tensor([2000.0, 2600.0, 3000.0])
    areas = tm.quality(mesh).area
    for count in counts:
        field = size_field(mesh, "boundary", triangles=count[None])
        corner_mean = (1 / field.square())[mesh.triangles].mean(1)
        assert float((areas * corner_mean).sum() / (math.sqrt(3) / 4)) == pytest.approx(float(count), rel=0.03)
    finest = size_field(mesh, "boundary", triangles=torch.tensor([1e9]))
    even_finer = size_field(mesh, "boundary", triangles=torch.tensor([1e12]))
    assert torch.equal(finest, even_finer)


@pytest.mark.parametrize("accuracy", [1e-2, 1e-8])
def test_conjugate_gradients_come_as_near_to_the_exact_sizes_as_they_are_asked_to(accuracy):
    parts = [meshes.jittered(9, 8, 0.2, 3), meshes.ring(), meshes.delaunay(40), meshes.equilateral()]
    batch = tm.join(parts)
    exact, near = size_field(batch), size_field(batch, accuracy=accuracy)
    error = (near / exact - 1).abs().max()
    assert 0 < float(error) < 3 * accuracy
    known = continue_inwards(batch).known
    assert torch.equal(near[known], exact[known])
    alone = torch.cat([size_field(part, accuracy=accuracy) for part in parts])
    assert torch.equal(alone, near)


def test_boundary_sizes_are_the_mean_of_the_two_edges_there():
    mesh = meshes.l_shape(3)
    field = size_field(mesh)
    twin = connectivity.twins(mesh.triangles)
    edges = torch.cat([connectivity.boundary_edges(mesh.triangles, twin), mesh.constrained_edges])
    for v in edges.unique().tolist():
        there = (edges == v).any(1)
        assert float(field[v]) == pytest.approx(float(edge_lengths(mesh, edges[there]).mean()), rel=1e-12)


def test_keep_is_the_mean_length_of_the_edges_at_a_vertex():
    mesh = meshes.jittered(6, 5, 0.1, 3)
    edges = connectivity.edges(mesh.triangles, connectivity.twins(mesh.triangles))
    length = edge_lengths(mesh, edges)
    field = size_field(mesh, "keep")
    for v in range(0, len(mesh.points), 5):
        assert float(field[v]) == pytest.approx(float(length[(edges == v).any(1)].mean()), rel=1e-12)


@pytest.mark.parametrize("sizes", ["boundary", "keep", "uniform"])
@pytest.mark.parametrize("unit", [2.0**60, 2.0**-60, 3e140, 1e-140])
def test_sizes_scale_with_the_unit(sizes, unit):
    mesh = meshes.jittered(6, 5, 0.1, 3)
    scaled = mesh.with_points(mesh.points * unit)
    assert torch.allclose(size_field(scaled, sizes) / unit, size_field(mesh, sizes), rtol=1e-9, atol=0)
    for name in ("mean", "low", "high"):
        ours, theirs = (float(getattr(size_conformity(m, sizes), name)) for m in (scaled, mesh))
        assert ours == pytest.approx(theirs, rel=1e-9)


@pytest.mark.parametrize("sizes", ["boundary", "keep", "uniform"])
def test_a_mesh_alone_and_the_same_in_a_batch(sizes):
    parts = [meshes.jittered(6, 5, 0.1, 3), meshes.ring(), meshes.l_shape(), meshes.disc(), meshes.delaunay()]
    batch = tm.join(parts)
    field, conformity = size_field(batch, sizes), size_conformity(batch, sizes)
    for b, part in enumerate(parts):
        rows = slice(int(batch.point_offsets[b]), int(batch.point_offsets[b + 1]))
        assert torch.equal(size_field(part, sizes), field[rows])
        own = size_conformity(part, sizes)
        for name in ("mean", "low", "high"):
            assert float(getattr(own, name)) == float(getattr(conformity, name)[b])


def test_conformity_is_the_mean_and_the_percentiles_of_numpy():
    batch = tm.join([meshes.jittered(6, 5, 0.2, 3), meshes.ring(), meshes.delaunay(9, 1)])
    size = 0.1 + batch.points[:, 0].square()
    conformity = size_conformity(batch, size)
    for b, mesh in enumerate(batch.split()):
        own = size[batch.point_offsets[b] : batch.point_offsets[b + 1]].numpy()
        edges = np.unique(np.sort(mesh.triangles.numpy()[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), 1), axis=0)
        ends = mesh.points.numpy()[edges]
        ratio = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) / own[edges].mean(1)
        assert float(conformity.mean[b]) == pytest.approx(ratio.mean(), rel=1e-12)
        assert float(conformity.low[b]) == pytest.approx(np.percentile(ratio, 5), rel=1e-12)
        assert float(conformity.high[b]) == pytest.approx(np.percentile(ratio, 95), rel=1e-12)


def test_linear_fields_are_carried_exactly_and_stay_between_their_neighbours():
    mesh = meshes.jittered(8, 8, 0.1, 2)
    field = 1 + mesh.points @ torch.tensor([0.3, -0.2], dtype=torch.float64)
    shift = torch.where(mesh.fixed[:, None], 0.0, torch.full_like(mesh.points, 1e-3))
    there = mesh.points + shift
    exact = 1 + there @ torch.tensor([0.3, -0.2], dtype=torch.float64)
    assert torch.allclose(carried(mesh, field, there), exact, rtol=1e-12)
    far = carried(mesh, field, mesh.points + 100)
    assert bool((far <= field.max()).all())
    assert bool((far >= field.min()).all())
    assert torch.equal(carried(mesh, field, mesh.points), field)


def test_a_function_and_a_tensor_of_its_values_are_the_same():
    batch = tm.join([meshes.grid(3, 3), meshes.ring()])
    wanted = lambda p: 0.1 + p.square().sum(1)  # noqa: E731
    assert torch.equal(size_field(batch, wanted), size_field(batch, wanted(batch.points)))


def test_tangled_meshes_have_finite_sizes_too():
    mesh = meshes.jittered(8, 7, 1.0, 0)
    for sizes in ("boundary", "keep", "uniform"):
        field = size_field(mesh, sizes)
        assert bool((field.isfinite() & (field > 0)).all()), sizes


def test_wrong_sizes_are_named():
    batch = tm.join([meshes.grid(3, 3), meshes.grid(2, 2)])
    good = torch.ones(len(batch.points))
    with pytest.raises(ValueError, match=r"sizes must be one of \['boundary', 'keep', 'uniform'\].*'coarse'"):
        size_field(batch, "coarse")
    with pytest.raises(tm.InvalidMeshError, match=r"shape \(25,\), one length a vertex, not \(24,\)"):
        size_field(batch, good[1:])
    for wrong in (0.0, -1.0, math.nan, math.inf):
        sizes = good.clone()
        sizes[20] = wrong
        with pytest.raises(
            tm.InvalidMeshError, match=r"mesh 1: sizes row 20 is .*must be positive and finite \(1 rows"
        ):
            size_field(batch, sizes)
    with pytest.raises(tm.InvalidMeshError, match="shape"):
        size_field(batch, lambda p: p)


def test_uniform_is_uniform_in_each_mesh():
    batch = tm.join([meshes.grid(3, 3), meshes.ring()])
    field = size_field(batch, "uniform")
    per_mesh = field[batch.point_offsets[:-1]]
    assert torch.equal(field, spread(per_mesh, batch.point_offsets))


@pytest.mark.parametrize(
    ("name", "value"),
    [("accuracy", 1.0), ("least_weight", 0.0), ("least_weight", 30.0), ("finer", -0.1), ("coarser", -1)],
)
def test_options_of_the_continuation_that_cannot_work_are_refused(name, value):
    with pytest.raises(ValueError, match=f"InwardOptions.{name} must"):
        InwardOptions(**{name: value})


def test_compiled_conjugate_gradients_come_to_the_sizes_of_torch():
    need_compiled_loops()
    batch = tm.join([meshes.delaunay(200, seed=1), meshes.ring(), meshes.l_shape(5)])
    by_torch, compiled = both(lambda: size_field(batch, accuracy=1e-3))
    assert torch.allclose(by_torch, compiled, rtol=1e-10, atol=0)
    assert not torch.equal(compiled, size_field(batch))
