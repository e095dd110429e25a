import itertools

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchmesh.mesh.curve_fitting import fit_curves
from torchmesh.mesh.curve_motion import chain_areas, order_penalty, restore_area
from torchmesh.mesh.curves import BoundaryCurves


def fitted(points, edges, angle=40.0, stays=(), offsets=None) -> BoundaryCurves:
    points = torch.as_tensor(np.asarray(points), dtype=torch.float64)
    may = torch.ones(len(points), dtype=torch.bool)
    may[list(stays)] = False
    offsets = torch.tensor([0, len(points)] if offsets is None else offsets)
    return fit_curves(points, torch.tensor(np.asarray(edges), dtype=torch.int64), may, angle, offsets)


def loop(count: int, first: int = 0) -> list[list[int]]:
    return [[first + i, first + (i + 1) % count] for i in range(count)]


def circle(angles) -> np.ndarray:
    return np.stack([np.cos(angles), np.sin(angles)], 1)


def chains(curves: BoundaryCurves) -> list[list[int]]:
    return [
        curves.vertex[a:b].tolist() for a, b in zip(*(curves.chain_offsets[i:].tolist() for i in (0, 1)), strict=False)
    ]


def uneven(count: int, seed: int = 0) -> np.ndarray:
    step = np.random.default_rng(seed).uniform(0.6, 1.4, count)
    return 2 * np.pi * np.cumsum(step) / step.sum()


SQUARE = [[0, 0], [1, 0], [2, 0], [2, 2], [1, 2], [0, 2], [0, 1]]


def test_the_sides_of_a_square_are_chains_between_its_corners():
    curves = fitted(SQUARE, loop(7))
    assert sorted(map(sorted, chains(curves))) == [[0, 1, 2], [0, 5, 6], [3, 4, 5]]
    assert sorted(curves.vertex[curves.slides].tolist()) == [1, 4, 6]
    assert bool((curves.height == 0).all())
    assert bool((curves.period == 0).all())


def test_a_circle_is_one_closed_chain():
    curves = fitted(circle(uneven(30)), loop(30))
    assert len(curves.vertex) == 31
    assert curves.vertex[0] == curves.vertex[-1]
    assert int(curves.slides.sum()) == 30
    lengths = np.linalg.norm(np.diff(circle(np.append(uneven(30), uneven(30)[0])), axis=0), axis=1)
    assert curves.period[0].item() == pytest.approx(lengths.sum(), rel=1e-14)


def test_what_is_a_corner():
    # A turn of 30 degrees is none by default, one of 45 is; between two straight lines any bend is.
    hexagon = circle(np.pi / 3 * np.arange(6))
    assert len(fitted(hexagon, loop(6)).vertex) == 0
    assert int(fitted(hexagon, loop(6), angle=61).slides.sum()) == 6
    assert int(fitted(circle(np.pi / 6 * np.arange(12)), loop(12)).slides.sum()) == 12
    bent = [[-2, 0], [-1, 0], [0, 0], [1, 0.01], [2, 0.02], [0, -3]]
    curves = fitted(bent, loop(6))
    assert sorted(curves.vertex[curves.slides].tolist()) == [1, 3]
    # A bend between arcs is part of the curve.
    arc = [[-2, -0.1], [-1, -0.02], [0, 0], [1, -0.02], [2, -0.1], [0, -3]]
    assert sorted(fitted(arc, loop(6)).vertex[fitted(arc, loop(6)).slides].tolist()) == [1, 2, 3]


def test_ends_and_meetings_of_edges_and_held_vertices_are_corners():
    # A T: 0-1-2-3-4 with 5-6 hanging down from 2; 3 is held.
    points = [[0, 0], [1, 0], [2, 0], [3, 0], [4, 0], [2, -1], [2, -2]]
    curves = fitted(points, [[0, 1], [1, 2], [3, 2], [3, 4], [5, 2], [5, 6]], stays=[3])
    assert sorted(curves.vertex[curves.slides].tolist()) == [1, 5]
    assert sorted(map(sorted, chains(curves))) == [[0, 1, 2], [2, 5, 6]]


def test_edges_may_run_either_way_and_come_in_any_order(rng):
    angles = uneven(20, 1)
    edges = np.array(loop(20))
    turned = rng.random(20) < 0.5
    edges[turned] = edges[turned, ::-1]
    (chain,) = chains(fitted(circle(angles), edges[rng.permutation(20)]))
    steps = np.diff(chain) % 20
    assert len(set(steps.tolist())) == 1
    assert steps[0] in (1, 19)


