"""Histograms as SVG text, which a web page shows without any library."""

from html import escape

import numpy as np

from .histograms import Histogram

# The picture and its margins, in the units of the SVG's view box.
_WIDTH, _HEIGHT = 460, 240
_LEFT, _RIGHT, _TOP, _BOTTOM = 54, 14, 12, 44
_FLOOR = _HEIGHT - _BOTTOM

# The axis of counts begins here: a single triangle must be seen.
_LEAST_COUNT = 0.7


def svg_histogram(histogram: Histogram) -> str:
    """The histogram as one `<svg>`: before filled, after as a line; counts logarithmic.  Its style is the page's."""
    name = escape(histogram.name)
    counts = histogram.counts()
    decades = max(1, int(np.ceil(np.log10(max(2, *(c.max() for c in counts))))))
    parts = [f'<svg class="histogram" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img"><title>{name}</title>']
    if histogram.shade_below is not None:
        width = _x(histogram, histogram.shade_below) - _LEFT
        parts.append(f'<rect class="shade" x="{_LEFT}" y="{_TOP}" width="{width:.1f}" height="{_FLOOR - _TOP}"/>')
        parts.append(f'<text class="shaded" x="{_LEFT + 6}" y="{_TOP + 15}">inverted</text>')
    for kind, count in zip(("before", "after"), counts, strict=True):
        parts.append(f'<path class="{kind}" d="{_outline(histogram, count, decades)}"/>')
    parts += _axes(histogram, decades)
    parts.append(f'<text class="tick" x="{(_LEFT + _WIDTH - _RIGHT) / 2}" y="{_HEIGHT - 8}">{name}</text>')
    return "".join([*parts, "</svg>"])


def _x(histogram: Histogram, value: float) -> float:
    scale = np.log if histogram.logarithmic else np.asarray
    first, last = float(scale(histogram.limits[0])), float(scale(histogram.limits[-1]))
    return _LEFT + (float(scale(value)) - first) / (last - first) * (_WIDTH - _LEFT - _RIGHT)


def _y(count: float, decades: int) -> float:
    low = np.log10(_LEAST_COUNT)
    part = (np.log10(max(count, _LEAST_COUNT)) - low) / (decades - low)
    return float(_FLOOR - part * (_FLOOR - _TOP))


def _outline(histogram: Histogram, count: np.ndarray, decades: int) -> str:
    """The path along the tops of the bins."""
    limits = histogram.limits
    steps = [f"M{_x(histogram, limits[0]):.1f} {_FLOOR}"]
    for left, right, value in zip(limits, limits[1:], count, strict=False):
        height = f"{_y(value, decades):.1f}"
        steps.append(f"L{_x(histogram, left):.1f} {height}L{_x(histogram, right):.1f} {height}")
    return "".join([*steps, f"L{_x(histogram, limits[-1]):.1f} {_FLOOR}"])


def _axes(histogram: Histogram, decades: int) -> list[str]:
    parts = [f'<path class="axis" d="M{_LEFT} {_TOP}V{_FLOOR}H{_WIDTH - _RIGHT}"/>']
    for power in range(decades + 1):
        height = _y(10.0**power, decades)
        parts.append(f'<path class="axis" d="M{_LEFT - 4} {height:.1f}H{_LEFT}"/>')
        parts.append(f'<text class="count" x="{_LEFT - 7}" y="{height + 4:.1f}">{10**power:,}</text>')
    for value, text in histogram.ticks:
        x = f"{_x(histogram, value):.1f}"
        parts.append(f'<path class="axis" d="M{x} {_FLOOR}v4"/>')
        parts.append(f'<text class="tick" x="{x}" y="{_FLOOR + 17}">{escape(text)}</text>')
    return parts
