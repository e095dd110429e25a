"""Flips towards triangles that are equilateral in a metric field."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from ..mesh.ragged import true_rows
from ..mesh.triangle import Corners
from ..optimising.jacobian import EdgeMap
from .rules import LEAST_GAIN, Quads, finite_energy, new_pair, new_signs, old_pair, old_signs


@dataclass(frozen=True, eq=False)
class MetricRule:
    """The rule `shape_rule` in a metric: flip when the smoother's energy of the two triangles falls.

    The energy of a triangle depends on its vertices only.  Every flip therefore lowers the sum over the mesh, and
    the rounds end.

    metric  (V, 3) from `MetricField.at_vertices`
    """

    metric: Tensor

    def at(self, u: Tensor, w: Tensor, s: Tensor, r: Tensor) -> Callable[[Quads], tuple[Tensor, Tensor]]:
        """The rule for quads of these vertices."""

        def rule(q: Quads) -> tuple[Tensor, Tensor]:
            mu, mw, ms, mr = (self.metric[v] for v in (u, w, s, r))
            (uws, wur), (urs, rws) = old_pair(q), new_pair(q)
            before = _energy(uws, mu + mw + ms) + _energy(wur, mw + mu + mr)
            after = _energy(urs, mu + mr + ms) + _energy(rws, mr + mw + ms)
            wanted = before - after > LEAST_GAIN * before
            rows = true_rows(wanted)
            few = Quads(*(v[rows] for v in q))
            wanted[rows] = torch.stack(old_signs(few) + new_signs(few)).amin(0) > 0
            return wanted, before - after

        return rule


def _energy(t: Corners, metric: Tensor) -> Tensor:
    return finite_energy(EdgeMap.root_of(metric).corners(t))