@given(st.integers(0, 10_000))
def test_chains_are_those_of_a_walk_from_vertex_to_vertex(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 40))
    # A random graph of paths, rounds and meetings; directions at random.
    edges = {tuple(sorted(e)) for e in rng.integers(0, count, (int(1.2 * count), 2)).tolist() if e[0] != e[1]}
    edges = [list(e) if rng.random() < 0.5 else list(e)[::-1] for e in edges]
    curves = fitted(rng.normal(size=(count, 2)), edges, angle=180)
    neighbours = {v: [a + b - v for a, b in edges if v in (a, b)] for v in range(count)}
    inner = {v for v, n in neighbours.items() if len(n) == 2}
    expected, seen = [], set()
    for v in sorted(inner):
        if v in seen:
            continue
        walk = [v]
        for side in neighbours[v]:
            before, here, way = v, side, []
            while True:
                way.append(here)
                if here not in inner or here == v:
                    break
                a, b = neighbours[here]
                before, here = here, b if a == before else a
            if here == v:
                walk = [v, *way]
                break
            walk = way[::-1] + walk if side == neighbours[v][0] else walk + way
        seen |= set(walk) & inner
        expected.append((len(walk), *sorted(set(walk))))
    # A round may begin anywhere, and comes back there.
    assert sorted((len(c), *sorted(set(c))) for c in chains(curves)) == sorted(expected)
    present = {frozenset(e) for e in edges}
    for chain in chains(curves):
        assert all(frozenset(pair) in present for pair in itertools.pairwise(chain))


def test_the_curve_through_points_of_a_circle_is_nearly_that_circle():
    for count, seed in [(12, 3), (24, 4), (60, 5)]:
        angles = 2 * np.pi * np.arange(count) / count if seed == 3 else uneven(count, seed)
        curves = fitted(circle(angles), loop(count))
        largest = np.diff(np.append(angles, angles[0] + 2 * np.pi)).max()
        for part in np.linspace(0, 1, 11):
            position, _, _ = curves.at(curves.at_knot + part * curves.period[0] / count)
            # The radius of the cubic arc of angle a differs by a^6 / 4.5e5 or so (the textbook's 2.7e-4 at 90 degrees).
            assert float((position.norm(dim=1) - 1).abs().max()) < largest**6 / 4e4
    # The bound in the module's text.
    assert (np.pi / 6) ** 6 / 4e4 < 1e-6


def test_an_open_arc_is_an_arc_up_to_its_ends():
    angles = np.linspace(0.3, 1.9, 12)
    points = np.concatenate([circle(angles), [[-0.2, 0]]])
    curves = fitted(points, loop(13))
    for part in np.linspace(0, 1, 7):
        s = curves.at_knot + part * (curves.at_knot[curves.after] - curves.at_knot)
        assert float((curves.at(s)[0].norm(dim=1) - 1).abs().max()) < 1e-8


def test_on_straight_lines_places_are_exactly_straight():
    curves = fitted([[0, 0.1], [0.3, 0.1], [1, 0.1], [1, 1.7], [1, 3.3], [0, 3.3]], loop(6))
    for part in np.linspace(0, 0.999, 13):
        position, tangent, segment = curves.at(curves.at_knot + part * (curves.at_knot[curves.after] - curves.at_knot))
        assert bool(curves.straight[segment].all())
        along_x = tangent[:, 1] == 0
        assert bool((position[along_x, 1] == 0.1).all())
        assert bool((position[~along_x, 0] == 1).all())
        torch.testing.assert_close(tangent.norm(dim=1), torch.ones(len(tangent), dtype=torch.float64))


def test_a_line_runs_into_an_arc_and_stays_a_line():
    angles = np.linspace(-np.pi / 2, np.pi / 2, 13)
    lower, upper = [[x, -1] for x in (-3, -2, -1)], [[x, 1] for x in (-1, -2, -3)]
    points = np.array(lower + circle(angles).tolist() + upper)
    curves = fitted(points, loop(len(points)))
    s = curves.at_knot + 0.37 * (curves.at_knot[curves.after] - curves.at_knot)
    position, _, segment = curves.at(s)
    flat = position[:, 0] < -1e-9
    assert bool((position[flat, 1].abs() == 1)[1:].all())
    assert bool(curves.straight[segment][flat].all())
    # Where line and arc meet the arc's tangent is the line's: as smooth as the original.
    torch.testing.assert_close(
        position[~flat].norm(dim=1), torch.ones(int((~flat).sum()), dtype=torch.float64), atol=2e-5, rtol=0
    )


SHAPES = {
    "closed": lambda: fitted(circle(uneven(30, 7)) * [1.5, 1], loop(30)),
    "open": lambda: fitted(np.concatenate([circle(np.linspace(0, 2, 9)), [[-3, 0]]]), loop(10)),
    "square": lambda: fitted(SQUARE, loop(7)),
}


