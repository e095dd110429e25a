"""The compiled pairing of points with points near them against that in torch: the same pairs."""

import pytest
import torch
from both_loops import both, need_compiled_loops

from torchmesh.mesh.matching import pairs_nearby


@pytest.mark.parametrize("count", [1, 2, 37, 800])
def test_the_same_pairs(generator, count):
    need_compiled_loops()
    even = torch.rand((count, 2), generator=generator, dtype=torch.float64)
    clustered = torch.where(even < 0.5, 1e-6 * even, 3 + even**3)
    in_one_place = torch.round(4 * even)
    for points, goals in ((even, clustered), (clustered, even), (in_one_place, even), (in_one_place, in_one_place)):
        expected, got = both(lambda points=points, goals=goals: pairs_nearby(points, goals))
        assert torch.equal(expected, got)
