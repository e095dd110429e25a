"""Wrong options of remeshing are refused by name."""

import pytest

from torchmesh.remeshing.options import RemeshOptions


@pytest.mark.parametrize(
    ("message", "wrong"),
    [
        (
            r"RemeshOptions.collapse_below must be positive and at most half of split_above \(1.4\)",
            {"collapse_below": 0.8},
        ),
        ("RemeshOptions.collapse_below must be positive", {"collapse_below": 0.0}),
        ("RemeshOptions.worst must be above 1", {"worst": 1.0}),
        ("RemeshOptions.max_rounds must not be negative", {"max_rounds": -1}),
        (r"sizes must be one of \['boundary', 'keep', 'uniform'\]", {"sizes": "fine"}),
    ],
)
def test_wrong_options_are_named(message, wrong):
    with pytest.raises(ValueError, match=message):
        RemeshOptions(**wrong)
