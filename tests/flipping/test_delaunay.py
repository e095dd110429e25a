"""`flip_to_delaunay` over batches: the Delaunay mesh comes out, whatever the batch, the unit and the options."""

from functools import cache

import meshes
import numpy as np
import pytest
import sequential
import torch
from exact import incircle, triangle_set
from flips import ALL, RULES, SEEDS, SIZES, assert_same_domain, interior_edges, random_mesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from torchmesh import FlipOptions, MeshBatch, flip_to_delaunay, join
from torchmesh.mesh import connectivity


@pytest.mark.parametrize("rule", list(RULES))
@pytest.mark.parametrize("name", list(ALL))
def test_flips_keep_points_boundary_area_euler_number_and_constrained_edges(name, rule):
    before = ALL[name]()
    copy = before.triangles.clone()
    after, info = flip_to_delaunay(before, RULES[rule])
    assert_same_domain(before, after, info)
    assert torch.equal(before.triangles, copy)
    assert (int(info.flips) > 0) == (triangle_set(after.triangles) != triangle_set(copy))


@given(SIZES, SEEDS, st.sampled_from(list(RULES)))
def test_flips_of_random_tangles_keep_what_they_must(size, seed, rule):
    before = random_mesh(size, seed)
    assert_same_domain(before, *flip_to_delaunay(before, RULES[rule]))


def test_safe_flips_end_delaunay_where_the_mesh_is_valid():
    mesh, _ = flip_to_delaunay(meshes.scrambled(meshes.l_shape(), 3))
    locked = {frozenset(e) for e in mesh.constrained_edges.tolist()}
    points = mesh.points.tolist()
    opposite = {}
    for a, b, c in mesh.triangles.tolist():
        opposite |= {(a, b): c, (b, c): a, (c, a): b}
    for (u, w), s in opposite.items():
        if (w, u) in opposite and frozenset((u, w)) not in locked:
            assert incircle(*(points[v] for v in (u, w, s, opposite[w, u]))) <= 0


@cache
def scrambled_hull(vertices, seed):
    """A valid mesh of a convex hull, and the triangles that the sequential loop makes of it."""
    start = meshes.scrambled(meshes.delaunay(vertices, seed), seed)
    return start, sequential.flip_to_delaunay(start.points.tolist(), start.triangles.tolist())[0]


@pytest.mark.parametrize("seed", range(4))
def test_any_valid_mesh_of_a_convex_hull_becomes_the_delaunay_mesh(seed):
    start, plain = scrambled_hull(40, seed)
    assert triangle_set(start.triangles) != triangle_set(plain)
    by_scipy = Delaunay(start.points.numpy()).simplices
    for options in (FlipOptions(), FlipOptions(rule="kim")):
        flipped, info = flip_to_delaunay(start, options)
        assert triangle_set(flipped.triangles) == triangle_set(plain)
        assert {frozenset(t) for t in flipped.triangles.tolist()} == {frozenset(t) for t in by_scipy.tolist()}
        assert int(info.flips) > 10


@pytest.mark.parametrize("seed", range(3))
def test_constrained_delaunay_is_that_of_the_sequential_loop(seed):
    mesh, free = scrambled_hull(30, seed)
    inner = sorted(tuple(sorted(edge)) for edge in interior_edges(mesh))
    kept = np.array(inner)[:: len(inner) // 6]
    mesh = MeshBatch.from_arrays(mesh.points, mesh.triangles, constrained_edges=kept)
    plain, _ = sequential.flip_to_delaunay(mesh.points.tolist(), mesh.triangles.tolist(), kept.tolist())
    assert triangle_set(plain) != triangle_set(free)
    assert triangle_set(flip_to_delaunay(mesh)[0].triangles) == triangle_set(plain)


@pytest.mark.parametrize("rule", list(RULES))
def test_joined_equals_alone(rule):
    parts = [make() for make in ALL.values()]
    batch, info = flip_to_delaunay(join(parts), RULES[rule])
    for mesh, together, flips in zip(parts, batch.split(), info.flips.tolist(), strict=True):
        alone, its = flip_to_delaunay(mesh, RULES[rule])
        assert torch.equal(alone.triangles, together.triangles)
        assert its.flips.tolist() == [flips]


@pytest.mark.parametrize("exponent", [-200, -3, 40, 200])
@pytest.mark.parametrize("rule", list(RULES))
def test_flips_do_not_depend_on_the_unit_of_length(rule, exponent):
    mesh = meshes.jittered(cells=0.8)
    scaled = mesh.with_points(mesh.points * 2.0**exponent)
    flipped, info = flip_to_delaunay(mesh, RULES[rule])
    assert int(info.flips) > 0
    assert torch.equal(flip_to_delaunay(scaled, RULES[rule])[0].triangles, flipped.triangles)


def test_around_everything_is_the_same_as_no_around():
    mesh = meshes.jittered()
    everything = torch.ones(len(mesh.triangles), dtype=torch.bool)
    flipped, info = flip_to_delaunay(mesh)
    assert int(info.flips) > 0
    assert torch.equal(flip_to_delaunay(mesh, around=everything)[0].triangles, flipped.triangles)


def test_around_starts_from_the_triangles_given():
    pair, triangles = [[0, 0], [1, 0], [2, 0.2], [1, 0.3]], [[0, 1, 2], [0, 2, 3]]
    one = MeshBatch.from_arrays(pair, triangles)
    far = one.with_points(one.points + 10)
    both = join([one, far])
    assert flip_to_delaunay(both)[1].flips.tolist() == [1, 1]
    assert flip_to_delaunay(both, around=torch.tensor([False, False, True, False]))[1].flips.tolist() == [0, 1]
    assert flip_to_delaunay(both, around=torch.zeros(4, dtype=torch.bool))[1].flips.tolist() == [0, 0]


def test_twins_are_handed_on_by_flips_and_those_given_are_not_changed():
    mesh = meshes.jittered()
    copy = mesh.twin.clone()
    flipped, info = flip_to_delaunay(mesh)
    assert int(info.flips) > 0
    assert torch.equal(mesh.twin, copy)
    assert torch.equal(flipped.known_twin, connectivity.twins(flipped.triangles))


@pytest.mark.parametrize(
    ("match", "arguments"),
    [
        ("FlipOptions.rule must be one of .*'greedy'", {"rule": "greedy"}),
        ("FlipOptions.max_rounds must be at least 1, not 0", {"max_rounds": 0}),
    ],
)
def test_bad_options_are_named(match, arguments):
    with pytest.raises(ValueError, match=match):
        FlipOptions(**arguments)
