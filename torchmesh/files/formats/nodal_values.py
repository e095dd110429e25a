"""Values that a file gives to single nodes, in lines that stay to the letter when it is changed in place.

A temperature belongs to a position.  Where its node moves, the line keeps the value of the old position, and this must
be told.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np


@dataclass
class NodalValues:
    """What the cards of a file give to nodes.

    given    for each card, by its name, and each row of a node: all that the card gives to it
    nonzero  for each card the rows of nodes with a value that is not zero
    loads    the cards of loads and supports, where zero is the same as nothing
    """

    given: dict[str, dict[int, list[tuple[float | str, ...]]]] = field(default_factory=dict)
    nonzero: dict[str, set[int]] = field(default_factory=dict)
    loads: set[str] = field(default_factory=set)

    def add(
        self, name: str, node: int, texts: Sequence[str], first: int = 0, load: bool = False,
        real: Callable[[str], float] = float,
    ) -> None:  # fmt: skip
        """Notes what the card `name` gives to a node: `texts`, of which those from `first` on are its values.

        load  is it a load or a support
        real  reads a number
        """
        values = tuple(_number(text, real) for text in texts)
        if len(values) <= first:
            return
        self.given.setdefault(name, {}).setdefault(node, []).append(values)
        if any(values[first:]):
            self.nonzero.setdefault(name, set()).add(node)
        if load:
            self.loads.add(name)

    def rows(self, count: int) -> dict[str, np.ndarray]:
        """The rows of the nodes, of `count`, whose values say something of where the nodes are, for each card.

        A field that is zero, or the same at all nodes, is left out: it is right wherever the nodes are.  A load or a
        support of zero is left out, too; a load that is the same at all nodes is not, as it acts at single points.
        """
        found: dict[str, np.ndarray] = {}
        for name, given in self.given.items():
            nonzero, load = self.nonzero.get(name, set()), name in self.loads
            uniform = len(given) == count and len({tuple(values) for values in given.values()}) == 1
            if nonzero and (load or not uniform):
                found[name] = np.array(sorted(nonzero if load else given), np.int64)
        return found


def _number(text: str, real: Callable[[str], float]) -> float | str:
    """The number that a text means, 0 for none; the text itself if it means no number."""
    try:
        return real(text) if text else 0.0
    except ValueError:
        return text
