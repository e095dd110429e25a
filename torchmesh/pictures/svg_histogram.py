"""Histograms as SVG text, which a web page shows without any library."""

from collections.abc import Sequence
from html import escape

import numpy as np

_WIDTH, _HEIGHT = 460, 240


_LEFT, _RIGHT, _TOP, _BOTTOM = 54, 14, 12, 44


def histogram(
    before: np.ndarray,
    after: np.ndarray,
    edges: np.ndarray,
    ticks: Sequence[tuple[float, str]],
    name: str,
    *,
    logarithmic: bool = False,
    shade_below: float | None = None,
) -> str:
    """Two histograms over each other as one `<svg>`: `before` filled, `after` as a line; counts logarithmic.

    before, after  (T,) values; those outside the edges count in the first or last bin
    edges          (N + 1,) limits of the bins, ascending
    ticks          places on the axis and what to write there
    name           of the axis; also the picture's text for screen readers
    logarithmic    space the axis by logarithms
    shade_below    shade the part of the axis below this value, where triangles are inverted
    """
    counts = [np.histogram(np.clip(v, edges[0], edges[-1]), edges)[0] for v in (before, after)]
    decades = max(1, int(np.ceil(np.log10(max(2, *(c.max() for c in counts))))))
    scale = np.log if logarithmic else np.asarray
    first, last = float(scale(edges[0])), float(scale(edges[-1]))
    floor = _HEIGHT - _BOTTOM

    def x(value: float) -> float:
        return _LEFT + (float(scale(value)) - first) / (last - first) * (_WIDTH - _LEFT - _RIGHT)

    def y(count: float) -> float:
        # One triangle must be seen: the axis begins at 0.7.
        part = (np.log10(max(count, 0.7)) - np.log10(0.7)) / (decades - np.log10(0.7))
        return float(floor - part * (floor - _TOP))

    def outline(count: np.ndarray) -> str:
        steps = [f"M{x(edges[0]):.1f} {floor}"]
        for left, right, value in zip(edges, edges[1:], count, strict=False):
            steps.append(f"L{x(left):.1f} {y(value):.1f}L{x(right):.1f} {y(value):.1f}")
        return "".join([*steps, f"L{x(edges[-1]):.1f} {floor}"])

    parts = [f'<svg class="histogram" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img"><title>{escape(name)}</title>']
    if shade_below is not None and shade_below > edges[0]:
        width = x(shade_below) - _LEFT
        parts.append(f'<rect class="shade" x="{_LEFT}" y="{_TOP}" width="{width:.1f}" height="{floor - _TOP}"/>')
        parts.append(f'<text class="shaded" x="{_LEFT + 6}" y="{_TOP + 15}">inverted</text>')
    parts.append(f'<path class="before" d="{outline(counts[0])}"/><path class="after" d="{outline(counts[1])}"/>')
    parts.append(f'<path class="axis" d="M{_LEFT} {_TOP}V{floor}H{_WIDTH - _RIGHT}"/>')
    for power in range(decades + 1):
        height = y(10.0**power)
        parts.append(f'<path class="axis" d="M{_LEFT - 4} {height:.1f}H{_LEFT}"/>')
        parts.append(f'<text class="count" x="{_LEFT - 7}" y="{height + 4:.1f}">{10**power:,}</text>')
    for value, text in ticks:
        parts.append(f'<path class="axis" d="M{x(value):.1f} {floor}v4"/>')
        parts.append(f'<text class="tick" x="{x(value):.1f}" y="{floor + 17}">{escape(text)}</text>')
    parts.append(f'<text class="tick" x="{(_LEFT + _WIDTH - _RIGHT) / 2}" y="{_HEIGHT - 8}">{escape(name)}</text>')
    return "".join([*parts, "</svg>"])
