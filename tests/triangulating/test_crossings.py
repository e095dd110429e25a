import numpy as np
import pytest
import shapely

from torchmesh.triangulating import crossings
from torchmesh.triangulating.crossings import crossing_pairs


@pytest.mark.parametrize("seed", range(10))
def test_crossing_pairs_against_all_pairs(seed):
    """On a coarse lattice, so that touching, overlapping and shared ends abound."""
    rng = np.random.default_rng(seed)
    lattice = rng.permutation(25)[:14]
    points = np.stack([lattice % 5, lattice // 5], 1).astype(float)
    segments = np.unique(np.sort(np.stack([rng.permutation(14)[:2] for _ in range(20)]), 1), axis=0)
    found = {tuple(sorted(pair)) for pair in crossing_pairs(points, segments).tolist()}
    lines = shapely.linestrings(points[segments])
    for i in range(len(segments)):
        for j in range(i + 1, len(segments)):
            common = lines[i].intersection(lines[j])
            shared = set(segments[i]) & set(segments[j])
            allowed = common.is_empty or (common.geom_type == "Point" and len(shared) == 1)
            assert ((i, j) in found) == (not allowed), (segments[i], segments[j])


@pytest.mark.parametrize("seed", range(6))
def test_pairs_are_the_same_by_sweep_and_by_tree(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    # Places on a small lattice, so that segments also touch, overlap and share ends.
    points = rng.integers(0, 12, (60, 2)).astype(float)
    segments = rng.integers(0, 60, (80, 2))
    segments = segments[segments[:, 0] != segments[:, 1]]
    group = rng.integers(0, 3, 60)[segments[:, 0]] if seed % 2 else None
    swept = crossing_pairs(points, segments, group)
    assert len(swept) > 20
    assert (np.diff(swept[:, 0] * len(segments) + swept[:, 1]) > 0).all()
    monkeypatch.setattr(crossings, "overlapping_boxes", lambda low, high: None)
    assert sorted(map(tuple, crossing_pairs(points, segments, group).tolist())) == list(map(tuple, swept.tolist()))
