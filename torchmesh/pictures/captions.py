"""Numbers and qualities as people write them: on pictures, on the report page, in the terminal."""

import numpy as np

from ..mesh.measure import Quality

# The mean width of a character of a panel's title, in inches.
_CHARACTER = 0.073


def short(value: float) -> str:
    """A quality in a few digits: 1.042, 4,944, 1.3e+06, inf."""
    if not np.isfinite(value):
        return "inf"
    return f"{value:.3f}" if value < 1000 else f"{value:,.0f}" if value < 1e6 else f"{value:.1e}"


def shapes_in_words(quality: Quality) -> str:
    """The average and the worst shape of one mesh."""
    return f"IMR average {short(float(quality.mean[0]))}, maximum {short(float(quality.max[0]))}"


def quality_in_words(quality: Quality) -> str:
    """How many triangles of one mesh are inverted, and its average and its worst shape."""
    return f"{int(quality.inverted[0]):,} inverted, {shapes_in_words(quality)}"


def panel_title(name: str, quality: Quality, inches: float) -> str:
    """A name and one mesh in numbers: in one line, or in two if one line is longer than `inches`."""
    count, quads = len(quality.inverse_mean_ratio), len(quality.quad_inverse_mean_ratio)
    more = f" and {quads:,} quad{'' if quads == 1 else 's'}" if quads else ""
    numbers = f"{name} {count:,} triangle{'' if count == 1 else 's'}{more}, {int(quality.inverted[0]):,} inverted,"
    shapes = shapes_in_words(quality)
    fits = _CHARACTER * (len(numbers) + len(shapes) + 1) <= inches
    return f"{numbers}{' ' if fits else chr(10)}{shapes}"
