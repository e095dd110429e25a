"""Flips towards triangles that are equilateral in a metric field."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from ..mesh.triangle import Corners, inverse_mean_ratio
from ..optimising.jacobian import EdgeMap
from .rules import Quads, new_signs, old_signs


@dataclass(frozen=True, eq=False)
class MetricRule:
    """The flip rule `shape_rule` in a metric: flip when the smoother's energy of the two triangles falls.

    The energy of a triangle depends on nothing but its vertices, so the sum over the mesh falls
    with every flip and rounds cannot cycle.

    metric  (V, 3) from `MetricField.at_vertices`
    """

    metric: Tensor

    def at(self, u: Tensor, w: Tensor, s: Tensor, r: Tensor) -> Callable[[Quads], tuple[Tensor, Tensor]]:
        """The rule for quads of these vertices."""

        def rule(q: Quads) -> tuple[Tensor, Tensor]:
            mu, mw, ms, mr = (self.metric[v] for v in (u, w, s, r))
            before = _energy(Corners(q.ux, q.uy, q.wx, q.wy, q.sx, q.sy), mu + mw + ms)
            before = before + _energy(Corners(q.wx, q.wy, q.ux, q.uy, q.rx, q.ry), mw + mu + mr)
            after = _energy(Corners(q.ux, q.uy, q.rx, q.ry, q.sx, q.sy), mu + mr + ms)
            after = after + _energy(Corners(q.rx, q.ry, q.wx, q.wy, q.sx, q.sy), mr + mw + ms)
            wanted = before - after > 1e-10 * before
            rows = wanted.nonzero().squeeze(1)
            few = Quads(*(v[rows] for v in q))
            wanted[rows] = torch.stack(old_signs(few) + new_signs(few)).amin(0) > 0
            return wanted, before - after

        return rule


def _energy(t: Corners, metric: Tensor) -> Tensor:
    # A flat triangle's infinity must not meet another in a difference.
    return inverse_mean_ratio(EdgeMap.root_of(metric).corners(t)).clamp_max(1e30).square()
