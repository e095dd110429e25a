"""Histograms: every triangle is counted once, and matplotlib and the page show the same counts."""

import re

import meshes
import numpy as np
import pytest

from torchmesh import quality
from torchmesh.pictures import histograms
from torchmesh.pictures.svg_histogram import svg_histogram


@pytest.fixture(scope="module")
def both():
    before, after = meshes.moved_hole(), meshes.grid()
    qualities = quality(before), quality(after)
    return {
        "shapes": histograms.shapes(*qualities),
        "angles": histograms.angles(before, after, *qualities),
        "sizes": (len(before.triangles), len(after.triangles)),
        "inverted": int(qualities[0].inverted[0]),
    }


@pytest.mark.parametrize("kind", ["shapes", "angles"])
def test_every_triangle_is_in_one_bin(both, kind):
    assert tuple(int(counts.sum()) for counts in both[kind].counts()) == both["sizes"]


def test_inverted_triangles_have_angles_below_zero(both):
    found = both["angles"]
    before, after = found.counts()
    assert both["inverted"] > 0
    assert before[found.limits[:-1] < 0].sum() == both["inverted"]
    assert after[found.limits[:-1] < 0].sum() == 0
    assert found.shade_below == 0


def test_without_inverted_triangles_the_axis_of_angles_begins_at_zero():
    mesh = meshes.grid()
    found = histograms.angles(mesh, mesh, quality(mesh), quality(mesh))
    assert found.limits[0] == 0
    assert found.limits[-1] == 60
    assert found.shade_below is None
    assert "shade" not in svg_histogram(found)


@pytest.mark.parametrize("kind", ["shapes", "angles"])
def test_matplotlib_draws_the_counts(both, kind):
    figure = pytest.importorskip("matplotlib.figure").Figure()
    ax = figure.add_subplot()
    histograms.draw(ax, both[kind])
    bars = [patch.get_height() for patch in ax.patches if hasattr(patch, "get_height")]
    before, _ = both[kind].counts()
    assert bars[: len(before)] == before.tolist()


@pytest.mark.parametrize("kind", ["shapes", "angles"])
def test_the_svg_is_as_high_as_the_counts(both, kind):
    text = svg_histogram(both[kind])
    for name, counts in zip(("before", "after"), both[kind].counts(), strict=True):
        path = re.search(rf'<path class="{name}" d="([^"]*)"', text).group(1)
        heights = [float(y) for y in re.findall(r"L[\d.]+ ([\d.]+)L", path)]
        assert len(heights) == len(counts)
        # More triangles stand higher, which in SVG is a smaller y; rounding to a tenth makes some equal.
        order = np.argsort(counts, kind="stable")
        assert np.diff(np.array(heights)[order]).max() <= 0
        top, bottom = np.argmax(counts), np.argmin(counts)
        assert heights[top] < heights[bottom]


def test_elements_are_counted_where_quads_are_among_them():
    figure = pytest.importorskip("matplotlib.figure").Figure()
    mixed, triangles = meshes.mixed(), meshes.grid()
    for before, after, counted in ((mixed, triangles, "elements"), (triangles, mixed, "elements"),
                                   (triangles, triangles, "triangles")):  # fmt: skip
        ends = quality(before), quality(after)
        for found in (histograms.shapes(*ends), histograms.angles(before, after, *ends)):
            ax = figure.add_subplot()
            histograms.draw(ax, found)
            assert ax.get_ylabel() == counted
            assert ("square" in found.name) == (counted == "elements")
        assert histograms.shapes(*ends).title == f"inverse mean ratio, all {counted}"
