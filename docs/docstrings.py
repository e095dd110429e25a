"""Makes lists of the docstrings' columns, for the site.

points     (V, 2) float64, any one           - **points**: (V, 2) float64, any one
           length unit                  -->    length unit
triangles  (T, 3) int64                      - **triangles**: (T, 3) int64
"""

import re
from typing import Any

import griffe

# A name, or several with commas, or a short phrase of them; two spaces or more; a text.
_ENTRY = re.compile(r"^([A-Za-z_][\w.*]*(?:, [A-Za-z_][\w.*]*)*)\s{2,}(\S.*)$")


def lists_of_columns(text: str) -> str:
    """The text with every paragraph of two columns turned into a Markdown list."""
    return "\n\n".join(_list(paragraph) for paragraph in re.split(r"\n\s*\n", text))


def _list(paragraph: str) -> str:
    lines = paragraph.splitlines()
    if not lines or not _ENTRY.match(lines[0]):
        return paragraph
    entries: list[str] = []
    for line in lines:
        entry = _ENTRY.match(line)
        if entry:
            entries.append(f"- **{entry[1]}**: {entry[2]}")
        elif line.startswith("  "):
            entries.append(f"  {line.strip()}")
        else:
            # Plain lines below the columns, as in "Raises ...", are a paragraph of their own.
            entries += ["", line]
    return "\n".join(entries)


class Tables(griffe.Extension):
    """Rewrites every docstring as it is read."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = lists_of_columns(obj.docstring.value)
