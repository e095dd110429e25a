"""A case and a family of them, which has one number that makes it harder.

    family, number --seeded generator--> undeformed mesh, motion --> tangled mesh

What case k of a family is depends on the family and on k alone.  Levels of difficulty follow one another, so that the
first N cases of a family cover all of them.
"""

import functools
import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.measure import quality

# The number of cases in each family, and how often one is drawn anew until its boundary is simple.
COUNT = 1200
_TRIES = 40

# So often a case is drawn anew if it is not tangled, as happens at the easiest levels.
_TANGLE_TRIES = 6


@dataclass(frozen=True, eq=False)
class Case:
    """One case.

    family, number  its name
    level           how hard it is, in the family's unit
    undeformed      the valid mesh before it was tangled
    mesh            the tangled mesh that a method is given: a batch of one, on the CPU, float64
    path            further positions (V, 2) of the boundary, for a sequence of motions: what a method makes of one step
                    follows the boundary to the next one
    details         what else was drawn, by name
    """

    family: str
    number: int
    level: float
    undeformed: MeshBatch
    mesh: MeshBatch
    path: tuple[Tensor, ...] = ()
    details: dict[str, Any] = field(default_factory=dict)

    @functools.cached_property
    def digest(self) -> str:
        """The first half of the SHA-256 of points and triangles: the same on two machines, the case is the same."""
        digest = hashlib.sha256()
        for array in (self.mesh.points, self.mesh.triangles, self.mesh.quads, self.undeformed.points, *self.path):
            digest.update(array.numpy().tobytes())
        return digest.hexdigest()[:32]

    @property
    def inverted(self) -> int:
        """How many triangles are inverted or flat."""
        return int(quality(self.mesh).inverted)


# From random numbers, the level and the number of the case to the case; None: to be drawn anew.
Draw = Callable[[np.random.Generator, float], "Drawn | None"]


@dataclass(frozen=True, eq=False)
class Drawn:
    """What a family draws: the undeformed mesh, the tangled positions (V, 2), the path, and details."""

    undeformed: MeshBatch
    points: Tensor
    path: tuple[Tensor, ...] = ()
    details: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Family:
    """A family of cases.

    name    in the results
    draw    makes one
    levels  the numbers that make it harder, in order
    unit    what they are, for a picture's axis
    words   what the cases are, in one sentence
    needs   "" or what must be there to draw them: "weights", those of the network
    """

    name: str
    draw: Draw
    levels: tuple[float, ...]
    unit: str
    words: str
    needs: str = ""

    def __len__(self) -> int:
        return COUNT

    def level(self, number: int) -> float:
        """How hard the case of that number is."""
        return self.levels[number % len(self.levels)]

    def case(self, number: int) -> Case:
        """The case of that number, which may be COUNT and more: these are no part of the benchmark, but to train on.

        Raises Missing where what it needs is not there.
        """
        level = self.level(number)
        key = int.from_bytes(self.name.encode(), "little")
        found = None
        for attempt in range(_TRIES):
            drawn = self.draw(np.random.default_rng([key, number, attempt]), level)
            if drawn is not None:
                mesh = drawn.undeformed.with_points(drawn.points)
                found = Case(self.name, number, level, drawn.undeformed, mesh, drawn.path, drawn.details)
            if found is not None and (found.path or found.inverted or attempt >= _TANGLE_TRIES):
                return found
        raise RuntimeError(f"{self.name}: case {number} was drawn {_TRIES} times and none had a simple boundary")
