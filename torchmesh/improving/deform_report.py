"""What `deform` did with each mesh."""

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from ..errors import ConvergenceError
from ..mesh.ragged import true_rows
from ..status import Status
from .report import Report
from .trail import Piece


@dataclass(frozen=True, eq=False)
class DeformReport:
    """What `deform` did, per mesh (B,).

    status    int64 `Status`; VALID where the whole motion was done
    reached   float64, the part of the motion that was done without a tangle; 1 for all of it
    steps     int64, the steps taken
    refused   int64, the steps tried that would have inverted a triangle, and were shortened
    flips     int64, the edges flipped, on the way and on arrival
    path      for each mesh, the parts of the motion at which its steps ended
    messages  for each mesh, why it ended
    report    the `Report` of the improvement on arrival
    rewired   bool, some triangle has other corners than in the mesh given; `tm.rewired` says which
    trail     for each mesh its pieces of constant connectivity, in order: see `Piece`; None unless `deform` was told to
              keep it
    """

    status: Tensor
    reached: Tensor
    steps: Tensor
    refused: Tensor
    flips: Tensor
    path: list[list[float]]
    messages: list[str]
    report: Report
    rewired: Tensor
    trail: list[list[Piece]] | None = None

    @property
    def valid(self) -> Tensor:
        """(B,) bool: every triangle of the mesh is upright, wherever its boundary is."""
        return self.report.valid

    def check(self) -> "DeformReport":
        """Raise ConvergenceError, which names the meshes, unless every mesh did the whole motion and is valid."""
        failed = true_rows(self.status != Status.VALID).tolist()
        if failed:
            shown = "; ".join(f"mesh {b}: {self.messages[b]}" for b in failed[:10])
            more = f"; and {len(failed) - 10} more" if len(failed) > 10 else ""
            raise ConvergenceError(f"{len(failed)} of {len(self.status)} meshes did not arrive: {shown}{more}")
        return self

    def to_dict(self) -> list[dict[str, Any]]:
        """One plain record a mesh, for JSON: no infinities."""
        records = self.report.to_dict()
        columns = ("reached", "steps", "refused", "flips")
        return [
            {
                "mesh": b,
                "status": Status(int(self.status[b])).name.lower(),
                "message": self.messages[b],
                **{name: getattr(self, name)[b].item() for name in columns},
                "rewired": bool(self.rewired[b]),
                "path": self.path[b],
                "improve": {key: value for key, value in records[b].items() if key != "mesh"},
            }
            for b in range(len(self.status))
        ]
