"""Edge flips: `flipping` on bare tensors and `delaunay` over batches."""

import dataclasses

import meshes
import numpy as np
import pytest
import sequential
import torch
from exact import (
    boundary,
    directed_edges,
    double_areas,
    edge_counts,
    incircle,
    inverted,
    inverted_area,
    total_area,
    triangle_set,
)
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from torchmesh import FlipOptions, MeshBatch, flip_to_delaunay, join, quality
from torchmesh.flipping import rounds as flipping
from torchmesh.flipping import rules
from torchmesh.mesh import connectivity
from torchmesh.mesh.batch import constrained_half_edges

RULES = {
    "safe": FlipOptions(),
    "shape": FlipOptions(rule="shape"),
    "kim": FlipOptions(rule="kim"),
    "paper": FlipOptions.paper(),
}
ALL = {
    **{f"scrambled {n}": (lambda n=n: meshes.scrambled(meshes.VALID[n](), 1)) for n in meshes.VALID},
    **meshes.TANGLED,
}

# Tangled a little up to beyond recognition.
SIZES, SEEDS = st.sampled_from([0.1, 0.3, 0.6, 1.0, 2.0]), st.integers(0, 10_000)


def random_mesh(size: float, seed: int) -> MeshBatch:
    makers = [
        lambda: meshes.jittered(5, 5, size, seed),
        lambda: meshes.disturbed(meshes.disc(9, 3), 0.25 * size, seed),
        lambda: meshes.disturbed(meshes.delaunay(30, seed), 0.3 * size, seed),
        lambda: meshes.disturbed(meshes.l_shape(3), 0.3 * size, seed),
    ]
    return makers[seed % 4]()


def interior_edges(mesh) -> set[frozenset]:
    return {edge for edge, count in edge_counts(mesh.triangles).items() if count == 2}


def assert_same_domain(before, after, info):
    """What no flip may change, whatever the rule."""
    assert torch.equal(after.points, before.points)
    assert torch.equal(after.fixed, before.fixed)
    assert after.triangles.shape == before.triangles.shape
    assert boundary(after.triangles) == boundary(before.triangles)
    assert max(directed_edges(after.triangles).values()) == 1
    assert max(edge_counts(after.triangles).values()) <= 2
    assert total_area(after) == total_area(before)
    assert torch.equal(after.twin, connectivity.twins(after.triangles))
    assert connectivity.euler_number(after.triangles, after.twin) == connectivity.euler_number(
        before.triangles, connectivity.twins(before.triangles)
    )
    assert {frozenset(e) for e in before.constrained_edges.tolist()} <= set(edge_counts(after.triangles))


# --- every rule, every mesh ---


@pytest.mark.parametrize("rule", list(RULES))
@pytest.mark.parametrize("name", list(ALL))
def test_flips_keep_points_boundary_area_euler_number_and_constrained_edges(name, rule):
    before = ALL[name]()
    copy = before.triangles.clone()
    after, info = flip_to_delaunay(before, RULES[rule])
    assert_same_domain(before, after, info)
    assert torch.equal(before.triangles, copy)
    assert (int(info.flips) > 0) == (triangle_set(after.triangles) != triangle_set(copy))


@pytest.mark.parametrize("rule", ["safe", "shape", "kim"])
@given(SIZES, SEEDS)
def test_flipping_ends_and_has_then_nothing_left_to_flip(rule, size, seed):
    before = random_mesh(size, seed)
    after, _ = flip_to_delaunay(before, dataclasses.replace(RULES[rule], max_rounds=500))
    again, info = flip_to_delaunay(after, RULES[rule])
    assert info.flips.tolist() == [0]
    assert torch.equal(again.triangles, after.triangles)


@given(SIZES, SEEDS, st.sampled_from(list(RULES)))
def test_flips_of_random_tangles_keep_what_they_must(size, seed, rule):
    before = random_mesh(size, seed)
    assert_same_domain(before, *flip_to_delaunay(before, RULES[rule]))


@given(SIZES, SEEDS, st.sampled_from(list(RULES)))
def test_never_more_inverted_triangles_than_before(size, seed, rule):
    before = random_mesh(size, seed)
    after, _ = flip_to_delaunay(before, RULES[rule])
    assert inverted(after) <= inverted(before)


# --- the safe rule ---


@given(SIZES, SEEDS)
def test_safe_flips_never_add_inverted_area(size, seed):
    before = random_mesh(size, seed)
    after, info = flip_to_delaunay(before)
    # The rule compares areas of size one in floating point.
    assert inverted_area(after) <= inverted_area(before) + 1e-13 * int(info.flips)


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