@pytest.mark.parametrize("name", list(SHAPES))
def test_derivatives_are_those_of_finite_differences(name, rng):
    curves = SHAPES[name]()
    gap = curves.at_knot[curves.after] - curves.at_knot
    gap = torch.where(gap <= 0, gap + curves.period, gap)
    s = curves.at_knot + torch.from_numpy(rng.uniform(0.1, 0.4, len(gap))) * gap
    s = curves.moved_to(s[curves.slides])
    step = 1e-6
    tangent = curves.at(s)[1]
    slides = curves.slides
    ahead, back = (curves.at(curves.moved_to((s + d)[slides]))[0] for d in (step, -step))
    torch.testing.assert_close(tangent[slides], ((ahead - back) / (2 * step))[slides], rtol=1e-7, atol=1e-8)
    slope = order_penalty(curves, s)[1]
    for k in slides.nonzero().squeeze(1).tolist():
        values = []
        for d in (step, -step):
            there = s.clone()
            there[k] += d
            values.append(order_penalty(curves, curves.moved_to(there[slides]))[0].item())
        assert slope[k].item() == pytest.approx((values[0] - values[1]) / (2 * step), rel=1e-5, abs=1e-9)


def test_the_penalty_is_felt_where_an_edge_stands_far_off_its_curve():
    curves = fitted(circle(2 * np.pi * np.arange(24) / 24), loop(24))
    assert order_penalty(curves, curves.at_knot)[0].item() == pytest.approx(24 * 0.5**8)
    s = curves.at_knot.clone()
    s[5] -= 0.9 * (s[5] - s[4])
    total, slope, in_order = order_penalty(curves, s)
    # An edge of 1.9 times the length stands 3.6 times as high, of 2 allowed.
    assert total.item() == pytest.approx((1.9**2 / 2) ** 8, rel=1e-2)
    assert slope[5].item() < 0
    assert bool(in_order)
    s[5] -= 0.2 * (s[5] - s[3])
    assert not bool(order_penalty(curves, s)[2])


def test_going_round_a_closed_chain_comes_back():
    curves = SHAPES["closed"]()
    assert curves.slides.sum() == 30
    for turns in (-2, 1, 3):
        s = curves.at_knot + turns * curves.period
        torch.testing.assert_close(curves.at(s)[0], curves.knots, rtol=0, atol=1e-13)
        torch.testing.assert_close(
            curves.bending(s)[0] - curves.bending(curves.at_knot)[0],
            turns * curves.bend[curves.last],
            rtol=0,
            atol=1e-12,
        )


@pytest.mark.parametrize("name", list(SHAPES))
def test_areas_come_back_exactly(name, rng):
    curves = SHAPES[name]()
    gap = curves.at_knot[curves.after] - curves.at_knot
    gap = torch.where(gap <= 0, gap + curves.period, gap)
    s = curves.moved_to((curves.at_knot + torch.from_numpy(rng.uniform(0, 0.5, len(gap))) * gap)[curves.slides])
    position, _, segment = curves.at(s)
    before = chain_areas(curves, position) - chain_areas(curves, curves.knots)
    restored, lack = restore_area(curves, position, segment)
    assert float(lack.abs().max()) < 1e-14
    torch.testing.assert_close(chain_areas(curves, restored), chain_areas(curves, curves.knots), rtol=1e-14, atol=1e-14)
    if name == "square":
        assert torch.equal(restored, position)
    else:
        assert float(before.abs().max()) > 1e-3
        if name == "closed":
            torch.testing.assert_close(restored[curves.first], restored[curves.last], rtol=0, atol=1e-14)
    ends = ~curves.slides & (curves.period == 0)
    assert torch.equal(restored[ends], curves.knots[ends])


def test_curves_of_a_batch_are_those_of_its_meshes_and_can_be_picked():
    one, two = circle(uneven(16, 7)), np.array(SQUARE, dtype=float)
    both = fitted(np.concatenate([one, two]), loop(16) + loop(7, 16), offsets=[0, 16, 23])
    for b, alone in enumerate((fitted(one, loop(16)), fitted(two, loop(7)))):
        picked = both.select(torch.tensor([b == 0, b == 1]))
        for name, value in vars(alone).items():
            assert torch.equal(getattr(picked, name), value), name
    part = both.select(torch.tensor([False, True]))
    changed = both.put(torch.tensor([False, True]), BoundaryCurves(**(vars(part) | {"parameter": part.parameter + 1})))
    assert torch.equal(
        changed.parameter - both.parameter, (both.offsets[1] <= torch.arange(len(both.at_knot))).double()
    )


def test_edges_without_a_vertex_that_slides_give_no_curves():
    curves = fitted([[0, 0], [1, 0], [0, 1]], loop(3))
    assert len(curves.vertex) == 0
    assert curves.offsets.tolist() == [0, 0]
    assert [len(v) for v in curves.at(curves.parameter)] == [0, 0, 0]
    assert order_penalty(curves, curves.parameter)[0].tolist() == [0]
