"""What moving the vertices of a batch gives back."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from torch import Tensor

if TYPE_CHECKING:
    from ..mesh.curves import BoundaryCurves


@dataclass(frozen=True, eq=False)
class MoveInfo:
    """What a vertex-moving minimisation did, per mesh (B,).

    energy and gradient (root mean square of the gradient per free coordinate, scaled by the local
    edge length) at the end; steps accepted; energies evaluated; `Status` as int64.

    curves  where the sliding vertices are now; None: no vertex may slide
    """

    energy: Tensor
    gradient: Tensor
    iterations: Tensor
    evaluations: Tensor
    status: Tensor
    curves: "BoundaryCurves | None" = None


Monitor = Callable[[int, Tensor], None]
