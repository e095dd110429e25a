"""Sides of elements after flips: each edge is found again, on the side that it was on."""

import numpy as np
import pytest

from torchmesh.files.formats.sides import edges_of, followed

BEFORE = np.array([[0, 1, 2], [0, 2, 3], [4, 0, 3]])


def test_the_edges_of_a_flipped_pair_are_found_again():
    after = np.array([[1, 3, 0], [1, 2, 3], [4, 0, 3]])
    elements, sides = np.array([0, 0, 1, 1, 2, 2]), np.array([0, 1, 1, 2, 0, 1])
    found = followed(BEFORE, after, elements, sides)
    np.testing.assert_array_equal(edges_of(after, *found), edges_of(BEFORE, elements, sides))


def test_an_edge_between_two_elements_stays_on_its_side():
    after = np.array([[1, 3, 0], [1, 2, 3], [0, 3, 4]])
    element, side = followed(BEFORE, after, np.array([2]), np.array([1]))
    assert (element.tolist(), side.tolist()) == ([2], [0])
    element, side = followed(BEFORE, after, np.array([1]), np.array([2]))
    assert (element.tolist(), side.tolist()) == ([0], [1])


def test_elements_that_have_not_changed_keep_their_sides():
    elements, sides = np.array([0, 2]), np.array([2, 1])
    assert followed(BEFORE, BEFORE, elements, sides)[0] is elements


def test_an_edge_that_is_gone_is_an_error():
    with pytest.raises(ValueError, match="gone"):
        followed(BEFORE, np.array([[1, 3, 0], [1, 2, 3], [4, 0, 3]]), np.array([0]), np.array([2]))
