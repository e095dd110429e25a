"""The compiled rounds of flips against those in torch: the same edges, in the same order."""

import pytest
import torch
from both_loops import both
from meshes import delaunay, disc, grid, jittered, ring, scrambled

from torchmesh import FlipOptions, MetricField, flip_to_delaunay, join
from torchmesh.flipping.rounds import flip_rounds
from torchmesh.flipping.rules import kim_rule, safe_rule, shape_rule
from torchmesh.kernels import flips


def lattice(generator):
    """A grid with its free vertices on few places: flat triangles, vertices on each other, points of one circle."""
    mesh = grid(12, 11)
    at = torch.randint(0, 5, mesh.points.shape, generator=generator).to(mesh.points) / 4
    return mesh.with_points(torch.where(mesh.fixed[:, None], mesh.points, at * mesh.points.max()))


def batches(generator):
    return {
        "valid": join([delaunay(80, seed=1), ring(), disc()]),
        "scrambled": scrambled(delaunay(90, seed=3), seed=3),
        "tangled": join([jittered(12, 11, cells=2.5, seed=1), jittered(9, 9, cells=9.0, seed=2)]),
        "lattice": lattice(generator),
    }


@pytest.mark.parametrize("name", ["valid", "scrambled", "tangled", "lattice"])
@pytest.mark.parametrize("rule", [safe_rule, kim_rule, shape_rule])
def test_the_same_edges_flip_in_the_same_order(generator, name, rule):
    mesh = batches(generator)[name]
    locked = torch.zeros_like(mesh.twin, dtype=torch.bool)
    some = torch.arange(len(locked)) % 17 == 3
    locked |= some | (some[mesh.twin.clamp_min(0)] & (mesh.twin >= 0))
    for more in ({}, {"once": True}, {"max_rounds": 2}, {"around": torch.arange(len(mesh.triangles)) % 5 == 0}):
        run = lambda more=more: flip_rounds(mesh.points, mesh.triangles, mesh.twin, locked, rule, **more)  # noqa: E731
        for expected, got in zip(*both(run), strict=True):
            assert torch.equal(expected, got), more


def test_some_edges_do_flip(generator):
    for name, mesh in batches(generator).items():
        for rule in ("safe", "kim", "shape"):
            _, info = flip_to_delaunay(mesh, FlipOptions(rule=rule))
            assert rule != "safe" or name == "valid" or int(info.flips.sum()) > 20


def test_flips_in_a_metric_are_the_same(generator):
    mesh = scrambled(delaunay(90, seed=3), seed=3)
    metric = MetricField.stretched(
        lambda at: torch.stack([1 + at[:, 1], at[:, 0]], 1), lambda at: 1 + 3 * at[:, 0].abs()
    )
    (expected, before), (got, after) = both(lambda: flip_to_delaunay(mesh, metric=metric))
    assert torch.equal(expected.triangles, got.triangles)
    assert torch.equal(expected.twin, got.twin)
    assert int(before.flips.sum()) == int(after.flips.sum()) > 20


def test_pauses_change_nothing(monkeypatch):
    mesh = scrambled(delaunay(90, seed=3), seed=3)
    expected, _ = flip_to_delaunay(mesh)
    monkeypatch.setattr(flips, "_WORK", 1)
    assert torch.equal(flip_to_delaunay(mesh)[0].triangles, expected.triangles)


def test_an_own_rule_is_left_to_torch():
    mesh = scrambled(delaunay(60, seed=3), seed=3)
    asked = []

    def rule(q):
        asked.append(len(q.ux))
        return safe_rule(q)

    free = torch.zeros_like(mesh.twin, dtype=torch.bool)
    got, expected = (flip_rounds(mesh.points, mesh.triangles, mesh.twin, free, by) for by in (rule, safe_rule))
    assert asked
    assert all(torch.equal(a, b) for a, b in zip(got, expected, strict=True))
