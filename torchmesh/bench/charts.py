"""Lines over a number that makes cases harder, as SVG text, which a web page shows without any library."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

_WIDTH, _HEIGHT = 480, 260
_LEFT, _RIGHT, _TOP, _BOTTOM = 58, 14, 12, 44


@dataclass(frozen=True)
class Line:
    """One method: its name, its colour, whether the line is dashed, and its points (level, value)."""

    name: str
    colour: str
    dashed: bool
    points: list[tuple[float, float]]


def chart(
    lines: Sequence[Line],
    unit: str,
    title: str,
    *,
    limits: tuple[float, float] | None = None,
    logarithmic: bool = False,
) -> str:
    """One `<svg>`.  Levels stand at equal distances; the values' axis has `limits`, or those of the lines."""
    levels = sorted({x for line in lines for x, _ in line.points})
    values = [y for line in lines for _, y in line.points if math.isfinite(y) and (y > 0 or not logarithmic)]
    low, high = limits or (min(values, default=1.0), max(values, default=1.0))
    if logarithmic:
        low, high = 10 ** math.floor(math.log10(low)), 10 ** math.ceil(math.log10(high * 1.0001))
    span = (math.log10(high) - math.log10(low)) if logarithmic else high - low

    def x_of(level: float) -> float:
        part = (levels.index(level) + 0.5) / max(len(levels), 1)
        return _LEFT + part * (_WIDTH - _LEFT - _RIGHT)

    def y_of(value: float) -> float:
        part = (math.log10(max(value, low)) - math.log10(low)) if logarithmic else value - low
        return _HEIGHT - _BOTTOM - part / (span or 1) * (_HEIGHT - _TOP - _BOTTOM)

    parts = [f"<svg viewBox='0 0 {_WIDTH} {_HEIGHT}' role='img'><title>{escape(title)}</title>"]
    parts.append(f"<path class='axis' d='M{_LEFT} {_TOP}V{_HEIGHT - _BOTTOM}H{_WIDTH - _RIGHT}'/>")
    for value in _ticks(low, high, logarithmic):
        parts.append(f"<text x='{_LEFT - 6}' y='{y_of(value) + 4:.1f}' text-anchor='end'>{value:g}</text>")
        parts.append(f"<path class='axis' d='M{_LEFT - 4} {y_of(value):.1f}H{_LEFT}'/>")
    for level in levels:
        parts.append(f"<text x='{x_of(level):.1f}' y='{_HEIGHT - 27}' text-anchor='middle'>{level:g}</text>")
    middle = (_LEFT + _WIDTH - _RIGHT) / 2
    parts.append(f"<text x='{middle}' y='{_HEIGHT - 8}' text-anchor='middle'>{escape(unit)}</text>")
    parts.append(f"<text x='{_LEFT + 6}' y='{_TOP + 8}'>{escape(title)}</text>")
    for line in lines:
        drawn = [(x_of(x), y_of(y)) for x, y in sorted(line.points) if math.isfinite(y)]
        if drawn:
            path = "L".join(f"{x:.1f} {y:.1f}" for x, y in drawn)
            dash = " stroke-dasharray='5 3'" if line.dashed else ""
            parts.append(
                f"<path d='M{path}' fill='none' stroke='{line.colour}' stroke-width='2'{dash}>"
                f"<title>{escape(line.name)}</title></path>"
            )
            parts += [f"<circle cx='{x:.1f}' cy='{y:.1f}' r='2.6' fill='{line.colour}'/>" for x, y in drawn]
    return "".join([*parts, "</svg>"])


def _ticks(low: float, high: float, logarithmic: bool) -> list[float]:
    """Where the values' axis has numbers."""
    if logarithmic:
        first, last = round(math.log10(low)), round(math.log10(high))
        return [10.0**k for k in range(first, last + 1)]
    return [low + (high - low) * k / 4 for k in range(5)]
