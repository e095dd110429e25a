"""What the cleaning of a mesh's arrays did, and where everything is now."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

NOTHING = "nothing to mend"


@dataclass(eq=False)
class CleanLog:
    """What `clean` did, in lines, and where everything is now.

    lines         what was done and what there is, a sentence each; also what iterating and printing give
    changed       is anything not as it was given
    new_vertex    (V,) int64 the new row of each vertex that was given, -1 where it was dropped
    old_vertex    (V',) int64 the given row of each vertex
    old_triangle  (T',) int64 the given row of the triangle that each triangle is, or is a part of; T + q for quad q
    old_quad      (Q',) int64 the given row of each quad
    """

    lines: list[str] = field(default_factory=list)
    changed: bool = False
    new_vertex: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    old_vertex: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    old_triangle: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    old_quad: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))

    def did(self, count: int, one: str, many: str | None = None) -> None:
        """Notes that something was done `count` times; nothing if that is 0."""
        if count:
            self.changed = True
            self.lines.append(f"{count:,} {one}" if count == 1 else f"{count:,} {many or one}")

    def __iter__(self) -> Iterator[str]:
        return iter(self.lines)

    def __len__(self) -> int:
        return len(self.lines)

    def __str__(self) -> str:
        return "\n".join(self.lines)
