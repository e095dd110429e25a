"""The total lifted content of Du et al. as an energy for `MeshObjective`; torchmesh itself does not use it."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor


@dataclass(frozen=True)
class TotalLiftedContent:
    """The energy sqrt(det^2 + alpha stretch + alpha^2), whose sum is minimised to untangle a mesh.

    Du, Aigerman, Zhou, Kovalsky, Yan, Kaufman & Ju, Lifting simplices to find injectivity, ACM Transactions on
    Graphics 39, 2020.
    """

    stretches: ClassVar[bool] = True
    alpha: Tensor | float = 1e-2

    def value(self, stretch: Tensor, det: Tensor) -> Tensor:
        """(T,) the energy."""
        return torch.sqrt(det * det + self.alpha * stretch + self.alpha * self.alpha)

    def value_and_slopes(self, stretch: Tensor, det: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(T,) the energy, and its derivatives by stretch and by det."""
        phi = self.value(stretch, det)
        return phi, 0.5 * self.alpha / phi, det / phi
