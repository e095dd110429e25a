"""What can be wrong with the boundary and the fixed vertices of a mesh, and how it is told."""

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from .no_place_steps import NoPlace


class ProblemKind(str, Enum):
    """What is wrong; the value says it in words."""

    NOT_FINITE = "a position is no finite number to compute with"
    DUPLICATE_VERTICES = "two fixed vertices in one place"
    BOUNDARY_CROSSING = "the boundary meets itself"
    CONSTRAINT_CROSSING = "a constrained edge meets another or the boundary"
    NO_AREA = "the boundary encloses no positive area"
    HOLE_INSIDE_OUT = "a hole is inside out"
    HOLE_OUTSIDE = "a hole lies outside the outer loop or in another hole"
    VERTEX_OUTSIDE = "a fixed vertex lies outside its region or on an edge"
    NOT_PLANE = "the triangles form a surface that is no part of a plane"
    FIXED_TRIANGLE = "a triangle of three fixed vertices is inverted or flat"
    FIXED_QUAD = "a corner of a quad with three fixed vertices is not upright"
    FIXED_EDGE = "an edge between two fixed vertices leaves the domain or meets another"
    NO_KERNEL = "the fixed edges round a free vertex leave it no place"
    NO_PLACE = "from no place of a free vertex do its edges and triangles reach what they have to reach"

    @property
    def local(self) -> bool:
        """Is the problem one of a place, so that what is out of its reach can be mended?"""
        K = ProblemKind
        return self not in (K.NO_AREA, K.HOLE_INSIDE_OUT, K.HOLE_OUTSIDE, K.NOT_PLANE)

    @property
    def proves(self) -> bool:
        """Is it a proof that no valid mesh exists?

        It is none where a mesh may lie over itself: a strip of more than one turn is valid.
        """
        return self not in (ProblemKind.DUPLICATE_VERTICES, ProblemKind.BOUNDARY_CROSSING)


@dataclass(frozen=True)
class Problem:
    """One reason why a mesh cannot be valid.

    kind      what is wrong
    message   the same with vertex numbers and the position
    mesh      the mesh of the batch
    vertices  the vertices concerned, numbered within their mesh
    place     the position, about, in the mesh's length unit
    proof     of NO_PLACE: the `NoPlace` that `torchmesh.diagnosing.no_place_check.check_no_place` checks step by step
    """

    kind: ProblemKind
    message: str
    mesh: int
    vertices: tuple[int, ...]
    place: tuple[float, float]
    proof: "NoPlace | None" = None


class Finding(NamedTuple):
    """A problem of the mesh that is looked at; which mesh of the batch it is, `diagnose` knows."""

    kind: ProblemKind
    message: str
    vertices: tuple[int, ...]
    place: tuple[float, float]


def position_of(xy: np.ndarray) -> tuple[float, float]:
    """The coordinates (2,) as two numbers."""
    return float(xy[0]), float(xy[1])


def text_of(place: tuple[float, float]) -> str:
    """The position in six digits."""
    return f"({place[0]:.6g}, {place[1]:.6g})"
