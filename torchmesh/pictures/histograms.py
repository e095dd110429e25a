"""The two histograms that pictures and the report page show: shapes and angles, before and after.

    elements of both meshes --shapes, angles--> Histogram --draw-->           matplotlib axes
                                                           --svg_histogram-->  the report page

So both show the same numbers, however they are drawn.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..mesh.batch import MeshBatch
from ..mesh.measure import Quality, signed_minimum_angles, signed_narrowest_angles
from . import palette
from .regions import of_elements

# Inverse mean ratios from here on fall into the last bin.
_LARGEST_RATIO = 10.0
_RATIO_BINS = 46
# Degrees; inverted triangles have angles down to -60.
_LARGEST_ANGLE, _ANGLE_BIN = 60.0, 2.0


@dataclass(frozen=True, eq=False)
class Histogram:
    """Two sets of values over one axis.

    before, after  (T,) values; those outside the limits count in the first or last bin
    limits         (N + 1,) limits of the bins, ascending
    ticks          positions on the axis and what to write there
    title          of the picture
    name           of the axis
    logarithmic    space the axis by logarithms
    counted        what the counts are of
    shade_below    shade the part of the axis below this value, where triangles are inverted; None: no part
    """

    before: np.ndarray
    after: np.ndarray
    limits: np.ndarray
    ticks: Sequence[tuple[float, str]]
    title: str
    name: str
    logarithmic: bool = False
    counted: str = "triangles"
    shade_below: float | None = None

    def counts(self) -> tuple[np.ndarray, np.ndarray]:
        """(N,) and (N,) the number of values in each bin, before and after."""
        inside = (np.clip(values, self.limits[0], self.limits[-1]) for values in (self.before, self.after))
        before, after = (np.histogram(values, self.limits)[0] for values in inside)
        return before, after


def shapes(before: Quality, after: Quality) -> Histogram:
    """The inverse mean ratios of all triangles and quads of two meshes."""
    counted = _counted(before, after)
    labels = [(t, f"{t:g}") for t in (1, 1.5, 2, 3, 5)]
    return Histogram(
        of_elements(before)[1],
        of_elements(after)[1],
        np.geomspace(1.0, _LARGEST_RATIO, _RATIO_BINS + 1),
        [*labels, (_LARGEST_RATIO, f"{_LARGEST_RATIO:g}+")],
        f"inverse mean ratio, all {counted}",
        f"inverse mean ratio (1: equilateral{' or square' if counted == 'elements' else ''})",
        logarithmic=True,
        counted=counted,
    )


def angles(before: MeshBatch, after: MeshBatch, before_quality: Quality, after_quality: Quality) -> Histogram:
    """The smallest angle of every triangle and quad of two meshes; inverted triangles have negative angles."""
    pairs = ((before, before_quality), (after, after_quality))
    values = [np.concatenate([signed_minimum_angles(*p), signed_narrowest_angles(*p)]) for p in pairs]
    inverted = min(float(v.min()) for v in values) < 0
    counted = _counted(before_quality, after_quality)
    quads = counted == "elements"
    largest = 1.5 * _LARGEST_ANGLE if quads else _LARGEST_ANGLE
    low = -largest if inverted else 0.0
    return Histogram(
        values[0],
        values[1],
        np.arange(low, largest + 0.1, _ANGLE_BIN),
        [(t, f"{t:g}") for t in np.arange(low, largest + 1, (30.0 if quads else 20.0) if inverted else 10.0)],
        f"smallest angle of each {'element' if quads else 'triangle'}"
        + (", inverted ones below zero" if inverted else ""),
        "smallest angle (degrees; 60: equilateral" + ("; 90: square)" if quads else ")"),
        counted=counted,
        shade_below=0.0 if inverted else None,
    )


def _counted(*ends: Quality) -> str:
    """What the meshes consist of: 'triangles', or 'elements' where quads are among them."""
    return "elements" if any(len(q.quad_inverse_mean_ratio) for q in ends) else "triangles"


def draw(ax: Any, histogram: Histogram, legend: bool = False) -> None:
    """Draw the histogram on matplotlib axes: before as an area, after as a line; the counts are logarithmic."""
    low, high = float(histogram.limits[0]), float(histogram.limits[-1])
    before, after = histogram.counts()
    for counts, style in ((before, _BEFORE), (after, _AFTER)):
        ax.hist(histogram.limits[:-1], histogram.limits, weights=counts, log=True, **style)
    if histogram.logarithmic:
        ax.set_xscale("log")
        ax.minorticks_off()
    if histogram.shade_below is not None:
        ax.axvspan(low, histogram.shade_below, color=palette.INVERTED, alpha=palette.SHADE_OPACITY, linewidth=0)
        ax.text(0.02, 0.94, "inverted", color=palette.INVERTED_TEXT, transform=ax.transAxes, fontsize=9, va="top")
    ax.set_xticks([value for value, _ in histogram.ticks], [text for _, text in histogram.ticks])
    ax.set_xlim(low, high)
    ax.set_title(histogram.title, fontsize=10)
    ax.set_xlabel(histogram.name, fontsize=9)
    ax.set_ylabel(histogram.counted, fontsize=9)
    # A single one must be seen.
    ax.set_ylim(bottom=0.7)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    if legend:
        ax.legend(fontsize=9, frameon=False, loc="upper right")


_BEFORE = {"color": palette.BEFORE, "alpha": palette.BEFORE_OPACITY, "label": "before"}
_AFTER = {"histtype": "step", "color": palette.AFTER, "linewidth": 1.6, "label": "after"}
