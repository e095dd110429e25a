"""Structured zones of CGNS files: their cells are quads, and conditions on ranges of them are lines.

(1,3)---(2,3)---(3,3)      vertices are numbered by two indices from 1, the first of which runs fastest;
  |       |       |        a condition on the range (1,1) to (1,3) is the side on the left
(1,2)---(2,2)---(3,2)
  |       |       |
(1,1)---(2,1)---(3,1)
"""

from dataclasses import dataclass

import numpy as np

from .cgns_sections import Section
from .cgns_tree import Tree

# No zone has more vertices.
_MOST = 1 << 31


@dataclass(frozen=True)
class Structure:
    """A zone of two indices.

    name     of the zone
    columns  how many values the first index has
    rows     how many values the second index has
    start    the first vertex of the zone among all
    """

    name: str
    columns: int
    rows: int
    start: int

    @classmethod
    def of(cls, zone: Tree, start: int) -> "Structure | None":
        """That of a zone; None for an unstructured one.  Raises ValueError for one of three indices."""
        kind = next((node.text() for node in zone.children("ZoneType_t")), "Structured")
        if kind == "Unstructured":
            return None
        sizes = zone.whole("the numbers of its zone").reshape(-1)
        if kind != "Structured" or len(sizes) % 3:
            raise ValueError(f"its zone {zone.name!r} is neither structured nor unstructured")
        vertices = sizes[: len(sizes) // 3].tolist()
        if len(vertices) != 2:
            indices = len(vertices)
            raise ValueError(f"its zone {zone.name!r} is structured by {indices} indices; those of two can be improved")
        if min(vertices) < 2 or vertices[0] * vertices[1] > _MOST:
            raise ValueError(f"its zone {zone.name!r} has {vertices[0]} by {vertices[1]} vertices")
        return cls(zone.name, vertices[0], vertices[1], start)

    @property
    def count(self) -> int:
        """The number of vertices."""
        return self.columns * self.rows

    def quads(self) -> Section:
        """The cells, as elements from 1."""
        i, j = np.meshgrid(np.arange(self.columns - 1), np.arange(self.rows - 1))
        corner = (self.start + j * self.columns + i).reshape(-1)
        nodes = np.stack([corner, corner + 1, corner + 1 + self.columns, corner + self.columns], 1)
        return self._section("quad", nodes, 1)

    def condition(self, node: Tree, place: str, number: int) -> tuple[Section | None, np.ndarray]:
        """The edges of a condition, as elements from `number`, if it lies along one line of the zone; its vertices.

        place  where its ranges count: Vertex, or the faces of one index or of both
        """
        low, high = self._range(node)
        if low is None or high is None:
            return None, np.zeros(0, np.int64)
        along = self._direction(low, high, place)
        if along is None:
            i, j = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
            return None, self._rows_of(i.reshape(-1), j.reshape(-1))
        stop = high[along] + (place != "Vertex")
        run = np.arange(low[along], min(stop, (self.columns, self.rows)[along]) + 1)
        across = np.full(len(run), low[1 - along])
        rows = self._rows_of(run, across) if along == 0 else self._rows_of(across, run)
        return self._section("line", np.stack([rows[:-1], rows[1:]], 1), number), rows

    def _range(self, node: Tree) -> tuple[list[int] | None, list[int] | None]:
        """The first and the last pair of indices of a condition; None where it has no range.  Raises ValueError."""
        child = next((c for c in node.children("IndexRange_t") if c.name in ("PointRange", "ElementRange")), None)
        if child is None:
            return None, None
        numbers = child.whole("a boundary condition").reshape(-1).tolist()
        if len(numbers) != 4:
            raise ValueError(f"its condition {node.name!r} has no range of two indices")
        pairs = zip(numbers[:2], numbers[2:], (self.columns, self.rows), strict=True)
        if any(not 1 <= min(a, b) <= max(a, b) <= most for a, b, most in pairs):
            raise ValueError(f"its condition {node.name!r} leaves the zone {self.name!r}")
        low = [min(a, b) for a, b in zip(numbers[:2], numbers[2:], strict=True)]
        return low, [max(a, b) for a, b in zip(numbers[:2], numbers[2:], strict=True)]

    def _direction(self, low: list[int], high: list[int], place: str) -> int | None:
        """The index that runs along a condition; None where that is not one."""
        known = {"IFaceCenter": 1, "JFaceCenter": 0}
        if place in known:
            return known[place]
        same = [a == b for a, b in zip(low, high, strict=True)]
        return same.index(False) if sum(same) == 1 else None

    def _rows_of(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        return self.start + (j - 1) * self.columns + i - 1

    def _section(self, kind: str, nodes: np.ndarray, number: int) -> Section:
        """Elements that stand nowhere in the file, and that nothing changes."""
        numbers = number + np.arange(len(nodes))
        return Section(kind, nodes, "", np.zeros(len(nodes), np.int64), numbers, self.start)
