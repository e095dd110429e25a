"""Each rule flips what it promises to flip, ranks by what it says, and does no harm."""

import meshes
import numpy as np
import sequential
import torch
from exact import double_areas, inverted, inverted_area, triangle_set
from flips import RULES, SEEDS, SIZES, random_mesh
from hypothesis import assume, given
from hypothesis import strategies as st

from torchmesh import FlipOptions, MeshBatch, flip_to_delaunay, quality
from torchmesh.flipping import rules


@given(SIZES, SEEDS, st.sampled_from(list(RULES)))
def test_never_more_inverted_triangles_than_before(size, seed, rule):
    before = random_mesh(size, seed)
    after, _ = flip_to_delaunay(before, RULES[rule])
    assert inverted(after) <= inverted(before)


@given(SIZES, SEEDS)
def test_safe_flips_never_add_inverted_area(size, seed):
    before = random_mesh(size, seed)
    after, info = flip_to_delaunay(before)
    # The areas are about 1, and each flip compares them with an error of rounding.
    assert inverted_area(after) <= inverted_area(before) + 1e-13 * int(info.flips)


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


def test_safe_flips_do_not_lower_the_inverted_area_by_one_more_inverted_triangle():
    # Double areas 14 and -19 would become -1 and -4.
    points = torch.tensor([[2.0, 3.0], [-3.0, -3.0], [1.0, -1.0], [1.0, -2.0]], dtype=torch.float64)
    upright = MeshBatch.from_arrays([[0, 0], [1, 0], [0.5, 1], [0.5, -1]], [[0, 1, 2], [1, 0, 3]])
    mesh = upright.with_points(points)
    assert double_areas(mesh) == [14, -19]
    assert int(flip_to_delaunay(mesh)[1].flips) == 0


def test_kim_flips_only_where_the_sum_of_the_opposite_angles_exceeds_pi():
    # The fourth corner moves across the circle through (0, 0), (2, 0), (1, 1): centre (1, 0), radius 1.
    for depth, flips in [(0.5, 1), (0.999, 1), (1.0, 0), (1.001, 0), (3.0, 0)]:
        mesh = MeshBatch.from_arrays([[0, 0], [2, 0], [1, 1], [1, -depth]], [[0, 1, 2], [1, 0, 3]])
        assert int(flip_to_delaunay(mesh, FlipOptions.paper())[1].flips) == flips, depth


def test_kim_makes_two_upright_triangles_or_none():
    # One triangle is inverted, the angles sum to more than pi, and a flip would again leave one inverted: in the first
    # mesh the first of the two new triangles, in the other mesh the second.
    u, w, s, r = [1, 1.2], [0.1, -1.2], [1.6, 0.5], [0.8, -0.6]
    for points in ([u, w, s, r], [w, u, r, s]):
        mesh = MeshBatch.from_arrays(points, [[0, 1, 2], [1, 0, 3]])
        assert inverted(mesh) == 1
        assert int(flip_to_delaunay(mesh, FlipOptions.paper())[1].flips) == 0


def test_kim_ranks_by_the_sum_of_the_opposite_angles(rng):
    quads = rng.uniform(-1, 1, (300, 4, 2))
    total = [sum(sequential.opposite_angle(p, u, w) for p in (s, r)) for u, w, s, r in quads.tolist()]
    _, rank = rules.kim_rule(rules.Quads(*torch.from_numpy(quads.reshape(300, 8).T.copy())))
    assert np.argsort(total).tolist() == rank.argsort().tolist()


@given(st.sampled_from(["grid", "disc", "ring", "delaunay", "l_shape"]), st.integers(0, 1000))
def test_shape_flips_lower_the_energy_of_the_smoother(name, seed):
    before = meshes.scrambled(meshes.VALID[name](), seed)
    after, info = flip_to_delaunay(before, FlipOptions(rule="shape"))
    was, now = (float(quality(m).inverse_mean_ratio.square().sum()) for m in (before, after))
    assert all(area > 0 for area in double_areas(after))
    assume(int(info.flips))
    assert now < was


def test_four_points_of_one_circle_are_left_alone():
    for diagonal in ([[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]):
        mesh = MeshBatch.from_arrays([[0, 0], [3, 0], [3, 2], [0, 2]], diagonal)
        for rule in RULES:
            flipped, info = flip_to_delaunay(mesh, RULES[rule])
            assert int(info.flips) == 0, rule
            assert flipped.triangles.tolist() == diagonal


def test_a_flip_that_would_invert_is_not_made():
    # The quadrilateral is not convex at the vertex 0, although the angles at 2 and 3 are large; or at the vertex 1.
    for points in ([[0, 0], [4, 0], [-1, 0.4], [-1, -1]], [[0, 0], [4, 0], [5, 0.4], [5, -1]]):
        mesh = MeshBatch.from_arrays(points, [[0, 1, 2], [1, 0, 3]])
        for rule in RULES:
            assert int(flip_to_delaunay(mesh, RULES[rule])[1].flips) == 0, rule


def test_the_rank_of_an_edge_has_the_same_bits_wherever_it_stands(rng):
    # Vectorised functions may round otherwise in the last rows of a tensor, which do not fill a vector register.
    coordinates = torch.from_numpy(rng.uniform(-1, 1, (8, 203)))
    for rule in rules.RULES.values():
        rank = rule(rules.Quads(*coordinates))[1]
        for start in (0, 1, 101, 202):
            part = rule(rules.Quads(*coordinates[:, start:].contiguous()))[1]
            assert torch.equal(part, rank[start:]), (rule.__name__, start)
            single = rule(rules.Quads(*coordinates[:, start : start + 1].contiguous()))[1]
            assert torch.equal(single, rank[start : start + 1]), (rule.__name__, start)