@pytest.mark.parametrize("seed", range(4))
def test_any_valid_mesh_of_a_convex_hull_becomes_the_delaunay_mesh(seed):
    delaunay = meshes.delaunay(40, seed)
    start = meshes.scrambled(delaunay, seed)
    assert triangle_set(start.triangles) != triangle_set(delaunay.triangles)
    plain, _ = sequential.flip_to_delaunay(start.points.tolist(), start.triangles.tolist())
    by_scipy = Delaunay(start.points.numpy()).simplices
    for options in (FlipOptions(), FlipOptions(rule="kim")):
        flipped, info = flip_to_delaunay(start, options)
        assert triangle_set(flipped.triangles) == triangle_set(plain)
        assert {frozenset(t) for t in flipped.triangles.tolist()} == {frozenset(t) for t in by_scipy.tolist()}
        assert int(info.flips) > 10


@pytest.mark.parametrize("seed", range(3))
def test_constrained_delaunay_is_that_of_the_sequential_loop(seed):
    mesh = meshes.scrambled(meshes.delaunay(30, seed), seed)
    inner = sorted(tuple(sorted(edge)) for edge in interior_edges(mesh))
    kept = np.array(inner)[:: len(inner) // 6]
    mesh = MeshBatch.from_arrays(mesh.points, mesh.triangles, constrained_edges=kept)
    plain, _ = sequential.flip_to_delaunay(mesh.points.tolist(), mesh.triangles.tolist(), kept.tolist())
    free, _ = sequential.flip_to_delaunay(mesh.points.tolist(), mesh.triangles.tolist())
    assert triangle_set(plain) != triangle_set(free)
    assert triangle_set(flip_to_delaunay(mesh)[0].triangles) == triangle_set(plain)


def test_four_points_of_one_circle_are_left_alone():
    for diagonal in ([[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]):
        mesh = MeshBatch.from_arrays([[0, 0], [3, 0], [3, 2], [0, 2]], diagonal)
        for rule in RULES:
            flipped, info = flip_to_delaunay(mesh, RULES[rule])
            assert int(info.flips) == 0, rule
            assert flipped.triangles.tolist() == diagonal


def test_a_flat_triangle_goes():
    # The vertex 2 lies on the edge from 0 to 1: flipped to the edge 2-3.
    mesh = MeshBatch.from_arrays([[0, 0], [2, 0], [1, 0], [1, -1]], [[0, 1, 2], [1, 0, 3]])
    flipped, info = flip_to_delaunay(mesh)
    assert int(info.flips) == 1
    assert triangle_set(flipped.triangles) == {(0, 3, 2), (1, 2, 3)}


def test_an_inverted_pair_that_a_flip_mends_is_mended():
    # Vertex 2 has been pulled through the edge 0-1: the triangle 0 1 2 is inverted.
    mesh = MeshBatch.from_arrays([[0, 0], [2, 0], [1, -0.5], [1, -2]], [[0, 1, 2], [1, 0, 3]])
    assert inverted(mesh) == 1
    flipped, _ = flip_to_delaunay(mesh)
    assert inverted(flipped) == 0


def test_kim_flips_only_where_the_sum_of_the_opposite_angles_exceeds_pi():
    # The fourth corner moves across the circle through (0, 0), (2, 0), (1, 1): centre (1, 0), radius 1.
    for depth, flips in [(0.5, 1), (0.999, 1), (1.0, 0), (1.001, 0), (3.0, 0)]:
        mesh = MeshBatch.from_arrays([[0, 0], [2, 0], [1, 1], [1, -depth]], [[0, 1, 2], [1, 0, 3]])
        assert int(flip_to_delaunay(mesh, FlipOptions.paper())[1].flips) == flips, depth


def test_a_flip_that_would_invert_is_not_made():
    # The quadrilateral is not convex at the vertex 0, although the angles at 2 and 3 are large; or at the vertex 1.
    for points in ([[0, 0], [4, 0], [-1, 0.4], [-1, -1]], [[0, 0], [4, 0], [5, 0.4], [5, -1]]):
        mesh = MeshBatch.from_arrays(points, [[0, 1, 2], [1, 0, 3]])
        for rule in RULES:
            assert int(flip_to_delaunay(mesh, RULES[rule])[1].flips) == 0, rule


def test_kim_makes_two_upright_triangles_or_none():
    # One triangle is inverted, the angles sum to more than pi, and a flip would again leave one inverted: the first
    # of the two new ones, or the second.
    u, w, s, r = [1, 1.2], [0.1, -1.2], [1.6, 0.5], [0.8, -0.6]
    for points in ([u, w, s, r], [w, u, r, s]):
        mesh = MeshBatch.from_arrays(points, [[0, 1, 2], [1, 0, 3]])
        assert inverted(mesh) == 1
        assert int(flip_to_delaunay(mesh, FlipOptions.paper())[1].flips) == 0


def test_safe_flips_buy_no_area_with_another_inverted_triangle():
    # Double areas 14 and -19 would become -1 and -4.
    points = torch.tensor([[2.0, 3.0], [-3.0, -3.0], [1.0, -1.0], [1.0, -2.0]], dtype=torch.float64)
    upright = MeshBatch.from_arrays([[0, 0], [1, 0], [0.5, 1], [0.5, -1]], [[0, 1, 2], [1, 0, 3]])
    mesh = upright.with_points(points)
    assert double_areas(mesh) == [14, -19]
    assert int(flip_to_delaunay(mesh)[1].flips) == 0


def test_an_edge_that_exists_is_not_made_again():
    # Round the vertex 3, inside the triangle 0 1 2, every flip would make an edge of the rim a second time.
    for x, y in [(0.2, 0.2), (0.9, 0.05), (-0.5, 0.2), (2.0, 2.0)]:
        mesh = MeshBatch.from_arrays([[0, 0], [1, 0], [0, 1], [x, y]], [[0, 1, 3], [1, 2, 3], [2, 0, 3]])
        for rule in RULES:
            flipped, info = flip_to_delaunay(mesh, RULES[rule])
            assert int(info.flips) == 0, (rule, x, y)
            assert torch.equal(flipped.triangles, mesh.triangles)


@pytest.mark.parametrize("triangles", [[[0, 1, 2], [1, 0, 2]], [[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]]])
def test_closed_surfaces_are_left_alone(triangles):
    # Two triangles back to back, and a tetrahedron trodden flat.
    mesh = MeshBatch.from_arrays([[0, 0], [3, 0], [1, 2], [1, 1]][: max(max(t) for t in triangles) + 1], triangles)
    for rule in RULES:
        flipped, info = flip_to_delaunay(mesh, RULES[rule])
        assert int(info.flips) == 0
        assert torch.equal(flipped.triangles, mesh.triangles)


def test_an_edge_that_exists_in_another_fan_of_the_same_vertex_is_not_made_again():
    # The triangle 3 4 2 hangs on the vertices 2 and 3 only; flipping 0-1 would give the edge 2-3 a third triangle.
    mesh = MeshBatch.from_arrays([[-3, 0], [3, 0], [0, 1], [0, -1], [0.5, 0]], [[0, 1, 2], [1, 0, 3], [3, 4, 2]])
    for rule in RULES:
        flipped, info = flip_to_delaunay(mesh, RULES[rule])
        assert_same_domain(mesh, flipped, info)


# --- one pass of Kim 2017 ---


@given(SIZES, SEEDS)
def test_a_pass_asks_no_more_about_an_edge_that_it_made(size, seed):
    mesh = random_mesh(size, seed)
    place = {tuple(p): v for v, p in enumerate(mesh.points.tolist())}
    asked = set()

    def listening(q):
        ends = zip(q.ux.tolist(), q.uy.tolist(), q.wx.tolist(), q.wy.tolist(), strict=True)
        asked.update(frozenset((place[ux, uy], place[wx, wy])) for ux, uy, wx, wy in ends)
        return rules.kim_rule(q)

    twin = connectivity.twins(mesh.triangles)
    locked = constrained_half_edges(mesh)
    triangles, _, log = flipping.flip_rounds(mesh.points, mesh.triangles, twin, locked, listening, once=True)
    expected, info = flip_to_delaunay(mesh, FlipOptions.paper())
    assert torch.equal(triangles, expected.triangles)
    assert len(log) == int(info.flips)
    before = interior_edges(mesh)
    made = interior_edges(expected) - before
    assert asked <= before
    assert not asked & {frozenset(e) for e in mesh.constrained_edges.tolist()}
    # Each flip takes one edge of the input away and makes one that stays.
    assert len(made) == len(before - interior_edges(expected)) <= int(info.flips) <= len(before)


def test_a_pass_flips_the_larger_sum_of_two_that_share_a_triangle():
    # A pentagon with two diagonals from the vertex 0, neither of them Delaunay; only one can go in a pass,
    # since the other has then a neighbour that has changed.
    points = [[0, 0], [4, -0.6], [5, 0], [4, 0.3], [2.5, 0.45]]
    mesh = MeshBatch.from_arrays(points, [[0, 1, 2], [0, 2, 3], [0, 3, 4]])

    def total(u, w, s, r):
        return sum(sequential.opposite_angle(points[p], points[u], points[w]) for p in (s, r))

    first, second = total(0, 2, 1, 3), total(0, 3, 2, 4)
    assert min(first, second) > np.pi
    larger = (1, 3) if first > second else (2, 4)
    flipped, _ = flip_to_delaunay(mesh, dataclasses.replace(FlipOptions.paper(), max_rounds=1))
    assert interior_edges(flipped) - interior_edges(mesh) == {frozenset(larger)}


@pytest.mark.parametrize("rounds", [1, 2, 3])
def test_a_round_flips_no_two_edges_of_one_triangle(rounds):
    mesh = meshes.jittered(cells=0.8)
    before, _ = flip_to_delaunay(mesh, FlipOptions(max_rounds=rounds))
    after, info = flip_to_delaunay(before, FlipOptions(max_rounds=1))
    changed = (after.triangles != before.triangles).any(1)
    assert int(changed.sum()) == 2 * int(info.flips) > 0


# --- other rules and arguments ---


@given(st.sampled_from(["grid", "disc", "ring", "delaunay", "l_shape"]), st.integers(0, 1000))
def test_shape_flips_lower_the_energy_of_the_smoother(name, seed):
    before = meshes.scrambled(meshes.VALID[name](), seed)
    after, info = flip_to_delaunay(before, FlipOptions(rule="shape"))
    was, now = (float(quality(m).inverse_mean_ratio.square().sum()) for m in (before, after))
    assert all(area > 0 for area in double_areas(after))
    if int(info.flips):
        assert now < was


def test_around_everything_is_the_same_as_no_around():
    mesh = meshes.jittered()
    everything = torch.ones(len(mesh.triangles), dtype=torch.bool)
    assert torch.equal(flip_to_delaunay(mesh, around=everything)[0].triangles, flip_to_delaunay(mesh)[0].triangles)


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


@pytest.mark.parametrize("rule", list(RULES))
def test_joined_equals_alone(rule):
    parts = [make() for make in ALL.values()]
    batch, info = flip_to_delaunay(join(parts), RULES[rule])
    for mesh, together, flips in zip(parts, batch.split(), info.flips.tolist(), strict=True):
        alone, its = flip_to_delaunay(mesh, RULES[rule])
        assert torch.equal(alone.triangles, together.triangles)
        assert its.flips.tolist() == [flips]


def test_the_rank_of_an_edge_has_the_same_bits_wherever_it_stands(rng):
    # Vectorised functions may round otherwise in the last, odd rows of a tensor.
    coordinates = torch.from_numpy(rng.uniform(-1, 1, (8, 203)))
    for rule in (rules.kim_rule, rules.safe_rule, rules.shape_rule):
        rank = rule(flipping.Quads(*coordinates))[1]
        for start in (0, 1, 101, 202):
            part = rule(flipping.Quads(*coordinates[:, start:].contiguous()))[1]
            assert torch.equal(part, rank[start:]), (rule.__name__, start)
            single = rule(flipping.Quads(*coordinates[:, start : start + 1].contiguous()))[1]
            assert torch.equal(single, rank[start : start + 1]), (rule.__name__, start)


def test_kim_ranks_by_the_sum_of_the_opposite_angles(rng):
    quads = rng.uniform(-1, 1, (300, 4, 2))
    total = [sum(sequential.opposite_angle(p, u, w) for p in (s, r)) for u, w, s, r in quads.tolist()]
    _, rank = rules.kim_rule(rules.Quads(*torch.from_numpy(quads.reshape(300, 8).T.copy())))
    assert np.argsort(total).tolist() == rank.argsort().tolist()


@pytest.mark.parametrize("exponent", [-200, -3, 40, 200])
@pytest.mark.parametrize("rule", list(RULES))
def test_flips_do_not_depend_on_the_unit_of_length(rule, exponent):
    mesh = meshes.jittered(cells=0.8)
    scaled = mesh.with_points(mesh.points * 2.0**exponent)
    assert torch.equal(
        flip_to_delaunay(scaled, RULES[rule])[0].triangles, flip_to_delaunay(mesh, RULES[rule])[0].triangles
    )


def test_edge_exists_sees_every_neighbour_and_no_one_else():
    for mesh in (meshes.delaunay(20, 1), meshes.ring(6, 2), meshes.disc(6, 2)):
        vertex, twin = mesh.triangles.reshape(-1), connectivity.twins(mesh.triangles)
        edges = edge_counts(mesh.triangles)
        h = torch.arange(len(vertex))
        for target in range(len(mesh.points)):
            elsewhere = h[vertex != target]
            found = flipping.edge_exists(vertex, twin, elsewhere, torch.full_like(elsewhere, target))
            expected = [frozenset((v, target)) in edges for v in vertex[elsewhere].tolist()]
            assert found.tolist() == expected


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
