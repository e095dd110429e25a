"""Draw the flow of the algorithm, as in figure 2 of Kim 2017, as docs/loop.svg.

python -m experiments.paper.draw_loop
"""

import sys
from collections.abc import Sequence
from html import escape
from pathlib import Path

from experiments.shared import arguments

_WIDTH, _HEIGHT = 640, 560
_BOX_WIDTH, _BOX_HEIGHT, _MIDDLE = 260, 60, 250
# The lines of text, the distance of the box's middle from the top, and the colour.
_BOXES = [
    (("tangled mesh", "boundary fixed"), 40, "#ffffff"),
    (("1. edge flip", "edges that are not Delaunay"), 140, "#d9ecf7"),
    (("2. untangling", "untangle-beta moves vertices"), 240, "#d9ecf7"),
    (("4. smoothing", "inverse mean ratio"), 440, "#d9ecf7"),
    (("valid mesh",), 530, "#ffffff"),
]
_DECISION = 340
_INVERTED = "#d55e00"


def drawing() -> str:
    """The figure as SVG text."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" font-family="sans-serif" '
        'font-size="16" text-anchor="middle" stroke-width="1.5">',
        "<title>Kim 2017, figure 2: flip edges, untangle, repeat while a triangle is inverted, smooth</title>",
        '<defs><marker id="head" viewBox="0 0 10 10" refX="10" refY="5" markerWidth="8" markerHeight="8" '
        'orient="auto"><path d="M0 0L10 5L0 10z" fill="#333"/></marker></defs>',
        f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="#ffffff"/>',
    ]
    for lines, y, colour in _BOXES:
        height = _BOX_HEIGHT if len(lines) > 1 else 40
        parts.append(
            f'<rect x="{_MIDDLE - _BOX_WIDTH / 2}" y="{y - height / 2}" width="{_BOX_WIDTH}" height="{height}" rx="6" '
            f'fill="{colour}" stroke="#333"/>'
        )
        parts += _text(lines, _MIDDLE, y)
    across, up = 150, 42
    parts.append(
        f'<path d="M{_MIDDLE - across} {_DECISION}L{_MIDDLE} {_DECISION - up}L{_MIDDLE + across} {_DECISION}'
        f'L{_MIDDLE} {_DECISION + up}z" fill="#fbe7d9" stroke="{_INVERTED}"/>'
    )
    parts += _text(("3. inverted triangles?",), _MIDDLE, _DECISION)
    for start, end in ((70, 110), (170, 210), (270, _DECISION - up), (_DECISION + up, 410), (470, 510)):
        parts.append(_arrow(f"M{_MIDDLE} {start}V{end}"))
    right, side = _MIDDLE + _BOX_WIDTH / 2, 520
    parts.append(_arrow(f"M{_MIDDLE + across} {_DECISION}H{side}V140H{right}"))
    parts += _text(("yes: again",), side + 50, 240)
    parts += _text(("no",), _MIDDLE + 22, _DECISION + up + 12)
    return "\n".join([*parts, "</svg>", ""])


def _text(lines: tuple[str, ...], x: float, y: float) -> list[str]:
    first = y + 6 - 11 * (len(lines) - 1)
    return [
        f'<text x="{x}" y="{first + 22 * i}" fill="{"#111" if i == 0 else "#444"}">{escape(line)}</text>'
        for i, line in enumerate(lines)
    ]


def _arrow(path: str) -> str:
    return f'<path d="{path}" fill="none" stroke="#333" marker-end="url(#head)"/>'


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    default = Path(__file__).parents[2] / "docs" / "loop.svg"
    parser.add_argument("--out", type=Path, default=default, help="the file to write")
    arguments.parse(parser, argv).out.write_text(drawing(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
