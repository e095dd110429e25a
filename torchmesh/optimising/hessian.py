"""Second derivatives of mesh energies: products with the Hessian, for linear solves with it.

The forces are phi_s grad stretch + phi_d grad det, both gradients being linear in the edges e.  Along a motion
that changes the edges by d, they change by

    d(phi_s) grad stretch(e) + d(phi_d) grad det(e)  +  phi_s grad stretch(d) + phi_d grad det(d)

so with the slopes and curvatures of phi at hand, a product costs about as much as two gradients, and no matrix
is needed.
"""

import functools
from dataclasses import dataclass

import torch
from torch import Tensor

from ..kernels.block_factors import BlockFactors
from ..kernels.hessian import solved
from ..kernels.library import library_for
from ..mesh.triangle import Corners
from .energies import Energy, slopes_and_curvatures
from .jacobian import (
    Target,
    add_area_slope,
    edge_coordinates,
    four_rows,
    half_stretch_slope,
    inner,
    invariants,
)


@dataclass(frozen=True, eq=False)
class Hessian:
    """The Hessian of the sum of an energy over triangles, at one point.

    rows    (6, T) where ax ay bx by cx cy stand in the vector of all coordinates
    size    N, the length of that vector
    edges   (2, 2, T): x and y of e1 = b - a, then of e2 = c - a
    target  of the energy
    slopes  (2, T) phi by stretch and by det
    curvatures  (3, T) phi by stretch twice, by stretch and det, by det twice
    triangle_offsets  (B+1,) the triangles of each of several meshes that share no unknown; None: nobody knows
    factors  of Hessians nearby, with which systems are solved in fewer steps; None: there are none
    """

    rows: Tensor
    size: int
    edges: Tensor
    target: Target
    slopes: Tensor
    curvatures: Tensor
    triangle_offsets: Tensor | None = None
    factors: BlockFactors | None = None

    @classmethod
    def at(
        cls,
        coordinates: Tensor,
        rows: Tensor,
        energy: Energy,
        target: Target,
        triangle_offsets: Tensor | None = None,
        factors: BlockFactors | None = None,
    ) -> "Hessian":
        """At `coordinates` (N,); the curvatures are those of the energy's `value`, by autograd."""
        rows = rows.long()
        t = Corners(*coordinates.detach()[rows])
        edges = torch.stack(edge_coordinates(t)).view(2, 2, -1)
        derivatives = slopes_and_curvatures(energy, *invariants(t, target))
        return cls(rows, len(coordinates), edges, target, *derivatives, triangle_offsets, factors)

    def solved(
        self, right: Tensor, diagonal: Tensor, offsets: Tensor, tolerance: Tensor | float, max_iterations: int
    ) -> tuple[Tensor, Tensor, Tensor] | None:
        """What the compiled solver finds, as in `conjugate_gradients.solve`; None where torch is to do the work."""
        if self.triangle_offsets is None or right.dtype != torch.float64 or library_for(right) is None:
            return None
        triangles = self.rows, self.edges, self.slopes, self.curvatures
        known = triangles, self.target, self.triangle_offsets
        return solved(*known, offsets, diagonal, right, tolerance, max_iterations, self.factors)

    def __matmul__(self, u: Tensor) -> Tensor:
        """(N,) the product with u (N,)."""
        corner = u[self.rows].view(3, 2, -1)
        motion = corner[1:] - corner[0]
        of_stretch, of_det = self._first_derivatives
        by_stretch = inner(four_rows(of_stretch), four_rows(motion))
        by_det = inner(four_rows(of_det), four_rows(motion))
        ss, sd, dd = self.curvatures
        forces = self._forces(motion, *self.slopes)
        forces.addcmul_(of_stretch, ss * by_stretch + sd * by_det)
        forces.addcmul_(of_det, sd * by_stretch + dd * by_det)
        return self._gathered(_on_corners(forces))

    def gradient(self) -> Tensor:
        """(N,) the gradient of the energy's sum."""
        return self._gathered(_on_corners(self._forces(self.edges, *self.slopes)))

    def diagonal(self) -> Tensor:
        """(N,) the diagonal."""
        g11, g12, g22, _ = self.target
        ss, sd, dd = self.curvatures
        p, q = (_on_corners(v) for v in self._first_derivatives)
        diagonal = ss * p * p + 2 * sd * p * q + dd * q * q
        for corner, second in enumerate((g11 + 2 * g12 + g22, g11, g22)):
            diagonal[corner] += 2 * self.slopes[0] * second
        return self._gathered(diagonal)

    @functools.cached_property
    def _first_derivatives(self) -> tuple[Tensor, Tensor]:
        """(2, 2, T) each, of stretch and of det by the edges."""
        one, zero = torch.ones_like(self.slopes[0]), torch.zeros_like(self.slopes[0])
        return self._forces(self.edges, one, zero), self._forces(self.edges, zero, one)

    def _forces(self, e: Tensor, by_stretch: Tensor, by_det: Tensor) -> Tensor:
        """(2, 2, T) of edges e (2, 2, T) and slopes (T,): the derivatives by the edges."""
        forces = torch.empty_like(e)
        half_stretch_slope(e, self.target, out=forces)
        forces.mul_(2 * by_stretch)
        add_area_slope(four_rows(e), self.target.m * by_det, to=four_rows(forces))
        return forces

    def _gathered(self, corner: Tensor) -> Tensor:
        """(N,) sums of numbers (3, 2, T), one for each coordinate of each corner."""
        out = self.slopes.new_zeros(self.size)
        return out.index_add_(0, self.rows.view(-1), corner.view(-1))


def _on_corners(forces: Tensor) -> Tensor:
    """(3, 2, T) forces on a, b and c, of those on b and c (2, 2, T)."""
    return torch.cat([-forces.sum(0, keepdim=True), forces])
