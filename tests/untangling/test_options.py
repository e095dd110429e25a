"""Options of `untangle` that make no sense are refused by name."""

import math

import pytest

from torchmesh import UntangleOptions


@pytest.mark.parametrize(
    ("match", "arguments"),
    [
        ("UntangleOptions.method must be .*'magic'", {"method": "magic"}),
        ("UntangleOptions.max_iterations must be at least 1, not 0", {"max_iterations": 0}),
        ("UntangleOptions.max_continuations must be at least 1, not -2", {"max_continuations": -2}),
        ("UntangleOptions.beta must not be negative, but is -0.1", {"beta": -0.1}),
        ("UntangleOptions.beta must not be negative, but is nan", {"beta": math.nan}),
        ("UntangleOptions.size_sweeps must be numbers", {"size_sweeps": ()}),
        ("UntangleOptions.size_sweeps must be numbers", {"size_sweeps": (-1,)}),
        ("UntangleOptions.stall_patience must be at least 1, not 0", {"stall_patience": 0}),
        ("UntangleOptions.stall_ratio must be above 0", {"stall_ratio": 0.0}),
        ("UntangleOptions.stall_depth must not be negative, but is -1", {"stall_depth": -1}),
        ("UntangleOptions.energy_tolerance must not be negative, but is -1e-06", {"energy_tolerance": -1e-6}),
        ("UntangleOptions.first_step must be positive, not 0", {"first_step": 0.0}),
        ("UntangleOptions.reach must be at least 1, not 0", {"reach": 0}),
        ("UntangleOptions.local and absolute_beta exclude each other", {"local": True, "absolute_beta": 0.1}),
        ("UntangleOptions.absolute_beta must not be negative, but is -1", {"absolute_beta": -1}),
    ],
)
def test_bad_options_are_named(match, arguments):
    with pytest.raises(ValueError, match=match):
        UntangleOptions(**arguments)
