"""The colours: the scale is the one that its name says, and every asset takes its colours from there."""

import re
from importlib import resources

import pytest

from torchmesh.pictures import palette


def test_the_scale_is_that_of_matplotlib():
    colormaps = pytest.importorskip("matplotlib").colormaps
    from matplotlib.colors import to_rgb

    for i, colour in enumerate(palette.SHAPES):
        assert colormaps["YlGnBu"](i / 8)[:3] == pytest.approx(to_rgb(colour), abs=0.01)


def test_no_colour_of_the_palette_stands_in_an_asset_again():
    colours = {value.lower() for value in vars(palette).values() if isinstance(value, str) and value.startswith("#")}
    assert len(colours) >= 8
    for name in ("page.css", "page.js", "page_mesh.js", "page.html"):
        text = (resources.files("torchmesh.pictures") / "assets" / name).read_text().lower()
        assert not colours & set(re.findall(r"#[0-9a-f]{6}", text)), name


def test_every_variable_that_the_style_uses_is_set():
    style = (resources.files("torchmesh.pictures") / "assets" / "page.css").read_text()
    used = set(re.findall(r"var\(--([\w-]+)\)", style))
    own = set(re.findall(r"--([\w-]+):", style))
    assert not own & set(re.findall(r"--([\w-]+):", palette.css()))
    assert used == own | set(re.findall(r"--([\w-]+):", palette.css()))
