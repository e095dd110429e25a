"""Rounds of flips end, share no triangle, make no edge twice, and ask about each edge no more than they should."""

import dataclasses

import meshes
import numpy as np
import pytest
import sequential
import torch
from exact import edge_counts
from flips import RULES, SEEDS, SIZES, assert_same_domain, interior_edges, random_mesh
from hypothesis import given

from torchmesh import FlipOptions, MeshBatch, flip_to_delaunay
from torchmesh.flipping import rounds, rules
from torchmesh.mesh import connectivity
from torchmesh.mesh.kept_edges import constrained_half_edges


@pytest.mark.parametrize("rule", [name for name, options in RULES.items() if not options.once])
@given(SIZES, SEEDS)
def test_flipping_ends_and_has_then_nothing_left_to_flip(rule, size, seed):
    before = random_mesh(size, seed)
    after, _ = flip_to_delaunay(before, dataclasses.replace(RULES[rule], max_rounds=500))
    again, info = flip_to_delaunay(after, RULES[rule])
    assert info.flips.tolist() == [0]
    assert torch.equal(again.triangles, after.triangles)


def test_an_edge_that_exists_is_not_made_again():
    # Round the vertex 3, inside the triangle 0 1 2, every flip would make an edge of the boundary a second time.
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


@given(SIZES, SEEDS)
def test_a_pass_asks_no_more_about_an_edge_that_it_made(size, seed):
    mesh = random_mesh(size, seed)
    vertex_at = {tuple(p): v for v, p in enumerate(mesh.points.tolist())}
    asked = set()

    def listening(q):
        ends = zip(q.ux.tolist(), q.uy.tolist(), q.wx.tolist(), q.wy.tolist(), strict=True)
        asked.update(frozenset((vertex_at[ux, uy], vertex_at[wx, wy])) for ux, uy, wx, wy in ends)
        return rules.kim_rule(q)

    twin = connectivity.twins(mesh.triangles)
    locked = constrained_half_edges(mesh)
    triangles, _, log = rounds.flip_rounds(mesh.points, mesh.triangles, twin, locked, listening, once=True)
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


def test_edge_exists_sees_every_neighbour_and_no_one_else():
    for mesh in (meshes.delaunay(20, 1), meshes.ring(6, 2), meshes.disc(6, 2)):
        vertex, twin = mesh.triangles.reshape(-1), connectivity.twins(mesh.triangles)
        edges = edge_counts(mesh.triangles)
        h = torch.arange(len(vertex))
        for target in range(len(mesh.points)):
            elsewhere = h[vertex != target]
            found = rounds.edge_exists(vertex, twin, elsewhere, torch.full_like(elsewhere, target))
            expected = [frozenset((v, target)) in edges for v in vertex[elsewhere].tolist()]
            assert found.tolist() == expected
