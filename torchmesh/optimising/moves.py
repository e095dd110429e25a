"""The record that every minimisation over vertex positions returns."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from torch import Tensor

if TYPE_CHECKING:
    from ..mesh.curves import BoundaryCurves


@dataclass(frozen=True, eq=False)
class MoveInfo:
    """What a minimisation over vertex positions did, per mesh (B,).

    energy       float64, the energy at the end
    gradient     float64, the root mean square of the gradient over the free coordinates at the end, each entry scaled
                 by the local edge length
    iterations   int64, the steps that were accepted
    evaluations  int64, how often the energy was evaluated
    status       int64, a `Status`
    curves       the boundary curves with the positions of the sliding vertices on them; None if no vertex may slide
    """

    energy: Tensor
    gradient: Tensor
    iterations: Tensor
    evaluations: Tensor
    status: Tensor
    curves: "BoundaryCurves | None" = None


Monitor = Callable[[int, Tensor], None]
