"""Which meshes are so poor that vertices should travel."""

import meshes
import torch
from meshes import crowded_square

import torchmesh as tm
from torchmesh.remeshing.criteria import CrowdedOptions, crowded
from torchmesh.remeshing.options import RemeshOptions
from torchmesh.smoothing.polishing import PolishOptions


def test_it_is_tried_where_shapes_are_poor_or_sizes_were_asked_for():
    batch = tm.join([meshes.equilateral(), crowded_square(), meshes.jittered(8, 7, 1.0, 0)])
    assert crowded(tm.quality(batch), RemeshOptions()).tolist() == [False, True, False]
    assert crowded(tm.quality(batch), RemeshOptions(sizes="uniform")).tolist() == [True, True, False]


def test_one_poor_triangle_of_a_large_mesh_is_not_worth_work_on_all_of_it():
    ratio = torch.full((20_000,), 1.02, dtype=torch.float64)
    ratio[7] = 2.5
    for count, expected in ((20_000, False), (5_000, True)):
        some = ratio[:count]
        q = tm.Quality(some, some, some > 0, some.mean()[None], some.amax()[None], torch.zeros(1, dtype=torch.int64))
        assert crowded(q, RemeshOptions(), torch.tensor([0, count])).tolist() == [expected]
        assert crowded(q, RemeshOptions()).tolist() == [True]


def test_a_huge_mesh_must_be_poorer_on_the_whole_to_be_worth_it():
    for count, mean, expected in ((200_000, 1.07, True), (200_001, 1.07, False), (200_001, 1.09, True)):
        some = torch.full((count,), mean, dtype=torch.float64)
        q = tm.Quality(some, some, some > 0, some.mean()[None], some.amax()[None], torch.zeros(1, dtype=torch.int64))
        assert crowded(q, RemeshOptions(), torch.tensor([0, count])).tolist() == [expected]


def test_the_maximum_that_is_poor_is_the_one_that_polishing_works_on():
    assert CrowdedOptions().max == PolishOptions().ratio
