"""Numbers as people write them."""

import meshes
import pytest

from torchmesh import quality
from torchmesh.pictures.captions import panel_title, short


@pytest.mark.parametrize(
    ("value", "text"),
    [(1.0, "1.000"), (999.9, "999.900"), (4943.76, "4,944"), (1e6, "1.0e+06"), (float("inf"), "inf")],
)
def test_short(value, text):
    assert short(value) == text


def test_a_title_has_one_line_or_two():
    q = quality(meshes.grid(1, 1))
    assert panel_title("mesh:", q, 9.0) == "mesh: 2 triangles, 0 inverted, IMR average 1.155, maximum 1.155"
    assert panel_title("mesh:", q, 3.0) == "mesh: 2 triangles, 0 inverted,\nIMR average 1.155, maximum 1.155"
