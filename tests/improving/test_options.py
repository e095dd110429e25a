"""Records of options refuse by name what no step can work with."""

import math
import re

import numpy as np
import pytest

from torchmesh.improving.deform_options import DeformOptions, StepControl
from torchmesh.improving.options import ImproveOptions
from torchmesh.improving.step_options import LocalRepair, Refining, Rounds

WRONG = [
    (Rounds, "flip_rounds", -1),
    (Rounds, "progress", -0.1),
    (Rounds, "progress", 1.5),
    (Rounds, "patience", 0),
    (Rounds, "paper_patience", 0),
    (Rounds, "paper_quiet", 0),
    (Rounds, "rings_round_faults", -1),
    (Refining, "first_flip_rounds", -1),
    (Refining, "rest", -0.01),
    (Refining, "little_gain", -1e-3),
    (Refining, "least_gain", math.nan),
    (Refining, "least_gain_of_maximum", -1e-3),
    (Refining, "sliver", 0.5),
    (Refining, "last_steps", -1),
    (Refining, "coarse", 0.0),
    (Refining, "kept_again", -1),
    (LocalRepair, "large", -1),
    (LocalRepair, "poor", 0.9),
    (LocalRepair, "excellent", math.nan),
    (LocalRepair, "share", -0.1),
    (LocalRepair, "share", 1.1),
    (LocalRepair, "rings", 0),
    (LocalRepair, "rings_by_width", -1.0),
]


@pytest.mark.parametrize(("record", "name", "value"), WRONG)
def test_a_value_that_cannot_be_is_refused_by_name(record, name, value):
    with pytest.raises(ValueError, match=rf"{record.__name__}\.{name} must be at (least|most) \d.*, not {value}"):
        record(**{name: value})


@pytest.mark.parametrize("value", [2.5, 4.0, "3", None, True])
@pytest.mark.parametrize(
    ("record", "name"),
    [
        (DeformOptions, "rounds"),
        (DeformOptions, "max_steps"),
        (ImproveOptions, "smooth_rounds"),
        (ImproveOptions, "untangle_rounds"),
    ],
)
def test_numbers_of_rounds_and_steps_are_whole(record, name, value):
    with pytest.raises(ValueError, match=rf"{record.__name__}\.{name} must be a whole number, not {value!r}"):
        record(**{name: value})
    assert getattr(record(**{name: np.int32(2)}), name) == 2


@pytest.mark.parametrize("value", ["1", None, [], math.nan])
@pytest.mark.parametrize(
    ("record", "name"),
    [
        (DeformOptions, "stiffening"),
        (DeformOptions, "part"),
        (DeformOptions, "smallest_step"),
        (StepControl, "shrink"),
        (StepControl, "grow"),
        (StepControl, "after_refusal"),
        (StepControl, "negligible"),
        (Refining, "sliver"),
    ],
)
def test_what_is_no_number_is_refused_by_name(record, name, value):
    with pytest.raises(ValueError, match=rf"{record.__name__}\.{name} must be .*, not {re.escape(repr(value))}"):
        record(**{name: value})


@pytest.mark.parametrize("record", [Rounds, Refining, LocalRepair])
def test_every_number_of_a_record_is_checked(record):
    numbers = {name for name, value in vars(record()).items() if type(value) in (int, float)}
    assert {name for kind, name, _ in WRONG if kind is record} == numbers
