"""What a method may answer in place of a mesh."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .stopwatch import Seconds

if TYPE_CHECKING:
    from ..mesh.batch import MeshBatch


class Missing(Exception):
    """What the method needs is not installed or not found; the message says what to do."""


class Refused(Exception):
    """The method says that it cannot take this mesh."""


@dataclass(frozen=True, eq=False)
class Result:
    """What a method may return in place of a mesh.

    mesh     the mesh that it made
    seconds  the time that counts, if that is not the time of the whole call: a tool's own, without the way of the mesh
             into its data structures.  A number is the processor time and the wall time
    note     what a reader of the results should know, in a few words
    """

    mesh: "MeshBatch"
    seconds: "Seconds | float | None" = None
    note: str = ""

    def __post_init__(self) -> None:
        if self.seconds is not None and not isinstance(self.seconds, Seconds):
            object.__setattr__(self, "seconds", Seconds(float(self.seconds), float(self.seconds)))
