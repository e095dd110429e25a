"""Each point gets a goal of its own, and travels no further than the numbers of both ask."""

import pytest
import torch

from torchmesh.mesh.matching import pairs_nearby


def evenly(generator, count):
    return torch.rand((count, 2), generator=generator, dtype=torch.float64)


def test_each_point_has_one_goal(generator):
    for count in (0, 1, 2, 100):
        pairs = pairs_nearby(evenly(generator, count), evenly(generator, count) * 1e-3 + 5)
        assert torch.equal(pairs.sort().values, torch.arange(count))


def test_points_that_stay_are_paired_with_themselves(generator):
    points = evenly(generator, 500)
    order = torch.randperm(500, generator=generator)
    assert torch.equal(pairs_nearby(points, points[order]), order)


def test_what_is_moved_or_turned_round_by_powers_of_two_has_the_same_pairs(generator):
    points, goals = evenly(generator, 300), evenly(generator, 300)
    assert torch.equal(pairs_nearby(points, goals), pairs_nearby(points * 1024, goals * 1024))


@pytest.mark.parametrize("excess", [0, 40])
def test_only_the_excess_travels_far(generator, excess):
    """Points lie evenly but for too many in one corner, where as many goals are missing as there are too many."""
    count = 2000
    points, goals = evenly(generator, count), evenly(generator, count)
    points[:excess] = 0.01 * points[:excess]
    far = (points[pairs_nearby(points, goals)] - goals).norm(dim=1) * count**0.5
    assert float(far.median()) < 1.5
    assert float((far > 10).double().mean()) < 0.1
