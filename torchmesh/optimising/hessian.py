"""Second derivatives of mesh energies: products with the Hessian, and linear solves with it.

An energy phi(stretch, det) has two slopes and three curvatures.  They are taken once; after that a
product with the Hessian costs about as much as a gradient and needs no matrix:

    d force = d(phi_s) grad stretch + d(phi_d) grad det + phi_s d(grad stretch) + phi_d d(grad det)
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from ..mesh.triangle import Corners
from .energies import Energy, Target, invariants


@dataclass(frozen=True, eq=False)
class Hessian:
    """The Hessian of the sum of an energy over triangles, at one place.

    rows    (6, T) where ax ay bx by cx cy stand in the vector of all coordinates
    size    N, the length of that vector
    e       four (T,): the edges e1 = b - a and e2 = c - a, as x, y, x, y
    target  of the energy
    slopes  (2, T) phi by stretch and by det
    curvatures  (3, T) phi by stretch twice, by stretch and det, by det twice
    """

    rows: Tensor
    size: int
    e: tuple[Tensor, Tensor, Tensor, Tensor]
    target: Target
    slopes: Tensor
    curvatures: Tensor

    @classmethod
    def at(cls, coordinates: Tensor, rows: Tensor, energy: Energy, target: Target) -> "Hessian":
        """At `coordinates` (N,); the curvatures are those of the energy's `value`, by autograd."""
        rows = rows.long()
        with torch.no_grad():
            t = Corners(*coordinates[rows])
            stretch, det = invariants(t, target)
        with torch.enable_grad():
            s, d = stretch.requires_grad_(), det.requires_grad_()
            by_s, by_d = torch.autograd.grad(
                energy.value(s, d).sum(), (s, d), create_graph=True, allow_unused=True, materialize_grads=True
            )
            ss, sd = _slopes(by_s, s, d)
            _, dd = _slopes(by_d, s, d)
        return cls(
            rows,
            len(coordinates),
            (t.bx - t.ax, t.by - t.ay, t.cx - t.ax, t.cy - t.ay),
            target,
            torch.stack([by_s.detach(), by_d.detach()]),
            torch.stack([ss, sd, dd]),
        )

    def __matmul__(self, u: Tensor) -> Tensor:
        """(N,) the product with u (N,)."""
        ax, ay, bx, by, cx, cy = u[self.rows]
        e1x, e1y, e2x, e2y = self.e
        d1x, d1y, d2x, d2y = bx - ax, by - ay, cx - ax, cy - ay
        m = self.target.m
        # Half the gradient of the stretch by e1 and e2, and how it changes.
        s1x, s1y, s2x, s2y = self._half_stretch(*self.e)
        ds1x, ds1y, ds2x, ds2y = self._half_stretch(d1x, d1y, d2x, d2y)
        ds = 2 * (s1x * d1x + s1y * d1y + s2x * d2x + s2y * d2y)
        dd = m * (d1x * e2y + e1x * d2y - d1y * e2x - e1y * d2x)
        by_s, by_d = self.slopes
        ss, sd, dd2 = self.curvatures
        change_s, change_d = 2 * (ss * ds + sd * dd), m * (sd * ds + dd2 * dd)
        by_s, by_d = 2 * by_s, m * by_d
        f1x = change_s * s1x + by_s * ds1x + change_d * e2y + by_d * d2y
        f1y = change_s * s1y + by_s * ds1y - change_d * e2x - by_d * d2x
        f2x = change_s * s2x + by_s * ds2x - change_d * e1y - by_d * d1y
        f2y = change_s * s2y + by_s * ds2y + change_d * e1x + by_d * d1x
        return self._scattered(-f1x - f2x, -f1y - f2y, f1x, f1y, f2x, f2y)

    def gradient(self) -> Tensor:
        """(N,) the gradient of the energy's sum."""
        e1x, e1y, e2x, e2y = self.e
        s1x, s1y, s2x, s2y = (2 * self.slopes[0] * v for v in self._half_stretch(*self.e))
        d = self.target.m * self.slopes[1]
        f1x, f1y, f2x, f2y = s1x + d * e2y, s1y - d * e2x, s2x - d * e1y, s2y + d * e1x
        return self._scattered(-f1x - f2x, -f1y - f2y, f1x, f1y, f2x, f2y)

    def diagonal(self) -> Tensor:
        """(N,) the diagonal."""
        e1x, e1y, e2x, e2y = self.e
        g11, g12, g22, m = self.target
        s1x, s1y, s2x, s2y = self._half_stretch(*self.e)
        ss, sd, dd = self.curvatures

        def entry(by_stretch: Tensor, by_det: Tensor, second: Tensor | float) -> Tensor:
            p, q = 2 * by_stretch, m * by_det
            return ss * p * p + 2 * sd * p * q + dd * q * q + 2 * self.slopes[0] * second

        first = g11 + 2 * g12 + g22
        return self._scattered(
            entry(-s1x - s2x, e1y - e2y, first),
            entry(-s1y - s2y, e2x - e1x, first),
            entry(s1x, e2y, g11),
            entry(s1y, -e2x, g11),
            entry(s2x, -e1y, g22),
            entry(s2y, e1x, g22),
        )

    def _half_stretch(
        self, e1x: Tensor, e1y: Tensor, e2x: Tensor, e2y: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        g11, g12, g22, _ = self.target
        return g11 * e1x + g12 * e2x, g11 * e1y + g12 * e2y, g12 * e1x + g22 * e2x, g12 * e1y + g22 * e2y

    def _scattered(self, *forces: Tensor) -> Tensor:
        out = self.slopes.new_zeros(self.size)
        for row, force in zip(self.rows, forces, strict=True):
            out.index_add_(0, row, force)
        return out


def _slopes(of: Tensor, s: Tensor, d: Tensor) -> tuple[Tensor, Tensor]:
    if not of.requires_grad:
        return torch.zeros_like(s), torch.zeros_like(d)
    by_s, by_d = torch.autograd.grad(of.sum(), (s, d), retain_graph=True, allow_unused=True, materialize_grads=True)
    return by_s, by_d
