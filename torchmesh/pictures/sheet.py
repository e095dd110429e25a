"""The sheet that pictures and films are laid out on.

    title
    panel (0, 0)   panel (0, 1)   colour bar
    panel (1, 0)   panel (1, 1)
    histogram      histogram

The sizes of the panels follow from the shape of the view.
"""

from pathlib import Path
from typing import Any

import numpy as np

from ..files.atomic import replacing
from ..files.messages import printable
from . import palette
from .regions import Box

# Lengths in inches.  The panels: as large as the mesh's shape wants within these limits.
_WIDTH, _NARROWEST, _WIDEST = 5.0, 3.2, 6.2
_LOWEST, _HIGHEST = 2.0, 6.5
# A panel below the first row is at most so many times as high as wide: the close-up of a tall mesh may be less tall.
_HIGHEST_BELOW = 1.1
_HISTOGRAM = 2.2
# The margins, with and without a title above, and the gaps between panels.
_LEFT, _RIGHT, _BOTTOM, _TITLE, _NO_TITLE = 0.75, 1.25, 0.65, 0.95, 0.5
_GAP_X, _GAP_Y = 0.75, 0.95
# The colour bar, and above it the key of inverted triangles.
_BAR_WIDTH, _BAR_HIGHEST, _KEY = 0.18, 6.0, 0.55

_DOTS_PER_INCH = 150
_UNIT = "length units of the file"


class Sheet:
    """A figure of two columns of equal panels, with a colour bar to the right, and perhaps histograms below.

    panel    (width, height) of a panel of the first row, in inches
    heights  of all rows, in inches
    """

    def __init__(self, view: Box, rows: int, title: str | None, histograms: bool = False) -> None:
        from matplotlib.figure import Figure

        ratio = (view[3] - view[1]) / (view[2] - view[0])
        width = float(np.clip(_WIDTH / ratio, _NARROWEST, _WIDEST))
        self.panel = (width, float(np.clip(width * ratio, _LOWEST, _HIGHEST)))
        below = min(self.panel[1], _HIGHEST_BELOW * width)
        self.heights = [self.panel[1], *[below] * (rows - 1), *[_HISTOGRAM] * histograms]
        self.rows = rows
        self.size = (
            _LEFT + 2 * width + _GAP_X + _RIGHT,
            _BOTTOM + sum(self.heights) + _GAP_Y * (len(self.heights) - 1) + (_TITLE if title else _NO_TITLE),
        )
        self.figure = Figure(figsize=self.size, dpi=_DOTS_PER_INCH, facecolor="white")
        if title:
            style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 13, "weight": "bold"}
            # The name of a file may have $ in it, and may be no text at all.
            self.figure.text(0.5, 1 - 0.35 / self.size[1], printable(title), parse_math=False, **style)

    def axes(self, row: int, column: int) -> Any:
        """The axes of one panel; the row after the last one holds the histograms."""
        left = _LEFT + column * (self.panel[0] + _GAP_X)
        ax = self._add(left, self._floor(row), self.panel[0], self.heights[row])
        ax.tick_params(labelsize=8)
        # A label takes half an inch at most; more of them would overlap.
        ax.locator_params(axis="x", nbins=max(2, min(8, int(self.panel[0] / 0.55))))
        ax.locator_params(axis="y", nbins=max(2, min(8, int(self.heights[row] / 0.4))))
        ax.set_xlabel(f"x ({_UNIT})", fontsize=9)
        ax.set_ylabel(f"y ({_UNIT})" if column == 0 else "y", fontsize=9)
        return ax

    def colour_bar(self, fill: Any) -> None:
        """The colours of `fill`, which `plot_mesh` returned, beside the panels, and the key of inverted triangles."""
        from matplotlib.lines import Line2D

        low, high = self._floor(self.rows - 1), self._floor(0) + self.panel[1]
        height = min(high - low, _BAR_HIGHEST)
        left = self.size[0] - _RIGHT + 0.25
        cax = self._add(left, (low + high - height) / 2, _BAR_WIDTH, height - _KEY)
        bar = self.figure.colorbar(fill, cax=cax, extend="max", ticks=palette.TICKS)
        bar.ax.minorticks_off()
        bar.ax.set_yticklabels([f"{t:g}" for t in palette.TICKS], fontsize=8)
        bar.set_label("inverse mean ratio", fontsize=9)
        mark = Line2D([], [], marker="^", linestyle="none", markersize=9, color=palette.INVERTED, label="inverted")
        anchor = ((left - 0.12) / self.size[0], ((low + high + height) / 2 + 0.05) / self.size[1])
        self.figure.legend(handles=[mark], loc="upper left", bbox_to_anchor=anchor, frameon=False, fontsize=9,
                           handletextpad=0.1, borderpad=0, borderaxespad=0)  # fmt: skip

    def save(self, path: Path) -> None:
        """Write the sheet in the format of the path's extension, whole or not at all."""
        with replacing(path) as whole:
            form = path.suffix[1:].lower()
            # The file is a tenth larger than it could be, and pressed in half of the time.
            pressed: dict[str, Any] = {"pil_kwargs": {"compress_level": 1}} if form == "png" else {}
            self.figure.savefig(whole, format=form, dpi=_DOTS_PER_INCH, **pressed)

    def _floor(self, row: int) -> float:
        """The height of a row's lower side above the bottom of the sheet."""
        return _BOTTOM + sum(self.heights[row + 1 :]) + _GAP_Y * (len(self.heights) - 1 - row)

    def _add(self, left: float, bottom: float, width: float, height: float) -> Any:
        across, up = self.size
        return self.figure.add_axes((left / across, bottom / up, width / across, height / up))
