"""Nets of triangles: flips and their costs, and ways from one net to another that end where they should."""

import random
from dataclasses import replace

import meshes
import numpy as np
import torch

from torchmesh.untangling.wiring import Wiring, backwards, costs, flip_apart, offers, way_between


def scrambled(start: Wiring, flips: int, seed: int = 0) -> tuple[Wiring, list[tuple[int, int]]]:
    """Another net after so many flips at random, and those flips."""
    wiring, rng, made = start.copy(), random.Random(seed), []
    while len(made) < flips:
        edge = rng.choice(sorted(wiring.row))
        if wiring.flip(*edge):
            made.append(edge)
    return wiring, made


def flipped(start: Wiring, flips: list[tuple[int, int]]) -> Wiring:
    wiring = start.copy()
    assert all(wiring.flip(*edge) for edge in flips)
    return wiring


def faces(wiring: Wiring) -> set[frozenset[int]]:
    return {frozenset(face) for face in wiring.faces}


def test_a_way_between_two_nets_leads_to_the_other_and_is_no_longer_than_a_way_round():
    start = Wiring(meshes.grid(6, 6))
    for flips in (1, 5, 20):
        end, made = scrambled(start, flips)
        way = way_between(start, end)
        assert way is not None
        assert faces(flipped(start, way)) == faces(end)
        assert len(end.edges() - start.edges()) <= len(way) <= len(made)


def test_a_way_crosses_edges_of_the_other_net_where_nothing_else_leads_on():
    start = Wiring(meshes.grid(4, 4))
    end, _ = scrambled(start, 80)
    assert way_between(start, end, round_about=0) is None
    assert faces(flipped(start, way_between(start, end))) == faces(end)


def test_a_way_backwards_undoes_what_the_way_did():
    start = Wiring(meshes.grid(5, 5))
    end, made = scrambled(start, 12, seed=3)
    undone = backwards(start, made)
    assert undone is not None
    assert len(undone) == 12
    assert faces(flipped(end, undone)) == faces(start)
    assert backwards(start, None) is None


def test_a_net_keeps_its_rows_its_orientation_and_its_constrained_edges():
    mesh = meshes.grid(4, 4)
    edge = next(e for e in Wiring(mesh).row if Wiring(mesh).across(*e))
    held = Wiring(replace(mesh, constrained_edges=torch.tensor([edge])))
    assert held.across(*edge) is None
    assert not held.flip(*edge)
    end, _ = scrambled(held, 30)
    assert frozenset(edge) in end.edges()
    # Every half-edge is there once, and those of the boundary are the same.
    sides = [side for a, b, c in end.faces for side in ((a, b), (b, c), (c, a))]
    assert len(set(sides)) == len(sides)
    boundary = [{side for side in net.row if side[::-1] not in net.row} for net in (held, end)]
    assert boundary[0] == boundary[1]
    assert all(side in ((a, b), (b, c), (c, a)) for side, row in end.row.items() for a, b, c in [end.faces[row]])


def test_costs_of_flips_are_what_the_squares_of_lacking_areas_change_by():
    mesh = meshes.grid(4, 4)
    points = mesh.points.numpy() + np.random.default_rng(0).normal(0, 0.1, mesh.points.shape)
    size, least = np.full(len(points), 0.25), 0.3
    wiring = Wiring(mesh)

    def lack(net: Wiring) -> float:
        total = 0.0
        for a, b, c in points[np.array(net.faces)]:
            area = ((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]) / 2
            total += min(area / (0.25**2 * 3**0.5 / 4) - least, 0.0) ** 2
        return total

    found = offers(wiring, points, size, least, every=True)
    assert len(found) > 3
    assert found == sorted(found)
    for added, edge in found:
        np.testing.assert_allclose(added, lack(flipped(wiring, [edge])) - lack(wiring), atol=1e-12)
    assert costs(wiring, [(0, 1)], points, size, least) == [np.inf]
    inverted = offers(wiring, points, size, least, every=False)
    assert set(inverted) <= set(found)


def test_flips_made_together_share_no_triangle():
    mesh = meshes.grid(4, 4)
    wiring = Wiring(mesh)
    rows = {edge: {wiring.row[edge], wiring.row[edge[::-1]]} for edge in wiring.row if edge[::-1] in wiring.row}
    edges = sorted(edge for edge in rows if edge[0] < edge[1])
    made = flip_apart(wiring, edges, 5)
    assert len(made) == 5
    touched = [row for edge in made for row in rows[edge]]
    assert len(set(touched)) == 10


def test_a_mesh_of_another_order_of_unknowns_is_pushed_to_the_same_positions():
    """The order of another net is right, if not the best; only rounding tells."""
    from torchmesh.untangling.enough_flips import FlipSearch
    from torchmesh.untangling.persisting import pushed, sizes_to_push

    mesh = meshes.grid(6, 6)
    points = mesh.points.clone()
    points[~mesh.fixed] = torch.tensor([0.2, 0.7], dtype=points.dtype)
    ways, order = FlipSearch().ways, list[np.ndarray]()
    size = sizes_to_push(mesh, ways)
    pushed(mesh, ways, size, points, order)
    assert len(order) == 1
    end, _ = scrambled(Wiring(mesh), 4)
    other = mesh.with_triangles(end.triangles())
    one, count, _ = pushed(other, ways, size, points)
    two, same, _ = pushed(other, ways, size, points, order)
    assert count == same
    torch.testing.assert_close(one, two, atol=1e-6, rtol=0)
