"""How domains are drawn: wishes come evenly along the stream, and options are refused by name."""

import numpy as np
import pytest

from torchmesh.learning import drawing
from torchmesh.learning.drawing import DomainOptions, DrawOptions


def test_wishes_come_evenly():
    options = DomainOptions(tangled=0.3)
    wishes = np.array([drawing._wished(options, n) for n in range(2000)])
    for length in (20, 100, 1000):
        sums = np.convolve(wishes, np.ones(length), "valid")
        assert np.abs(sums - 0.3 * length).max() <= 3


def test_a_domain_depends_on_its_number_and_not_on_those_drawn_with_it():
    options = DomainOptions(["circle", "gate"], triangles=200)
    alone, together = drawing.draw_domains(options, [1]), drawing.draw_domains(options, [0, 1])
    assert alone[0].family == together[1].family == "gate"
    assert (alone[0].mesh.points == together[1].mesh.points).all()


@pytest.mark.parametrize("name", ["domain_tries", "motion_tries", "levels"])
def test_wrong_options_are_refused_by_name(name):
    with pytest.raises(ValueError, match=f"DrawOptions.{name}"):
        DrawOptions(**{name: 0})
