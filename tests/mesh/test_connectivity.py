import meshes
import numpy as np
import pytest
import torch
from exact import boundary, directed_edges, edge_counts

from torchmesh.mesh import connectivity as con

EULER = {"grid": 1, "disc": 1, "ring": 0, "l_shape": 1, "equilateral": 1, "delaunay": 1, "bowtie": 1}
LOOPS = {"grid": 1, "disc": 1, "ring": 2, "l_shape": 1, "equilateral": 1, "delaunay": 1, "bowtie": 2}


@pytest.fixture(params=list(meshes.VALID))
def named(request):
    mesh = meshes.VALID[request.param]()
    return request.param, mesh, mesh.triangles, con.twins(mesh.triangles)


def test_next_and_previous_walk_round_the_triangle():
    h = torch.arange(30)
    after, before = con.next_in_triangle(h), con.previous_in_triangle(h)
    assert torch.equal(after // 3, h // 3)
    assert torch.equal(con.previous_in_triangle(after), h)
    assert torch.equal(con.next_in_triangle(after), before)
    assert torch.equal(con.next_in_triangle(before), h)
    assert bool((after != h).all())


def test_a_half_edge_runs_from_its_tail_to_the_tail_of_the_next(named):
    _, _, triangles, _ = named
    h = torch.arange(3 * len(triangles))
    assert torch.equal(con.heads(triangles), con.tails(triangles)[con.next_in_triangle(h)])
    assert torch.equal(con.tails(triangles), triangles[h // 3, h % 3])


def test_twin_of_twin_is_the_half_edge_itself(named):
    _, _, triangles, twin = named
    tail, head = con.tails(triangles).tolist(), con.heads(triangles).tolist()
    inner = 0
    for h, g in enumerate(twin.tolist()):
        if g >= 0:
            inner += 1
            assert twin[g] == h
            assert g // 3 != h // 3
            assert (tail[g], head[g]) == (head[h], tail[h])
    assert inner == sum(2 for count in edge_counts(triangles).values() if count == 2)


def test_a_half_edge_without_twin_is_on_the_boundary_and_no_other(named):
    _, _, triangles, twin = named
    edges = con.boundary_edges(triangles, twin)
    assert {tuple(e) for e in edges.tolist()} == boundary(triangles)
    mask = con.boundary_vertices(triangles, twin, int(triangles.max()) + 3)
    assert set(mask.nonzero().squeeze(1).tolist()) == {v for e in boundary(triangles) for v in e}


def test_edges_are_each_there_once(named):
    _, _, triangles, twin = named
    edges = [frozenset(e) for e in con.edges(triangles, twin).tolist()]
    assert len(edges) == len(set(edges))
    assert set(edges) == set(edge_counts(triangles))


def test_edge_keys_tell_edges_apart_and_not_their_ends(rng):
    u, v = torch.from_numpy(rng.integers(0, 50, (2, 1000)))
    keys = con.edge_keys(u, v, 50).tolist()
    assert con.edge_keys(v, u, 50).tolist() == keys
    pairs = [frozenset(p) for p in zip(u.tolist(), v.tolist(), strict=True)]
    assert len(set(zip(keys, pairs, strict=True))) == len(set(keys)) == len(set(pairs))


def test_euler_number(named):
    name, _, triangles, twin = named
    assert con.euler_number(triangles, twin) == EULER[name]


def test_euler_number_leaves_unused_vertices_out():
    triangles = torch.tensor([[3, 7, 9]])
    assert con.euler_number(triangles, con.twins(triangles)) == 1


def test_boundary_loops_use_each_boundary_edge_once(named):
    name, _, triangles, twin = named
    loops = [loop.tolist() for loop in con.boundary_loops(con.boundary_edges(triangles, twin))]
    assert len(loops) == LOOPS[name]
    walked = [(u, v) for loop in loops for u, v in zip(loop, loop[1:] + loop[:1], strict=True)]
    assert sorted(walked) == sorted(boundary(triangles))
    assert all(len(set(loop)) == len(loop) for loop in loops)


def test_loops_that_meet_in_a_vertex_are_taken_apart():
    # Three squares round the vertex 0, all listed as one chain of edges.
    loops = [[0, 1, 2, 3], [0, 4, 5, 6], [0, 7, 8, 9]]
    edges = torch.tensor([e for loop in loops for e in zip(loop, loop[1:] + loop[:1], strict=True)])
    for order in (torch.arange(12), torch.arange(12).flip(0), torch.arange(12).reshape(3, 4).T.reshape(-1)):
        found = sorted(sorted(loop.tolist()) for loop in con.boundary_loops(edges[order]))
        assert found == loops


def test_vertex_triangle_counts(named):
    _, mesh, triangles, _ = named
    counts = con.vertex_triangle_counts(triangles, len(mesh.points) + 2)
    flat = triangles.reshape(-1).tolist()
    assert counts.tolist() == [flat.count(v) for v in range(len(mesh.points) + 2)]


def test_components_are_parted_by_missing_and_by_blocked_edges():
    points, triangles = meshes.grid_arrays(3, 2)
    both = torch.from_numpy(np.concatenate([triangles, triangles + len(points)]))
    component = con.triangle_components(both, con.twins(both))
    assert component.tolist() == [0] * len(triangles) + [1] * len(triangles)
    mesh = meshes.l_shape()
    twin = con.twins(mesh.triangles)
    line = {frozenset(e) for e in mesh.constrained_edges.tolist()}
    ends = zip(con.tails(mesh.triangles).tolist(), con.heads(mesh.triangles).tolist(), strict=True)
    blocked = torch.tensor([frozenset(e) in line for e in ends])
    side = mesh.points[mesh.triangles].mean(1)[:, 0] > 1
    parts = con.triangle_components(mesh.triangles, twin, blocked)
    assert parts.max() == 1
    assert len({(int(p), bool(s)) for p, s in zip(parts, side, strict=True)}) == 2


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 1.0])
def test_components_agree_with_scipys(named, rng, share):
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    triangles = named[2][torch.from_numpy(rng.permutation(len(named[2])))]  # so that roots are far from each other
    twin = con.twins(triangles)
    blocked = torch.from_numpy(rng.random(len(twin)) < share)
    open_side = ((twin >= 0) & ~blocked).nonzero().squeeze(1)
    ends = (open_side // 3).numpy(), (twin[open_side] // 3).numpy()
    graph = coo_matrix((np.ones(len(open_side)), ends), shape=(len(triangles),) * 2)
    _, label = connected_components(graph, directed=False)
    assert con.triangle_components(triangles, twin, blocked).tolist() == label.tolist()


def test_triangles_that_touch_in_a_vertex_are_not_neighbours():
    triangles = torch.from_numpy(meshes.BOWTIE[1])
    assert con.twins(triangles).tolist() == [-1] * 6
    assert con.triangle_components(triangles, con.twins(triangles)).unique().numel() == 2


def test_components_of_vertices_agree_with_scipys(named, rng):
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    # Twice the mesh and a bowtie, whose triangles touch in a vertex alone, numbered at random, with unused vertices.
    mesh, triangles = named[1], named[2]
    count, bowtie = len(mesh.points), torch.from_numpy(meshes.BOWTIE[1])
    whole = torch.cat([triangles, triangles + count, bowtie + 2 * count])
    vertices = 2 * count + int(bowtie.max()) + 4
    name = torch.from_numpy(rng.permutation(vertices))
    whole = name[whole[torch.from_numpy(rng.permutation(len(whole)))]]
    label, components = con.vertex_components(whole, con.twins(whole), vertices)
    ends = whole.reshape(-1).numpy(), whole.roll(1, 1).reshape(-1).numpy()
    graph = coo_matrix((np.ones(len(ends[0])), ends), shape=(vertices,) * 2)
    _, expected = connected_components(graph, directed=False)
    used = con.vertex_triangle_counts(whole, vertices) > 0
    assert torch.equal(label >= 0, used)
    pairs = set(zip(label[used].tolist(), expected[used.numpy()].tolist(), strict=True))
    assert len(pairs) == len({p for p, _ in pairs}) == len({e for _, e in pairs}) == components
    # They are numbered by their first triangles.
    first = label[whole[:, 0]].tolist()
    assert list(dict.fromkeys(first)) == list(range(components))


def test_twins_do_not_depend_on_the_order_of_triangles_or_corners(rng):
    triangles = meshes.ring().triangles
    order = torch.from_numpy(rng.permutation(len(triangles)))
    turned = torch.stack(
        [row.roll(int(k)) for row, k in zip(triangles[order], rng.integers(0, 3, len(order)), strict=True)]
    )

    def pairs(faces):
        twin, tail, head = con.twins(faces), con.tails(faces).tolist(), con.heads(faces).tolist()
        return {(tail[h], head[h], tail[g], head[g]) for h, g in enumerate(twin.tolist()) if g >= 0}

    assert pairs(turned) == pairs(triangles)
    assert max(directed_edges(turned).values()) == 1


def test_no_triangles():
    none = torch.zeros((0, 3), dtype=torch.int64)
    assert con.vertex_components(none, con.twins(none), 2)[0].tolist() == [-1, -1]
    assert con.vertex_components(none, con.twins(none), 2)[1] == 0
    twin = con.twins(none)
    assert len(twin) == 0
    assert con.euler_number(none, twin) == 0
    assert con.boundary_loops(con.boundary_edges(none, twin)) == []


def test_half_edges_on_edges_are_both_halves_of_these_edges():
    mesh = meshes.l_shape()
    locked = con.half_edges_on(mesh.triangles, mesh.constrained_edges, len(mesh.points))
    tail, head = con.tails(mesh.triangles), con.heads(mesh.triangles)
    ends = sorted(zip(tail[locked].tolist(), head[locked].tolist(), strict=True))
    given_edges = mesh.constrained_edges.tolist()
    assert ends == sorted((u, v) for e in given_edges for u, v in (e, e[::-1]))
    assert len(ends) > 2


def test_triangles_that_touch_vertices_and_corners_of_triangles_by_brute_force(rng):
    mesh = meshes.disc()
    vertices = torch.from_numpy(rng.random(len(mesh.points)) < 0.1)
    touched = con.touching(mesh.triangles, vertices)
    assert touched.tolist() == [any(bool(vertices[v]) for v in t) for t in mesh.triangles.tolist()]
    assert 0 < int(touched.sum()) < len(touched)
    corners = con.corners_of(mesh.triangles, touched, len(mesh.points))
    assert set(corners.nonzero().flatten().tolist()) == set(mesh.triangles[touched].flatten().tolist())
